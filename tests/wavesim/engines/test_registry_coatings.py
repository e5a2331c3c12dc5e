"""Amplitude and phase of coatings on all engines that propagate through surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from coated_plate import COATED, FILMS, WAVELENGTH_UM, beam, plane_waves, plate_scene

from wavesim import Field, Scene, engine_for

SIZE_MM = 0.1
ENGINES = [
    ("eikonal", {"tile_width_mm": 1.0, "error": 1e-3}),
    ("slices", {"slices": 3, "compensation": "oblique"}),
    ("wpm", {}),
]


def line_through(coating: Any) -> Scene:
    return plate_scene(SIZE_MM, coating, "scalar", 1)


def exact_field(scene: Scene, films: Any) -> np.ndarray:
    """The field of s light, up to a factor."""
    return np.fft.ifft(plane_waves(scene, films)[0])


@pytest.mark.parametrize(("engine", "settings"), ENGINES)
@pytest.mark.parametrize(("coating", "films", "allowed"), [("bare", (), 3e-4), (COATED, FILMS, 2e-3)])
def test_a_coated_plate_has_the_sum_over_plane_waves(
    engine: str, settings: dict[str, Any], coating: Any, films: Any, allowed: float
) -> None:
    scene = line_through(coating)
    found = engine_for(scene, engine, **settings).forward(beam(scene)).values
    exact = exact_field(scene, films)
    scale = abs(np.vdot(exact, found) / np.vdot(exact, exact))
    assert np.linalg.norm(found - scale * exact) < allowed * np.linalg.norm(found)
    # Without the phase of the coating the same field would differ by more.
    if films:
        bare = exact_field(scene, ())
        size = np.vdot(bare, found) / np.vdot(bare, bare)
        assert np.linalg.norm(found - size * bare) > 3.0 * allowed * np.linalg.norm(found)


@pytest.mark.parametrize(("engine", "settings"), ENGINES)
def test_the_adjoint_with_phases_of_coatings(engine: str, settings: dict[str, Any]) -> None:
    scene = line_through(COATED)
    built, random = engine_for(scene, engine, **settings), np.random.default_rng(4)
    start, end = (
        Field(grid, random.standard_normal((grid.size, 2)) @ [1.0, 1j], WAVELENGTH_UM)
        for grid in (scene.object_grid, scene.exit_grid)
    )
    left = np.vdot(built.forward(start).values, end.values) * scene.exit_grid.cell
    right = np.vdot(start.values, built.adjoint(end).values) * scene.object_grid.cell
    assert abs(left - right) < 1e-9 * abs(left)
