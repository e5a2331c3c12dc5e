"""The object's response to a change of the bench, which compensates a part of the change of the frames.

About the object found, amplitudes change by d per unit of a parameter of the bench. The object follows by the
change x of its transmission with the least |d + J x|. The remainder D = d + J x is the part that the object
cannot imitate. With the residuals r and their variances V, the error of the parameter and the variance of
this estimate are

    theta = D'r / D'D,    D'V D / (D'D)^2.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.forward.linear_model import LinearModel, RealArray
from wavesim.runtime.threads import at_once
from wavesim.scene.settings import Kind

FOLLOWING_ITERATIONS = 10
"""Iterations of block conjugate gradients by which the object follows changes."""


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


class EliminatedObject(NamedTuple):
    """Effects of parameters of the bench with the object eliminated.

    Attributes
    ----------
    columns : ndarray, shape (parameters, ...)
        Change of the amplitudes per unit of each parameter that no change of the object makes.
    changes : ndarray, shape (parameters, ny, nx)
        Change of the transmission with which the object follows a unit of each parameter.
    """

    columns: RealArray
    changes: NDArray[Any]


def eliminated_object(
    linear: ObjectJacobian,
    columns: RealArray,
    is_free: NDArray[np.bool_],
    kind: Kind,
    values: NDArray[Any],
    most_iterations: int = FOLLOWING_ITERATIONS,
    followed: Callable[[RealArray], Array] | None = None,
) -> EliminatedObject:
    """Return the effects of parameters with the object eliminated, and how the object follows.

    The object may change with the parameters, so a parameter is determined only by the part of its effect
    that no change of the object can make. With the columns :math:`C` of the parameters, and the projection
    :math:`P` onto the changes that the object can make, that part is :math:`(1 - P) C`. Block conjugate
    gradients build the projection: each iteration takes the gradients of combinations of columns, and makes
    their effects orthogonal to those of the iteration before. The lengths of the results are upper bounds
    that fall with every iteration.

    Parameters
    ----------
    linear
        Linear model about the object.
    columns : ndarray, shape (parameters, planes, ny, nx)
        Changes of the modelled amplitudes.
    is_free
        Samples of the object that may change.
    kind, values
        Kind of the object, and its transmission.
    most_iterations
        Largest number of iterations. Each of them applies the forward and the adjoint operator once per
        combination. With 0 iterations the object stays fixed.
    followed
        Function of the present columns, shape (parameters, pixels), that returns the combinations, shape
        (parameters, combinations), for which the next iteration is made; none ends the iterations. Default:
        all columns.

    References
    ----------
    D. P. O'Leary, "The block conjugate gradient algorithm and related methods", Linear Algebra Appl. 29, 293
    (1980).
    """
    remaining, every_column = columns.reshape(len(columns), -1).copy(), np.eye(len(columns))
    changes = np.zeros((len(columns), values.size), values.dtype)
    previous = None
    for _ in range(most_iterations):
        combinations = every_column if followed is None else followed(remaining)
        effects = _unit_rows(_combined(remaining, combinations.T))
        if not len(effects):
            break
        gradients = np.empty((len(effects), values.size), values.dtype)

        def propose(effect: RealArray, gradient: NDArray[Any]) -> None:
            """Set the change of the object that the misfit's gradient proposes, and its effect."""
            change = possible_change(kind, values, linear.adjoint_to_object(effect)) * is_free
            gradient[:], effect[:] = change.ravel(), linear.jacobian_times_object(change)

        pairs = zip(effects.reshape(-1, *columns.shape[1:]), gradients, strict=True)
        at_once([partial(propose, *pair) for pair in pairs])
        if previous is not None:
            overlap = products(effects, previous[0])
            effects -= _combined(previous[0], overlap)
            gradients -= _combined(previous[1], overlap)
        basis = _orthonormal_combinations(effects)
        if not len(basis):
            break
        previous = effects, gradients = _combined(effects, basis), _combined(gradients, basis)
        shares = products(remaining, effects)
        remaining -= _combined(effects, shares)
        changes -= _combined(gradients, shares)
    return EliminatedObject(remaining.reshape(columns.shape), changes.reshape(-1, *values.shape))


def products(rows: RealArray, other_rows: RealArray) -> Array:
    """Return the scalar products of rows, computed in their precision."""
    return np.asarray(rows @ other_rows.T, float)


def _combined(rows: NDArray[Any], factors: Array) -> NDArray[Any]:
    """Return combinations of rows, factors of shape (combinations, rows)."""
    return np.asarray(factors.astype(rows.real.dtype) @ rows)


def _unit_rows(rows: RealArray) -> RealArray:
    """Return the rows that are not 0, each of length 1."""
    lengths = np.linalg.norm(rows, axis=1)
    return np.asarray(rows[lengths > 0.0] / lengths[lengths > 0.0, None])


def _orthonormal_combinations(rows: RealArray) -> Array:
    """Return the combinations of rows, shape (directions, rows), that are an orthonormal basis of them.

    Directions that rounding alone may have made are left out.
    """
    lengths = np.linalg.norm(rows, axis=1).astype(float)
    scales = np.where(lengths > 0.0, 1.0 / np.where(lengths > 0.0, lengths, 1.0), 0.0)
    powers, mixtures = np.linalg.eigh(products(rows, rows) * np.outer(scales, scales))
    # Squared relative length below which a direction may be an effect of rounding in single precision.
    rounding = 1e-5
    is_kept = powers > rounding * max(powers.max(initial=0.0), 1.0)
    return np.asarray((mixtures[:, is_kept] / np.sqrt(powers[is_kept])).T * scales)
