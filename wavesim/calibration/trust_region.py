"""Bounded Gauss-Newton search for a few parameters of an expensive model with derivatives.

The search uses scaled directions in which the residual of the linear model changes equally.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import TransferLensError

RealArray = NDArray[np.floating]

LARGEST_STEP, SMALLEST_STEP = 0.5, 1e-4
"""First and last radius of the trust region, in coordinates of curvature 1."""

LARGEST_CURVATURE_RATIO = 1e3
"""Ratio of curvatures beyond which a direction is not scaled further."""


@dataclass(frozen=True)
class Minimum:
    """Best point of a search.

    Attributes
    ----------
    point : ndarray, shape (n,)
        Parameters.
    residual_norm : float
        Length of the residual at the point.
    evaluations : int
        Number of evaluations of the model.
    stopped_because : str
        Reason for the end of the search.
    """

    point: Array
    residual_norm: float
    evaluations: int
    stopped_because: str


def curvature_directions(jacobian: RealArray, search_range: Array) -> tuple[Array, Array]:
    """Return the principal directions of a linear model's Hessian, and the curvature along each.

    Parameters
    ----------
    jacobian : ndarray, shape (n, m)
        Change of the model per unit of each parameter.
    search_range : ndarray, shape (n,)
        Natural scale of each parameter.

    Returns
    -------
    directions : ndarray, shape (n, n)
        Directions as columns, of unit length in units of the scales.
    curvatures : ndarray, shape (n,)
        Squared change of the residual per unit; their ratio is limited to `LARGEST_CURVATURE_RATIO`.
    """
    scaled = jacobian * search_range[:, None].astype(jacobian.dtype)
    values, vectors = np.linalg.eigh(np.asarray(scaled @ scaled.T, float))
    return np.asarray(search_range[:, None] * vectors), np.maximum(
        values, values[-1] / LARGEST_CURVATURE_RATIO
    )


class GaussNewton:
    """Minimizes the length of a residual of a model with (approximately) known derivatives.

    The derivatives are corrected along each step by the actual change of the model (Broyden's update).

    Parameters
    ----------
    model
        Function that returns the residual, shape (m,), measured less modelled, and the change of the model
        per unit of each parameter, shape (n, m), at a point.
    start, search_range : ndarray, shape (n,)
        Start of the search, which is limited to -search_range to search_range.
    """

    def __init__(
        self, model: Callable[[Array], tuple[RealArray, RealArray]], start: Array, search_range: Array
    ) -> None:
        self.model, self.point, self.search_range = model, np.array(start, float), search_range

    def run(self, least_gain: float, most_evaluations: int) -> Minimum:
        """Search until a step gains less than a fraction of the squared residual, or all evaluations are
        used.

        Parameters
        ----------
        least_gain
            Smallest relative decrease of the squared residual in a step.
        most_evaluations
            Largest number of evaluations of the model.

        Raises
        ------
        TransferLensError
            If the model raises it at the start. Later points at which it raises are avoided.
        """
        residual, jacobian = self.model(self.point)
        directions, curvatures = curvature_directions(jacobian, self.search_range)
        self.scaling = directions / np.sqrt(curvatures)
        jacobian = self._scaled_jacobian(jacobian)
        radius, evaluations, reason = LARGEST_STEP, 1, "limit of evaluations reached"
        while evaluations < most_evaluations:
            step = self._step(jacobian, residual, radius)
            length = float(np.linalg.norm(step))
            squared_residual = max(_squared(residual), np.finfo(float).tiny)
            expected_gain = 1.0 - _squared(residual - step @ jacobian) / squared_residual
            if expected_gain < least_gain or length < SMALLEST_STEP:
                reason = "converged"
                break
            evaluations += 1
            point = self.point + self.scaling @ step
            found = self._evaluated(point)
            if found is None:
                radius = 0.4 * length
                continue
            gain = 1.0 - _squared(found[0]) / squared_residual
            # Errors of a few percent of the derivatives may exceed the derivatives in soft directions.
            next_jacobian = jacobian if gain <= 0.0 else self._scaled_jacobian(found[1])
            error = (residual - found[0]) - step @ next_jacobian
            jacobian = next_jacobian + np.outer(step / length**2, error).astype(next_jacobian.dtype)
            if gain <= 0.0:
                radius = 0.4 * length
                continue
            self.point, residual = point, found[0]
            if gain < least_gain:
                reason = "converged"
                break
            if gain > 0.7 * expected_gain:
                radius = max(radius, 2.0 * length)
        return Minimum(self.point, float(np.sqrt(_squared(residual))), evaluations, reason)

    def _scaled_jacobian(self, jacobian: RealArray) -> RealArray:
        return np.asarray(self.scaling.T.astype(jacobian.dtype) @ jacobian)

    def _evaluated(self, point: Array) -> tuple[RealArray, RealArray] | None:
        try:
            return self.model(point)
        except TransferLensError:
            return None

    def _step(self, jacobian: RealArray, residual: RealArray, radius: float) -> Array:
        """Return the minimum of the linear model within the trust radius and the bounds."""
        import nlopt

        hessian = np.asarray(jacobian @ jacobian.T, float)
        descent = np.asarray(jacobian @ residual, float)
        best: list[tuple[float, Array]] = [(0.0, np.zeros(len(descent)))]

        # Relative tolerance of the bounds.
        tolerance = 1e-6

        def model(y: Array, gradient: Array) -> float:
            value = float(0.5 * y @ hessian @ y - descent @ y)
            if gradient.size:
                gradient[:] = hessian @ y - descent
            if value < best[0][0] and np.max(bounds(y)) <= tolerance:
                best[0] = (value, y.copy())
            return value

        def bounds(y: Array) -> Array:
            point = self.point + self.scaling @ y
            return np.array(
                [
                    *(point / self.search_range - 1.0),
                    *(-point / self.search_range - 1.0),
                    np.dot(y, y) / radius**2 - 1.0,
                ]
            )

        def constraints(result: Array, y: Array, gradient: Array) -> None:
            result[:] = bounds(y)
            if gradient.size:
                rows = self.scaling / self.search_range[:, None]
                gradient[:] = np.concatenate([rows, -rows, 2.0 * y[None] / radius**2])

        opt = nlopt.opt(nlopt.LD_SLSQP, len(descent))
        opt.set_min_objective(model)
        opt.add_inequality_mconstraint(constraints, np.full(2 * len(descent) + 1, tolerance))
        opt.set_xtol_abs(1e-7)
        opt.set_maxeval(500)
        # After a rounding error NLopt returns no point; `best` holds the best one.
        with suppress(nlopt.RoundoffLimited):
            opt.optimize(best[0][1])
        return best[0][1]


def _squared(values: RealArray) -> float:
    return float(np.sum(values * values, dtype=float))
