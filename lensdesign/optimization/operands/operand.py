"""Operands (goals and constraints with derivatives), and the state of the lens that they evaluate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.optimization.as_built import AsBuiltValues, LossValues
from lensdesign.optimization.nlopt_driver import UNTRACEABLE
from lensdesign.optimization.operands.ghosts import GhostValues
from lensdesign.raytrace.gradients import GradientTrace, Variable

LIMIT_MARGIN = 3e-5
"""Relative margin by which limits are tightened, so that a denser check of the result finds them met."""

ACCEPTED_VIOLATION = 2.0 * LIMIT_MARGIN
"""Largest excess of a scaled square over its tightened limit that still meets the limit as given."""


def not_needed() -> None:
    """Return None, the value of a prediction that a search does not need."""


@dataclass(frozen=True)
class State:
    """A lens of the search with its rays: n rays, v variables.

    Predictions take much longer than the rays. They are computed when an operand uses them.

    Attributes
    ----------
    lens
        The lens, not validated.
    variables
        Variables of the derivatives.
    fields_mm : ndarray, shape (n, 2)
        Object point of each ray.
    traces
        Ray trace at each wavelength of the lens.
    temperature_c
        Temperature of the lens; None as designed.
    expansion_factors : ndarray, shape (surfaces,)
        Factors by which the surfaces have expanded; None as designed.
    heated
        The lens at the other temperatures of the specification.
    predict_as_built
        Returns predictions of the lens as built; None if not needed.
    predict_losses
        Returns mean reconstruction losses as built; None if not needed.
    predict_ghosts
        Returns the power of ghosts on the sensor; None if not needed.
    """

    lens: Lens
    variables: tuple[Variable, ...]
    fields_mm: Array
    traces: tuple[GradientTrace, ...]
    temperature_c: float | None = None
    expansion_factors: Array | None = None
    heated: tuple[State, ...] = ()
    predict_as_built: Callable[[], AsBuiltValues | None] = not_needed
    predict_losses: Callable[[], LossValues | None] = not_needed
    predict_ghosts: Callable[[], GhostValues | None] = not_needed

    @property
    def all(self) -> tuple[State, ...]:
        """The lens as designed, and at other temperatures."""
        return (self, *self.heated)


@dataclass(frozen=True)
class Operand:
    """Goals or constraints of one kind.

    Attributes
    ----------
    name
        Name in reports.
    values, by : ndarray, shapes (k,) and (k, v)
        Scaled values and their derivatives.
    rays : ndarray of int or None
        Index of the ray of each value; None if the values do not belong to rays.
    """

    name: str
    values: Array
    by: Array
    rays: NDArray[np.int64] | None = None


def squares_of(points: Array, by: Array) -> tuple[Array, Array]:
    """Return x^2 + y^2 and its derivatives."""
    x, y = points[:, 0], points[:, 1]  # sums over an axis of length 2 are slow
    squares_by = x[:, None] * by[:, 0]
    squares_by += y[:, None] * by[:, 1]
    squares_by *= 2.0
    return x * x + y * y, squares_by


def heights_of(trace: GradientTrace, i: int) -> tuple[Array, Array]:
    """Return the squares of the radial heights on a surface, and their derivatives."""
    return squares_of(trace.heights[:, i], trace.heights_by[:, i])


def finite_operand(name: str, values: Array, by: Array) -> Operand:
    """Return an operand in which values that are not finite are replaced by one far beyond any limit."""
    ok = np.isfinite(values) & np.isfinite(by).all(axis=-1)
    if ok.all():
        return Operand(name, values, by)
    return Operand(name, np.where(ok, values, UNTRACEABLE), np.where(ok[:, None], by, 0.0))
