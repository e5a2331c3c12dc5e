"""The point characteristic against free space and the eikonal; perturbed pupils against exact identities."""

import pickle
from collections.abc import Callable, Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from places import DESIGNS
from scipy.interpolate import CubicSpline
from scipy.optimize import root

from lensdesign import InputError, Lens, ObjectSpace, Pose, Sensor, Surface, SurfacePerturbation, load_design
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.rays import RayTrace, trace, trace_compiled
from lensdesign.raytrace.status import Status
from wavesim.pupil.characteristic import PointCharacteristic, PupilSampler, point_characteristic
from wavesim.pupil.patch_rays import NominalRays
from wavesim.pupil.pupil import ReconstructionPupil, refocus, rms_waves
from wavesim.pupil.ray_aiming import RayAimError
from wavesim.rays.ray_bundles import FoldError
from wavesim.scene.system_state import SystemState

Array = NDArray[np.float64]
Surfaces = Mapping[int, SurfacePerturbation] | None

DESIGN = DESIGNS / "paper_singlet.toml"
PAPER = load_design(DESIGN)
WAVELENGTH_UM = PAPER.wavelengths_um[0]
TOLERANCE_MM = 1e-4 * WAVELENGTH_UM * 1e-3

FREE_SPACE = Lens(
    wavelengths_um=(0.5,),
    object=ObjectSpace(field_diameter_mm=1.0, numerical_aperture=0.5, working_distance_mm=6.0),
    sensor=Sensor(pixel_pitch_um=3.0, pixels=(100, 100), plane_distances_mm=(1.0,)),
    surfaces=(
        Surface(thickness_mm=2.0, material=1.0, semi_diameter_mm=4.0, stop=True),
        Surface(semi_diameter_mm=20.0),
    ),
)

INNER_STOP = PAPER.replaced(wavelengths_um=(0.45, 0.532, 0.65)).with_surface(0, stop=False)
INNER_STOP = INNER_STOP.with_surface(1, stop=True, semi_diameter_mm=6.0)


@pytest.fixture(scope="module")
def sampler() -> PupilSampler:
    return PupilSampler(PAPER, samples=65)


@pytest.fixture(scope="module")
def off_axis_sampler() -> PupilSampler:
    return PupilSampler(PAPER, field_mm=(0.4, -1.2), samples=64)


def largest_difference_mm(first: ReconstructionPupil, second: ReconstructionPupil) -> float:
    both = first.valid & second.valid
    assert np.count_nonzero(both) > 0.97 * len(both)
    return np.max(np.abs(first.opd_mm - second.opd_mm)[both])


def amplitude_per_mm(lens: Lens, rays: PointCharacteristic) -> np.ndarray:
    return NominalRays(rays, line=False, system=compile_system(lens, rays.grid.wavelength_um)).amplitude


def test_free_space_is_the_rayleigh_sommerfeld_kernel() -> None:
    v = point_characteristic(FREE_SPACE, field_mm=(0.3, -0.2), plane_distance_mm=4.0, samples=40)
    way = np.column_stack([v.sensor_points_mm - [0.3, -0.2], np.full(len(v.path_mm), 12.0)])
    r = np.linalg.norm(way, axis=1)
    np.testing.assert_allclose(v.path_mm, r, rtol=1e-13)
    np.testing.assert_allclose(v.directions, way / r[:, None], atol=1e-13)
    np.testing.assert_allclose(v.grid.cosines, (way / r[:, None])[:, :2], atol=1e-13)
    np.testing.assert_allclose(amplitude_per_mm(FREE_SPACE, v), 12.0 / r**2, rtol=1e-6)
    assert v.index_behind == 1.0


def test_grid_covers_the_stop_and_status_says_the_rest() -> None:
    v = point_characteristic(PAPER, samples=64)
    sine = 8.26 / np.hypot(8.26, 13.5 + PAPER.surfaces[0].sag_mm(8.26))
    assert v.grid.half_width == pytest.approx(sine, rel=1e-9)
    assert np.max(np.hypot(*v.grid.cosines.T)) < sine
    assert v.grid.inside.mean() == pytest.approx(np.pi / 4.0, abs=0.01)
    np.testing.assert_array_equal(v.grid.inside, v.status == Status.OK)
    assert v.status[0, 0] == Status.CLIPPED


def test_gradient_of_the_path_is_the_direction_behind() -> None:
    v = point_characteristic(PAPER, field_mm=(0.0, 1.0), samples=201)
    position = {index: i for i, index in enumerate(v.grid.index)}
    neighbours = {k: k + 1 for k in position if (k + 1) % v.grid.samples}
    pairs = np.array([(position[k], position[n]) for k, n in neighbours.items() if n in position])
    first, second = pairs.T
    step = v.sensor_points_mm[second] - v.sensor_points_mm[first]
    mean = 0.5 * (v.directions[first] + v.directions[second])[:, :2]
    np.testing.assert_allclose(v.path_mm[second] - v.path_mm[first], np.sum(mean * step, axis=1), atol=1e-6)


