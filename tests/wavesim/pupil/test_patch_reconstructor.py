"""The patch reconstructor against full engines, exact identities, the isoplanatic pupil, and noise."""

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from places import DESIGNS

from lensdesign import InputError, Pose, SurfacePerturbation, load_design, scaled
from lensdesign.errors import SamplingError
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.fields.field import Field, Grid, Orientation, correlation
from wavesim.pupil.characteristic import PupilSampler
from wavesim.pupil.line_pairs import line_pair_contrast
from wavesim.pupil.patch_reconstruction import PerturbedPatch, ReconstructedPatch
from wavesim.pupil.patch_reconstructor import PatchReconstructor, patch_bar_contrast
from wavesim.pupil.pupil import refocus
from wavesim.pupil.ray_aiming import RayAimError
from wavesim.rays.ray_bundles import FoldError
from wavesim.scene.patches import exit_grid
from wavesim.scene.scene import Scene
from wavesim.scene.system_state import SystemState
from wavesim.targets.patterns import band_limit

Values = NDArray[np.complex128]

PAPER = load_design(DESIGNS / "paper_singlet.toml")
WAVELENGTH_UM = PAPER.wavelengths_um[0]
FINE_UM, COARSE_UM = 0.775, 1.55


@pytest.fixture(scope="module")
def line() -> PatchReconstructor:
    return PatchReconstructor(PAPER, line=True)


@pytest.fixture(scope="module")
def plane() -> PatchReconstructor:
    return PatchReconstructor(PAPER, samples=131)


@pytest.fixture(scope="module")
def off_axis() -> PatchReconstructor:
    return PatchReconstructor(PAPER, field_mm=(0.4, -1.0), patch_um=20.0)


