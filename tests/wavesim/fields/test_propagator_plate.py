"""A plane plate between grids, beside three steps through air, glass and air that are computed here."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from lensdesign.errors import InputError
from lensdesign.raytrace import PlanePlate
from wavesim.fields.field import Grid, relative_error
from wavesim.fields.plane_waves import PlaneWaves
from wavesim.fields.propagator import FreeSpacePropagator

WAVELENGTH_UM, INDEX, THICKNESS_MM = 0.532, 1.5195, 0.7
PLATE = PlanePlate(THICKNESS_MM, np.array([INDEX]))


def step(values: np.ndarray, pitch_mm: float, distance_mm: float, index: float) -> np.ndarray:
    """Return the field after a distance in a medium: a periodic angular spectrum."""
    cycles = np.meshgrid(*(np.fft.fftfreq(n, pitch_mm) for n in values.shape), indexing="ij")
    wavenumber = 2e3 * np.pi * index / WAVELENGTH_UM
    along = np.sqrt(wavenumber**2 - sum((2.0 * np.pi * f) ** 2 for f in cycles) + 0j)
    return np.asarray(np.fft.ifftn(np.fft.fftn(values) * np.exp(1j * along * distance_mm)))


def noise(grid: Grid, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape))


@pytest.mark.parametrize("shape", [(256,), (48, 60)])
@pytest.mark.parametrize("front_mm", [0.0, 0.3, 0.9])
def test_field_behind_the_plate_is_that_of_three_steps(shape: tuple[int, ...], front_mm: float) -> None:
    grid = Grid(shape, 1.5e-3, 0.0)  # the pitch samples no evanescent waves
    values = noise(grid, 1)
    expected = step(values, 1.5e-3, front_mm, 1.0)
    expected = step(expected, 1.5e-3, THICKNESS_MM, INDEX)
    expected = step(expected, 1.5e-3, 1.6 - front_mm - THICKNESS_MM, 1.0)
    found = FreeSpacePropagator(
        grid, grid.at(1.6), WAVELENGTH_UM, pad=grid.shape, band_limit=False, plate=PLATE
    ).forward(values)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.max(np.abs(expected)))


def test_phase_of_each_wave_is_that_of_glass_instead_of_air() -> None:
    cycles = np.linspace(-600.0, 600.0, 241)
    waves = PlaneWaves([cycles[:, None], cycles], WAVELENGTH_UM)
    found = waves.transfer_function(2.0, plate=PLATE) / waves.transfer_function(2.0)
    wavenumber = 2e3 * np.pi / WAVELENGTH_UM
    across = 4.0 * np.pi**2 * (cycles[:, None] ** 2 + cycles**2)
    phase = THICKNESS_MM * (np.sqrt((INDEX * wavenumber) ** 2 - across) - np.sqrt(wavenumber**2 - across))
    assert np.max(np.abs(np.angle(found * np.exp(-1j * phase)))) < 1e-9


PAIRS = {
    "line": (Grid((4000,), 3e-4, -0.9, (0.0, 0.02)), Grid((7000,), 5e-4, 0.1)),
    "plane": (Grid((120, 130), 4e-4, -0.9, (0.01, 0.02)), Grid((160, 100), 6e-4, 0.1)),
    "same samples": (Grid((300, 310), 4e-4, -0.9, (0.01, 0.02)), Grid((300, 310), 4e-4, 0.1)),
    "nearer than the plate is thick": (Grid((400,), 3e-4, 0.0), Grid((500,), 4e-4, 0.1)),
}


@pytest.mark.parametrize("kind", PAIRS)
def test_adjoint_is_exact(kind: str) -> None:
    source, target = PAIRS[kind]
    operator = FreeSpacePropagator(source, target, WAVELENGTH_UM, plate=PLATE)
    u, v = noise(source, 2), noise(target, 3)
    forward = target.cell * np.vdot(v, operator.forward(u))
    adjoint = source.cell * np.vdot(operator.adjoint(v), u)
    assert abs(forward - adjoint) < 1e-11 * abs(forward)


@pytest.mark.parametrize("distance_mm", [0.1, 0.5, 1.5])
def test_chirp_z_transforms_give_the_field_of_a_padded_spectrum(distance_mm: float) -> None:
    source = Grid((400,), 5e-4, 0.0)
    values = np.exp(-((source.y_mm / 0.02) ** 2)) * np.exp(2j * np.pi * 300.0 * source.y_mm)
    wide = Grid((16384,), 5e-4, 0.0)
    padded = np.zeros(wide.shape, complex)
    padded[8192 - 200 : 8192 + 200] = values
    expected = step(step(padded, 5e-4, distance_mm - THICKNESS_MM, 1.0), 5e-4, THICKNESS_MM, INDEX)
    target = Grid((1501,), 1e-3, distance_mm, (0.0, 2.5e-4))
    found = FreeSpacePropagator(source, target, WAVELENGTH_UM, plate=PLATE).forward(values)
    rows = np.round((target.y_mm - wide.y_mm[0]) / 5e-4).astype(int)
    assert np.max(np.abs(wide.y_mm[rows] - target.y_mm)) < 1e-12
    assert relative_error(found, expected[rows]) < 1e-4


@pytest.mark.parametrize("kind", PAIRS)
def test_index_1_is_no_plate(kind: str) -> None:
    source, target = PAIRS[kind]
    vacuum = PlanePlate(THICKNESS_MM, np.array([1.0]))
    u = noise(source, 4)
    found, expected = (
        FreeSpacePropagator(source, target, WAVELENGTH_UM, plate=plate).forward(u) for plate in (vacuum, None)
    )
    # Another number of samples changes the light at the ends of the band alone.
    assert relative_error(found, expected) < 2e-3


def test_index_1_changes_no_wave() -> None:
    waves = PlaneWaves.of(Grid((60, 64), 4e-4, 0.0), WAVELENGTH_UM)
    found = waves.transfer_function(1.0, plate=PlanePlate(THICKNESS_MM, np.array([1.0])))
    np.testing.assert_array_equal(found, waves.transfer_function(1.0))


def test_memory_is_predicted_with_a_plate() -> None:
    source, target = PAIRS["plane"]
    operator = FreeSpacePropagator(source, target, WAVELENGTH_UM, plate=PLATE)
    values = noise(source, 5)
    operator.forward(values)
    tracemalloc.start()
    try:
        operator.forward(values)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert operator.peak_bytes == pytest.approx(peak, rel=0.3)


def test_a_plate_in_front_of_a_tilted_plane_is_refused() -> None:
    grid = Grid((32, 32), 1e-3, 0.0)
    operator = FreeSpacePropagator(grid, grid, WAVELENGTH_UM, target_tilt_deg=(1.0, 0.0), plate=PLATE)
    with pytest.raises(InputError, match="plate must keep"):
        operator.forward(noise(grid, 6))
