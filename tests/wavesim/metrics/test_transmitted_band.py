"""What a lens passes of an object field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign import Pose, load_design, scaled
from lensdesign.errors import InputError
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.metrics.contrast import object_correlation
from wavesim.metrics.transmitted_band import transmitted_directions, transmitted_part
from wavesim.scene.scene import Scene
from wavesim.targets.usaf import UsafElement, usaf_chart

WAVELENGTH = 0.532
APERTURE = 0.5
LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
GRID = Grid((120, 120), 4.2e-4, LENS.object_z_mm)
SCENE = Scene(LENS, GRID, Grid((216, 216), 3.2e-3, LENS.exit_vertex_z_mm + 0.08), WAVELENGTH)
OPEN = transmitted_directions(SCENE)


def wave(sine_y: float, sine_x: float, grid: Grid = GRID) -> Field:
    """A plane wave by its direction cosines."""
    path = sine_y * grid.y_mm[:, None] + sine_x * grid.x_mm
    return Field(grid, np.exp(2j * np.pi * path / (1e-3 * WAVELENGTH)), WAVELENGTH)


@pytest.mark.parametrize(("y_mm", "x_mm"), [(0.0, 0.0), (0.02, -0.013)])
def test_the_border_is_that_of_straight_rays_to_the_stop(y_mm: float, x_mm: float) -> None:
    """The stop is the rim of the front surface: a circle in the plane of that rim."""
    border = OPEN.border(np.array([y_mm, x_mm]))
    radius = LENS.stop_semi_diameter_mm
    depth_mm = LENS.surfaces[LENS.stop_index].sag_mm(radius) - LENS.object_z_mm
    slopes = border / np.sqrt(1.0 - np.sum(border**2, axis=1, keepdims=True))
    assert np.hypot(*(slopes * depth_mm + (y_mm, x_mm)).T) == pytest.approx(radius, rel=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.0, 0.58), st.floats(0.0, 6.28))
def test_a_plane_wave_passes_or_does_not(sine: float, turn: float) -> None:
    """Far from what a block's middle sees as the border, all or nothing."""
    field = wave(sine * np.sin(turn), sine * np.cos(turn))
    middle = np.s_[52:68, 52:68]
    passed = transmitted_part(field, OPEN).values[middle]
    if sine < 0.42:
        assert passed == pytest.approx(field.values[middle], abs=0.03)
    elif sine > 0.56:
        assert np.max(np.abs(passed)) < 0.06


def test_it_is_a_projection_nearly_and_keeps_the_grid() -> None:
    rng = np.random.default_rng(3)
    field = Field(GRID, rng.normal(size=GRID.shape) + 1j * rng.normal(size=GRID.shape), WAVELENGTH)
    once = transmitted_part(field, OPEN)
    twice = transmitted_part(once, OPEN)
    left = np.linalg.norm(once.values)
    assert once.grid == GRID
    assert left < 0.75 * np.linalg.norm(field.values)  # a disc of 0.5 in a square of 0.63
    assert np.linalg.norm(twice.values - once.values) < 0.15 * left
    assert transmitted_part(field.with_values(0.0 * field.values), OPEN).values.any() == np.False_


def test_a_part_of_the_object_has_its_own_directions() -> None:
    part = Grid((40, 40), GRID.pitch_mm, GRID.z_mm, (0.015, -0.01))
    here = transmitted_directions(SCENE, part)
    point = np.array([-0.012, 0.014])
    assert here.border(point) == pytest.approx(OPEN.border(point), abs=1e-5)


def test_a_displaced_lens_opens_other_directions() -> None:
    moved = transmitted_directions(replace(SCENE, pose=Pose(decenter_x_mm=0.01)))
    shift = np.mean(moved.border(np.zeros(2)) - OPEN.border(np.zeros(2)), axis=0)
    assert shift[1] > 5e-3
    assert abs(shift[0]) < 1e-6


def test_what_a_lens_passes_by_aperture_by_engine_and_by_rays() -> None:
    """On an ideal lens both ways to limit the truth agree: its finest detail is gone in both."""
    grid, engine = GRID, engine_for(SCENE, "eikonal", error=0.01)
    inside = np.hypot(grid.y_mm[:, None], grid.x_mm) < 0.022
    chart = usaf_chart(grid, [UsafElement(8, 3, (0.0, 0.0)), UsafElement(8, 6, (0.0, 0.012))], "bright")
    lit = Field(grid, inside.astype(np.complex64), WAVELENGTH)
    seen = lit.with_values((lit.values * chart).astype(np.complex64))
    limited = [[transmitted_part(one, by) for one in (seen, lit)] for by in (engine, APERTURE, OPEN)]
    (by_engine, lit_by_engine), (by_aperture, _), (by_rays, lit_by_rays) = limited
    assert object_correlation(by_engine, by_aperture, lit_by_engine, inside) > 0.95
    assert object_correlation(by_engine, seen, lit, inside) < object_correlation(
        by_engine, by_aperture, lit_by_engine, inside
    )
    left = np.linalg.norm(by_rays.values - by_engine.values)
    assert left < 0.05 * np.linalg.norm(by_engine.values)
    assert object_correlation(by_rays, by_engine, lit_by_rays, inside) > 0.997


def test_a_line_is_for_engines() -> None:
    line = Scene(
        LENS, Grid((64,), 4.2e-4, LENS.object_z_mm), Grid((64,), 3.2e-3, SCENE.exit_grid.z_mm), WAVELENGTH
    )
    with pytest.raises(InputError, match="must be a plane"):
        transmitted_directions(line)
