"""The wrapper around nlopt: known minima, and every trap that nlopt sets."""

from __future__ import annotations

import pickle
import time

import nlopt
import numpy as np
import pytest

from lensdesign.errors import InputError
from lensdesign.optimization.nlopt_driver import (
    ALGORITHMS,
    CONVERGED,
    FEASIBLE,
    LIMITS,
    UNTRACEABLE,
    Evaluation,
    minimize,
    stationarity,
)

LOCAL = [name for name, a in ALGORITHMS.items() if not a.everywhere]


def quadratic(x: np.ndarray) -> Evaluation:
    """Smallest at (0.7, 0.3), kept at x0 <= 0.5 by its constraint: the answer is (0.5, 0.3)."""
    centre = np.array([0.7, 0.3])
    return Evaluation(
        np.array([np.sum((x - centre) ** 2)]),
        2.0 * (x - centre)[None],
        np.array([x[0] - 0.5]),
        np.array([[1.0, 0.0]]),
    )


def minimax(x: np.ndarray) -> Evaluation:
    """The largest of three planes: 2/3 at (1/3, 1/3)."""
    by = np.array([[1.0, 1.0], [-2.0, 1.0], [1.0, -2.0]])
    goals = by @ x + np.array([0.0, 1.0, 1.0])
    return Evaluation(goals, by, np.empty(0), np.empty((0, 2)))


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_every_algorithm_finds_a_constrained_minimum(algorithm):
    found = minimize(quadratic, np.array([0.1, 0.9]), algorithm, max_seconds=5.0, max_evaluations=20_000)
    tolerance = 5e-3 if ALGORITHMS[algorithm].everywhere else 1e-3
    np.testing.assert_allclose(found.point, [0.5, 0.3], atol=tolerance)
    assert found.violation <= FEASIBLE


@pytest.mark.parametrize("algorithm", ["slsqp", "mma", "ccsaq", "cobyla"])
def test_local_searches_solve_the_minimax_problem(algorithm):
    found = minimize(minimax, np.array([0.9, 0.1]), algorithm)
    assert found.objective == pytest.approx(2.0 / 3.0, abs=1e-5)


def valley(x: np.ndarray) -> Evaluation:
    """A curved valley of four goals with kinks: 1 at (0.9, 0.81)."""
    across, across_by = 10.0 * (x[1] - x[0] ** 2), np.array([-20.0 * x[0], 10.0])
    along, along_by = 0.9 - x[0], np.array([-1.0, 0.0])
    by = np.array([across_by, -across_by, along_by, -along_by])
    return Evaluation(1.0 + np.array([across, -across, along, -along]), by, np.empty(0), np.empty((0, 2)))


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
@pytest.mark.parametrize("problem", [quadratic, minimax, valley])
def test_converged_means_that_the_first_order_conditions_hold(algorithm, problem):
    """Whatever nlopt's code says; a point that is stationary has the goal of the known minimum."""
    minimum = {quadratic: 0.04, minimax: 2.0 / 3.0, valley: 1.0}[problem]
    found = minimize(problem, np.array([0.1, 0.85]), algorithm, max_seconds=5.0, max_evaluations=3000)
    residual = stationarity(problem(found.point), found.point)
    assert found.residual == pytest.approx(residual, abs=1e-9)
    if found.stopped_because == "converged":
        assert residual <= CONVERGED
        assert found.objective == pytest.approx(minimum, abs=2e-3)
    elif found.stopped_because not in LIMITS:
        assert residual > CONVERGED
    if algorithm == "slsqp":
        assert found.stopped_because == "converged"


def test_a_search_that_stalls_beside_the_minimum_has_not_converged():
    """BOBYQA within an augmented Lagrangian stops in the valley, and nlopt reports success."""
    found = minimize(valley, np.array([0.1, 0.9]), "auglag-bobyqa")
    assert found.residual > 0.1
    assert "converged" not in found.stopped_because
    assert found.objective > 1.0002


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
@pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt])
def test_an_exception_in_the_problem_is_never_lost(algorithm, kind):
    calls = []

    def fails(x: np.ndarray) -> Evaluation:
        calls.append(1)
        if len(calls) > 4:
            raise kind("from inside")
        return quadratic(x)

    with pytest.raises(kind, match="from inside"):
        minimize(fails, np.array([0.1, 0.9]), algorithm, max_seconds=5.0)


@pytest.mark.parametrize("algorithm", LOCAL)
def test_the_best_point_survives_when_the_end_is_worse(algorithm):
    """A goal that turns bad after some calls, as a search that wanders off does."""
    seen: list[tuple[float, np.ndarray]] = []

    def drifting(x: np.ndarray) -> Evaluation:
        worse = 0.0 if len(seen) < 6 else 10.0
        e = quadratic(x)
        seen.append((e.objective + worse if e.violation <= FEASIBLE else np.inf, x.copy()))
        return Evaluation(e.goals + worse, e.goals_by, e.constraints, e.constraints_by)

    found = minimize(drifting, np.array([0.1, 0.9]), algorithm, max_seconds=2.0, max_evaluations=60)
    best = min(seen, key=lambda s: s[0])
    assert found.objective == best[0]
    np.testing.assert_array_equal(found.point, best[1])


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_values_that_are_not_finite_never_win(algorithm):
    """COBYLA, left alone, returns garbage and calls it success."""

    def holed(x: np.ndarray) -> Evaluation:
        e = quadratic(x)
        if 0.2 < x[0] < 0.4:
            return Evaluation(np.array([np.nan]), np.full((1, 2), np.nan), e.constraints, e.constraints_by)
        return e

    found = minimize(holed, np.array([0.1, 0.9]), algorithm, max_seconds=1.0, max_evaluations=2000)
    assert np.all(np.isfinite(found.point))
    assert found.objective < UNTRACEABLE
    assert found.objective <= quadratic(np.array([0.1, 0.9])).objective


