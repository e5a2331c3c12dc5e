"""Stops in free space, against other sums, and the edge that eikonal tiles draw against them."""

import math

import numpy as np
import pytest
from scipy.special import hankel1

from lensdesign.errors import InputError
from wavesim.analytic.aperture_diffraction import hole_scene, slit_scene
from wavesim.analytic.registry import analytic_case
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.fields.field import Grid, relative_error
from wavesim.fields.propagator import FreeSpacePropagator

SEMI_MM, WAVELENGTH_UM = 0.05, 0.5
K = 2e3 * math.pi / WAVELENGTH_UM


def test_slit_against_angular_spectrum() -> None:
    case = slit_scene(SEMI_MM, WAVELENGTH_UM)
    grid = case.scene.object_grid
    stop = Grid((4000,), 2.0 * SEMI_MM / 4000, 0.0)
    away = np.hypot(stop.y_mm - grid.y_mm[2], grid.z_mm)
    light = 0.5j * K * -grid.z_mm / away * hankel1(1, K * away) * grid.cell
    found = FreeSpacePropagator(stop, case.scene.exit_grid, WAVELENGTH_UM, 1.0).forward(light)
    assert relative_error(found, case.exact.values) < 1e-3


def test_hole_against_a_sum_over_its_area() -> None:
    case = hole_scene(SEMI_MM, WAVELENGTH_UM)
    grid, behind = case.scene.object_grid, case.scene.exit_grid
    x, weight = np.polynomial.legendre.leggauss(700)
    r, across = 0.5 * SEMI_MM * (x + 1.0), 0.5 * SEMI_MM * weight
    turn = 2.0 * np.pi * np.arange(1500) / 1500
    points = np.stack([r[:, None] * np.cos(turn), r[:, None] * np.sin(turn)])
    centre = np.array([grid.x_mm[2], grid.y_mm[2]])[:, None, None]
    light = radiated(np.sum((points - centre) ** 2, axis=0), -grid.z_mm) * (r * across)[:, None]
    for row, column in ((80, 80), (60, 100), (20, 75)):
        place = np.array([behind.x_mm[column], behind.y_mm[row]])[:, None, None]
        distances2 = np.sum((points - place) ** 2, axis=0)
        expected = np.sum(light * radiated(distances2, behind.z_mm)) * grid.cell * 2.0 * np.pi / 1500
        assert case.exact.values[row, column] == pytest.approx(expected, rel=1e-4)


def radiated(across2: np.ndarray, along_mm: float) -> np.ndarray:
    away = np.sqrt(across2 + along_mm**2)
    return along_mm / away**2 * (1.0 / away - 1j * K) * np.exp(1j * K * away) / (2.0 * np.pi)


@pytest.mark.parametrize(("solution", "allowed"), [("slit", 0.017), ("hole", 0.034)])
def test_edge_of_eikonal_tiles(solution: str, allowed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    case = analytic_case(solution, semi_diameter_mm=0.06)
    pitch_mm = case.scene.object_grid.pitch_mm
    drawn = FlatTiles(case.scene, tile_width_mm=pitch_mm)
    error = relative_error(drawn.forward(case.object_field).values, case.exact.values)
    monkeypatch.setattr(FlatTiles, "_draws_edges", False)
    sharp = FlatTiles(case.scene, tile_width_mm=pitch_mm)
    assert error < allowed
    assert error < drawn.predicted_error() < 3.0 * error
    assert relative_error(sharp.forward(case.object_field).values, case.exact.values) > 4.0 * error


@pytest.mark.parametrize("make", [slit_scene, hole_scene])
@pytest.mark.parametrize("arguments", [(0.01,), (math.nan,), (2.0,), (0.1, 0.0)])
def test_refused(make, arguments: tuple[float, ...]) -> None:
    with pytest.raises(InputError):
        make(*arguments)
