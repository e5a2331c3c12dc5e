"""Patches, objects, light, sensor windows, footprints and diversity of a design."""

import math
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lensdesign import load_design, scaled
from lensdesign.analysis.paraxial import first_order
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.poses import Pose
from wavesim.metrics.contrast import element_contrasts
from wavesim.scene.scattered_light import Light
from wavesim.scene.settings import DEFAULT_ERROR, EngineSettings, SettingError
from wavesim.sensor.sensor import FootprintWarning
from wavesim.sensor.windows import (
    TILE_ERROR,
    DiversityWarning,
    check_diversity,
    check_footprint,
    diversity,
    exit_scene,
    footprint_mm,
    imaging_engine,
    light_window,
    sensor_window,
)
from wavesim.targets.patch import (
    MAKERS,
    make_illumination,
    make_target,
    object_patch,
    usaf_charts_of,
    usaf_elements_of,
)
from wavesim.targets.usaf import chart_outline

PAPER = load_design("designs/paper_singlet.toml")
TWIN = scaled(PAPER, 0.125)
SMALL = scaled(PAPER, 1 / 32)


def test_a_patch_holds_the_light_of_the_aperture() -> None:
    patch = object_patch(TWIN, 0.38)
    assert patch.grid.pitch_mm < 0.532e-3 / (2 * 0.5)
    assert 0.38 <= patch.grid.shape[0] * patch.grid.pitch_mm < 0.4
    assert patch.field_stop_mm == 0.38
    assert patch.grid.z_mm == pytest.approx(-13.5 / 8)
    area = np.count_nonzero(patch.inside) * patch.grid.cell
    assert area == pytest.approx(math.pi * 0.19**2, rel=1e-3)