def test_infeasible_problems_give_the_least_violation():
    def never(x: np.ndarray) -> Evaluation:
        return Evaluation(x[:1], np.array([[1.0]]), np.array([1.0 - 0.5 * x[0]]), np.array([[-0.5]]))

    found = minimize(never, np.array([0.2]))
    assert found.violation == pytest.approx(0.5, abs=1e-6)


def test_time_limit_holds():
    def slow(x: np.ndarray) -> Evaluation:
        time.sleep(0.01)
        return quadratic(x)

    found = minimize(slow, np.array([0.1, 0.9]), "isres", max_seconds=0.3, max_evaluations=10**6)
    assert found.evaluations < 100
    assert found.stopped_because == "time limit"


def test_evaluation_limit_holds():
    found = minimize(quadratic, np.array([0.1, 0.9]), "isres", max_seconds=20.0, max_evaluations=50)
    assert found.evaluations <= 60
    assert found.stopped_because == "evaluation limit"


def test_results_and_problems_pickle_though_nlopt_objects_do_not():
    found = minimize(quadratic, np.array([0.1, 0.9]))
    again = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(again.point, found.point)
    with pytest.raises(TypeError):
        pickle.dumps(nlopt.opt(nlopt.LD_SLSQP, 2))


def test_points_handed_out_are_copies():
    """nlopt reuses the memory of x."""
    kept = []

    def keeps(x: np.ndarray) -> Evaluation:
        kept.append((x, x.copy()))
        return quadratic(x)

    minimize(keeps, np.array([0.1, 0.9]))
    for alias, copy in kept:
        np.testing.assert_array_equal(alias, copy)


@pytest.mark.parametrize("refuses", ["GN_CRS2_LM", "LN_BOBYQA", "GN_DIRECT_L", "LD_LBFGS"])
def test_algorithms_that_refuse_constraints_are_only_used_inside_auglag(refuses):
    opt = nlopt.opt(getattr(nlopt, refuses), 2)
    with pytest.raises(Exception):  # noqa: B017, PT011 (nlopt's own class, which differs by release)
        opt.add_inequality_mconstraint(lambda r, x, g: None, [1e-9])
    assert all(a.code != refuses for a in ALGORITHMS.values())
    assert any(a.inner == refuses for a in ALGORITHMS.values())


def test_bad_input_is_named():
    with pytest.raises(InputError, match=r"'simplex'.*slsqp"):
        minimize(quadratic, np.array([0.1, 0.9]), "simplex")
    with pytest.raises(InputError, match="unit box"):
        minimize(quadratic, np.array([0.1, 1.9]))


def test_improvements_are_reported():
    lines = []
    minimize(quadratic, np.array([0.1, 0.9]), on_improvement=lambda *a: lines.append(a))
    objectives = [line[0] for line in lines]
    assert len(lines) > 1
    assert objectives == sorted(objectives, reverse=True)


def test_the_conditions_of_first_order_hold_where_the_answer_is_and_nowhere_else():
    """On the constraint its multiplier balances; inside, what remains is the length of the derivative."""
    answer, inside = np.array([0.5, 0.3]), np.array([0.1, 0.9])
    assert stationarity(quadratic(answer), answer) == pytest.approx(0.0, abs=1e-9)
    assert stationarity(quadratic(inside), inside) == pytest.approx(2.0 * np.hypot(0.6, 0.6), rel=1e-4)
    outwards = Evaluation(np.zeros(1), np.array([[-1.0, 2.0]]), np.empty(0), np.empty((0, 2)))
    assert stationarity(outwards, np.array([1.0, 0.0])) == pytest.approx(0.0, abs=1e-9)  # the box stops it
    assert stationarity(outwards, np.array([0.0, 0.0])) == pytest.approx(1.0, rel=1e-4)
    balanced = np.full(2, 1.0 / 3.0)
    assert stationarity(minimax(balanced), balanced) == pytest.approx(0.0, abs=1e-9)
    off = np.array([0.4, 0.4])  # the first plane alone is largest there
    assert stationarity(minimax(off), off) == pytest.approx(np.sqrt(2.0), rel=1e-4)


def test_a_start_that_keeps_every_limit_with_room_is_searched_from():
    """Goals below zero, as constraints that are kept are."""

    def kept(x: np.ndarray) -> Evaluation:
        e = quadratic(x)
        return Evaluation(e.goals - 2.0, e.goals_by, e.constraints, e.constraints_by)

    assert minimize(kept, np.array([0.1, 0.9])).objective <= -1.0