def test_amplitude_carries_all_the_light_of_the_bundle() -> None:
    v = point_characteristic(PAPER, samples=401)
    row = np.flatnonzero((np.abs(v.grid.cosines[:, 1]) < 1e-12) & (v.grid.cosines[:, 0] >= -1e-12))
    radius, sine = v.sensor_points_mm[row, 0], v.grid.cosines[row, 0]
    flux = amplitude_per_mm(PAPER, v)[row] ** 2 * v.directions[row, 2] * 2.0 * np.pi * radius
    expected = 2.0 * np.pi / 3.0 * (1.0 - (1.0 - sine[-1] ** 2) ** 1.5)
    assert np.trapezoid(flux, radius) == pytest.approx(expected, rel=1e-4)


def test_the_nominal_lens_has_a_flat_pupil(sampler: PupilSampler, off_axis_sampler: PupilSampler) -> None:
    for each in (sampler, off_axis_sampler):
        pupil = each.pupil()
        assert np.all(pupil.valid)
        assert np.max(np.abs(pupil.opd_mm)) < 1e-12


@settings(max_examples=15, deadline=None)
@given(x=st.floats(-0.05, 0.05), y=st.floats(-0.05, 0.05), z=st.floats(-0.1, 0.1))
def test_to_shift_the_lens_is_to_shift_object_and_sensor_the_other_way(
    off_axis_sampler: PupilSampler, x: float, y: float, z: float
) -> None:
    lens = off_axis_sampler.pupil(Pose(decenter_x_mm=x, decenter_y_mm=y, despace_mm=z))
    rest = off_axis_sampler.pupil(SystemState(object_shift_mm=(-x, -y, -z), sensor_shift_mm=(-x, -y, -z)))
    assert largest_difference_mm(lens, rest) < 1e-11


def test_a_tilt_about_another_pivot_is_a_tilt_and_a_shift(sampler: PupilSampler) -> None:
    angle = np.deg2rad(0.2)
    about_five = sampler.pupil(Pose(tilt_y_deg=0.2, pivot_z_mm=5.0))
    pose = Pose(decenter_x_mm=-5.0 * np.sin(angle), despace_mm=5.0 * (1.0 - np.cos(angle)), tilt_y_deg=0.2)
    assert largest_difference_mm(about_five, sampler.pupil(pose)) < 1e-11


def test_a_small_decenter_follows_the_gradients_of_the_path(sampler: PupilSampler) -> None:
    decenter = 1e-4
    pupil = sampler.pupil(Pose(decenter_x_mm=decenter))
    expected = decenter * (pupil.cosines[:, 0] - sampler.nominal.directions[:, 0])
    np.testing.assert_allclose(pupil.opd_mm, expected, atol=2e-9)


def test_a_moved_object_is_found_back(sampler: PupilSampler, off_axis_sampler: PupilSampler) -> None:
    for each in (sampler, off_axis_sampler):
        result = refocus(each.pupil(SystemState(object_shift_mm=(0.002, -0.001, 0.003))))
        np.testing.assert_allclose(result.shift_um, [2.0, -1.0], atol=0.01)
        assert result.refocus_um == pytest.approx(3.0, abs=0.01)
        assert rms_waves(result.pupil) < 1e-3


def test_a_despaced_lens_shows_the_object_further_off(sampler: PupilSampler) -> None:
    assert refocus(sampler.pupil(Pose(despace_mm=0.01))).refocus_um == pytest.approx(-10.0, abs=0.1)


PERTURBATIONS = [
    (Pose(decenter_x_mm=0.05, tilt_y_deg=0.5, despace_mm=0.05), None),
    (Pose(), {0: SurfacePerturbation(radius_mm=0.1, tilt_x_deg=0.05)}),
    (Pose(tilt_x_deg=0.1), {0: SurfacePerturbation(thickness_mm=0.05, index=1e-4)}),
    (Pose(), {1: SurfacePerturbation(conic=0.002, decenter_y_mm=0.02)}),
]


