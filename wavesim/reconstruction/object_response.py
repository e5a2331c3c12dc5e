"""The object's response to a change of the bench, which compensates a part of the change of the frames.

About the object found, amplitudes change by d per unit of a parameter of the bench. The object follows by the
change x of its transmission with the least |d + J x|. The remainder D = d + J x is the part that the object
cannot imitate. With the residuals r and their variances V, the error of the parameter and the variance of
this estimate are

    theta = D'r / D'D,    D'V D / (D'D)^2.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from wavesim.forward.linear_model import LinearModel, RealArray
from wavesim.scene.settings import Kind

FOLLOWING_ITERATIONS = 12
"""Iterations of conjugate gradients by which the object follows a change."""


def free_samples(
    linear: LinearModel,
    values: NDArray[Any],
    gradient: NDArray[Any] | None = None,
    *,
    bounds: tuple[float, float] = (0.0, 1.0),
) -> NDArray[np.bool_]:
    """Return lit samples of the object that are not at a bound of an amplitude object.

    Parameters
    ----------
    linear
        Linear model about the object.
    values
        Transmission of the object, real for an amplitude object.
    gradient
        Change of the object that reduces the residuals; default: from those of the linear model.
    bounds
        Smallest and largest transmission that an amplitude object can have.
    """
    lit = linear.model.lit
    if np.iscomplexobj(values):
        return lit
    change = (linear.adjoint_to_object(linear.residual) if gradient is None else gradient).real
    lowest, highest = bounds
    is_at_bound = ((values <= lowest) & (change < 0.0)) | ((values >= highest) & (change > 0.0))
    return np.asarray(lit & ~is_at_bound)


def possible_change(kind: Kind, values: NDArray[Any], change: NDArray[Any]) -> NDArray[Any]:
    """Return the part of a change that an object of a kind can have.

    It is real for an amplitude object, and along the unit circle for a phase object.

    Parameters
    ----------
    kind, values
        Kind of the object, and its transmission.
    change
        Any change of the transmission.
    """
    if kind == "amplitude":
        return change.real
    if kind == "phase":
        along = 1j * values
        return np.asarray(along * (along.conj() * change).real)
    return change


class ObjectJacobian(Protocol):
    """Changes of the modelled amplitudes for changes of the object, and the adjoint."""

    def jacobian_times_object(self, change: NDArray[Any]) -> RealArray: ...

    def adjoint_to_object(self, left: RealArray) -> NDArray[Any]: ...


def following_change(
    linear: ObjectJacobian,
    column: RealArray,
    is_free: NDArray[np.bool_],
    kind: Kind,
    values: NDArray[Any],
) -> tuple[NDArray[Any], RealArray]:
    """Return the change x of the transmission with the least |column + J x|, and column + J x, by CGLS.

    Parameters
    ----------
    linear
        Linear model about the object.
    column
        Change of the modelled amplitudes.
    is_free
        Samples of the object that may change.
    kind, values
        Kind of the object, and its transmission.
    """

    def gradient(remaining: RealArray) -> NDArray[Any]:
        return np.asarray(possible_change(kind, values, linear.adjoint_to_object(remaining)) * is_free)

    remaining = column.copy()
    direction = -gradient(remaining)
    change_of_object, energy = np.zeros_like(direction), float(np.vdot(direction, direction).real)
    for _ in range(FOLLOWING_ITERATIONS):
        change = linear.jacobian_times_object(direction)
        size = float(np.vdot(change, change))
        if size <= 0.0 or energy <= 0.0:
            break
        length = np.float32(energy / size)
        change_of_object += length * direction
        remaining += length * change
        descent = -gradient(remaining)
        before, energy = energy, float(np.vdot(descent, descent).real)
        direction = descent + np.float32(energy / before) * direction
    return change_of_object, remaining
