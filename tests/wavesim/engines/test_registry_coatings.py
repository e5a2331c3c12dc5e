"""Amplitude and phase of coatings on all engines that propagate through surfaces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from lensdesign import Coating, CoatingLayer, Lens, ObjectSpace, Sensor, Surface
from lensdesign.lens.coatings.thin_films import film_coefficients
from wavesim import Field, Grid, Scene, engine_for

WAVELENGTH_UM, INDEX, SPREAD, SIZE_MM = 0.532, 1.5195, 0.125, 0.1
K = 2e3 * math.pi / WAVELENGTH_UM
FILMS = (1.38, 0.0964), (2.05, 0.1297), (1.65, 0.0806)
COATED = Coating(layers=tuple(CoatingLayer(index=n, thickness_nm=1e3 * d) for n, d in FILMS))
ENGINES = [
    ("eikonal", {"tile_width_mm": 1.0, "error": 1e-3}),
    ("slices", {"slices": 3, "compensation": "oblique"}),
    ("wpm", {}),
]


def plate_scene(coating: Any) -> Scene:
    """A meridional line through a plate, as wide as a beam up to NA 0.68."""
    outside, inside = (math.tan(math.asin(0.68 / n)) for n in (1.0, INDEX))
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(
            field_diameter_mm=0.1 * SIZE_MM, numerical_aperture=0.68, working_distance_mm=SIZE_MM
        ),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(64, 64), plane_distances_mm=(0.5 * SIZE_MM,)),
        surfaces=(
            Surface(
                thickness_mm=SIZE_MM,
                material=INDEX,
                semi_diameter_mm=SIZE_MM * outside,
                stop=True,
                coating=coating,
            ),
            Surface(semi_diameter_mm=SIZE_MM * (outside + 1.05 * inside), coating=coating),
        ),
    )
    half = SIZE_MM * (1.5 * math.tan(5.2 * SPREAD) + math.tan(5.2 * SPREAD / INDEX))
    start = 2 * math.ceil(5.0 / (K * SPREAD) / (0.25e-3 * WAVELENGTH_UM))
    exit_grid = Grid((2 * math.ceil(half / 4e-4),), 4e-4, 1.5 * SIZE_MM)
    return Scene(lens, Grid((start,), 0.25e-3 * WAVELENGTH_UM, -SIZE_MM), exit_grid, WAVELENGTH_UM)


def beam(scene: Scene) -> Field:
    y = scene.object_grid.y_mm
    values = np.exp(-0.5 * (K * SPREAD * y) ** 2) * K * SPREAD / math.sqrt(2.0 * math.pi)
    return Field(scene.object_grid, values.astype(complex), WAVELENGTH_UM)


def plane_waves(scene: Scene, films: Any) -> np.ndarray:
    """Sum over plane waves of s light on the exit grid."""
    grid = scene.exit_grid
    sine = 2.0 * np.pi * np.fft.fftfreq(grid.shape[0], grid.pitch_mm) / K
    passes = sine**2 < 0.9
    cosine, inside = np.sqrt(np.where(passes, 1.0 - sine**2, 1.0)), np.sqrt(1.0 - (sine / INDEX) ** 2)
    indices, thicknesses = [complex(n) for n, _ in films], [d for _, d in films]
    first = film_coefficients(1.0, INDEX, indices, thicknesses, cosine, WAVELENGTH_UM)
    last = film_coefficients(INDEX, 1.0, indices[::-1], thicknesses[::-1], inside, WAVELENGTH_UM)
    path = SIZE_MM * (1.5 * cosine + INDEX * inside) - 2e-3 * sum(thicknesses) * cosine
    wave = np.exp(-0.5 * (sine / SPREAD) ** 2 + 1j * K * (path + sine * grid.y_mm[0])) * passes
    return np.fft.ifft(wave * first.ts * last.ts) / grid.pitch_mm


@pytest.mark.parametrize(("engine", "settings"), ENGINES)
@pytest.mark.parametrize(("coating", "films", "allowed"), [("bare", (), 3e-4), (COATED, FILMS, 2e-3)])
def test_a_coated_plate_has_the_sum_over_plane_waves(
    engine: str, settings: dict[str, Any], coating: Any, films: Any, allowed: float
) -> None:
    scene = plate_scene(coating)
    found = engine_for(scene, engine, **settings).forward(beam(scene)).values
    exact = plane_waves(scene, films)
    scale = abs(np.vdot(exact, found) / np.vdot(exact, exact))
    assert np.linalg.norm(found - scale * exact) < allowed * np.linalg.norm(found)
    # Without the phase of the coating the same field would differ by more.
    if films:
        bare = plane_waves(scene, ())
        size = np.vdot(bare, found) / np.vdot(bare, bare)
        assert np.linalg.norm(found - size * bare) > 3.0 * allowed * np.linalg.norm(found)


@pytest.mark.parametrize(("engine", "settings"), ENGINES)
def test_the_adjoint_with_phases_of_coatings(engine: str, settings: dict[str, Any]) -> None:
    scene = plate_scene(COATED)
    built, random = engine_for(scene, engine, **settings), np.random.default_rng(4)
    start, end = (
        Field(grid, random.standard_normal((grid.size, 2)) @ [1.0, 1j], WAVELENGTH_UM)
        for grid in (scene.object_grid, scene.exit_grid)
    )
    left = np.vdot(built.forward(start).values, end.values) * scene.exit_grid.cell
    right = np.vdot(start.values, built.adjoint(end).values) * scene.object_grid.cell
    assert abs(left - right) < 1e-9 * abs(left)
