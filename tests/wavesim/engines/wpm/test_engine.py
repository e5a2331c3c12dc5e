"""The wave propagation method, against exact fields behind a cylinder and behind plane interfaces."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from engine_checks import dot_product_mismatch, engine_peak_bytes

from lensdesign import Lens, Pose, scaled
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.surface import Surface
from wavesim.analytic.cylinder import cylinder_scene
from wavesim.analytic.registry import AnalyticCase
from wavesim.engines.surfaces import grids as working_grid
from wavesim.engines.surfaces.grids import TotalReflectionWarning
from wavesim.engines.wpm.engine import WavePropagation
from wavesim.fields.field import Array, Field, Grid, relative_error
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene

WAVELENGTH_UM, INDEX = 0.532, 1.5195
K_PER_MM = 2e3 * math.pi / WAVELENGTH_UM


@pytest.fixture(scope="module")
def cylinder() -> AnalyticCase:
    return cylinder_scene(radius_mm=0.1)


def lens_of(surfaces: Sequence[Surface], distance_mm: float) -> Lens:
    return Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.02, numerical_aperture=0.4, working_distance_mm=distance_mm),
        sensor=Sensor(pixel_pitch_um=0.5, pixels=(100, 100), plane_distances_mm=(0.01,)),
        surfaces=tuple(surfaces),
    )


IN_PLACE = Pose()


def ball_scene(pose: Pose = IN_PLACE, coating: str = "ideal") -> Scene:
    """A ball of 0.015 mm radius, on the full plane."""
    a = 0.015
    front = Surface(radius_mm=a, thickness_mm=2 * a, material=INDEX, semi_diameter_mm=0.36 * a, stop=True)
    lens = lens_of([front, Surface(radius_mm=-a, semi_diameter_mm=0.7 * a)], 0.5 * a)
    grids = Grid((32, 32), 0.00025, -0.5 * a), Grid((120, 120), 0.0003, 2.1 * a)
    return Scene(lens, *grids, WAVELENGTH_UM, pose=pose, coating=coating)


def spot(grid: Grid, waist_mm: float, sine: float = 0.0, y_mm: float = 0.0) -> Field:
    """A Gaussian spot that sends its light under an angle."""
    y = grid.y_mm - grid.centre_mm[1]
    values = np.exp(-0.5 * ((y - y_mm) / waist_mm) ** 2 + 1j * K_PER_MM * sine * y)
    if not grid.is_line:
        values = values[:, None] * np.exp(-0.5 * (grid.x_mm / waist_mm) ** 2)
    return Field(grid, values, WAVELENGTH_UM)


def behind_planes(
    field: Field, exit_grid: Grid, planes: Sequence[tuple[float, float]], indices: Sequence[float]
) -> Array:
    """Exact field on a line behind tilted planes: every plane wave by Snell's law and Fresnel's TE formula.

    `planes` holds height on the axis and slope dz/dy.
    """
    grid = field.grid
    ky = K_PER_MM * np.linspace(-0.95, 0.95, 6001)
    weight = np.exp(-1j * np.outer(ky, grid.y_mm)) @ field.values * grid.pitch_mm
    kz = np.sqrt(K_PER_MM**2 - ky**2)
    amplitude = weight * (ky[1] - ky[0]) / (2.0 * math.pi) * np.exp(-1j * kz * grid.z_mm)
    for (height, slope), after in zip(planes, indices[1:], strict=True):
        cosine, sine = 1.0 / math.hypot(1.0, slope), slope / math.hypot(1.0, slope)
        along, across = ky * cosine + kz * sine, kz * cosine - ky * sine
        passes = np.abs(along) < 0.999 * after * K_PER_MM
        ky, kz, amplitude, along, across = (a[passes] for a in (ky, kz, amplitude, along, across))
        beyond = np.sqrt((after * K_PER_MM) ** 2 - along**2)
        ky, before = along * cosine - beyond * sine, kz
        kz = along * sine + beyond * cosine
        amplitude = amplitude * 2.0 * across / (across + beyond) * np.exp(1j * (before - kz) * height)
    result = np.zeros(exit_grid.shape, complex)
    for part in np.array_split(np.arange(len(ky)), 6):
        phase = np.outer(exit_grid.y_mm, ky[part]) + kz[part] * exit_grid.z_mm
        result += np.exp(1j * phase) @ amplitude[part]
    return result


def error(case: AnalyticCase, **settings: object) -> float:
    engine = WavePropagation(case.scene, **settings)  # type: ignore[arg-type]
    return relative_error(engine.forward(case.object_field).values, case.exact.values)


def order(steps: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of the error over the step, log-log."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def test_cylinder(cylinder: AnalyticCase) -> None:
    assert error(cylinder) < 2e-3


@pytest.mark.parametrize("radius_mm", [0.05, 0.2])
def test_what_is_left_falls_with_the_radius(radius_mm: float) -> None:
    case = cylinder_scene(radius_mm=radius_mm)
    assert error(case) < 1.5e-4 / radius_mm


def test_substep_converges_faster_than_the_second_power(cylinder: AnalyticCase) -> None:
    truth = WavePropagation(cylinder.scene, step_um=0.1).forward(cylinder.object_field).values
    steps = [0.35, 0.5, 0.7]
    left = [
        relative_error(
            WavePropagation(cylinder.scene, step_um=s).forward(cylinder.object_field).values, truth
        )
        for s in steps
    ]
    assert 3.5 < order(steps, left) < 6.0
    assert error(cylinder, step_um=0.7) < 2e-2


def test_staircase_converges_with_the_first_power_and_not_to_the_end(cylinder: AnalyticCase) -> None:
    steps = [WAVELENGTH_UM / d for d in (2, 4, 8)]
    left = [error(cylinder, interface="staircase", step_um=s) for s in steps]
    assert 0.8 < order(steps, left) < 1.3
    assert left[1] == pytest.approx(0.24, abs=0.05)
    assert 0.08 < error(cylinder, interface="staircase", step_um=0.0166) < 0.13


def plane_error(
    surfaces: Sequence[Surface],
    planes: Sequence[tuple[float, float]],
    sine: float = 0.0,
    grid: Grid | None = None,
    y_mm: float = 0.0,
    **settings: object,
) -> float:
    """Relative error behind planes of given height and slope, for light from 0.1 mm in front of them."""
    start = Grid((240,), 1.2e-4, -0.1) if grid is None else grid
    tilts = {
        i: SurfacePerturbation(tilt_x_deg=math.degrees(math.atan(slope)))
        for i, (_, slope) in enumerate(planes)
        if slope
    }
    end = Grid((1000,), 2e-4, 0.08)
    scene = Scene(
        lens_of(surfaces, 0.1), start, end, WAVELENGTH_UM, surface_perturbations=tilts, coating="bare"
    )
    field = spot(start, 0.0015, sine, y_mm)
    exact = behind_planes(field, end, planes, [1.0, INDEX, 1.0][: len(planes) + 1])
    engine = WavePropagation(scene, **settings)  # type: ignore[arg-type]
    return relative_error(engine.forward(field).values, exact)


def plate() -> list[Surface]:
    front = Surface(thickness_mm=0.05, material=INDEX, semi_diameter_mm=0.06, stop=True)
    return [front, Surface(semi_diameter_mm=0.12)]


@pytest.mark.parametrize("tilt_deg", [0.0, -4.0, 12.0, 20.0])
def test_refraction_at_a_tilted_plane(tilt_deg: float) -> None:
    glass = [Surface(material=INDEX, semi_diameter_mm=0.08, stop=True)]
    assert plane_error(glass, [(0.0, math.tan(math.radians(tilt_deg)))]) < 2e-3


def test_a_staircase_does_not_refract_as_the_plane_it_stands_for() -> None:
    glass = [Surface(material=INDEX, semi_diameter_mm=0.08, stop=True)]
    assert plane_error(glass, [(0.0, 0.2)], interface="staircase", step_um=0.133) > 0.1


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 35.0, 50.0])
def test_plate_under_oblique_incidence(angle_deg: float) -> None:
    angle = math.radians(angle_deg)
    start = Grid((240,), 1.2e-4, -0.1, (0.0, -0.1 * math.tan(angle)))
    assert plane_error(plate(), [(0.0, 0.0), (0.05, 0.0)], math.sin(angle), start) < 6e-3


def test_weak_prism() -> None:
    assert plane_error(plate(), [(0.0, 0.0), (0.05, 0.05)]) < 3e-3


def test_light_from_beside_the_middle_is_held_to_what_neglected_says() -> None:
    glass = [Surface(material=INDEX, semi_diameter_mm=0.08, stop=True)]
    wide = Grid((500,), 1.2e-4, -0.1)
    error = plane_error(glass, [(0.0, 0.2)], grid=wide, y_mm=0.025)
    scene = Scene(
        lens_of(glass, 0.1),
        wide,
        Grid((10,), 1e-3, 0.08),
        WAVELENGTH_UM,
        surface_perturbations={0: SurfacePerturbation(tilt_x_deg=math.degrees(math.atan(0.2)))},
        coating="bare",
    )
    said = max(n.relative_error for n in WavePropagation(scene).error_terms())
    assert 0.01 < error < said < 4.0 * error


@pytest.mark.parametrize("interface", ["substep", "staircase"])
def test_adjoint_on_a_line(cylinder: AnalyticCase, interface: str) -> None:
    assert dot_product_mismatch(WavePropagation(cylinder.scene, interface=interface)) < 1e-10  # type: ignore[arg-type]


@pytest.mark.parametrize("interface", ["substep", "staircase"])
def test_adjoint_on_a_plane(interface: str) -> None:
    scene = ball_scene(Pose(tilt_x_deg=3.0, tilt_y_deg=-2.0, decenter_x_mm=5e-4))
    engine = WavePropagation(scene, interface=interface, step_um=0.3)  # type: ignore[arg-type]
    assert dot_product_mismatch(engine) < 1e-10


def test_energy_on_a_plane() -> None:
    ideal, bare = ball_scene(), ball_scene(coating="bare")
    field = spot(ideal.object_grid, 0.0009)
    kept = WavePropagation(ideal).forward(field).energy / field.energy
    passed = WavePropagation(bare).forward(field).energy / field.energy
    assert kept == pytest.approx(1.0, abs=0.02)
    # Near normal incidence, both surfaces return ((n - 1) / (n + 1))^2 each.
    assert passed / kept == pytest.approx((1.0 - ((INDEX - 1.0) / (INDEX + 1.0)) ** 2) ** 2, abs=3e-3)


def test_tilted_ball_is_the_same_ball() -> None:
    """A ball turned about its own centre."""
    straight, turned = ball_scene(), ball_scene(Pose(tilt_x_deg=3.0, tilt_y_deg=2.0, pivot_z_mm=0.015))
    field = spot(straight.object_grid, 0.0009)
    a, b = (WavePropagation(s).forward(field).values for s in (straight, turned))
    assert relative_error(b, a) < 2e-3


def test_refuses_steps_that_are_too_long(cylinder: AnalyticCase) -> None:
    longest = 1e3 * math.pi / max(m.phase_across(1.0) for m in WavePropagation(cylinder.scene).working.media)
    with pytest.warns(SamplingWarning, match="step_um"):
        error(cylinder, step_um=1.2 * longest)
    with pytest.raises(SamplingError, match="step_um"):
        error(cylinder, step_um=1.6 * longest)
    with pytest.raises(SamplingError, match="both media"):
        error(cylinder, interface="staircase", step_um=1.0)


def test_refuses_grids_that_cannot_hold_the_field(cylinder: AnalyticCase) -> None:
    with pytest.raises(SamplingError, match="too coarse"):
        error(cylinder, pitch_mm=5e-4)
    with pytest.raises(SamplingError, match="too narrow"):
        error(cylinder, half_width_mm=0.05)


@pytest.mark.parametrize(
    "settings", [{"interface": "stairs"}, {"step_um": 0.0}, {"step_um": math.nan}, {"pitch_mm": -1.0}]
)
def test_refuses_bad_settings(cylinder: AnalyticCase, settings: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(settings))):
        error(cylinder, **settings)


def big_line() -> Scene:
    return cylinder_scene(radius_mm=0.8).scene


@pytest.mark.parametrize(
    ("interface", "make"), [("substep", big_line), ("substep", ball_scene), ("staircase", ball_scene)]
)
def test_predicts_its_memory_and_time(interface: str, make: Callable[[], Scene]) -> None:
    scene = make()
    engine = WavePropagation(scene, interface=interface)  # type: ignore[arg-type]
    cost = engine.cost()
    field = Field(scene.object_grid, np.ones(scene.object_grid.shape, complex), WAVELENGTH_UM)
    peak = engine_peak_bytes(engine, field)
    assert cost.peak_bytes == pytest.approx(peak, rel=0.3)
    step_um = float(engine.settings()["step_um"])
    finer = WavePropagation(scene, interface=interface, step_um=0.25 * step_um)  # type: ignore[arg-type]
    # Held against the time that is taken by benchmarks.chooser.
    assert 2.0 * cost.seconds < finer.cost().seconds < 30.0 * cost.seconds


def test_full_plane_of_a_full_lens_is_refused(paper_lens: Lens) -> None:
    grids = Grid((200, 200), 2.5e-4, -13.5), Grid((400, 400), 4e-3, 12.7)
    scene = Scene(paper_lens, *grids, WAVELENGTH_UM)
    engine = WavePropagation(scene)
    assert engine.cost().peak_bytes > 1e11
    with pytest.raises(SamplingError, match=r"e\+09 samples.*e\+11 bytes.*force = True"):
        engine.forward(Field(grids[0], np.ones(grids[0].shape), WAVELENGTH_UM))


def test_force_runs_what_is_refused(cylinder: AnalyticCase, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(working_grid, "LARGEST_BYTES", 1000)
    with pytest.raises(SamplingError, match="force = True"):
        error(cylinder)
    assert error(cylinder, force=True) < 2e-3


def test_decentered_lens_is_a_shifted_scene(cylinder: AnalyticCase) -> None:
    shift, still = 0.004, cylinder.scene
    moved = replace(
        still,
        pose=Pose(decenter_y_mm=shift),
        object_grid=replace(still.object_grid, centre_mm=(0.0, 0.004)),
        exit_grid=replace(still.exit_grid, centre_mm=(0.0, 0.004)),
    )
    beside = replace(still, object_grid=replace(still.object_grid, centre_mm=(0.0, -shift)))
    decentered = replace(moved, object_grid=still.object_grid)
    values = cylinder.object_field.values
    for a, b in [(still, moved), (beside, decentered)]:
        u, v = (
            WavePropagation(s).forward(Field(s.object_grid, values, WAVELENGTH_UM)).values for s in (a, b)
        )
        assert relative_error(v, u) < 1e-9


def test_object_beside_the_axis_on_a_plane() -> None:
    straight = ball_scene()
    shift = (6e-4, -9e-4)
    beside = replace(straight, object_grid=replace(straight.object_grid, centre_mm=shift))
    moved = replace(
        straight,
        pose=Pose(decenter_x_mm=-shift[0], decenter_y_mm=-shift[1]),
        exit_grid=replace(straight.exit_grid, centre_mm=(-shift[0], -shift[1])),
    )
    values = spot(straight.object_grid, 0.0009).values
    a, b = (
        WavePropagation(s).forward(Field(s.object_grid, values, WAVELENGTH_UM)).values
        for s in (beside, moved)
    )
    assert relative_error(b, a) < 1e-9


def test_total_reflection_is_named() -> None:
    front = Surface(thickness_mm=0.2, material=INDEX, semi_diameter_mm=0.06, stop=True)
    lens = lens_of([front, Surface(semi_diameter_mm=0.2)], 0.1)
    grids = Grid((100,), 1.2e-4, -0.1), Grid((500,), 2e-4, 0.3)
    scene = Scene(
        lens, *grids, WAVELENGTH_UM, surface_perturbations={1: SurfacePerturbation(tilt_x_deg=25.0)}
    )
    engine, field = WavePropagation(scene), spot(grids[0], 0.0003)
    with pytest.warns(TotalReflectionWarning, match=r"total reflection: .* % of the rays"):
        found = engine.forward(field)
    assert np.isfinite(found.values).all()
    assert 0.0 < found.energy < field.energy
    assert any("totally reflected" in n.description for n in engine.error_terms())
    steep = {1: SurfacePerturbation(tilt_x_deg=64.0)}
    with pytest.raises(InputError, match="total reflection"):
        WavePropagation(replace(scene, surface_perturbations=steep)).cost()


def slit() -> Scene:
    """A slit with glass behind it, lit by one object point."""
    lens = lens_of([Surface(material=INDEX, semi_diameter_mm=0.0501, stop=True)], 0.2)
    return Scene(lens, Grid((5,), 2.5e-4, -0.2), Grid((400,), 4e-4, 0.3), WAVELENGTH_UM)


def test_light_that_the_rim_turns_is_told_by_the_band() -> None:
    scene = slit()
    point = Field(scene.object_grid, np.eye(5, dtype=complex)[2], WAVELENGTH_UM)
    truth = WavePropagation(scene, zones=60.0).forward(point).values
    errors = []
    for zones in (2.0, 4.0, 8.0):
        engine = WavePropagation(scene, zones=zones)
        errors.append(relative_error(engine.forward(point).values, truth))
        (predicted,) = [n for n in engine.error_terms() if "rim" in n.description]
        assert predicted.at_rim
        assert 0.3 * predicted.relative_error < errors[-1] < 1.5 * predicted.relative_error
    assert errors[2] < 0.7 * errors[0]


def test_rim_lies_between_samples(paper_lens: Lens) -> None:
    """However the grid falls upon it: samples that are in or out differ by 7e-4."""
    scene = patch_scene(scaled(paper_lens, 1 / 4), 0.01, meridional=True, plane_distance_mm=2 / 4)
    point = Field(scene.object_grid, np.eye(scene.object_grid.size, dtype=complex)[12], WAVELENGTH_UM)
    pitch_mm = WavePropagation(scene).working.grid.pitch_mm
    fine, *coarser = (
        WavePropagation(scene, pitch_mm=share * pitch_mm).forward(point).values for share in (0.5, 1.0, 0.7)
    )
    assert max(relative_error(one, fine) for one in coarser) < 1e-4


def test_says_what_it_neglects(cylinder: AnalyticCase) -> None:
    found = WavePropagation(cylinder.scene).error_terms()
    errors = [n.relative_error for n in found]
    assert errors == sorted(errors, reverse=True)
    assert any("reflected" in n.description for n in found)
    assert all(0.0 <= e < 0.1 for e in errors)
    stairs = WavePropagation(cylinder.scene, interface="staircase").error_terms()[0]
    assert 0.5 < stairs.relative_error < 0.7
