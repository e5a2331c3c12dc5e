"""A beam up to NA 0.5 through a coated plane-parallel plate, and its sum over plane waves."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lensdesign import Coating, CoatingLayer, Lens, ObjectSpace, Sensor, Surface
from lensdesign.lens.coatings.thin_films import film_coefficients
from wavesim import Field, Grid, Scene

WAVELENGTH_UM, INDEX, SPREAD, APERTURE = 0.532, 1.5195, 0.125, 0.68
K = 2e3 * math.pi / WAVELENGTH_UM
FILMS = (1.38, 0.0964), (2.05, 0.1297), (1.65, 0.0806)
COATED = Coating(layers=tuple(CoatingLayer(index=n, thickness_nm=1e3 * d) for n, d in FILMS))


def plate_scene(size_mm: float, coating: str | Coating, polarization: str | float, dimensions: int) -> Scene:
    """A plate as thick as its distance, for a beam whose amplitude at NA 0.5 is 3e-4 of that on the axis."""
    outside, inside = (math.tan(math.asin(APERTURE / n)) for n in (1.0, INDEX))
    widths = (math.tan(5.2 * SPREAD / n) for n in (1.0, INDEX))
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(
            field_diameter_mm=0.1 * size_mm, numerical_aperture=APERTURE, working_distance_mm=size_mm
        ),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(64, 64), plane_distances_mm=(0.5 * size_mm,)),
        surfaces=(
            Surface(
                thickness_mm=size_mm,
                material=INDEX,
                semi_diameter_mm=size_mm * outside,
                stop=True,
                coating=coating,
            ),
            Surface(semi_diameter_mm=size_mm * (outside + 1.05 * inside), coating=coating),
        ),
    )
    half = sum(d * width for d, width in zip((1.5 * size_mm, size_mm), widths, strict=True))
    count, start = 2 * math.ceil(half / 4e-4), 2 * math.ceil(5.0 / (K * SPREAD) / (0.25e-3 * WAVELENGTH_UM))
    return Scene(
        lens,
        Grid((start,) * dimensions, 0.25e-3 * WAVELENGTH_UM, -size_mm),
        Grid((count,) * dimensions, 4e-4, 1.5 * size_mm),
        WAVELENGTH_UM,
        polarization=polarization,
    )


def beam(scene: Scene) -> Field:
    grid, d = scene.object_grid, len(scene.object_grid.shape)
    squared = np.asarray(grid.radius_squared_mm2())
    values = np.exp(-0.5 * (K * SPREAD) ** 2 * squared) * (K * SPREAD) ** d * (2.0 * math.pi) ** (-0.5 * d)
    return Field(grid, values.astype(complex), WAVELENGTH_UM)


def plane_waves(scene: Scene, films: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Field of s light, of p light, and the mixing of both for light along x, as spectra on the exit grid."""
    grid, size_mm = scene.exit_grid, -scene.object_grid.z_mm
    sines = 2.0 * np.pi * np.fft.fftfreq(grid.shape[0], grid.pitch_mm) / K
    py, px = (sines, 0.0 * sines) if grid.is_line else np.meshgrid(sines, sines, indexing="ij")
    squared = px**2 + py**2
    cosine = np.sqrt(np.where(squared < 0.9, 1.0 - squared, 1.0))
    inside = np.sqrt(INDEX**2 - squared) / INDEX
    indices, thicknesses = [complex(n) for n, _ in films], [d for _, d in films]
    first = film_coefficients(1.0, INDEX, indices, thicknesses, cosine, WAVELENGTH_UM)
    last = film_coefficients(INDEX, 1.0, indices[::-1], thicknesses[::-1], inside, WAVELENGTH_UM)
    # The films displace air.
    path = 1.5 * size_mm * cosine + size_mm * INDEX * inside - 2e-3 * sum(thicknesses) * cosine
    wave = np.exp(-0.5 * squared / SPREAD**2 + 1j * K * path) * (squared < 0.9)
    low = [float(axis[0]) for axis in (grid.y_mm, grid.x_mm)]
    wave = wave * np.exp(1j * K * (py * low[0] + (0.0 if grid.is_line else px * low[1])))
    turn = np.where(squared > 0.0, (px + 1j * py) ** 2 / np.where(squared > 0.0, squared, 1.0), 1.0)
    return wave * first.ts * last.ts, wave * first.tp * last.tp, turn
