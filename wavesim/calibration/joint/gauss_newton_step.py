"""A Gauss-Newton step of object and bench together.

The object compensates a large part of the effect of a change of the bench. The step of the bench therefore
follows from the normal equations of both, which conjugate gradients solve. Samples of an amplitude object
that are at a bound (0 or 1), and would move beyond it, stay fixed. Samples of a phase object move along the
unit circle.

On a dark ground, hardly anything but the lens's aberrations tells where the object is. An object that is
displaced compensates decenter and tilt of the light, and its Laplacian's displacement their coma. Conjugate
gradients need hundreds of iterations to find such changes, and samples that are fixed at 0 forbid them. These
changes are therefore eliminated exactly, and samples at 0 are free.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.forward.linear_model import LinearModel, RealArray
from wavesim.reconstruction.object_response import (
    EliminatedObject,
    eliminated_object,
    free_samples,
    possible_change,
    products,
)
from wavesim.scene.settings import Kind

DAMPING = 0.03
"""Damping: fraction of the squared misfit that a step by the typical deviation of a parameter costs.

It limits steps to the range in which the model is nearly linear.
"""

LEAST_INFORMATION = 0.5
"""Information of the frames over that of the prior below which a combination of parameters is not followed.

With more information, a standard deviation falls by at least a fifth.
"""

LOSS_ITERATIONS, LEAST_LOSS = 3, 0.06
"""Iterations of the elimination of the object, and the relative increase of a combination's variance in them
below which the combination of parameters is no longer followed.

