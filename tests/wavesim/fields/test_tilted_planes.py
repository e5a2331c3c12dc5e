"""Fields on tilted planes."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.poses import rotation_matrix
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.fields.propagator import FreeSpacePropagator, propagate

WAVELENGTH_UM = 0.5
WAVES_PER_MM = 1e3 / WAVELENGTH_UM
WAIST_MM = 3e-3


def _beam(x: np.ndarray, y: np.ndarray, z: np.ndarray, line: bool) -> np.ndarray:
    """Exact integral over plane waves of a beam with its waist at the origin."""
    f0 = 1.0 / (np.pi * WAIST_MM)
    f = np.linspace(-5.0 * f0, 5.0 * f0, 801 if line else 65)
    density = np.sqrt(np.pi) * WAIST_MM * np.exp(-((f / f0) ** 2)) * (f[1] - f[0])
    fx, fy = (0.0 * f, f) if line else (part.ravel() for part in np.meshgrid(f, f))
    weight = density if line else np.outer(density, density).ravel()
    fz = np.sqrt(WAVES_PER_MM**2 - fx**2 - fy**2)
    phase = np.multiply.outer(x, fx) + np.multiply.outer(y, fy) + np.multiply.outer(z, fz)
    return np.exp(2j * np.pi * phase) @ weight


def _waist_field(grid: Grid) -> Field:
    squared = (grid.y_mm - grid.centre_mm[1]) ** 2
    if not grid.is_line:
        squared = squared[:, None] + (grid.x_mm - grid.centre_mm[0]) ** 2
    return Field(grid, np.exp(-squared / WAIST_MM**2) + 0j, WAVELENGTH_UM)


def _random(shape: tuple[int, ...], seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize("tilt_deg", [-5.0, 20.0, 45.0, 60.0])
def test_beam_on_a_tilted_line_and_back(tilt_deg: float) -> None:
    tilt = np.deg2rad(tilt_deg)
    grid, tilted = Grid((600,), 0.2e-3, 3.0, (0.0, 0.4)), Grid((901,), 0.15e-3, 0.0, (0.0, 0.004))
    field = _waist_field(grid)
    result = propagate(field, tilted, target_tilt_deg=(tilt_deg, 0.0))
    y = tilted.y_mm
    exact = _beam(0.0 * y, y * np.cos(tilt), y * np.sin(tilt), line=True)
    assert relative_error(result.values, exact) < 1e-8
    assert (
        relative_error(propagate(result, grid, source_tilt_deg=(tilt_deg, 0.0)).values, field.values) < 1e-8
    )


def test_beam_on_a_tilted_plane_and_back() -> None:
    tilts = 15.0, -25.0
    grid = Grid((200, 180), 0.25e-3, 1.0, (0.5, 0.3))
    tilted = Grid((190, 200), 0.24e-3, 0.0, (0.001, -0.002))
    field = _waist_field(grid)
    result = propagate(field, tilted, target_tilt_deg=tilts)
    part = (slice(None, None, 10), slice(None, None, 10))
    y, x = np.meshgrid(tilted.y_mm, tilted.x_mm, indexing="ij")
    points = np.stack([x, y, 0.0 * x], -1)[part] @ rotation_matrix(*np.deg2rad(tilts)).T
    exact = _beam(points[..., 0], points[..., 1], points[..., 2], line=False)
    assert relative_error(result.values[part], exact) < 1e-8
    assert relative_error(propagate(result, grid, source_tilt_deg=tilts).values, field.values) < 1e-8


def test_plane_wave_is_one_on_the_tilted_plane() -> None:
    tilt, sine = np.deg2rad(30.0), 0.1
    grid = Grid((2000,), 0.2e-3, 0.0)
    window = np.exp(-((grid.y_mm / 0.1) ** 8))
    field = Field(grid, window * np.exp(2j * np.pi * WAVES_PER_MM * sine * grid.y_mm), WAVELENGTH_UM)
    tilted = Grid((200,), 0.2e-3, 0.0)
    result = propagate(field, tilted, target_tilt_deg=(30.0, 0.0))
    along = np.sin(np.arcsin(sine) + tilt)
    exact = np.exp(2j * np.pi * WAVES_PER_MM * along * tilted.y_mm)
    assert relative_error(result.values, exact) < 1e-4


def test_no_tilt_changes_nothing() -> None:
    field = _waist_field(Grid((128, 120), 0.25e-3, 2.0))
    same = propagate(field, field.grid.at(0.0), target_tilt_deg=(0.0, 0.0))
    assert relative_error(same.values, field.values) < 1e-10


@pytest.mark.parametrize(
    ("shape", "to", "tilts"), [((150,), (120,), (23.0, 0.0)), ((40, 36), (31, 44), (11.5, -17.0))]
)
def test_adjoints(shape: tuple, to: tuple, tilts: tuple) -> None:
    straight, tilted = Grid(shape, 0.3e-3, 1.0, (0.0, 2.0)), Grid(to, 0.25e-3, 0.0, (0.0, 0.003))
    for passage in (
        FreeSpacePropagator(straight, tilted, WAVELENGTH_UM, target_tilt_deg=tilts),
        FreeSpacePropagator(tilted, straight, WAVELENGTH_UM, source_tilt_deg=tilts),
    ):
        f, g = _random(passage.source.shape, 1), _random(passage.target.shape, 2)
        left = np.vdot(g, passage.forward(f)) * passage.target.cell
        right = np.vdot(passage.adjoint(g), f) * passage.source.cell
        assert abs(left - right) <= 1e-10 * abs(left)


def test_output_too_coarse_for_the_carrier_is_refused_unless_asked_for() -> None:
    field = _waist_field(Grid((300,), 0.4e-3, 0.0))
    tilt = np.deg2rad(50.0)
    with pytest.raises(SamplingError, match=r"0\.4 µm.*give a pitch of"):
        propagate(field, field.grid, target_tilt_deg=(50.0, 0.0))
    coarse = propagate(field, field.grid, target_tilt_deg=(50.0, 0.0), coarse_output=True)
    y = coarse.grid.y_mm
    exact = _beam(0.0 * y, y * np.cos(tilt), y * np.sin(tilt), line=True)
    assert relative_error(coarse.values, exact) < 1e-6


def test_field_too_fine_for_its_grid_is_refused() -> None:
    grid = Grid((64,), 2e-3, 0.0)
    with pytest.raises(SamplingError, match="sample the field"):
        propagate(Field(grid, _random((64,), 3), WAVELENGTH_UM), grid, target_tilt_deg=(6.0, 0.0))


def test_unusable_tilts_and_planes_are_refused() -> None:
    line = _waist_field(Grid((64,), 0.4e-3, 0.0))
    with pytest.raises(InputError, match="only a tilt about x"):
        propagate(line, line.grid, target_tilt_deg=(6.0, 6.0))
    with pytest.raises(InputError, match="between -90 and 90"):
        propagate(line, line.grid, target_tilt_deg=(90.0, 0.0))
    with pytest.raises(InputError, match="grid z_mm = 1: must be 0"):
        propagate(line, Grid((64,), 0.4e-3, 1.0), target_tilt_deg=(6.0, 0.0))
    with pytest.raises(InputError, match="only one plane can be tilted"):
        propagate(line, line.grid, source_tilt_deg=(6.0, 0.0), target_tilt_deg=(6.0, 0.0))
    with pytest.raises(InputError, match="not finite"):
        propagate(line.with_values(line.values * np.nan), line.grid, target_tilt_deg=(6.0, 0.0))
