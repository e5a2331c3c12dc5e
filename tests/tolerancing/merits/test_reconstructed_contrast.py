"""Contrast after the whole chain, on a small twin of the paper's lens."""

import numpy as np
import pytest
from pydantic import ValidationError

from lensdesign.errors import InputError
from tolerancing.merits.bars import DARK
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.reconstructed_contrast import ReconstructedContrast
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter

DECENTER = PerturbedParameter(target="lens", parameter="decenter_y_mm")
OBJECT = PerturbedParameter(target="object", parameter="decenter_x_mm")
SMALL = {"line_width_um": 1.2, "patch_mm": 0.05, "orientation": "y", "iterations": 5}


def merit(**keys):
    return ReconstructedContrast(kind="reconstructed_contrast", at_least=0.5, **SMALL | keys)


@pytest.fixture(scope="module")
def context(twin):
    return Context(twin, Sampling(), noise_seed=11)


@pytest.fixture(scope="module")
def chain(twin):
    return merit(orientation="worse")._chain(twin)


@pytest.fixture(scope="module")
def quiet(context):
    """Without noise: the nominal lens, a displaced object, a lens beside the axis."""
    values = np.array([[0.0, 0.0], [0.001, 0.0], [0.0, 0.008]])
    return merit().scores(context, PerturbationBatch((OBJECT, DECENTER), values))


def test_nominal_lens_gives_the_bars_back(quiet):
    assert quiet[0] > 0.95


def test_displaced_object_is_no_blur(quiet):
    assert quiet[1] == pytest.approx(quiet[0], abs=0.02)


def test_lens_beside_its_place_takes_contrast(quiet):
    assert quiet[2] < 0.5 * quiet[0]


def test_noise_takes_contrast_and_belongs_to_the_trial(context, quiet):
    noisy = merit(electrons=100.0)
    batch = PerturbationBatch((DECENTER,), np.zeros((2, 1)), trial_numbers=(3, 7))
    together = noisy.scores(context, batch)
    assert np.all(together < quiet[0] - 0.02)
    assert together[0] != together[1]
    assert noisy.scores(context, batch.trial(1))[0] == together[1]


def system_of(lens, target, parameter, value):
    one = PerturbedParameter(target=target, parameter=parameter)
    batch = PerturbationBatch((one,), np.array([[value]]))
    return batch.states(lens, lens.wavelengths_um[0])[0]


def scene_of(chain, system):
    return chain.recording(system, None, 12, None).scene(chain.lens, chain.patch)


def test_dispersion_counts_once(twin, chain):
    scene = scene_of(chain, system_of(twin, "light", "wavelength_um", 0.01))
    assert scene.wavelength_um == pytest.approx(0.542)
    assert scene.system.index[0] == pytest.approx(twin.indices(0.542), abs=1e-12)


def test_scene_holds_object_and_sensor_where_they_are(twin, chain):
    nominal = scene_of(chain, system_of(twin, "lens", "decenter_x_mm", 0.0))
    away = scene_of(chain, system_of(twin, "object", "working_distance_mm", 0.002)).object_grid
    assert away.z_mm == pytest.approx(nominal.object_grid.z_mm - 0.002)
    nearer = scene_of(chain, system_of(twin, "sensor", "plane_distance_1_mm", -0.003)).exit_grid
    assert nearer.z_mm == pytest.approx(nominal.exit_grid.z_mm - 0.003)
    aside = scene_of(chain, system_of(twin, "sensor", "decenter_x_mm", 0.004)).exit_grid
    assert aside.centre_mm == pytest.approx((0.004, 0.0))


@pytest.mark.parametrize("steps", [(0, 0), (3, -2), (-5, 4)])
def test_contrast_is_measured_where_the_bars_show(chain, steps):
    moved = np.roll(chain.transmission, steps, (0, 1))
    shift_um = 1e3 * chain.patch.grid.pitch_mm * np.array(steps[::-1])
    assert min(chain.contrasts(moved, shift_um)) > 0.99
    shown = 1e3 * chain._displacement_mm(np.abs(moved) ** 2, np.array([[-0.004, -0.004], [0.004, 0.004]]))
    assert shown == pytest.approx(shift_um, abs=1e-9)


def test_contrast_of_even_bars_is_that_of_their_intensities(chain):
    grey = 0.5 + 0.5 * chain.transmission
    assert chain.contrasts(grey, np.zeros(2)) == pytest.approx([(1 - 0.25) / (1 + 0.25)] * 2, abs=0.02)
    assert max(chain.contrasts(np.ones_like(grey), np.zeros(2))) == pytest.approx(0.0, abs=1e-9)


def test_what_is_all_but_black_shows_nothing(chain):
    """A bright border and hardly any light where the bars ought to be, but in their pattern."""
    faint = 0.01 * chain.transmission
    faint[:4] = 1.0
    assert max(chain.contrasts(faint, np.zeros(2))) < 1e-4 / DARK + 1e-6


def test_refuses_bars_beyond_the_field_stop(chain):
    with pytest.raises(InputError, match=r"patch_mm = 0\.05: the image is shifted"):
        chain.contrasts(chain.transmission, np.array([0.0, 20.0]))


def test_refuses_planes_that_tell_too_little(paper_lens):
    one = merit(patch_mm=0.1)
    with pytest.raises(InputError, match=r"patch_mm = 0\.1: .*diversity.*lensdesign scale"):
        one.check(paper_lens)
    with pytest.raises(InputError, match="diversity"):
        one.scores(Context(paper_lens, Sampling()), PerturbationBatch((DECENTER,), np.zeros((1, 1))))


def test_refuses_a_patch_larger_than_the_field(twin):
    with pytest.raises(InputError, match="field_diameter_mm"):
        merit(patch_mm=0.1).check(twin)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"patch_mm": 0.012}, r"field stop of 0.0153 mm"),
        ({"level": "pupil"}, "allowed: auto, wave"),
        ({"method": "magic"}, "method"),
        ({"electrons": 1.0}, "electrons"),
    ],
)
def test_refuses_bad_keys(keys, message):
    with pytest.raises(ValidationError, match=message):
        merit(**keys)


def test_refuses_compensators(twin):
    own = Compensator(target="lens", parameter="decenter_y_mm", limit=0.01)
    with pytest.raises(InputError, match="lens_decenter_y_mm"):
        merit().scores(Context(twin, Sampling(), (own,)), PerturbationBatch((DECENTER,), np.zeros((1, 1))))