@pytest.mark.parametrize(
    ("patch_mm", "stop_mm", "message"),
    [
        (0.4, None, "field_diameter_mm = 0.375"),
        (0.0, None, "patch_mm = 0"),
        (math.nan, None, "patch_mm = nan"),
        (0.1, 0.2, r"field_stop_mm = 0.2.*patch_mm = 0.1"),
    ],
)
def test_patches_that_are_refused(patch_mm: float, stop_mm: float | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        object_patch(TWIN, patch_mm, stop_mm)


@pytest.mark.parametrize("name", ["usaf", *MAKERS])
def test_objects_lie_within_the_field_stop(name: str) -> None:
    patch = object_patch(TWIN, 0.1)
    values = make_target(patch, name, "dark", numerical_aperture=0.5, seed=3).transmission.values
    assert values.shape == patch.grid.shape
    assert np.abs(values).max() <= 1.0 + 1e-6
    if name != "tissue":  # it fills the patch
        ground = 1.0 if name in ("phase", "empty") else 0.0
        np.testing.assert_allclose(values[~patch.inside], ground, atol=1e-6)
        assert np.any(np.abs(values[patch.inside] - ground) > 0.5) == (name != "empty")


def test_the_chart_tells_its_elements_and_both_grounds_add_up() -> None:
    patch = object_patch(TWIN, 0.1)
    bright, dark = (make_target(patch, "usaf", g, numerical_aperture=0.5) for g in ("bright", "dark"))
    np.testing.assert_allclose(bright.transmission.values + dark.transmission.values, 1.0, atol=1e-6)
    assert bright.elements == dark.elements
    assert min(one.line_width_um for one in bright.elements) == pytest.approx(0.87, abs=0.01)


def test_charts_beside_the_middle_lie_about_their_points_and_apart() -> None:
    patch = object_patch(PAPER, 0.4)
    points = [(0.15, 0.0), (-0.12, 0.1)]
    charts = usaf_charts_of(patch, points)
    assert charts[0] == usaf_elements_of(patch)
    for chart, point in zip(charts[1:], points, strict=True):
        assert {one.group for one in chart} <= {8, 9, 10}
        around = chart_outline(chart)
        middle = (0.5 * (around.left_mm + around.right_mm), 0.5 * (around.low_mm + around.high_mm))
        assert middle == pytest.approx(point, abs=1e-12)
        assert min(one.line_width_um for one in chart) == min(one.line_width_um for one in charts[0])
    target = make_target(patch, "usaf", numerical_aperture=0.5, chart_at_mm=points)
    assert target.elements == tuple(one for chart in charts for one in chart)
    contrasts = element_contrasts(target.transmission.values, patch.grid, charts[1])
    assert all(one.contrast > 0.9 for one in contrasts)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([(0.02, 0.01)], "overlaps another chart"),
        ([(0.15, 0.0), (0.15, 0.0)], r"chart at 0.15, 0 mm: .*overlaps"),
        ([(0.199, 0.0)], r"field stop of 0.4 mm"),
        ([(math.nan, 0.0)], "chart at nan, 0.0 mm: must be finite"),
    ],
)
def test_charts_without_room_are_refused(points: list[tuple[float, float]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        usaf_charts_of(object_patch(PAPER, 0.4), points)


def test_a_chart_beside_takes_fewer_groups_where_there_is_less_room() -> None:
    patch = object_patch(PAPER, 0.4, object_pitch_um=0.24)
    groups = [{one.group for one in usaf_charts_of(patch, [(x, 0.0)])[1]} for x in (0.15, 0.18, 0.19)]
    assert groups == [{8, 9, 10}, {9, 10}, {10}]
    with pytest.raises(SamplingError, match=r"lines of 1\.953 µm, the widest that are 0\.15, 0 mm from"):
        usaf_charts_of(object_patch(PAPER, 0.4, object_pitch_um=1.5), [(0.15, 0.0)])


@pytest.mark.parametrize(("rows", "columns"), [(7, 3), (40, 400), (300, 200)])
def test_a_picture_of_any_size_is_fitted_into_the_field_stop(tmp_path: Path, rows: int, columns: int) -> None:
    path = tmp_path / "picture.png"
    Image.fromarray(np.full((rows, columns), 255, np.uint8)).save(path)
    patch = object_patch(TWIN, 0.1, 0.08)

    def sides(**size: float) -> tuple[float, float]:
        values = make_target(patch, str(path), numerical_aperture=0.5, **size).transmission.values.real
        return tuple(patch.grid.pitch_mm * float(values.max(axis).sum()) for axis in (0, 1))

    across, down = sides()
    assert math.hypot(across, down) == pytest.approx(0.08, rel=0.02)
    assert across * rows == pytest.approx(down * columns, rel=0.06)
    assert sides(picture_width_mm=0.5 * across)[0] == pytest.approx(0.5 * across, rel=0.02)


def test_sizes_of_a_picture_that_do_not_fit_are_refused_in_one_message(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    Image.fromarray(np.full((20, 30), 255, np.uint8)).save(path)
    patch = object_patch(TWIN, 0.1, 0.05)
    with pytest.raises(InputError, match=r"picture_width_mm = 0\.06: .* give at most 0\.0416"):
        make_target(patch, str(path), numerical_aperture=0.5, picture_width_mm=0.06)
    with pytest.raises(InputError, match="picture_pixel_um, picture_width_mm: give only one of them"):
        make_target(patch, str(path), numerical_aperture=0.5, picture_width_mm=0.01, picture_pixel_um=1.0)


def test_a_picture_larger_than_the_field_stop_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    Image.fromarray(np.full((20, 30), 255, np.uint8)).save(path)
    patch = object_patch(TWIN, 0.1, 0.05)
    found = make_target(patch, str(path), numerical_aperture=0.5, picture_pixel_um=1.0)
    lit = float(np.sum(np.abs(found.transmission.values) ** 2)) * patch.grid.cell
    assert lit == pytest.approx(0.02 * 0.03, rel=0.02)
    with pytest.raises(InputError, match=r"picture_pixel_um = 2: .*30 x 20 pixels.* give at most 1\.387"):
        make_target(patch, str(path), numerical_aperture=0.5, picture_pixel_um=2.0)
    with pytest.raises(InputError, match=r"object = 'usef'.*did you mean usaf"):
        make_target(patch, "usef", numerical_aperture=0.5)


def test_light_keeps_to_the_stop_and_to_its_kind(tmp_path: Path) -> None:
    patch = object_patch(TWIN, 0.1, 0.08)
    plane = make_illumination(patch)
    assert plane.values.dtype == np.complex64
    assert plane.energy == pytest.approx(math.pi * 0.04**2, rel=1e-2)
    tilted = make_illumination(patch, "tilted", tilt_deg=(2.0, 0.0)).values
    middle = patch.grid.shape[0] // 2
    step = np.angle(tilted[middle, middle + 1] / tilted[middle, middle])
    slope = math.tan(math.radians(2.0)) / math.hypot(1.0, math.tan(math.radians(2.0)))
    assert step == pytest.approx(2e3 * math.pi / 0.532 * slope * patch.grid.pitch_mm, rel=1e-4)
    gaussian = np.abs(make_illumination(patch, "gaussian").values)
    at_waist = abs(abs(patch.grid.x_mm) - 0.02).argmin()
    assert gaussian[middle, at_waist] == pytest.approx(math.exp(-1.0), abs=0.02)
    distance = 0.4
    point = make_illumination(patch, "point", source_distance_mm=distance)
    assert point.energy == pytest.approx(math.pi * distance**2 * math.log1p((0.04 / distance) ** 2), rel=1e-2)
    grains = make_illumination(patch, "speckle", speckle_na=0.3, speckle_seed=4)
    assert grains.energy == pytest.approx(plane.energy, rel=0.1)
    assert not grains.values[~patch.inside & (plane.values == 0.0)].any()
    for name, missing in (("point", "source_distance_mm"), ("speckle", "speckle_na")):
        with pytest.raises(SettingError, match=f"illumination {name}: requires {missing}"):
            make_illumination(patch, name)
    np.savez(tmp_path / "light.npz", values=2.0 * np.ones((300, 300), complex), pitch_um=0.4)
    measured = make_illumination(patch, str(tmp_path / "light.npz"))
    assert measured.energy == pytest.approx(4.0 * plane.energy, rel=1e-3)
    with pytest.raises(InputError, match=r"illumination = 'gausian'.*did you mean gaussian"):
        make_illumination(patch, "gausian")


def test_windows_hold_the_footprint_and_no_more_than_the_sensor() -> None:
    patch = object_patch(SMALL, 0.05)
    planes = SMALL.sensor.plane_distances_mm
    widest = max(footprint_mm(SMALL, patch, z) for z in planes)
    window = sensor_window(SMALL, patch, planes)
    assert widest < min(window.size_mm) < 1.1 * widest
    assert sensor_window(SMALL, patch, planes, 100).pixels == (100, 100)
    near, far = (footprint_mm(SMALL, patch, z) for z in (1.0, 2.0))
    assert far > near
    assert sensor_window(SMALL, patch, (0.05, 3.0)).pixels[1] == SMALL.sensor.pixels[1]
    assert min(light_window(window, far_mm := footprint_mm(SMALL, patch, 3.0)).size_mm) > far_mm
    # The disc is about the axis; a lens that is moved also bends the light.
    wider = footprint_mm(SMALL, patch, 0.0625, Pose(decenter_x_mm=0.05)) - footprint_mm(SMALL, patch, 0.0625)
    assert 0.1 < wider < 0.2
    with pytest.raises(InputError, match=r"pixels = 300: .*1 to the sensor's 219"):
        sensor_window(SMALL, patch, planes, 300)
    # The sensor is wider than high.
    assert sensor_window(SMALL, patch, planes, SMALL.sensor.pixels).pixels == (292, 219)
    assert sensor_window(SMALL, patch, planes, (292, 100)).pixels == (292, 100)
    with pytest.raises(InputError, match=r"pixels = 219 x 292: .*1 x 1 to the sensor's 292 x 219"):
        sensor_window(SMALL, patch, planes, (219, 292))


def test_a_footprint_beyond_the_sensor_is_told_then_refused() -> None:
    patch = object_patch(SMALL, 0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_footprint(SMALL, patch, SMALL.sensor, (0.0625,))
    with pytest.warns(FootprintWarning, match="beyond the sensor's"):
        check_footprint(SMALL, patch, SMALL.sensor.replaced(pixels=(180, 180)), (0.0625,))
    with pytest.raises(InputError, match="smaller patch, more pixels"):
        check_footprint(SMALL, patch, SMALL.sensor.replaced(pixels=(100, 100)), (0.0625,))


def test_diversity_is_that_of_the_formula_and_told_where_it_is_low() -> None:
    patch = object_patch(PAPER, 0.1)
    focal_mm = first_order(PAPER, 0.532).efl_mm
    figure = 20.0 * 0.1**2 / (0.532e-3 * focal_mm**2)
    assert diversity(PAPER, patch, (2.0, 22.0)) == pytest.approx(figure, rel=1e-12)
    # All lengths scaled, it grows as the lengths shrink for the same patch, and with the field for its own.
    assert diversity(TWIN, object_patch(TWIN, 0.38), (0.25, 2.75)) > 50.0
    with pytest.warns(DiversityWarning, match=rf"dz w\^2 / \(lambda f\^2\) = {figure:.3g}"):
        check_diversity(PAPER, patch, (2.0, 22.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_diversity(TWIN, object_patch(TWIN, 0.38), (0.25, 2.75))


def test_engines_of_choice() -> None:
    patch = object_patch(SMALL, 0.03)
    scene = exit_scene(SMALL, patch, SMALL.sensor.replaced(pixels=(200, 200)), 0.0625)
    light = Light(make_illumination(patch))
    asked = partial(imaging_engine, scene, runs=10, light=light)
    chosen = asked(EngineSettings())
    assert chosen.name == "eikonal"
    assert chosen.predicted_error(light) <= DEFAULT_ERROR < chosen.predicted_error()
    tiles = asked(EngineSettings(engine="eikonal"))
    assert tiles.settings()["error"] == TILE_ERROR
    coarser = asked(EngineSettings(engine="eikonal", error=0.2))
    assert coarser.settings()["error"] == 0.2
    assert asked(EngineSettings(engine="slices", slices=7)).settings()["slices"] == 7
    with pytest.raises(InputError, match="auto: slices = 12"):
        asked(EngineSettings(slices=12))
    with pytest.raises(InputError, match=r"engine slices: error = 0\.1"):
        asked(EngineSettings(engine="slices", error=0.1))
