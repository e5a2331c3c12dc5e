"""The search for a few parameters of an expensive model with derivatives: Gauss-Newton, within bounds.

It goes along directions in which the linear model's residual changes alike.
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
"""First and last radius of the region in which a linear model is trusted, in coordinates of curvature 1."""

TOLERANCE = 1e-6
"""Of the bounds, relative."""

STIFFEST = 1e3
"""Ratio of curvatures beyond which a direction is not stretched further."""


@dataclass(frozen=True)
class Minimum:
    """Best point of a search.

    Attributes
    ----------
    point : ndarray, shape (n,)
    size : float
        Length of the residual there.
    evaluations : int
    stopped_because : str
    """

    point: Array
    size: float
    evaluations: int
    stopped_because: str


def stiff_directions(slopes: RealArray, reach: Array) -> tuple[Array, Array]:
    """Directions in which a linear model is stiff in its own measure, and its curvature along each.

    Parameters
    ----------
    slopes : ndarray, shape (n, m)
        Change of the model for a unit of each parameter.
    reach : ndarray, shape (n,)
        Natural scale of each parameter.

    Returns
    -------
    directions : ndarray, shape (n, n)
        As columns; of unit length where parameters are measured by their reach.
    curvatures : ndarray, shape (n,)
        Squared change of the residual for a unit; at most `STIFFEST` times apart.
    """
    scaled = slopes * reach[:, None].astype(slopes.dtype)
    values, vectors = np.linalg.eigh(np.asarray(scaled @ scaled.T, float))
    return np.asarray(reach[:, None] * vectors), np.maximum(values, values[-1] / STIFFEST)


class GaussNewton:
    """Makes the length of a residual small where the model's derivatives are known, or nearly so.

    Along each step they are corrected by what the step did (Broyden's update).

    Parameters
    ----------
    model
        Residual (shape (m,), recorded less modelled) and change of the model for a unit of each parameter
        (shape (n, m)) at a point.
    start, reach : ndarray, shape (n,)
        Where the search begins; it looks from -reach to reach.
    """

    def __init__(
        self, model: Callable[[Array], tuple[RealArray, RealArray]], start: Array, reach: Array
    ) -> None:
        self.model, self.point, self.reach = model, np.array(start, float), reach

    def run(self, gain: float, most: int) -> Minimum:
        """Search until a step lowers the squared residual by less than a share, or evaluations are used up.

        Raises
        ------
        TransferLensError
            What the model raised at the start. Points at which it raises later are avoided.
        """
        left, slopes = self.model(self.point)
        directions, curvatures = stiff_directions(slopes, self.reach)
        self.stretch = directions / np.sqrt(curvatures)
        slopes = self._stretched(slopes)
        radius, evaluations, reason = LARGEST_STEP, 1, "mountings used up"
        while evaluations < most:
            step = self._step(slopes, left, radius)
            length = float(np.linalg.norm(step))
            size = max(_squared(left), np.finfo(float).tiny)
            expected = 1.0 - _squared(left - step @ slopes) / size
            if expected < gain or length < SMALLEST_STEP:
                reason = "converged"
                break
            evaluations += 1
            there = self.point + self.stretch @ step
            found = self._tried(there)
            if found is None:
                radius = 0.4 * length
                continue
            gained = 1.0 - _squared(found[0]) / size
            # Derivatives may be a few percent off, which in soft directions is more than they are.
            ahead = slopes if gained <= 0.0 else self._stretched(found[1])
            missed = (left - found[0]) - step @ ahead
            slopes = ahead + np.outer(step / length**2, missed).astype(ahead.dtype)
            if gained <= 0.0:
                radius = 0.4 * length
                continue
            self.point, left = there, found[0]
            if gained < gain:
                reason = "converged"
                break
            if gained > 0.7 * expected:
                radius = max(radius, 2.0 * length)
        return Minimum(self.point, float(np.sqrt(_squared(left))), evaluations, reason)

    def _stretched(self, slopes: RealArray) -> RealArray:
        return np.asarray(self.stretch.T.astype(slopes.dtype) @ slopes)

    def _tried(self, point: Array) -> tuple[RealArray, RealArray] | None:
        try:
            return self.model(point)
        except TransferLensError:
            return None

    def _step(self, slopes: RealArray, left: RealArray, radius: float) -> Array:
        """Lowest point of the linear model within a radius and within the bounds."""
        import nlopt

        curvature = np.asarray(slopes @ slopes.T, float)
        pull = np.asarray(slopes @ left, float)
        lowest: list[tuple[float, Array]] = [(0.0, np.zeros(len(pull)))]

        def model(y: Array, gradient: Array) -> float:
            value = float(0.5 * y @ curvature @ y - pull @ y)
            if gradient.size:
                gradient[:] = curvature @ y - pull
            if value < lowest[0][0] and np.max(bounds(y)) <= TOLERANCE:
                lowest[0] = (value, y.copy())
            return value

        def bounds(y: Array) -> Array:
            there = self.point + self.stretch @ y
            return np.array(
                [
                    *(there / self.reach - 1.0),
                    *(-there / self.reach - 1.0),
                    np.dot(y, y) / radius**2 - 1.0,
                ]
            )

        def within(result: Array, y: Array, gradient: Array) -> None:
            result[:] = bounds(y)
            if gradient.size:
                rows = self.stretch / self.reach[:, None]
                gradient[:] = np.concatenate([rows, -rows, 2.0 * y[None] / radius**2])

        opt = nlopt.opt(nlopt.LD_SLSQP, len(pull))
        opt.set_min_objective(model)
        opt.add_inequality_mconstraint(within, np.full(2 * len(pull) + 1, TOLERANCE))
        opt.set_xtol_abs(1e-7)
        opt.set_maxeval(500)
        with suppress(nlopt.RoundoffLimited):  # which loses the point
            opt.optimize(lowest[0][1])
        return lowest[0][1]


def _squared(values: RealArray) -> float:
    return float(np.sum(values * values, dtype=float))
