"""Wrapper of nlopt that keeps the best point, exceptions and the time limit.

The problem is a minimax problem: minimize the largest of several goals subject to constraints that must not
be above zero, with every variable scaled to [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import DeadlineExceeded, now
from lensdesign.errors import InputError

FEASIBLE = 1e-8
"""Largest scaled constraint of a feasible point; constraints are scaled to about 1."""

CONVERGED = 2e-3
"""Residual of the first-order conditions (:func:`stationarity`) up to which a point counts as converged."""

UNTRACEABLE = 1e3
"""Replacement of a value that is not finite: far above any scaled goal, but without spoiling local models."""


EVALUATION_LIMIT, TIME_LIMIT = LIMITS = "evaluation limit", "time limit"
"""Reasons for the end of a search that say nothing of its point."""


@dataclass(frozen=True)
class Evaluation:
    """Goals and constraints at a point with their derivatives: k goals, m constraints, n variables.

    Attributes
    ----------
    goals : ndarray, shape (k,)
        Scaled goals, the largest of which is minimized down to 0; lower values count as 0.
    goals_by : ndarray, shape (k, n)
        Derivatives of the goals.
    constraints : ndarray, shape (m,)
        Scaled constraints, which must not be above zero.
    constraints_by : ndarray, shape (m, n)
        Derivatives of the constraints.
    """

    goals: Array
    goals_by: Array
    constraints: Array
    constraints_by: Array

    @property
    def objective(self) -> float:
        """Largest goal."""
        return float(np.max(self.goals))

    @property
    def violation(self) -> float:
        """Largest constraint, or 0."""
        return float(max(0.0, np.max(self.constraints, initial=0.0)))


@dataclass(frozen=True)
class Algorithm:
    """An algorithm of nlopt and its properties.

    Attributes
    ----------
    code
        Name of nlopt's constant.
    inner
        Constant of the subsidiary algorithm of AUGLAG; None if the algorithm handles constraints itself.
    bounded
        Whether an extra variable bounds all goals, each of which is then a constraint. This is smooth, as
        local searches require. Otherwise the largest goal itself is the objective.
    everywhere
        Whether the algorithm is global.
    """

    code: str
    inner: str | None = None
    bounded: bool = True
    everywhere: bool = False


ALGORITHMS = {
    "slsqp": Algorithm("LD_SLSQP"),
    "mma": Algorithm("LD_MMA"),
    "ccsaq": Algorithm("LD_CCSAQ"),
    "cobyla": Algorithm("LN_COBYLA"),
    "isres": Algorithm("GN_ISRES", bounded=False, everywhere=True),
    "auglag-lbfgs": Algorithm("LD_AUGLAG", "LD_LBFGS"),
    "auglag-bobyqa": Algorithm("LN_AUGLAG", "LN_BOBYQA"),
    "auglag-crs2": Algorithm("LN_AUGLAG", "GN_CRS2_LM", bounded=False, everywhere=True),
    "auglag-direct": Algorithm("LN_AUGLAG", "GN_DIRECT_L", bounded=False, everywhere=True),
}


@dataclass(frozen=True)
class Outcome:
    """Best point of a search.

    Attributes
    ----------
    point : ndarray, shape (n,)
        The best feasible point, or the point with the smallest violation if none is feasible.
    objective, violation
        Largest goal and largest constraint at this point.
    evaluations
        Number of different points that were evaluated.
    stopped_because
        Reason why the search ended. It is ``converged`` only if the point meets the first-order conditions;
        nlopt also stops where the steps of an algorithm have become small.
    residual
        Residual of the first-order conditions at this point (:func:`stationarity`); of the constraints
        alone, if the point violates one. NaN if it was not measured.
    """

    point: Array
    objective: float
    violation: float
    evaluations: int
    stopped_because: str
    residual: float = math.nan


class _Search:
    """Evaluates the problem for nlopt, and keeps the best point and exceptions."""

    def __init__(
        self,
        evaluate: Callable[[Array], Evaluation],
        n: int,
        bounded: bool,
        on_improvement: Callable[[float, float, int], None] | None,
        on_point: Callable[[Array], None] | None,
    ) -> None:
        self.evaluate, self.n, self.bounded = evaluate, n, bounded
        self.on_improvement, self.on_point = on_improvement, on_point
        self.end = math.inf
        self.evaluations = 0
        self.best: tuple[float, float] = (math.inf, math.inf)
        self.point: Array | None = None
        self.found: Evaluation | None = None
        self.error: BaseException | None = None
        self.opt: Any = None
        self._last: tuple[bytes, Evaluation] | None = None

    def at(self, x: Array) -> Evaluation:
        key = x[: self.n].tobytes()
        if self._last is None or self._last[0] != key:
            if now() >= self.end:
                raise DeadlineExceeded
            self._last = (key, self._finite(self.evaluate(np.clip(x[: self.n], 0.0, 1.0))))
            self.evaluations += 1
            self._remember(x, self._last[1])
        return self._last[1]

    def _finite(self, e: Evaluation) -> Evaluation:
        arrays = (e.goals, e.goals_by, e.constraints, e.constraints_by)
        if all(np.all(np.isfinite(a)) for a in arrays):
            return e
        fill = (UNTRACEABLE, 0.0, UNTRACEABLE, 0.0)
        return Evaluation(*(np.where(np.isfinite(a), a, f) for a, f in zip(arrays, fill, strict=True)))

    def _remember(self, x: Array, e: Evaluation) -> None:
        excess = e.violation if e.violation > FEASIBLE else 0.0
        if (excess, e.objective) < self.best:
            self.best, self.point = (excess, e.objective), np.clip(x[: self.n], 0.0, 1.0)
            self.found = e
            if self.on_point is not None:
                self.on_point(self.point)
            if self.on_improvement is not None:
                self.on_improvement(e.objective, e.violation, self.evaluations)

    def objective(self, x: Array, gradient: Array) -> float:
        """Return the objective for nlopt: the bound on the goals, or the largest goal."""
        try:
            e = self.at(x)
            worst = int(np.argmax(e.goals))
            if gradient.size:
                gradient[:] = 0.0
                if self.bounded:
                    gradient[self.n] = 1.0
                else:
                    gradient[:] = e.goals_by[worst]
            return float(x[self.n]) if self.bounded else float(e.goals[worst])
        except BaseException as error:
            return self._stop(error)

    def constraints(self, result: Array, x: Array, gradient: Array) -> None:
        """Compute the constraints for nlopt: those of the problem, and the goals minus their bound."""
        try:
            e = self.at(x)
            m = len(e.constraints)
            result[:m] = e.constraints
            if self.bounded:
                result[m:] = e.goals - x[self.n]
            if gradient.size:
                gradient[:] = 0.0
                gradient[:m, : self.n] = e.constraints_by
                if self.bounded:
                    gradient[m:, : self.n] = e.goals_by
                    gradient[m:, self.n] = -1.0
        except BaseException as error:
            self._stop(error)
            result[:] = UNTRACEABLE

    def _stop(self, error: BaseException) -> float:
        self.error = self.error or error
        self.opt.force_stop()
        return UNTRACEABLE


def stationarity(e: Evaluation, point: Array) -> float:
    """Return the residual of the first-order conditions (Karush, Kuhn, Tucker) of the minimax problem.

    The multipliers are not negative and sum to 1 over the active goals. They minimize the norm of the
    weighted sum of the gradients of active goals, active constraints and active bounds of the unit box.

    Returns
    -------
    float
        Norm of that sum: the decrease of the goal, to first order, for a step of length 1. It is inf where a
        ray is lost.
    """
    from scipy.optimize import nnls

    if not max(e.objective, e.violation) < 0.5 * UNTRACEABLE:
        return math.inf
    # Largest distance of active goals from the largest goal, and of active constraints from their limit.
    tolerance = 1e-4
    goals = e.goals >= np.max(e.goals) - tolerance
    reached = e.constraints >= -tolerance
    low, high = point < tolerance, point > 1.0 - tolerance
    eye = np.eye(len(point))
    by = np.concatenate([e.goals_by[goals], e.constraints_by[reached], -eye[low], eye[high]])
    if not np.all(np.isfinite(by)):
        return math.inf
    heavy = 1e3 * max(1.0, float(np.max(np.abs(by))))
    sums = heavy * (np.arange(len(by)) < np.sum(goals))
    target = np.append(np.zeros(len(point)), heavy)
    weights, _ = nnls(np.vstack([by.T, sums]), target)
    return float(np.linalg.norm(by.T @ weights))


def first_order_residual(e: Evaluation, point: Array) -> float:
    """Return the stationarity of a feasible point, or of the largest violation at another one."""
    return stationarity(constraints_alone(e) if e.violation > FEASIBLE else e, point)


def constraints_alone(e: Evaluation) -> Evaluation:
    """Return an evaluation with the constraints as goals and without constraints."""
    return Evaluation(e.constraints, e.constraints_by, e.constraints[:0], e.constraints_by[:0])


def _reason_by_residual(reason: str, residual: float) -> str:
    """Return why a search ended; whether it has converged is decided by its point, not by nlopt's code."""
    if reason in LIMITS:
        return reason
    if residual <= CONVERGED:
        return "converged"
    return f"{reason}, but it is not stationary (first-order residual {residual:.2g})"


