"""The whole chain on a meridional line, beside other computations of the same."""

import numpy as np
import pytest

from lensdesign import Pose, scaled
from lensdesign.errors import InputError
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.reconstructed_contrast import ReconstructedContrast
from tolerancing.merits.reconstruction.line_imaging_chain import LineImagingChain, ReconstructionEngine
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from wavesim import resolve
from wavesim.fields.field import Field
from wavesim.scene.system_state import AS_DESIGNED, SystemState

EIKONAL = ReconstructionEngine("eikonal")


def chain_of(lens, widths=(0.775, 1.55), **keys):
    return LineImagingChain(lens, 0.0, 0.05, lens.sensor.plane_distances_mm, "lines", widths, 0.532, **keys)


@pytest.fixture(scope="module")
def twin(paper_lens):
    return scaled(paper_lens, 1 / 16)


@pytest.fixture(scope="module")
def chain(twin):
    return chain_of(twin)


def scores(chain, pose=None, engine=EIKONAL, **keys):
    recorded = chain.record(SystemState(pose or Pose()), None, 12, None)
    return chain.reconstruct(recorded, engine, iterations=40, **keys)


def random_values(grid, seed):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(grid.size) + 1j * rng.standard_normal(grid.size)


@pytest.mark.parametrize("engine", [EIKONAL, ReconstructionEngine("slices", 4, "oblique")])
@pytest.mark.parametrize("refocus_um", [0.0, 3.0])
def test_the_way_back_is_the_adjoint_of_the_way_there(chain, engine, refocus_um):
    operator = chain.operator(engine, refocus_um=refocus_um)
    exit_grid, grid = operator.scene.exit_grid, operator.scene.object_grid
    one = Field(grid, random_values(grid, 1), 0.532)
    other = Field(exit_grid, random_values(exit_grid, 2), 0.532)
    there = exit_grid.cell * np.vdot(other.values, operator.forward(one).values)
    back = grid.cell * np.vdot(operator.adjoint(other).values, one.values)
    assert there == pytest.approx(back, rel=1e-5)


def test_pixels_get_the_energy_of_the_light(chain):
    lit = Field(chain.scene.object_grid, chain.object.transmission, 0.532).energy
    pitch_mm = 1e-3 * chain.lens.sensor.pixel_pitch_um
    for plane in chain.record(AS_DESIGNED, None, 12, None):
        assert pitch_mm * np.sum(plane.amplitude**2) == pytest.approx(lit, rel=0.05)


def test_the_lens_at_its_own_size_gives_the_object_back(paper_lens):
    found = scores(chain_of(paper_lens))
    assert found.correlation > 0.97
    assert min(found.contrasts) > 0.97


def test_nominal_lens_agrees_with_the_resolving_test(paper_lens):
    (line,) = resolve(paper_lens, (0.775,), engine="slices", slices=10, compensation="oblique").lines
    found = scores(chain_of(paper_lens))
    assert found.contrasts[0] == pytest.approx(line.contrast_of_reference, abs=0.03)
    # The same slices carry the light to the sensor; what they err by is the same on either way.
    by_slices = scores(chain_of(paper_lens, imaging="slices", imaging_slices=10))
    assert by_slices.contrasts[0] == pytest.approx(line.contrast, abs=0.03)


def test_agrees_with_the_chain_in_the_plane_for_meridional_perturbations(paper_lens):
    small = scaled(paper_lens, 1 / 48)
    keys = {"line_width_um": 1.2, "patch_mm": 0.05, "orientation": "y", "iterations": 5, "refocus": False}
    plane = ReconstructedContrast(kind="reconstructed_contrast", at_least=0.5, **keys)
    decenter = PerturbedParameter(target="lens", parameter="decenter_y_mm")
    values = np.array([[0.0], [0.008]])
    in_plane = plane.scores(Context(small, Sampling()), PerturbationBatch((decenter,), values))
    chain = chain_of(small, (1.2,))
    on_line = [scores(chain, Pose(decenter_y_mm=d)).contrasts[0] for d in values[:, 0]]
    assert on_line[0] == pytest.approx(in_plane[0], abs=0.03)
    assert max(on_line[1], in_plane[1]) < 0.3


def test_what_the_nominal_model_loses_the_true_one_finds(chain):
    moved = Pose(decenter_y_mm=0.004)
    assert scores(chain, moved).correlation < 0.7
    assert scores(chain, moved, model=SystemState(moved)).correlation > 0.97


@pytest.mark.parametrize("field_mm", [0.0, 0.6])
def test_noise_of_2000_electrons_leaves_the_lines_of_the_lens_at_its_own_size(paper_lens, field_mm):
    """A retrieval with too large steps on noise found a correlation of 0.57 at the field's edge."""
    lens = paper_lens
    chain = LineImagingChain(
        lens, field_mm, 0.05, lens.sensor.plane_distances_mm, "lines", (0.775, 1.55), 0.532
    )
    recorded = chain.record(AS_DESIGNED, 2000.0, 12, np.random.SeedSequence(3))
    assert chain.reconstruct(recorded, EIKONAL, iterations=40).correlation > 0.97


def test_refuses_a_focus_beyond_the_margin(chain):
    with pytest.raises(InputError, match=r"50 µm.* 13\.9 µm"):
        chain.operator(EIKONAL, refocus_um=50.0)


def test_noise_is_that_of_its_seed(chain):
    noise = [np.random.SeedSequence(number) for number in (1, 1, 2)]
    frames = [chain.record(AS_DESIGNED, 1000.0, 12, seed) for seed in noise]
    assert np.array_equal(frames[0][0].amplitude, frames[1][0].amplitude)
    assert not np.array_equal(frames[0][0].amplitude, frames[2][0].amplitude)
    assert chain.reconstruct(frames[0], EIKONAL, iterations=40).correlation > 0.9