A single iteration is not enough: the variance of a combination may rise on after one that changed nothing.
"""

TOLERANCE = 1e-3
"""Fraction of the squared gradient, in the norm of the Hessian, at which the solution ends."""


class GaussNewtonStep:
    """The normal equations about one object on one bench.

    Parameters
    ----------
    linear
        Linear model about the object and the bench.
    columns : ndarray, shape (parameters, planes, ny, nx)
        Change of the modelled amplitudes per unit of each parameter of the bench.
    values, typical : ndarray, shape (parameters,)
        Values of the parameters, and their expected standard deviations.
    variance
        Variance of a residual that scales the prior.
    transmission
        Transmission of the object; real for an amplitude object.
    kind
        Kind of the object, which limits the changes that its samples can have.
    object_is_free
        Whether the object is unknown, too; otherwise it stays fixed.
    compensations
        By index of a parameter, the known change of the transmission that compensates a unit of it. Only
        samples that cannot follow contain information on such a parameter. Conjugate gradients alone would
        need many iterations to find such a change.
    residual : ndarray, shape (planes, ny, nx), optional
        Residuals; default: those of the linear model.
    upper_bound
        Largest transmission that an amplitude object can have.
    displacements : sequence of ndarray, shape (ny, nx), optional
        Changes of a whole amplitude object on a dark ground that are eliminated exactly
        (:func:`wavesim.metrics.displacement.displacement_changes`).

    Attributes
    ----------
    following : ndarray, shape (parameters, k)
        Multiple of each of them with which the object follows a unit of each parameter.
    """

    def __init__(
        self,
        linear: LinearModel,
        columns: RealArray,
        values: Array,
        typical: Array,
        variance: float,
        transmission: NDArray[Any],
        kind: Kind,
        object_is_free: bool = True,
        compensations: Mapping[int, NDArray[Any]] = MappingProxyType({}),
        residual: RealArray | None = None,
        upper_bound: float = 1.0,
        displacements: Sequence[NDArray[Any]] | NDArray[Any] = (),
    ) -> None:
        self.linear, self.kind, self.transmission = linear, kind, transmission
        self.displacements = displacements
        self._displaced, self._from_displaced = self._effects_of_displacements()
        residual = linear.without_scale(linear.residual if residual is None else residual)
        residual, _ = self._without_displacements(residual)
        self._residual, self._values = residual.ravel(), values
        descent = self._object_part(linear.adjoint_to_object(residual))
        is_displaced = len(displacements) > 0
        bounds = -math.inf if is_displaced else 0.0, upper_bound
        is_free = free_samples(linear, transmission, descent, bounds=bounds)
        self.free_samples = is_free & object_is_free
        self.object_descent = descent * self.free_samples
        self.columns = columns.reshape(len(columns), -1)
        self.compensations = {index: change * self.free_samples for index, change in compensations.items()}
        if self.compensations or is_displaced:
            self.columns = self.columns.copy()
        for index, change in self.compensations.items():
            self.columns[index] += linear.jacobian_times_object(change).ravel()
        self.following = np.zeros((len(columns), len(displacements)))
        if is_displaced:
            for index, column in enumerate(self.columns):
                column[:], self.following[index] = self._without_displacements(column)
        self.variance, self.prior_precision = variance, variance / typical**2
        self.descent: Array = (
            np.asarray(self.columns @ residual.ravel(), float) - self.prior_precision * values
        )
        self.damping = DAMPING * linear.misfit**2 / typical**2
        self.hessian = np.asarray(self.columns @ self.columns.T, float) + np.diag(self.prior_precision)

    def steps_with_displacements(self, follows: NDArray[np.bool_]) -> Array:
        """Return the steps of the parameters with which the bench follows displacements of the object.

        Parameters
        ----------
        follows : ndarray of bool, shape (parameters,)
            Whether a parameter follows; the others keep their values.

        Returns
        -------
        ndarray, shape (k, parameters)
            Step per unit of each displacement, at which the frames change least.
        """
        effects = np.linalg.pinv(self._from_displaced)  # of displacements, by their orthonormal basis
        shares = -self.following @ effects
        hessian = (self.hessian + shares @ shares.T)[np.ix_(follows, follows)]
        steps = np.zeros((len(effects), len(follows)))
        steps[:, follows] = -np.linalg.solve(hessian, shares[follows] @ effects.T).T
        return steps

    def followed_by_object(self, direction: Array, changes: NDArray[Any]) -> NDArray[Any]:
        """Return the change of the transmission with which the object follows a change of the parameters.

        Parameters
        ----------
        direction : ndarray, shape (parameters,)
            Change of the parameters.
        changes : ndarray, shape (parameters, ny, nx)
            Changes of the object per unit of each parameter (`EliminatedObject`).
        """
        change = np.tensordot(direction.astype(self.columns.dtype), changes, 1)
        if len(self.displacements):
            _, undone = self._without_displacements(self.linear.jacobian_times_object(change))
            for multiple, one in zip(direction @ self.following + undone, self.displacements, strict=True):
                change = change + np.float32(multiple) * one
        for parameter, compensation in self.compensations.items():
            change = change + np.float32(direction[parameter]) * compensation
        return change

    def jacobian_times_object(self, change: NDArray[Any]) -> RealArray:
        """Return the change of the amplitudes for a change of the object, which is displaced as fits best."""
        return self._without_displacements(self.linear.jacobian_times_object(change))[0]

    def adjoint_to_object(self, left: RealArray) -> NDArray[Any]:
        """Return the adjoint of `jacobian_times_object` for changes that no displacement makes."""
        return self.linear.adjoint_to_object(left)

    def restricted(self, chosen: NDArray[np.bool_]) -> GaussNewtonStep:
        """Return the equations for some of the parameters; the others keep their values.

        Parameters
        ----------
        chosen : ndarray of bool, shape (parameters,)
            Whether a parameter is among them.
        """
        if chosen.all():
            return self
        result = copy.copy(self)
        result.columns, result.hessian = self.columns[chosen], self.hessian[np.ix_(chosen, chosen)]
        result.prior_precision, result.damping = self.prior_precision[chosen], self.damping[chosen]
        result.descent, result.following = self.descent[chosen], self.following[chosen]
        result._values = self._values[chosen]
        return result

    def after(self, step: Array) -> GaussNewtonStep:
        """Return the equations after a step of the bench parameters, shape (parameters,), for the rest."""
        result = copy.copy(self)
        change = (step.astype(self.columns.dtype) @ self.columns).reshape(self.linear.residual.shape)
        followed = self._object_part(self.linear.adjoint_to_object(change)) * self.free_samples
        result.object_descent = self.object_descent - followed
        result.descent = self.descent - self.hessian @ step
        result._residual, result._values = self._residual - change.ravel(), self._values + step
        return result

    def solve(self, iterations: int) -> Array:
        """Return the step of the bench parameters, shape (parameters,)."""
        descent = self.object_descent
        effect = self.jacobian_times_object(descent)
        energy = float(np.vdot(descent, descent).real)
        object_curvature = float(np.vdot(effect, effect)) / energy if energy > 0.0 else 1.0
        bench_inverse = np.linalg.inv(self.hessian + np.diag(self.damping))
        residual, bench_residual = descent.copy(), self.descent.copy()
        solution = np.zeros(len(self.descent))
        direction, bench_direction = residual / np.float32(object_curvature), bench_inverse @ bench_residual
        energy = first_energy = float(np.vdot(residual, direction).real) + float(
            bench_residual @ bench_direction
        )
        for _ in range(iterations):
            if energy <= TOLERANCE * first_energy:
                break
            product, bench_product = self._times(direction, bench_direction)
            length = energy / (
                float(np.vdot(direction, product).real) + float(bench_direction @ bench_product)
            )
            solution += length * bench_direction
            residual -= np.float32(length) * product
            bench_residual -= length * bench_product
            next_direction, bench_next = (
                residual / np.float32(object_curvature),
                bench_inverse @ bench_residual,
            )
            previous_energy, energy = (
                energy,
                float(np.vdot(residual, next_direction).real) + float(bench_residual @ bench_next),
            )
            direction = next_direction + np.float32(energy / previous_energy) * direction
            bench_direction = bench_next + energy / previous_energy * bench_direction
        return solution

    def step_of_effects(self, effects: RealArray, chosen: NDArray[np.bool_], others: Array) -> Array:
        """Return the undamped step of some bench parameters, from the effects of all parameters.

        Parameters
        ----------
        effects : ndarray, shape (parameters, pixels)
            Effects of the parameters with the object eliminated (:meth:`eliminated`).
        chosen : ndarray of bool, shape (parameters,)
            Whether a parameter is among them.
        others : ndarray, shape (parameters,)
            Known steps; only those of parameters that are not chosen count.
        """
        hessian = products(effects, effects) + np.diag(self.prior_precision)
        descent = np.asarray(effects @ self._residual, float) - self.prior_precision * self._values
        left = descent - hessian @ np.where(chosen, 0.0, others)
        return np.asarray(np.linalg.solve(hessian[np.ix_(chosen, chosen)], left[chosen]), float)

    def eliminated(
        self, most_iterations: int, progress: Callable[[int, int], None] = lambda completed, total: None
    ) -> EliminatedObject:
        """Return the effects of the parameters with the object eliminated, and how the object follows.

        The changes of the object are those beside its displacements and known compensations. Combinations
        that the frames determine less well than the prior are not followed, nor are those whose lengths have
        converged (`LEAST_LOSS`).

        Parameters
        ----------
        most_iterations
            Largest number of iterations (:func:`eliminated_object`). With 0 iterations the object stays
            fixed.
        progress
            Callback `progress(completed, total)` of the iterations; they may end early.
        """
        precisions: list[Array] = []

        def followed(remaining: RealArray) -> Array:
            progress(len(precisions), most_iterations)
            precisions.append(self._precision(remaining))
            if len(precisions) > LOSS_ITERATIONS:
                combinations = _still_losing(precisions[-1 - LOSS_ITERATIONS], precisions[-1])
            else:
                combinations = _well_determined(precisions[-1])
            return combinations / np.sqrt(self.prior_precision)[:, None]

        columns = self.columns.reshape(-1, *self.linear.residual.shape)
        found = eliminated_object(
            self, columns, self.free_samples, self.kind, self.transmission, most_iterations, followed
        )
        return found._replace(columns=found.columns.reshape(self.columns.shape))

    def _precision(self, columns: RealArray) -> Array:
        """Return the precision that columns give to the parameters, in units of that of their priors."""
        unit = 1.0 / np.sqrt(self.prior_precision)
        return products(columns, columns) * np.outer(unit, unit)

    def _times(self, direction: NDArray[Any], bench_direction: Array) -> tuple[NDArray[Any], Array]:
        """Return the product of the Hessian with a direction of object and bench."""
        bench_changes = (bench_direction.astype(self.columns.dtype) @ self.columns).reshape(
            self.linear.residual.shape
        )
        changes = self.jacobian_times_object(direction) + bench_changes
        product = self._object_part(self.linear.adjoint_to_object(changes)) * self.free_samples
        bench_product = (
            np.asarray(self.columns @ changes.ravel(), float)
            + (self.prior_precision + self.damping) * bench_direction
        )
        return product, bench_product

    def _effects_of_displacements(self) -> tuple[RealArray, Array]:
        """Return orthonormal effects of displacements, and the multiples for each, shape (effects, k)."""
        count, size = len(self.displacements), self.linear.residual.size
        if count == 0:
            return np.zeros((0, size), self.linear.residual.dtype), np.zeros((0, 0))
        effects = np.stack([self.linear.jacobian_times_object(one).ravel() for one in self.displacements])
        # Size of a displacement over that of the object below which it is rounding, as of an even object, and
        # relative square below which a combination of unit effects is.
        least_size, rounding = 1e-4 * np.linalg.norm(self.transmission), 1e-5
        lengths = np.linalg.norm(effects, axis=1).astype(float)
        is_large = np.array([np.linalg.norm(one) > least_size for one in self.displacements]) & (
            lengths > 0.0
        )
        scales = np.where(is_large, 1.0 / np.where(is_large, lengths, 1.0), 0.0)
        powers, mixtures = np.linalg.eigh(products(effects, effects) * np.outer(scales, scales))
        is_kept = powers > rounding * max(float(powers[-1]), rounding)
        factors = (mixtures[:, is_kept] / np.sqrt(powers[is_kept])).T * scales
        return _combined(effects, factors), factors

    def _without_displacements(self, change: RealArray) -> tuple[RealArray, Array]:
        """Return a change of the amplitudes without what displacements undo, and their multiples."""
        if not len(self.displacements):
            return change, np.zeros(0)
        shares = products(self._displaced, change.reshape(1, -1))[:, 0]
        left = change - _combined(self._displaced, shares).reshape(change.shape)
        return left, -shares @ self._from_displaced

    def _object_part(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the part of a change that an object of this kind can make."""
        return possible_change(self.kind, self.transmission, values)


def _well_determined(precision: Array) -> Array:
    """Return combinations of parameters with more than `LEAST_INFORMATION` of the prior's information."""
    information, combinations = np.linalg.eigh(precision)
    return np.asarray(combinations[:, information > LEAST_INFORMATION])


def _still_losing(earlier: Array, later: Array) -> Array:
    """Return combinations of parameters whose variance rose by more than `LEAST_LOSS`.

    Precisions are in units of those of the priors, to which they add.
    """
    prior = np.eye(len(later))
    ratios, combinations = scipy.linalg.eigh(earlier + prior, later + prior)
    return np.asarray(combinations[:, ratios > 1.0 + LEAST_LOSS])


def _combined(rows: RealArray, factors: Array) -> RealArray:
    """Return combinations of rows, factors of shape (combinations, rows)."""
    return np.asarray(factors.astype(rows.dtype) @ rows)