def aimed_ray(
    sampler: PupilSampler, sample: np.integer, pose: Pose, surfaces: Surfaces = None, *, clip: bool = False
) -> RayTrace:
    """The perturbed ray to the sensor point of one sample, as a root finder aims it."""
    nominal = sampler.nominal

    def ray(cosines: Array, clip: bool) -> RayTrace:
        direction = [[*cosines, np.sqrt(1.0 - np.sum(np.square(cosines)))]]
        system = compile_system(sampler.lens, WAVELENGTH_UM, pose, surfaces)
        return trace_compiled(system, [nominal.object_point_mm], direction, nominal.plane_z_mm, clip=clip)

    def miss(cosines: Array) -> Array:
        return ray(cosines, False).position[0, :2] - nominal.sensor_points_mm[sample]

    found = root(miss, nominal.grid.cosines[sample], tol=1e-13)
    assert np.max(np.abs(found.fun)) < 1e-9
    return ray(found.x, clip)


def largest_error_mm(sampler: PupilSampler, pose: Pose, surfaces: Surfaces) -> float:
    """Error of some path differences, against rays that a root finder aimed."""
    pupil = sampler.pupil(SystemState(pose, surfaces or {}))
    errors = []
    for i in np.flatnonzero(pupil.valid)[:: len(pupil.valid) // 12]:
        difference = aimed_ray(sampler, i, pose, surfaces).opl[0] - sampler.nominal.path_mm[i]
        errors.append(pupil.opd_mm[i] - difference)
    return float(np.max(np.abs(errors)))


@pytest.mark.parametrize(("pose", "surfaces"), PERTURBATIONS)
def test_aimed_paths_agree_with_a_root_finder(
    off_axis_sampler: PupilSampler, pose: Pose, surfaces: Surfaces
) -> None:
    assert largest_error_mm(off_axis_sampler, pose, surfaces) < TOLERANCE_MM


def test_the_index_behind_the_lens_counts() -> None:
    sampler = PupilSampler(PAPER.with_surface(1, material=1.33), (0.4, -1.2), samples=48)
    assert sampler.nominal.index_behind == 1.33
    assert largest_error_mm(sampler, Pose(decenter_x_mm=0.05, tilt_y_deg=0.5), None) < TOLERANCE_MM


@pytest.mark.parametrize(
    ("pose", "rms"),
    [
        (Pose(decenter_x_mm=0.01), 0.0648),
        (Pose(decenter_x_mm=0.03), 0.1943),
        (Pose(tilt_y_deg=0.1), 0.1799),
        (Pose(tilt_y_deg=0.5), 0.9031),
    ],
)
def test_meridional_path_difference(pose: Pose, rms: float) -> None:
    """Along the plane of the perturbation, shift and piston removed, evenly in the sine up to 0.5.

    The reference finds no rays: it interpolates the path of a fan of rays over where they land.
    """
    wide = PAPER.with_surface(0, semi_diameter_mm=8.7).with_surface(1, semi_diameter_mm=11.0)
    sampler = PupilSampler(wide, samples=601)
    grid = sampler.grid
    half = 0.5
    row = np.flatnonzero((np.abs(grid.cosines[:, 1]) < 1e-12) & (np.abs(grid.cosines[:, 0]) < half))
    pupil = sampler.pupil(pose)
    assert np.all(pupil.valid[row])
    sines = grid.cosines[row, 0]
    fan = np.linspace(-0.53, 0.53, 4001)
    directions = np.column_stack([fan, 0.0 * fan, np.sqrt(1.0 - fan**2)])
    origins = np.tile([0.0, 0.0, PAPER.object_z_mm], (len(fan), 1))
    plane = PAPER.exit_vertex_z_mm + 3.0
    nominal, perturbed = (
        trace(wide, origins, directions, WAVELENGTH_UM, p, plane, clip=False) for p in (Pose(), pose)
    )
    path = CubicSpline(perturbed.position[:, 0], perturbed.opl)
    difference = path(nominal.position[:, 0]) - nominal.opl

    def residual_waves(x: Array, y_mm: Array) -> float:
        return float(np.std(y_mm - np.polyval(np.polyfit(x, y_mm, 1), x)) / (WAVELENGTH_UM * 1e-3))

    np.testing.assert_allclose(pupil.opd_mm[row], CubicSpline(fan, difference)(sines), atol=TOLERANCE_MM)
    fine = np.linspace(-half, half, 4001)
    expected = residual_waves(fine, CubicSpline(fan, difference)(fine))
    assert expected == pytest.approx(rms, abs=1e-3 * max(1.0, rms / 0.1))
    assert residual_waves(sines, pupil.opd_mm[row]) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("pose", [Pose(decenter_x_mm=0.3), Pose(despace_mm=0.4)])
def test_the_perturbed_stop_clips_its_own_rim(sampler: PupilSampler, pose: Pose) -> None:
    pupil = sampler.pupil(pose)
    assert 0.9 < pupil.throughput <= 1.0
    rim = np.flatnonzero((np.abs(pupil.cosines[:, 1]) < 0.1) & (np.abs(pupil.cosines[:, 0]) > 0.46))
    for i in rim:
        assert pupil.valid[i] == aimed_ray(sampler, i, pose, clip=True).ok[0]


@pytest.mark.parametrize("field", [(0.0, 0.0), (1.0, 0.5)])
@pytest.mark.parametrize("wavelength", [0.45, 0.65])
def test_inner_stop_and_other_wavelengths(field: tuple[float, float], wavelength: float) -> None:
    sampler = PupilSampler(INNER_STOP, field, wavelength, samples=48)
    assert sampler.grid.wavelength_um == wavelength
    assert 0.6 < sampler.grid.inside.mean() < 0.9
    v = sampler.nominal
    rays = trace(
        INNER_STOP,
        np.tile(v.object_point_mm, (len(v.path_mm), 1)),
        np.column_stack([v.grid.cosines, v.grid.axial_cosine]),
        wavelength,
        record_hits=True,
    )
    assert rays.hits is not None
    height = np.hypot(rays.hits[:, 1, 0], rays.hits[:, 1, 1])
    assert 5.7 < height.max() <= 6.0 + 1e-8
    shifted = sampler.pupil(SystemState(object_shift_mm=(0.0, 0.0, 0.002)))
    assert refocus(shifted).refocus_um == pytest.approx(2.0, abs=0.01)


def test_a_sampler_survives_pickling(sampler: PupilSampler) -> None:
    pose = Pose(tilt_x_deg=0.2)
    copy = pickle.loads(pickle.dumps(sampler))
    np.testing.assert_array_equal(copy.pupil(pose).opd_mm, sampler.pupil(pose).opd_mm)


def test_a_plane_behind_the_caustic_is_refused() -> None:
    with pytest.raises(FoldError, match="caustic"):
        PupilSampler(PAPER, plane_distance_mm=200.0, samples=64)


def test_aiming_that_does_not_settle_is_refused(sampler: PupilSampler) -> None:
    with pytest.raises(RayAimError, match=r"too large.*ray map"):
        sampler.pupil(Pose(despace_mm=9.0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.pupil(Pose(decenter_x_mm=np.array([0.0, 0.1]))), "2 trials"),
        (lambda s: s.pupil(SystemState(object_shift_mm=(0.0, 1.0))), "object_shift_mm"),
        (lambda s: s.pupil(SystemState(sensor_shift_mm=(0.0, 1.0, np.nan))), "sensor_shift_mm"),
        (lambda s: s.pupil(SystemState(sensor_tilt_deg=(0.0, 1.0, 2.0))), "sensor_tilt_deg"),
        (lambda s: s.pupil(Pose(decenter_x_mm=30.0)), "no ray|too large"),
        (lambda s: PupilSampler(PAPER, samples=4), "samples = 4"),
        (lambda s: PupilSampler(PAPER, samples=True), "samples = True"),
        (lambda s: PupilSampler(PAPER, field_mm=(0.0,)), "field_mm"),
        (lambda s: PupilSampler(PAPER, plane_distance_mm=0.0), "plane_distance_mm = 0.0"),
        (lambda s: PupilSampler(FREE_SPACE, wavelength_um=-0.5), "wavelength_um = -0.5"),
        (lambda s: PupilSampler(PAPER, field_mm=(0.0, 500.0), samples=16), "choose a field point"),
    ],
)
def test_bad_input_is_named(sampler: PupilSampler, call: Callable, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call(sampler)


def test_a_tilted_sensor_is_a_lens_and_object_that_turn_the_other_way():
    sampler = PupilSampler(PAPER, samples=65)
    angle, plane_z = 0.4, sampler.nominal.plane_z_mm
    tilted = sampler.pupil(SystemState(sensor_tilt_deg=(0.0, angle)))
    reach, turn = plane_z - PAPER.object_z_mm, np.deg2rad(angle)
    moved = (reach * np.sin(turn), 0.0, reach * (1.0 - np.cos(turn)))
    turned = sampler.pupil(SystemState(Pose(tilt_y_deg=-angle, pivot_z_mm=plane_z), object_shift_mm=moved))
    both = tilted.valid & turned.valid
    assert np.mean(both) > 0.9
    assert np.abs(tilted.opd_mm - turned.opd_mm)[both].max() < TOLERANCE_MM
    assert rms_waves(tilted) > 1.0


def test_a_wavelength_scales_the_path_in_waves():
    sampler = PupilSampler(PAPER, samples=33)
    longer = sampler.pupil(SystemState(wavelength_um=1.01 * WAVELENGTH_UM))
    assert longer.opd_mm == pytest.approx(sampler.nominal.path_mm * (1.0 / 1.01 - 1.0), abs=1e-9)
