"""A Gauss-Newton step of object and bench together.

The object follows whatever the bench does, and takes most of its effect where it can: what is left for the
bench comes from the normal equations of both, which conjugate gradients solve. An amplitude object that is
at 0 or 1, and would go on, stays there.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.reconstruction.linear.linearised import Linearised, RealArray

DAMPING = 0.03
"""Of the squared misfit, what a step by what is typical of a parameter costs: farther, nothing is linear."""

LEAST_TOLD = 0.5
"""Of what is known before: with so much more, a standard deviation falls by a fifth."""

ALIKE = 1e-5
"""Squared relative length below which a direction may be an effect of rounding in single precision."""

SOLVED = 1e-3
"""Of the squared gradient, in the measure of the curvature, at which the solution ends."""


class GaussNewtonStep:
    """The normal equations about one object on one bench.

    Parameters
    ----------
    linear
        The model there.
    columns : ndarray, shape (parameters, planes, ny, nx)
        Change of the modelled amplitudes with each parameter of the bench.
    values, typical : ndarray, shape (parameters,)
        Where they are, and how far from 0 they are expected to be.
    variance
        Of a residual, as far as the model has errors of its own.
    transmission
        Of the object; real where it is an amplitude.
    follows
        Whether the object is unknown, too; else it stays as it is.
    undone
        By its place, what of the transmission undoes a unit of a parameter, where that is known: only the
        samples that cannot follow tell of such a parameter, and conjugate gradients would take many rounds
        to find that out.
    """

    def __init__(
        self,
        linear: Linearised,
        columns: RealArray,
        values: Array,
        typical: Array,
        variance: float,
        transmission: NDArray[Any],
        follows: bool = True,
        undone: Mapping[int, NDArray[Any]] = MappingProxyType({}),
    ) -> None:
        self.linear, self.is_real = linear, not np.iscomplexobj(transmission)
        left = linear.without_scale(linear.residual)
        slope = self._object_part(linear.to_object(left))
        self.free = linear.model.lit & follows
        if self.is_real:
            stuck = ((transmission <= 0.0) & (slope < 0.0)) | ((transmission >= 1.0) & (slope > 0.0))
            self.free = self.free & ~stuck
        self.object_slope = slope * self.free
        self.columns = columns.reshape(len(columns), -1)
        if undone:
            self.columns = self.columns.copy()
        for place, change in undone.items():
            self.columns[place] += linear.of_object(change * self.free).ravel()
        self.variance, self.pull = variance, variance / typical**2
        self.slope: Array = np.asarray(self.columns @ left.ravel(), float) - self.pull * values
        self.damping = DAMPING * linear.misfit**2 / typical**2
        self.curvature = np.asarray(self.columns @ self.columns.T, float) + np.diag(self.pull)

    def solve(self, rounds: int) -> Array:
        """The bench's part of the step."""
        slope = self.object_slope
        along = self.linear.of_object(slope)
        energy = float(np.vdot(slope, slope).real)
        stiffness = float(np.vdot(along, along)) / energy if energy > 0.0 else 1.0
        inverse = np.linalg.inv(self.curvature + np.diag(self.damping))
        left, left_bench = slope.copy(), self.slope.copy()
        there = np.zeros(len(self.slope))
        way, way_bench = left / np.float32(stiffness), inverse @ left_bench
        size = first = float(np.vdot(left, way).real) + float(left_bench @ way_bench)
        for _ in range(rounds):
            if size <= SOLVED * first:
                break
            back, back_bench = self._times(way, way_bench)
            length = size / (float(np.vdot(way, back).real) + float(way_bench @ back_bench))
            there += length * way_bench
            left -= np.float32(length) * back
            left_bench -= length * back_bench
            ahead, ahead_bench = left / np.float32(stiffness), inverse @ left_bench
            before, size = size, float(np.vdot(left, ahead).real) + float(left_bench @ ahead_bench)
            way = ahead + np.float32(size / before) * way
            way_bench = ahead_bench + size / before * way_bench
        return there

    def reduced_curvature(self, most_iterations: int) -> Array:
        """Return the curvature of the parameters with the object eliminated, shape (parameters, parameters).

        The object may change with the parameters, so a parameter is determined only by the part of its effect
        that no change of the object can make. With the columns :math:`C` of the parameters, and the
        projection :math:`P` onto the changes that the object can make, the result is
        :math:`C^T (1 - P) C` plus the curvature of the prior. Block conjugate gradients build the projection:
        each iteration takes the gradients of all columns at once, and makes their effects orthogonal to those
        of the iteration before. The result is an upper bound that falls with every iteration.

        Combinations of parameters that the frames determine less well than the prior are not followed.

        Parameters
        ----------
        most_iterations
            Iterations at most. Each of them carries as many fields forward and back as there are parameters.
            With 0 of them the object stays as it is.

        References
        ----------
        D. P. O'Leary, "The block conjugate gradient algorithm and related methods", Linear Algebra Appl. 29,
        293 (1980).
        """
        remaining, shape = self.columns.copy(), self.linear.residual.shape
        previous: RealArray | None = None
        for _ in range(most_iterations):
            effects = self._determined(remaining)
            if not len(effects):
                break
            for effect in effects:
                gradient = self._object_part(self.linear.to_object(effect.reshape(shape))) * self.free
                effect[:] = self.linear.of_object(gradient).ravel()
            if previous is not None:
                effects -= _combined(previous, _products(effects, previous))
            previous = _orthonormal(effects)
            remaining -= _combined(previous, _products(remaining, previous))
        return _products(remaining, remaining) + np.diag(self.pull)

    def _determined(self, columns: RealArray) -> RealArray:
        """Return unit mixtures of columns that the frames determine better than `LEAST_TOLD` of the prior."""
        unit = 1.0 / np.sqrt(self.pull)
        precision, mixed = np.linalg.eigh(_products(columns, columns) * np.outer(unit, unit))
        chosen = mixed[:, precision > LEAST_TOLD] * unit[:, None]
        mixtures = _combined(columns, chosen.T)
        lengths = np.linalg.norm(mixtures, axis=1)
        return np.asarray(mixtures / lengths[:, None].astype(columns.dtype))

    def _times(self, way: NDArray[Any], way_bench: Array) -> tuple[NDArray[Any], Array]:
        bench = (way_bench.astype(self.columns.dtype) @ self.columns).reshape(self.linear.residual.shape)
        changes = self.linear.of_object(way) + bench
        back = self._object_part(self.linear.to_object(changes)) * self.free
        own = np.asarray(self.columns @ changes.ravel(), float) + (self.pull + self.damping) * way_bench
        return back, own

    def _object_part(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(values.real) if self.is_real else values


def _products(one: RealArray, other: RealArray) -> Array:
    """Return the scalar products of rows, in double precision."""
    return np.asarray(one @ other.T, float)


def _combined(rows: RealArray, factors: Array) -> RealArray:
    """Return combinations of rows, factors of shape (combinations, rows)."""
    return np.asarray(factors.astype(rows.dtype) @ rows)


def _orthonormal(rows: RealArray) -> RealArray:
    """Return an orthonormal basis of rows, without directions that rounding alone may have made."""
    lengths = np.linalg.norm(rows, axis=1).astype(float)
    units = rows[lengths > 0.0] / lengths[lengths > 0.0, None].astype(rows.dtype)
    powers, mixed = np.linalg.eigh(_products(units, units))
    kept = powers > ALIKE * max(powers.max(initial=0.0), 1.0)
    return _combined(units, (mixed[:, kept] / np.sqrt(powers[kept])).T)