def minimize(
    evaluate: Callable[[Array], Evaluation],
    start: Array,
    algorithm: str = "slsqp",
    max_seconds: float = math.inf,
    max_evaluations: int = 2000,
    seed: int = 0,
    on_improvement: Callable[[float, float, int], None] | None = None,
    on_point: Callable[[Array], None] | None = None,
) -> Outcome:
    """Search from a start with one of nlopt's algorithms.

    Parameters
    ----------
    evaluate
        Goals and constraints at a point of the unit box.
    start
        Start point in the unit box, shape (n,).
    algorithm
        A key of :data:`ALGORITHMS`.
    max_seconds, max_evaluations
        Limits of time and evaluations. A deadline around the call applies, too.
    seed
        Seed of stochastic algorithms.
    on_improvement
        Called with objective, violation and number of evaluations at each new best point (default: none).
    on_point
        Called with each new best point, including the start, before `on_improvement` (default: none).

    Raises
    ------
    InputError
        If the algorithm is unknown or the start is outside the unit box.
    BaseException
        If `evaluate` raised it, including a keyboard interrupt.
    """
    import nlopt

    method = ALGORITHMS.get(algorithm)
    if method is None:
        raise InputError(f"algorithm = {algorithm!r}: unknown; allowed: {', '.join(ALGORITHMS)}")
    start = np.array(start, float)
    if start.ndim != 1 or not np.all((start >= 0.0) & (start <= 1.0)):
        raise InputError("start: must be a vector within the unit box")
    search = _Search(evaluate, len(start), method.bounded, on_improvement, on_point)
    first = search.at(start)
    search.end = now() + max_seconds
    rows = len(first.constraints) + (len(first.goals) if method.bounded else 0)
    n = len(start) + method.bounded
    opt = search.opt = _prepared(
        nlopt, method, n, search, rows, 2.0 * abs(first.objective) + 1.0, (max_seconds, max_evaluations)
    )
    nlopt.srand(seed + 1)
    x0 = np.append(start, max(0.0, first.objective)) if method.bounded else start
    reason = _run(nlopt, opt, search, x0)
    if search.error is not None and not isinstance(search.error, DeadlineExceeded):
        raise search.error
    assert search.point is not None  # at least the start was evaluated
    assert search.found is not None
    residual = first_order_residual(search.found, search.point)
    return Outcome(
        search.point,
        search.best[1],
        search.best[0],
        search.evaluations,
        _reason_by_residual(reason, residual),
        residual,
    )


