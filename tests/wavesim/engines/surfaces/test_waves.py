"""Waves on a curved surface and from it, against direct sums of plane waves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from wavesim.engines.surfaces.samples import SurfaceSamples
from wavesim.engines.surfaces.waves import Medium, SurfaceWaves, interpolation_error, planes_across
from wavesim.fields.field import Grid, relative_error

GRID = Grid((96,), 3e-4, 0.0)
PLANE = Grid((24, 20), 4e-4, 0.0)
ComplexArray = NDArray[np.complex128]


def bowl(grid: Grid, flat: bool = False) -> SurfaceSamples:
    """z = 8 r^2 over the middle of the grid."""
    x, y = (c.ravel() for c in np.broadcast_arrays(grid.x_mm, grid.y_mm[:, None]))
    pixels = np.flatnonzero(np.hypot(x, y) < 0.4 * grid.pitch_mm * grid.shape[0])
    z = np.zeros(len(pixels)) if flat else 8.0 * (x[pixels] ** 2 + y[pixels] ** 2)
    order = np.argsort(z, kind="stable")
    pixels, z = pixels[order], z[order]
    rise = 0.0 if flat else 16.0
    slopes = (rise * y[pixels],) if grid.is_line else (rise * y[pixels], rise * x[pixels])
    return SurfaceSamples(pixels, z, slopes, np.ones(len(z)), float(z[-1]))


def medium(grid: Grid) -> Medium:
    return Medium(grid, 0.532, 1.5, 7000.0)


def noise(shape: tuple[int, ...], seed: int) -> ComplexArray:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.normal(size=shape) + 1j * rng.normal(size=shape))


def direct(waves: SurfaceWaves, spectrum: ComplexArray) -> ComplexArray:
    """On a line, every plane wave at every sample."""
    kz, kept = waves.medium.waves.kz, waves.medium.waves.propagating
    order = waves.samples.pixels
    across = np.exp(1j * waves.medium.waves.transverse[0] * GRID.pitch_mm * order[:, None])
    along = np.exp(1j * kz * (waves.samples.z_mm[:, None] - waves.first_z_mm))
    return np.asarray((across * along) @ (spectrum * kept) / math.sqrt(GRID.size))


@pytest.mark.parametrize("step_mm", [2e-4, 4e-4, 8e-4])
def test_values_on_a_surface_are_those_of_its_plane_waves(step_mm: float) -> None:
    waves = SurfaceWaves(medium(GRID), bowl(GRID), step_mm)
    spectrum = noise(GRID.shape, 1)
    error = relative_error(waves.evaluate(spectrum), direct(waves, spectrum))
    assert error < 1.5 * interpolation_error(waves.medium.phase_across(step_mm)) + 1e-12


def test_interpolation_error_falls_with_the_fourth_power() -> None:
    assert interpolation_error(0.2) / interpolation_error(0.1) == pytest.approx(16.0, rel=0.1)
    assert interpolation_error(2.5 * math.pi) == 1.0


def test_a_flat_surface_takes_one_plane() -> None:
    waves = SurfaceWaves(medium(GRID), bowl(GRID, flat=True), 1e-3)
    spectrum = noise(GRID.shape, 2)
    assert planes_across(0.0, 1e-3) == waves.planes == 1
    assert relative_error(waves.evaluate(spectrum), direct(waves, spectrum)) < 1e-12


@pytest.mark.parametrize("grid", [GRID, PLANE])
@pytest.mark.parametrize("flat", [False, True])
def test_adjoints_are_exact(grid: Grid, flat: bool) -> None:
    waves = SurfaceWaves(medium(grid), bowl(grid, flat), 4e-4)
    spectrum, values = noise(grid.shape, 3), noise(waves.samples.z_mm.shape, 4)
    there = np.vdot(values, waves.evaluate(spectrum))
    assert abs(there - np.vdot(waves.collect(values), spectrum)) < 1e-11 * abs(there)
    there = np.vdot(spectrum, waves.radiate(values))
    assert abs(there - np.vdot(waves.radiate_adjoint(spectrum), values)) < 1e-11 * abs(there)


def test_a_surface_radiates_the_wave_that_it_carries() -> None:
    """A beam's values on a surface within its medium give back the beam."""
    waves = SurfaceWaves(medium(GRID), bowl(GRID), 3e-4)
    beam = np.exp(-0.5 * (GRID.y_mm / 2e-3) ** 2) + 0j
    spectrum = np.fft.fft(beam, norm="ortho") * waves.medium.waves.transfer_function(waves.first_z_mm)
    assert relative_error(waves.radiate(waves.evaluate(spectrum)), spectrum) < 2e-3
