"""Object with less bias of the total variation, by which a result is judged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.object_solver import Reconstructed
from wavesim.reconstruction.prior_bias import with_less_bias
from wavesim.reconstruction.stop_rule import Stop

NOISE = 0.1


def found(misfits: Sequence[float], stopped: Stop = "converged") -> Reconstructed:
    grid = Grid((2, 2), 1e-3, 0.0)
    misfit = tuple(NOISE * one for one in misfits)
    return Reconstructed(Field(grid, np.ones((2, 2), complex), 0.5), misfit, (), 1.0, stopped)


class Solver:
    """Ends at misfits over that of noise that are given in advance, after two iterations each."""

    def __init__(self, *ends: float) -> None:
        self.ends, self.factors, self.iterations = list(ends), list[float](), list[int]()

    def __call__(self, start: Field, scale: float, factor: float, iterations: int) -> Reconstructed:
        self.factors.append(factor)
        self.iterations.append(iterations)
        return found((1.5, self.ends.pop(0)))


def test_the_weight_is_halved_until_the_misfit_is_that_of_noise() -> None:
    solve, first = Solver(1.2, 1.005), found((3.0, 1.4))
    shown, judged = with_less_bias(solve, first, NOISE, 80)
    assert shown is first  # half of the weight leaves 1.2 times the noise, so that it had another cause
    assert solve.factors == [0.5, 0.25]
    assert solve.iterations == [80, 78]
    assert judged.misfit == pytest.approx([NOISE * one for one in (3.0, 1.4, 1.5, 1.2, 1.5, 1.005)])


def test_the_weight_is_halved_three_times_at_most() -> None:
    solve = Solver(1.3, 1.2, 1.1)
    with_less_bias(solve, found((3.0, 1.4)), NOISE, 80)
    assert solve.factors == [0.5, 0.25, 0.125]


@pytest.mark.parametrize(
    ("first", "noise", "iterations"),
    [
        (found((3.0, 1.005)), NOISE, 80),
        (found((3.0, 2.1)), NOISE, 80),
        (found((3.0, 1.4)), None, 80),
        (found((3.0, 1.4)), NOISE, 0),
        (found((3.0, 1.4), "iterations"), NOISE, 80),
    ],
    ids=["at the noise", "another cause", "noise unknown", "none left", "not converged"],
)
def test_the_object_itself_is_judged(first: Reconstructed, noise: float | None, iterations: int) -> None:
    assert with_less_bias(Solver(), first, noise, iterations) == (first, first)


@pytest.mark.parametrize(("first", "copy", "is_replaced"), [(1.08, 1.02, True), (1.03, 1.005, False)])
def test_a_copy_is_shown_where_the_total_variation_removed_detail(
    first: float, copy: float, is_replaced: bool
) -> None:
    one = found((3.0, first))
    shown, judged = with_less_bias(Solver(copy, 0.99), one, NOISE, 80)
    assert (shown is not one) == is_replaced
    assert shown.misfit[-1] == pytest.approx(NOISE * (copy if is_replaced else first))
    assert judged.misfit[-1] <= shown.misfit[-1]
