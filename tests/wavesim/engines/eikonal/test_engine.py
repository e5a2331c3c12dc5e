"""Eikonal tiles, against exact fields, rays of single object points, and another engine past a focus."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from engine_checks import dot_product_mismatch
from numpy.typing import NDArray

from lensdesign import Lens, Pose, scaled
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.scaling import stopped_down
from lensdesign.lens.surface import Surface
from wavesim.analytic.registry import analytic_case
from wavesim.engines.choosing import engine_for
from wavesim.engines.eikonal.engine import EikonalEngine, FlatTiles, HierarchicalTiles
from wavesim.engines.eikonal.plan import chosen_probe
from wavesim.engines.registry import engine_on
from wavesim.engines.wpm.engine import WavePropagation
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.metrics.accuracy import peak_bytes
from wavesim.metrics.comparison import lens_case
from wavesim.rays.maps import RayMap, RayMapError, ray_map
from wavesim.rays.ray_bundles import FoldError
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene

WAVELENGTH_UM = 0.532
POSE = Pose(tilt_x_deg=0.4, decenter_x_mm=0.05, tilt_y_deg=0.2)
Values = NDArray[np.complex128]


def plane_scene(lens: Lens, centre: tuple[float, float] = (0.0, 0.0), **changes: Any) -> Scene:
    ends = Grid((120, 140), 0.5e-3, -13.5, centre), Grid((150, 160), 0.12, 12.7)
    return Scene(lens, *ends, WAVELENGTH_UM, **changes)


def line_scene(lens: Lens, centre: float = 0.0, **changes: Any) -> Scene:
    ends = Grid((200,), 0.25e-3, -13.5, (0.0, centre)), Grid((3000,), 7e-3, 12.7)
    return Scene(lens, *ends, WAVELENGTH_UM, **changes)


def focusing_scene(exit_z_mm: float) -> Scene:
    """A weak lens, with the image at z = 0.65 mm."""
    front = Surface(radius_mm=0.3, thickness_mm=0.3, material=1.5, semi_diameter_mm=0.06, stop=True)
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.01, numerical_aperture=0.06, working_distance_mm=1.0),
        sensor=Sensor(pixel_pitch_um=0.5, pixels=(100, 100), plane_distances_mm=(0.1,)),
        surfaces=(front, Surface(radius_mm=-0.3, semi_diameter_mm=0.1)),
    )
    return Scene(lens, Grid((128,), 2e-3, -1.0), Grid((1200,), 0.4e-3, exit_z_mm), WAVELENGTH_UM)


def noise(grid: Grid, seed: int = 1) -> Field:
    rng = np.random.default_rng(seed)
    return Field(grid, rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape), WAVELENGTH_UM)


def spot(grid: Grid, waist_mm: float) -> Field:
    y = grid.y_mm - grid.centre_mm[1]
    values = np.exp(-((y / waist_mm) ** 2))
    if not grid.is_line:
        values = values[:, None] * np.exp(-(((grid.x_mm - grid.centre_mm[0]) / waist_mm) ** 2))
    return Field(grid, values.astype(complex), WAVELENGTH_UM)


@pytest.mark.parametrize(("radius_mm", "allowed"), [(0.1, 3.5e-3), (0.2, 2.5e-3), (0.8, 6e-4)])
def test_cylinder(radius_mm: float, allowed: float) -> None:
    case = analytic_case("cylinder", radius_mm=radius_mm)
    engine = FlatTiles(case.scene)
    assert relative_error(engine.forward(case.object_field).values, case.exact.values) < allowed


def test_narrower_tiles_err_less(paper_lens: Lens) -> None:
    """Light that fills the aperture, far off the axis: the footprint moves over the object."""
    lens = stopped_down(scaled(paper_lens, 1 / 32), 0.44)
    case = lens_case(lens, 0.0169, 0.75 * lens.half_field_mm, plane_distance_mm=9 / 32)
    errors = []
    for width_mm in (0.017, 0.0086, 0.0043, 0.0022, 0.0011):
        engine = FlatTiles(case.scene, tile_width_mm=width_mm, error=0.05)
        found = engine.forward(case.object_field)
        errors.append(relative_error(found.values, case.exact.values))
        assert errors[-1] < engine.predicted_error()
        assert found.energy == pytest.approx(case.exact.energy, rel=0.03)
    assert errors[-1] < 0.3 * errors[0]
    assert all(narrow < 1.25 * min(errors[:i]) for i, narrow in enumerate(errors) if i)


@pytest.mark.parametrize(
    ("field", "vignetted", "changes", "allowed"),
    [
        (0.0, False, {}, 6e-3),
        (0.3, False, {"pose": Pose(decenter_y_mm=0.02, tilt_x_deg=0.4)}, 0.01),
        (0.3, False, {"surface_perturbations": {0: SurfacePerturbation(decenter_y_mm=0.01)}}, 6e-3),
        (0.7, True, {}, 7e-3),
    ],
)
def test_point_that_fills_the_stop(
    paper_lens: Lens, field: float, vignetted: bool, changes: Any, allowed: float
) -> None:
    """A one-sixteenth twin, whose footprint is a hundred fringes wide; sharp edges err by 0.06."""
    lens = scaled(paper_lens, 1 / 16)
    if vignetted:
        lens = lens.replaced(surfaces=(lens.surfaces[0], lens.surfaces[1].replaced(semi_diameter_mm=0.5)))
    scene = replace(patch_scene(lens, 0.01, meridional=True, plane_distance_mm=2 / 16), **changes)
    # Fine enough for light of all directions: a coarser grid's own limit would be seen beside the rim.
    start = Grid((5,), 0.25e-3, scene.object_grid.z_mm, (0.0, field * lens.half_field_mm))
    scene = replace(scene, object_grid=start)
    point = Field(start, np.eye(5, dtype=complex)[2], WAVELENGTH_UM)
    engine = FlatTiles(scene, tile_width_mm=start.pitch_mm)
    truth = WavePropagation(scene, zones=45.0).forward(point).values
    error = relative_error(engine.forward(point).values, truth)
    assert error < allowed
    assert error < engine.predicted_error() < 3.0 * error


@pytest.mark.parametrize("solution", ["stigmatic", "plate", "plane"])
def test_other_exact_fields(solution: str) -> None:
    case = analytic_case(solution)
    assert relative_error(FlatTiles(case.scene).forward(case.object_field).values, case.exact.values) < 5e-3


@pytest.mark.parametrize(
    ("quadratic", "changes"),
    [
        ("low-rank", {}),
        ("low-rank", {"pose": POSE}),
        ("low-rank", {"surface_perturbations": {1: SurfacePerturbation(decenter_y_mm=0.03, tilt_x_deg=0.1)}}),
        ("low-rank", {"coating": "bare"}),
        ("mean", {"pose": POSE}),
    ],
)
def test_sum_over_the_rays_of_object_points(paper_lens: Lens, changes: Any, quadratic: Any) -> None:
    scene = plane_scene(paper_lens, (0.3, 1.2), **changes)
    points = {(10, 20): 1.0, (60, 70): 1j, (110, 30): -0.7}
    values = np.zeros(scene.object_grid.shape, complex)
    for place, strength in points.items():
        values[place] = strength
    found = FlatTiles(scene, quadratic=quadratic).forward(Field(scene.object_grid, values, WAVELENGTH_UM))
    expected, inside = direct_sum(scene, points)
    assert relative_error(found.values[inside], expected[inside]) < 1.2e-2


def direct_sum(scene: Scene, points: dict[tuple[int, int], complex]) -> tuple[Values, NDArray[np.bool_]]:
    """Sum over object points of strength a exp(i k V), and where all have light, away from the rim."""
    grid, k = scene.exit_grid, scene.wavenumber_per_mm
    total, inside = np.zeros(grid.shape, complex), np.ones(grid.shape, bool)
    for (row, column), strength in points.items():
        point = float(scene.object_grid.x_mm[column]), float(scene.object_grid.y_mm[row])
        carrier = ray_map(scene, point, grid.z_mm, 1e-3)
        path, amplitude, *_ = carrier.maps.on_axes((grid.y_mm, grid.x_mm))
        total += strength * amplitude * np.exp(1j * (k * path - 0.5 * np.pi)) * k / (2.0 * np.pi)
        middle = carrier.rim_mm.mean(axis=0)
        radius = np.linalg.norm(carrier.rim_mm - middle, axis=1).min()
        inside &= np.hypot(grid.y_mm[:, None] - middle[0], grid.x_mm - middle[1]) < 0.97 * radius
    return np.asarray(total * scene.object_grid.cell, complex), np.asarray(inside)


@pytest.mark.parametrize("quadratic", ["low-rank", "mean"])
@pytest.mark.parametrize("kind", ["plane", "coarse", "line", "past focus"])
def test_adjoint(paper_lens: Lens, quadratic: Any, kind: str) -> None:
    scene = {
        "plane": lambda: plane_scene(paper_lens, (0.0, 1.0), pose=POSE),
        "coarse": lambda: replace(plane_scene(paper_lens), exit_grid=Grid((420, 400), 0.04, 12.7)),
        "line": lambda: line_scene(paper_lens, 1.4),
        "past focus": lambda: focusing_scene(0.8),
    }[kind]()
    engine = FlatTiles(scene, quadratic=quadratic, error=0.05)
    assert dot_product_mismatch(engine) <= 1e-10


def test_coarse_grid_changes_nothing(paper_lens: Lens) -> None:
    few = replace(plane_scene(paper_lens), exit_grid=Grid((41, 41), 0.4, 12.7))
    many = replace(few, exit_grid=Grid((401, 401), 0.04, 12.7))
    u = noise(few.object_grid)
    a, b = (FlatTiles(scene).forward(u).values for scene in (few, many))
    radius = np.hypot(few.exit_grid.y_mm[:, None], few.exit_grid.x_mm)
    assert relative_error(b[::10, ::10][radius < 9.4], a[radius < 9.4]) < 1e-3


def test_single_precision_agrees(paper_lens: Lens) -> None:
    scene = plane_scene(paper_lens)
    engine, u = FlatTiles(scene), noise(scene.object_grid)
    single = engine.forward(u.with_values(u.values.astype(np.complex64))).values
    assert single.dtype == np.complex64
    assert relative_error(single, engine.forward(u).values) < 1e-3


@pytest.mark.parametrize("line", [True, False])
def test_light_inside_the_stop_keeps_its_energy(paper_lens: Lens, line: bool) -> None:
    scene = line_scene(paper_lens) if line else plane_scene(paper_lens)
    light = spot(scene.object_grid, 3e-3)
    out = FlatTiles(scene).forward(light)
    # |u|^2 over the plane is flux over cosine: small angles on both sides.
    assert out.energy / light.energy == pytest.approx(1.0, abs=4e-3)


def test_aperture_takes_what_rays_lose(paper_lens: Lens) -> None:
    scene = line_scene(paper_lens)
    point = np.zeros(200, complex)
    point[100] = 1.0
    out = FlatTiles(scene).forward(Field(scene.object_grid, point, WAVELENGTH_UM))
    # A point sends cos(theta) dp / lambda into each dp.
    sine = 8.26 / math.hypot(8.26, 13.5 + float(paper_lens.surfaces[0].sag_mm(8.26)))
    through = scene.object_grid.cell**2 * (math.asin(sine) + sine * math.sqrt(1 - sine**2)) * 1e3
    assert out.energy == pytest.approx(through / WAVELENGTH_UM, rel=5e-3)


def test_bare_surfaces_lose_what_fresnel_says(paper_lens: Lens) -> None:
    ideal = line_scene(paper_lens)
    light = spot(ideal.object_grid, 5e-3)
    energies = [FlatTiles(s).forward(light).energy for s in (ideal, replace(ideal, coating="bare"))]
    index = 1.5194726
    assert energies[1] / energies[0] == pytest.approx((4 * index / (1 + index) ** 2) ** 2, rel=2e-3)


@pytest.mark.parametrize("exit_z_mm", [0.5, 0.65, 1.2])
def test_on_and_past_a_focus(exit_z_mm: float) -> None:
    scene = focusing_scene(exit_z_mm)
    light = spot(scene.object_grid, 0.012)
    engine = FlatTiles(scene, error=3e-3)
    assert engine.settings()["plane_z_mm"] < exit_z_mm
    found = engine.forward(light).values
    assert relative_error(found, WavePropagation(scene).forward(light).values) < 3e-3


def test_fold_is_refused_by_name() -> None:
    scene = focusing_scene(0.7)
    with pytest.raises(FoldError, match=r"fold.*z = 0\.65 mm"):
        FlatTiles(scene, plane_z_mm=0.65).forward(noise(scene.object_grid))


def test_too_wide_tiles_are_told_or_refused(paper_lens: Lens) -> None:
    scene = plane_scene(paper_lens)
    u = noise(scene.object_grid)
    with pytest.warns(SamplingWarning, match=r"tile_width_mm = 0\.07: .*0\.0"):
        FlatTiles(scene, tile_width_mm=0.07, quadratic="mean", error=0.015).forward(u)
    with pytest.raises(SamplingError, match=r"tile_width_mm = 0.07.*allowed: 0\.001"):
        FlatTiles(scene, tile_width_mm=0.07, quadratic="mean", error=1e-3).forward(u)


@pytest.mark.parametrize(
    ("width_mm", "rms", "largest"), [(0.05, 0.0052, 0.0134), (0.1, 0.0207, 0.0536), (0.2, 0.0827, 0.2143)]
)
def test_neglected_path_of_a_tile(paper_lens: Lens, width_mm: float, rms: float, largest: float) -> None:
    count = round(width_mm / 1e-3)
    scene = Scene(paper_lens, Grid((count, count), 1e-3, -13.5), Grid((20, 20), 0.1, 12.7), WAVELENGTH_UM)
    engine = FlatTiles(scene, tile_width_mm=1.0, quadratic="mean", error=0.5)
    assert engine.probe.neglected_waves == pytest.approx((rms, largest), rel=0.06)
    assert any(
        "waves rms" in part.description and part.relative_error > 0.005 for part in engine.error_terms()
    )


def test_narrow_tiles_keep_sharp_edges_where_rays_behind_the_rim_are_too_rough() -> None:
    """As of a sphere: its middle's rays can be followed into the shadow, its corners' cannot."""
    case = analytic_case("sphere", radius_mm=0.15)
    wide, narrow = (FlatTiles(case.scene, error=error) for error in (0.03, 3e-3))
    errors = [relative_error(e.forward(case.object_field).values, case.exact.values) for e in (wide, narrow)]
    assert [len(e.probe.tiles) for e in (wide, narrow)] == [1, 9]
    assert wide.error_terms()[1].description.endswith("beyond Fresnel's")
    assert errors[1] < 0.75 * errors[0] < 2e-3


def test_why_not_even_the_narrowest_tiles_do_is_said(paper_lens: Lens) -> None:
    def mapper(point_mm: tuple[float, float]) -> RayMap:
        raise RayMapError(f"the rays from {point_mm} are too rough")

    with pytest.raises(SamplingError, match=r"one object sample.*rough") as refused:
        chosen_probe(line_scene(paper_lens), 0.01, "mean", mapper)
    assert isinstance(refused.value.__cause__, RayMapError)


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("kind", ["plane", "line", "cylinder"])
def test_peak_bytes(paper_lens: Lens, kind: str, single: bool) -> None:
    case = analytic_case("cylinder")
    if kind != "cylinder":
        scene = line_scene(paper_lens) if kind == "line" else plane_scene(paper_lens)
        scene = replace(scene, exit_grid=Grid((20000,) if kind == "line" else (800, 800), 0.024, 12.7))
        if kind == "line":
            scene = replace(scene, exit_grid=Grid((20000,), 1e-3, 12.7))
        case = replace(case, scene=scene, object_field=noise(scene.object_grid))
    cost = FlatTiles(case.scene).cost()
    predicted = cost.peak_bytes_in_single if single else cost.peak_bytes
    if single:
        values = case.object_field.values.astype(np.complex64)
        case = replace(case, object_field=case.object_field.with_values(values))
    result = FlatTiles(case.scene).forward(case.object_field)
    assert predicted + result.values.nbytes == pytest.approx(peak_bytes("eikonal", case, {}), rel=0.3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"error": 0.0}, r"error = 0.0.*1e-5 to 1"),
        ({"tile_width_mm": -1.0}, r"tile_width_mm = -1.0"),
        ({"quadratic": "none"}, "quadratic = 'none': allowed: mean, low-rank"),
        ({"plane_z_mm": math.nan}, "plane_z_mm = nan"),
    ],
)
def test_unusable_settings_are_refused(paper_lens: Lens, settings: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        FlatTiles(line_scene(paper_lens), **settings)


def test_field_that_is_not_finite_is_refused(paper_lens: Lens) -> None:
    scene = line_scene(paper_lens)
    with pytest.raises(InputError, match="not finite"):
        FlatTiles(scene).forward(Field(scene.object_grid, np.full(200, np.nan), WAVELENGTH_UM))


def test_many_tiles_form_a_hierarchy_unless_settings_say_otherwise(paper_lens: Lens) -> None:
    patch, field = (patch_scene(paper_lens, width_mm) for width_mm in (0.1, 3.0))
    for scene, settings, kind in (
        (patch, {}, FlatTiles),
        (field, {}, HierarchicalTiles),
        (field, {"plane_z_mm": 12.7}, FlatTiles),
        (field, {"quadratic": "mean"}, FlatTiles),
        (field, {"hierarchical": False}, FlatTiles),
        (patch, {"hierarchical": True}, HierarchicalTiles),
        (patch, {"tiles_across": 2}, HierarchicalTiles),
    ):
        engine = EikonalEngine(scene, **settings)
        assert type(engine) is type(engine_for(scene, "eikonal", **settings)) is kind
        assert type(copy(engine)) is type(engine.at_wavelength(scene.wavelength_um)) is kind
    line = patch_scene(paper_lens, 3.0, meridional=True)
    assert type(EikonalEngine(line)) is FlatTiles


def test_settings_that_contradict_the_kind_of_tiles_are_refused(paper_lens: Lens) -> None:
    scene = patch_scene(paper_lens, 0.1)
    for settings in ({"hierarchical": False}, {"plane_z_mm": 12.7}, {"quadratic": "mean"}):
        with pytest.raises(InputError, match=f"{next(iter(settings))} = .*engine hierarchical"):
            engine_for(scene, "hierarchical", **settings)


def test_an_engine_on_another_scene_keeps_its_kind_of_tiles(paper_lens: Lens) -> None:
    """Settings that are in use name what is needed to make the same kind again."""
    twin = scaled(paper_lens, 1 / 16)
    scene = patch_scene(twin, 0.02, plane_distance_mm=0.125)
    for hierarchical in (False, True):
        engine = EikonalEngine(scene, error=0.1, hierarchical=hierarchical)
        other = patch_scene(twin, 0.021, plane_distance_mm=0.125)
        assert type(engine_on(engine, other)) is type(engine)


def test_candidates_make_the_kind_of_tiles_that_was_predicted(paper_lens: Lens) -> None:
    grids = Grid((840, 840), 2.5e-3, -13.5), Grid((300, 300), 0.07, 12.7)
    scene = Scene(paper_lens, *grids, WAVELENGTH_UM)
    for implementation in EikonalEngine.implementations():
        settings = next(iter(implementation.candidates(scene, 0.1)))
        assert type(engine_for(scene, implementation.name, **settings)) is implementation
