"""Goals and constraints as rows of values with derivatives, and the lens that they are of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.optimization.as_built import AsBuiltValues, LossValues
from lensdesign.optimization.nlopt_driver import UNTRACEABLE
from lensdesign.raytrace.gradients import GradientTrace, Variable

LIMIT_MARGIN = 3e-5
"""Limits are kept by this relative margin, so that a denser check of the result finds them kept too."""

KEPT = 2.0 * LIMIT_MARGIN
"""A scaled square that exceeds its narrowed limit by no more than this keeps the limit as given."""


@dataclass(frozen=True)
class State:
    """A lens of the search with its rays; n rays, v variables.

    Attributes
    ----------
    lens
        The lens, not validated.
    variables
        What the derivatives are by.
    fields_mm : ndarray, shape (n, 2)
        Object point of each ray.
    traces
        One for each wavelength of the lens.
    as_built
        What is predicted of it as built, where goals or constraints ask for that.
    temperature_c
        Of the lens; None as designed.
    sizes : ndarray, shape (surfaces,)
        By which its surfaces have grown; None as designed.
    heated
        The same lens at other temperatures, where something is asked of it there.
    losses
        Its mean reconstruction losses as built, where goal or constraints ask for them.
    """

    lens: Lens
    variables: tuple[Variable, ...]
    fields_mm: Array
    traces: tuple[GradientTrace, ...]
    as_built: AsBuiltValues | None = None
    temperature_c: float | None = None
    sizes: Array | None = None
    heated: tuple[State, ...] = ()
    losses: LossValues | None = None

    @property
    def all(self) -> tuple[State, ...]:
        """The lens as designed, and at other temperatures."""
        return (self, *self.heated)


@dataclass(frozen=True)
class Row:
    """Goals or constraints of one kind.

    Attributes
    ----------
    name
        As reports call it.
    values, by : ndarray, shapes (k,) and (k, v)
        Scaled values and their derivatives.
    rays : ndarray of int or None
        Which ray each value belongs to.
    """

    name: str
    values: Array
    by: Array
    rays: NDArray[np.int64] | None = None


def squares_of(points: Array, by: Array) -> tuple[Array, Array]:
    """x^2 + y^2 and its derivatives."""
    return np.sum(points**2, axis=-1), 2.0 * np.einsum("na,nav->nv", points, by)


def heights_of(trace: GradientTrace, i: int) -> tuple[Array, Array]:
    """Squares of the radial heights on a surface, and their derivatives."""
    return squares_of(trace.heights[:, i], trace.heights_by[:, i])


def finite_operand(name: str, values: Array, by: Array) -> Row:
    """A row in which what is not finite is far beyond any limit."""
    ok = np.isfinite(values) & np.all(np.isfinite(by), axis=-1)
    return Row(name, np.where(ok, values, UNTRACEABLE), np.where(ok[:, None], by, 0.0))
