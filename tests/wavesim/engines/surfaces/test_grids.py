"""The grid on which a field is carried: chosen, checked, and refused where it is too large."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import Lens, Pose
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.surface import Surface
from wavesim.engines.surfaces.grids import check_grid_size, working_grid
from wavesim.fields.field import Grid
from wavesim.scene.engine import Cost
from wavesim.scene.scene import Scene

WAVELENGTH_UM, INDEX = 0.532, 1.5


def scene_of(
    shape: tuple[int, ...] = (40,),
    stop_mm: float = 0.3,
    y_mm: float = 0.0,
    perturbations: dict[int, SurfacePerturbation] | None = None,
) -> Scene:
    """A biconvex lens 1 mm behind the object."""
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.1, numerical_aperture=0.3, working_distance_mm=1.0),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(0.5,)),
        surfaces=(
            Surface(radius_mm=1.5, thickness_mm=0.3, material=INDEX, semi_diameter_mm=stop_mm, stop=True),
            Surface(radius_mm=-1.5, semi_diameter_mm=0.6),
        ),
    )
    grids = Grid(shape, 1e-3, -1.0, (0.0, y_mm)), Grid(shape, 1e-3, 1.0)
    return Scene(lens, *grids, WAVELENGTH_UM, surface_perturbations=perturbations or {})


@given(stop_mm=st.floats(0.05, 0.4), y_mm=st.floats(-0.1, 0.1))
def test_holds_all_rays(stop_mm: float, y_mm: float) -> None:
    found = working_grid(scene_of(stop_mm=stop_mm, y_mm=y_mm))
    rim = math.hypot(1.0, stop_mm + abs(y_mm) + 0.02)
    steepest = 2.0 * math.pi / WAVELENGTH_UM * 1e3 * (stop_mm + abs(y_mm) + 0.02) / rim
    assert math.pi / found.grid.pitch_mm > 0.97 * steepest
    assert found.grid.half_widths_mm[0] > stop_mm
    assert found.reach_mm[0] >= stop_mm * (1.0 - 1e-9)
    for low, high in found.heights_mm:
        assert low < high
    assert found.reflected == 0.0


def test_steeper_light_takes_a_finer_pitch() -> None:
    pitches = [working_grid(scene_of(stop_mm=s)).grid.pitch_mm for s in (0.1, 0.2, 0.4)]
    assert pitches == sorted(pitches, reverse=True)


def test_a_plane_is_as_wide_as_a_line() -> None:
    line, plane = working_grid(scene_of()), working_grid(scene_of((40, 40)))
    assert len(plane.grid.shape) == 2
    assert plane.grid.half_widths_mm[0] == pytest.approx(line.grid.half_widths_mm[0], rel=0.1)


def test_asked_for_grids_are_taken_or_refused_with_the_limit() -> None:
    scene = scene_of()
    chosen = working_grid(scene).grid
    half = chosen.half_widths_mm[0]
    finer = working_grid(scene, 0.5 * chosen.pitch_mm, 1.2 * half).grid
    assert finer.pitch_mm == 0.5 * chosen.pitch_mm
    assert finer.half_widths_mm[0] >= 1.2 * half
    with pytest.raises(SamplingError, match=r"pitch_mm = .*at most .* mm"):
        working_grid(scene, 1.2 * chosen.pitch_mm)
    with pytest.raises(SamplingError, match=r"half_width_mm = .*at least .* mm"):
        working_grid(scene, None, 0.9 * half)
    for bad in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="above 0"):
            working_grid(scene, bad)


def test_light_that_never_gets_through_is_refused() -> None:
    with pytest.raises(InputError, match="fewer than three rays"):
        working_grid(scene_of(perturbations={1: SurfacePerturbation(decenter_y_mm=1.4)}))
    beside = replace(scene_of(), pose=Pose(decenter_x_mm=0.4))
    with pytest.raises(InputError, match=r"surface 0 .* decenter"):
        working_grid(beside)


def test_an_object_behind_the_lens_is_refused() -> None:
    scene = replace(scene_of(), pose=Pose(despace_mm=-1.5))
    with pytest.raises(InputError, match=r"vertex.* 0\.5 mm"):
        working_grid(scene)


def test_light_along_the_planes_is_refused() -> None:
    """A ball that turns the light of its rim far round."""
    lens = scene_of().lens
    ball = (
        Surface(radius_mm=0.5, thickness_mm=1.0, material=2.4, semi_diameter_mm=0.45, stop=True),
        Surface(radius_mm=-0.5, semi_diameter_mm=0.45),
    )
    steep = Scene(
        lens.model_copy(update={"surfaces": ball}),
        Grid((40,), 1e-3, -0.3),
        Grid((40,), 1e-3, 1.2),
        WAVELENGTH_UM,
    )
    with pytest.raises(SamplingError, match=r"at most 78\.5"):
        working_grid(steep)


@pytest.mark.parametrize("cost", [Cost(1.0, 0.0, 10**11), Cost(1e4, 0.0, 1000), Cost(1.0, 1e4, 1000)])
def test_huge_runs_are_refused_with_their_size(cost: Cost) -> None:
    with pytest.raises(SamplingError, match=r"engine wpm: 1e\+09 samples"):
        check_grid_size("wpm", 10**9, cost, force=False)
    check_grid_size("wpm", 10**9, cost, force=True)
    check_grid_size("wpm", 10**9, Cost(10.0, 1.0, 10**9), force=False)