def speckle(model: PatchReconstructor, seed: int = 1) -> Values:
    """Light of all directions, dark towards the patch's border."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(model.patch.shape) + 1j * rng.standard_normal(model.patch.shape)
    window = np.hanning(model.patch.shape[0])
    return np.asarray(values * (window if model.line else np.outer(window, window)))


def difference(found: Values, truth: Values) -> float:
    """Relative L2, whatever the phase common to all."""
    overlap = np.vdot(found, truth)
    return float(np.linalg.norm(found * overlap / abs(overlap) - truth) / np.linalg.norm(truth))


def by_engines(
    model: PatchReconstructor,
    reconstructed: ReconstructedPatch,
    values: Values,
    pose: Pose,
    **settings: Any,
) -> Values:
    """Eikonal tiles through the whole exit field, and back to where the object shows."""
    lens, grid = model.lens, model.rays.base.grid
    distance = model.plane_distance_mm
    ends = exit_grid(lens, WAVELENGTH_UM, distance, len(model.patch.shape))
    x, y = model.field_mm

    def scene(pose: Pose, moved_um: NDArray[np.float64]) -> Scene:
        centre = (x + 1e-3 * float(moved_um[0]), y + 1e-3 * float(moved_um[1]))
        start = Grid(model.patch.shape, 1e-3 * model.patch.pitch_um, lens.object_z_mm, centre)
        return Scene(lens, start, ends, grid.wavelength_um, pose)

    forward = FlatTiles(scene(pose, np.zeros(2)), **settings)
    field = forward.forward(Field(forward.scene.object_grid, values, WAVELENGTH_UM))
    return np.asarray(FlatTiles(scene(Pose(), reconstructed.shift_um), **settings).adjoint(field).values)


@pytest.mark.parametrize("name", ["line", "plane"])
def test_the_nominal_lens_brings_back_what_the_stop_lets_through(
    name: str, request: pytest.FixtureRequest
) -> None:
    model: PatchReconstructor = request.getfixturevalue(name)
    count, pad = model.patch.shape[0], model.patch.shape[0]
    # The adjoint's weight cos(t_obj) / cos(t_out) is felt where light goes in all directions.
    for values, least in ((model.bars(FINE_UM), 0.999), (speckle(model), 0.998)):
        wide = np.pad(values, pad)
        grid = Grid(wide.shape, 1e-3 * model.patch.pitch_um, -13.5)
        sine = model.rays.base.grid.half_width
        passed = band_limit(wide, grid, WAVELENGTH_UM, sine)[(slice(pad, pad + count),) * values.ndim]
        reconstructed = model.reconstruct(values)
        assert correlation(reconstructed, passed) > least
        assert np.linalg.norm(reconstructed) == pytest.approx(np.linalg.norm(passed), rel=0.1)


@pytest.mark.parametrize("height_mm", [0.0, 1.0])
@pytest.mark.parametrize("pose", [Pose(), Pose(tilt_x_deg=0.1), Pose(decenter_y_mm=0.03)])
def test_on_a_line_it_is_what_engines_bring_back_from_the_whole_exit_field(
    height_mm: float, pose: Pose
) -> None:
    model = PatchReconstructor(PAPER, (0.0, height_mm), line=True)
    bars = model.bars(FINE_UM)
    reconstructed = model.perturbed(pose).reconstruct(bars, "shift")
    assert difference(reconstructed.values, by_engines(model, reconstructed, bars, pose, error=1e-3)) < 1e-2


def test_without_registration_phase_and_size_are_those_of_the_engines(line: PatchReconstructor) -> None:
    pose, bars = Pose(tilt_x_deg=0.1, despace_mm=0.005), line.bars(FINE_UM)
    reconstructed = line.perturbed(pose).reconstruct(bars)
    truth = by_engines(line, reconstructed, bars, pose, error=1e-3)
    assert np.linalg.norm(reconstructed.values - truth) < 1e-2 * np.linalg.norm(truth)
    np.testing.assert_array_equal(line.reconstruct(bars, pose), reconstructed.values)


@pytest.mark.parametrize(
    ("height_mm", "pose"), [(0.0, Pose(tilt_x_deg=0.1)), (0.06, Pose(decenter_y_mm=0.002))]
)
def test_in_the_plane_it_is_what_engines_bring_back_through_a_small_twin(
    height_mm: float, pose: Pose
) -> None:
    twin = scaled(PAPER, 1.0 / 16.0)
    model = PatchReconstructor(
        twin, (0.0, height_mm), plane_distance_mm=3.0 / 16.0, patch_um=12.0, samples=131
    )
    bars = model.bars(FINE_UM)
    reconstructed = model.perturbed(pose).reconstruct(bars, "shift")
    assert difference(reconstructed.values, by_engines(model, reconstructed, bars, pose, error=1e-2)) < 2e-2


@pytest.mark.parametrize(
    "pose", [Pose(), Pose(tilt_x_deg=0.3), Pose(tilt_x_deg=0.5), Pose(decenter_x_mm=0.03, tilt_y_deg=-0.2)]
)
@pytest.mark.parametrize("orientation", ["x", "y"])
def test_contrast_is_near_that_of_an_isoplanatic_pupil(
    plane: PatchReconstructor, pose: Pose, orientation: Orientation
) -> None:
    sampler = PupilSampler(PAPER, samples=131)
    trial = plane.perturbed(pose)
    expected = line_pair_contrast(refocus(sampler.pupil(pose)).pupil, FINE_UM, orientation)
    # The adjoint weights the rim's light with cos(t_obj) / cos(t_out), which the pupil leaves out.
    assert patch_bar_contrast(trial, FINE_UM, orientation) == pytest.approx(expected, abs=0.025)


@settings(max_examples=8, deadline=None)
@given(x=st.floats(-0.01, 0.01), y=st.floats(-0.01, 0.01), z=st.floats(-0.02, 0.02))
def test_to_shift_the_lens_is_to_shift_object_and_sensor_the_other_way(
    off_axis: PatchReconstructor, x: float, y: float, z: float
) -> None:
    bars = off_axis.bars(FINE_UM)
    lens = off_axis.reconstruct(bars, Pose(decenter_x_mm=x, decenter_y_mm=y, despace_mm=z))
    ends = off_axis.reconstruct(bars, SystemState(object_shift_mm=(-x, -y, -z), sensor_shift_mm=(-x, -y, -z)))
    # Rays at the very rim may be let through in one and not in the other.
    assert np.linalg.norm(lens - ends) < 2e-3 * np.linalg.norm(lens)


def test_a_shifted_object_shows_where_it_is(off_axis: PatchReconstructor) -> None:
    bars = off_axis.bars(FINE_UM, "x")
    nominal = off_axis.reconstruct(bars)
    reconstructed = off_axis.perturbed(SystemState(object_shift_mm=(0.004, -0.006, 0.003))).reconstruct(
        bars, "focus"
    )
    np.testing.assert_allclose(reconstructed.shift_um, [4.0, -6.0], atol=0.05)
    assert reconstructed.refocus_um == pytest.approx(3.0, abs=0.05)
    assert difference(reconstructed.values, nominal) < 0.02


def test_line_and_plane_agree_for_bars_much_longer_than_wide() -> None:
    line, plane = PatchReconstructor(PAPER, line=True), PatchReconstructor(PAPER)
    pose = Pose(tilt_x_deg=0.3)
    found = [patch_bar_contrast(c.perturbed(pose), FINE_UM, refocused=False) for c in (line, plane)]
    assert found[0] == pytest.approx(found[1], abs=0.03)


def test_tilt_takes_fine_lines_away_and_decenter_does_not(
    plane: PatchReconstructor, line: PatchReconstructor
) -> None:
    for model in (plane, line):
        whole, tilted, moved = (
            patch_bar_contrast(model.perturbed(pose), FINE_UM)
            for pose in (Pose(), Pose(tilt_x_deg=0.5), Pose(decenter_y_mm=0.05))
        )
        assert whole > 0.98
        assert tilted < whole - 0.15
        assert moved > whole - 0.02
        assert patch_bar_contrast(model.perturbed(Pose(tilt_x_deg=0.5)), COARSE_UM) > 0.95


@pytest.mark.parametrize("name", ["line", "plane"])
def test_defocus_reverses_lines_and_refocusing_brings_them_back(
    name: str, request: pytest.FixtureRequest
) -> None:
    model: PatchReconstructor = request.getfixturevalue(name)
    # Half a wave between the order along the axis and the first ones.
    axial = np.sqrt(1.0 - (0.5 * WAVELENGTH_UM / FINE_UM) ** 2)
    distance_mm = 0.5e-3 * WAVELENGTH_UM / (1.0 - axial)
    trial = model.perturbed(SystemState(object_shift_mm=(0.0, 0.0, distance_mm)))
    assert patch_bar_contrast(trial, FINE_UM, refocused=False) < -0.3
    assert patch_bar_contrast(trial, FINE_UM) > 0.97
    reconstructed = trial.reconstruct(model.bars(FINE_UM), "focus")
    assert reconstructed.refocus_um == pytest.approx(1e3 * distance_mm, rel=0.02)


def test_surfaces_are_perturbed_too(plane: PatchReconstructor) -> None:
    trial = plane.perturbed(SystemState(surface_perturbations={1: SurfacePerturbation(tilt_x_deg=0.2)}))
    assert patch_bar_contrast(trial, FINE_UM) < 0.9


def test_light_that_the_perturbed_stop_takes_away_is_missing(line: PatchReconstructor) -> None:
    moved = line.perturbed(Pose(decenter_y_mm=-0.05))
    lost = ~moved.aimed.valid
    assert 0 < np.count_nonzero(lost) < 0.02 * len(lost)
    light = moved.reconstruct(speckle(line), "shift").spectrum[line.rays.base.grid.inside]
    assert np.all(light[lost] == 0.0)
    assert np.all(light[~lost] != 0.0)


def test_noise_is_that_of_the_pixels(line: PatchReconstructor) -> None:
    """White noise on every pixel of the exit plane, brought back by the engine."""
    bars, electrons = line.bars(FINE_UM), 1e4
    trial = line.perturbed()
    clean = trial.reconstruct(bars).values
    rng = np.random.default_rng(5)
    power = np.mean(
        [np.abs(trial.reconstruct(bars, "none", electrons, rng).values - clean) ** 2 for _ in range(400)]
    )
    start = Grid(line.patch.shape, 1e-3 * line.patch.pitch_um, PAPER.object_z_mm)
    pitch = 1e-3 * PAPER.sensor.pixel_pitch_um
    ends = Grid((5800,), pitch, PAPER.exit_vertex_z_mm + 3.0)
    engine = FlatTiles(Scene(PAPER, start, ends, WAVELENGTH_UM))
    field = np.asarray(engine.forward(Field(start, bars, WAVELENGTH_UM)).values)
    spread = 0.5 * np.abs(field).max() / np.sqrt(electrons)
    reconstructed = []
    for _ in range(100):
        noise = spread * (rng.standard_normal(field.shape) + 1j * rng.standard_normal(field.shape))
        reconstructed.append(np.abs(engine.adjoint(Field(ends, noise, WAVELENGTH_UM)).values) ** 2)
    assert power == pytest.approx(np.mean(reconstructed), rel=0.06)


def test_noise_takes_contrast_and_comes_from_its_seed(plane: PatchReconstructor) -> None:
    trial = plane.perturbed()

    def contrast(electrons: float, seed: int) -> float:
        return patch_bar_contrast(trial, FINE_UM, electrons=electrons, rng=np.random.default_rng(seed))

    assert contrast(100.0, 1) == contrast(100.0, 1)
    assert contrast(100.0, 1) != contrast(100.0, 2)
    assert contrast(1e-2, 1) < contrast(1e8, 1) - 0.01
    assert contrast(1e12, 1) == pytest.approx(patch_bar_contrast(trial, FINE_UM), abs=1e-4)


def test_bars_have_their_area_and_their_axis(plane: PatchReconstructor, line: PatchReconstructor) -> None:
    cell = plane.patch.pitch_um
    for orientation in ("x", "y"):
        bars = plane.bars(COARSE_UM, orientation)
        assert cell**2 * bars.sum().real == pytest.approx(5 * COARSE_UM * 9 * COARSE_UM, rel=1e-12)
        changes = [np.abs(np.diff(bars, axis=axis)).sum() for axis in (0, 1)]
        assert (changes[0] > changes[1]) == (orientation == "y")
    assert line.patch.pitch_um * line.bars(1.0, bars=2).sum().real == pytest.approx(2.0, rel=1e-12)


def test_neglected_grows_with_the_patch_and_the_displacement(line: PatchReconstructor) -> None:
    here, far = line.error_terms()[0].relative_error, line.error_terms(30.0)[0].relative_error
    wide = PatchReconstructor(PAPER, line=True, patch_um=68.0).error_terms()[0].relative_error
    assert wide == pytest.approx(4.0 * here, rel=0.05)
    assert here < 0.01 < far < 0.1


def test_a_reconstructor_can_be_sent_to_another_process(line: PatchReconstructor) -> None:
    other = pickle.loads(pickle.dumps(line))
    pose = Pose(tilt_x_deg=0.2)
    assert patch_bar_contrast(other.perturbed(pose), FINE_UM) == patch_bar_contrast(
        line.perturbed(pose), FINE_UM
    )


def test_too_few_samples_are_refused_beforehand() -> None:
    with pytest.raises(SamplingError, match=r"samples = 101.*at least 129"):
        PatchReconstructor(PAPER, samples=101)
    with pytest.raises(SamplingError, match="smaller patch"):
        PatchReconstructor(PAPER, samples=129, patch_um=60.0, line=True)


def test_a_displacement_beyond_the_window_is_refused(plane: PatchReconstructor) -> None:
    trial = plane.perturbed(Pose(decenter_y_mm=0.05))
    with pytest.raises(SamplingError, match="between neighbouring samples"):
        trial.reconstruct(plane.bars(FINE_UM))
    assert patch_bar_contrast(trial, FINE_UM) > 0.95


def test_folds_and_lost_rays_are_refused(line: PatchReconstructor) -> None:
    with pytest.raises(FoldError, match="caustic"):
        PatchReconstructor(PAPER, plane_distance_mm=200.0)
    with pytest.raises(RayAimError, match=r"too large.*ray map"):
        line.perturbed(Pose(despace_mm=9.0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: PatchReconstructor(PAPER, patch_um=0.0), "patch_um"),
        (lambda c: PatchReconstructor(PAPER, samples=7.5), "samples"),
        (lambda c: PatchReconstructor(PAPER, (0.1, 0.0), line=True), "lies at x = 0"),
        (lambda c: c.perturbed(Pose(tilt_y_deg=0.1)), "leave the plane x = 0"),
        (lambda c: c.perturbed(Pose(tilt_x_deg=np.zeros(2))), "2 trials"),
        (lambda c: c.perturbed(SystemState(object_shift_mm=(0.0, 1.0))), "object_shift_mm"),
        (lambda c: c.perturbed(SystemState(sensor_shift_mm=(0.0, 0.0, np.nan))), "sensor_shift_mm"),
        (lambda c: c.bars(0.775, "x"), "'y' only"),
        (lambda c: c.bars(0.775, "z"), "orientation"),
        (lambda c: c.bars(5.0), "fit into the patch"),
        (lambda c: c.bars(0.775, bars=1), "bars = 1"),
        (lambda c: c.reconstruct(np.ones(3)), "shape"),
        (lambda c: c.reconstruct(np.full(c.patch.shape, np.nan)), "finite"),
        (lambda c: c.perturbed().reconstruct(c.bars(1.0), "both"), "registration"),
        (lambda c: c.perturbed().reconstruct(c.bars(1.0), electrons=1e4), "needs rng"),
        (
            lambda c: c.perturbed().reconstruct(c.bars(1.0), electrons=0.0, rng=np.random.default_rng(1)),
            "electrons",
        ),
    ],
)
def test_bad_input_is_refused(
    line: PatchReconstructor, call: Callable[[PatchReconstructor], PerturbedPatch], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        call(line)


def test_sensor_tilt_and_wavelength_are_those_of_the_pupil():
    model = PatchReconstructor(PAPER, samples=65, patch_um=12.0)
    sampler = PupilSampler(PAPER, samples=65)
    for change in (
        {"sensor_tilt_deg": (0.1, 0.2)},
        {"wavelength_um": 0.5325},
        {"pose": Pose(tilt_x_deg=0.1), "sensor_tilt_deg": (0.1, 0.0), "wavelength_um": 0.5325},
    ):
        place = SystemState(**change)
        patch, pupil = model.perturbed(place).pupil, sampler.pupil(place)
        both = patch.valid & pupil.valid
        assert np.mean(both) > 0.9
        assert np.abs(patch.opd_mm - pupil.opd_mm)[both].max() < 2e-4 * 0.532e-3
