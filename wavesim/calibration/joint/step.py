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

ALIKE = 1e-6
"""Of the squared length of what is explained: below it, single precision tells nothing."""

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
        self.pull = variance / typical**2
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

    def reduced_curvature(self, rounds: int) -> Array:
        """What of the curvature is left where the object follows, shape (parameters, parameters).

        At most: the object follows along the slopes of what is left, some rounds of it, and where what frames
        tell is nothing beside the prior, it need not. The prior is in it.
        """
        left, shape = self.columns.copy(), self.linear.residual.shape
        for _ in range(rounds):
            followed = self._telling(left)
            for one in followed:
                change = self._object_part(self.linear.to_object(one.reshape(shape))) * self.free
                one[:] = self.linear.of_object(change).ravel()
            if len(followed):
                left -= _along(followed, left)
        return np.asarray(left @ left.T, float) + np.diag(self.pull)

    def _telling(self, columns: RealArray) -> RealArray:
        """Mixtures of columns of which frames tell more than `LEAST_TOLD` of the prior."""
        unit = 1.0 / np.sqrt(self.pull)
        told, mixed = np.linalg.eigh(np.asarray(columns @ columns.T, float) * np.outer(unit, unit))
        chosen = mixed[:, told > LEAST_TOLD] * unit[:, None]
        return np.asarray(chosen.T.astype(columns.dtype) @ columns)

    def _times(self, way: NDArray[Any], way_bench: Array) -> tuple[NDArray[Any], Array]:
        bench = (way_bench.astype(self.columns.dtype) @ self.columns).reshape(self.linear.residual.shape)
        changes = self.linear.of_object(way) + bench
        back = self._object_part(self.linear.to_object(changes)) * self.free
        own = np.asarray(self.columns @ changes.ravel(), float) + (self.pull + self.damping) * way_bench
        return back, own

    def _object_part(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(values.real) if self.is_real else values


def _along(basis: RealArray, columns: RealArray) -> RealArray:
    """The part of columns that a basis explains."""
    length = np.linalg.norm(basis, axis=1).astype(float)
    size = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    own = np.asarray(basis @ basis.T, float) * np.outer(size, size)
    met = np.asarray(basis @ columns.T, float) * size[:, None]
    share = np.linalg.pinv(own, rcond=ALIKE, hermitian=True) @ met * size[:, None]
    return np.asarray(share.T.astype(basis.dtype) @ basis)
