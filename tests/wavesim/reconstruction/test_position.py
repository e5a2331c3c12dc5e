"""Position of an object that frames prefer, for a search whose misfit is a known function of the position."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.object_solver import Reconstructed
from wavesim.reconstruction.position import MOST_MOVES, at_best_position

NOISE, GRID = 0.1, Grid((32, 32), 1e-3, 0.0)
LIGHT = Field(GRID, np.ones(GRID.shape, complex), 0.5)


def spot_at(y: float, x: float) -> Field:
    rows, columns = np.indices(GRID.shape)
    values = np.exp(-((rows - 16.0 - y) ** 2 + (columns - 16.0 - x) ** 2) / 8.0)
    return LIGHT.with_values(values.astype(complex))


def position_of(field: Field) -> tuple[float, float]:
    """Return the center of mass, relative to the center of the grid."""
    rows, columns = np.indices(GRID.shape)
    values = field.values.real
    return (
        float((values * rows).sum() / values.sum()) - 16.0,
        float((values * columns).sum() / values.sum()) - 16.0,
    )


class Search:
    """A search that keeps an object where it starts. Its misfit grows with the distance from a position."""

    def __init__(self, *target: float, curvature: float = 0.01) -> None:
        self.target, self.curvature, self.converged = target, curvature, 0

    def __call__(self, start: Field, scale: float, *, iterations: int | None = None) -> Reconstructed:
        self.converged += iterations is None
        squared = sum(
            (is_at - wanted) ** 2 for is_at, wanted in zip(position_of(start), self.target, strict=True)
        )
        misfit = (NOISE * (1.0 + self.curvature * squared),) * (iterations or 5)
        return Reconstructed(start, misfit, (), scale, "converged")


@given(y=st.integers(-4, 4), x=st.integers(-4, 4))
def test_an_object_moves_to_where_its_misfit_is_least(y: int, x: int) -> None:
    search = Search(y / 2, x / 2)
    placed = at_best_position(search, search(spot_at(0.0, 0.0), 1.0), LIGHT, NOISE)
    assert position_of(placed.transmission) == pytest.approx((y / 2, x / 2), abs=0.26)


def test_an_object_at_its_position_is_returned_itself() -> None:
    search = Search(0.1, -0.1)
    found = search(spot_at(0.0, 0.0), 1.0)
    assert at_best_position(search, found, LIGHT, NOISE) is found


@pytest.mark.parametrize("noise", [None, 0.5 * NOISE], ids=["unknown noise", "misfit far from the noise"])
def test_an_object_stays_where_its_position_is_not_the_cause_of_the_misfit(noise: float | None) -> None:
    search = Search(2.0, 0.0)
    found = search(spot_at(0.0, 0.0), 1.0)
    assert at_best_position(search, found, LIGHT, noise) is found


def test_moves_are_bounded_and_their_iterations_are_counted() -> None:
    search = Search(12.0, 0.0, curvature=1e-3)
    found = search(spot_at(0.0, 0.0), 1.0)
    search.converged = 0
    placed = at_best_position(search, found, LIGHT, NOISE)
    assert search.converged == MOST_MOVES
    assert len(placed.misfit) == len(found.misfit) + MOST_MOVES * 9
    assert position_of(placed.transmission)[0] == pytest.approx(MOST_MOVES, abs=0.1)


def test_samples_at_the_rim_of_the_light_keep_their_values() -> None:
    lit = np.hypot(*(np.indices(GRID.shape) - 16.0)) < 8.0
    light = LIGHT.with_values(LIGHT.values * lit)
    search = Search(2.0, 0.0)
    start = light.with_values(spot_at(0.0, 0.0).values * lit + 0.2 * lit)
    placed = at_best_position(search, search(start, 1.0), light, 0.5)
    assert np.abs(placed.transmission.values[lit]).min() >= 0.2
    assert np.all(placed.transmission.values[~lit] == 0.0)
