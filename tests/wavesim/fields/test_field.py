"""Grids and fields."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid, correlation, relative_error

counts = st.integers(1, 40)
pitches = st.floats(1e-5, 1.0)
centres = st.floats(-5.0, 5.0)


@given(counts, counts, pitches, centres, centres)
def test_samples_are_evenly_spaced_about_the_centre(
    ny: int, nx: int, pitch: float, x: float, y: float
) -> None:
    grid = Grid((ny, nx), pitch, 1.0, (x, y))
    assert grid.y_mm.shape == (ny,)
    assert grid.x_mm.shape == (nx,)
    assert grid.y_mm.mean() == pytest.approx(y, abs=1e-12)
    assert grid.x_mm.mean() == pytest.approx(x, abs=1e-12)
    assert np.diff(grid.y_mm) == pytest.approx(pitch, abs=1e-12)
    assert grid.half_widths_mm == (0.5 * ny * pitch, 0.5 * nx * pitch)
    assert grid.cell == pytest.approx(pitch**2)
    assert grid.size == nx * ny
    np.testing.assert_allclose(
        grid.radius_squared_mm2(), np.add.outer(grid.y_mm**2, grid.x_mm**2), rtol=1e-12
    )


def test_line_is_a_world_without_x() -> None:
    line = Grid((5,), 0.5, 2.0, (0.0, 1.0))
    assert line.is_line
    assert line.cell == 0.5
    assert line.y_mm.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert line.x_mm.tolist() == [0.0]
    assert line.at(7.0).z_mm == 7.0
    assert line.at(7.0).y_mm.tolist() == line.y_mm.tolist()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (((0,), 1.0, 0.0), "shape"),
        (((2, 2, 2), 1.0, 0.0), "shape"),
        (((2.5,), 1.0, 0.0), "shape"),
        (((4,), 0.0, 0.0), "pitch_mm"),
        (((4,), float("nan"), 0.0), "pitch_mm"),
        (((4,), 1.0, float("inf")), "z_mm"),
        (((4,), 1.0, 0.0, (1.0, 0.0)), "x = 0"),
    ],
)
def test_unusable_grids_are_refused(arguments: tuple, named: str) -> None:
    with pytest.raises(InputError, match=named):
        Grid(*arguments)


def test_energy_of_a_gaussian_is_its_integral() -> None:
    grid = Grid((201, 181), 0.05, 0.0)
    field = Field(grid, np.exp(-grid.radius_squared_mm2()) + 0j, 0.5, 1.5)
    assert field.energy == pytest.approx(0.5 * np.pi, rel=1e-12)
    assert field.with_values(2j * field.values).energy == pytest.approx(2.0 * np.pi, rel=1e-12)
    assert field.wavenumber_per_mm == pytest.approx(2.0 * np.pi * 1.5 / 0.5e-3)


def test_fields_that_do_not_fit_are_refused() -> None:
    grid = Grid((4, 5), 0.1, 0.0)
    with pytest.raises(InputError, match=r"\(5, 4\).*\(4, 5\)"):
        Field(grid, np.zeros((5, 4), complex), 0.5)
    with pytest.raises(InputError, match="wavelength_um"):
        Field(grid, np.zeros((4, 5), complex), 0.0)


def test_figures_of_likeness() -> None:
    field = np.array([1.0, 2j, -1.0])
    assert relative_error(1.1 * field, field) == pytest.approx(0.1)
    assert correlation(3j * field, field) == pytest.approx(1.0)
    assert correlation(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])) == 0.0