def _prepared(
    nlopt: Any,
    method: Algorithm,
    n: int,
    search: _Search,
    rows: int,
    highest: float,
    limits: tuple[float, int],
) -> Any:
    opt = nlopt.opt(getattr(nlopt, method.code), n)
    if method.inner is not None:
        opt.set_local_optimizer(_limited(nlopt.opt(getattr(nlopt, method.inner), n), limits, 1e-7))
    extra = [highest] if method.bounded else []
    opt.set_lower_bounds(np.zeros(n))
    opt.set_upper_bounds(np.append(np.ones(n - len(extra)), extra))
    opt.set_min_objective(search.objective)
    if rows:
        opt.add_inequality_mconstraint(search.constraints, np.full(rows, 1e-10))
    return _limited(opt, limits, 1e-10)


def _limited(opt: Any, limits: tuple[float, int], tolerance: float) -> Any:
    opt.set_maxtime(limits[0] if math.isfinite(limits[0]) else 0.0)  # 0 means no limit
    opt.set_maxeval(limits[1])
    opt.set_xtol_rel(tolerance)
    opt.set_xtol_abs(tolerance)
    opt.set_ftol_abs(tolerance)
    return opt


def _run(nlopt: Any, opt: Any, search: _Search, x0: Array) -> str:
    reasons = {
        nlopt.STOPVAL_REACHED: "the goal is reached",
        nlopt.FTOL_REACHED: "the objective no longer changes",
        nlopt.XTOL_REACHED: "the point no longer moves",
        nlopt.MAXEVAL_REACHED: EVALUATION_LIMIT,
        nlopt.MAXTIME_REACHED: TIME_LIMIT,
    }
    try:
        opt.optimize(x0)
        return reasons.get(opt.last_optimize_result(), "finished")
    except Exception as error:  # nlopt's own classes differ from release to release
        kind = type(error).__name__.lower().replace("_", "")
        if search.error is None and kind == "invalidargument":
            raise InputError(f"nlopt refused the problem: {kind} {error}") from error
        if isinstance(search.error, DeadlineExceeded):
            return TIME_LIMIT
        return "rounding limits further progress" if kind == "roundofflimited" else f"nlopt stopped: {kind}"
