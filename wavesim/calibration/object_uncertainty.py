"""What the uncertainty of a calibrated bench leaves open in its object.

The object follows an error of the bench, so that the frames stay as they are. The covariance of the estimates
is :math:`C = V V^T`, with one column of V for each independent direction. The object then has the independent
changes :math:`x_k`, of one standard deviation each, where :math:`x_k` follows the change :math:`v_k` of the
bench (:mod:`wavesim.reconstruction.object_response`). A complex or phase object also takes over all errors of
the light that were not sought; they have the standard deviations that are expected.

Ramp and curvature of an object's phase are exchanged with light and mounting, and those of its amplitude
with the unevenness of the light. The phase may be whole waves, so that these low orders are a factor of the
object, :math:`\\exp(a + i \\phi)`, and not a small change. Neither is the displacement of an object on a dark
ground, which is exchanged with the decenter and may be many samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.calibration.joint.gauss_newton_step import GaussNewtonStep
from wavesim.fields.field import Field
from wavesim.metrics.contrast import object_correlation
from wavesim.metrics.displacement import displaced_back, displacement_changes
from wavesim.metrics.goodness_of_fit import BenchUncertainty
from wavesim.metrics.low_orders import (
    LOW_ORDERS,
    ORDER_NAMES,
    PHASE_ORDERS,
    low_order_coefficients,
    low_order_factor,
    low_order_polynomial,
)

ComplexArray = NDArray[np.complexfloating]

MOST_DIRECTIONS, LEFT_OUT = 16, 0.01
"""Largest number of directions of a bench whose effects on the object are computed, and the fraction of all
effects that the others may have.
"""


@dataclass(frozen=True, eq=False)
class ObjectUncertainty:
    """Independent errors of an object, of one standard deviation each.

    Attributes
    ----------
    light : Field
        Light on the object.
    transmission : ndarray, shape (ny, nx)
        Transmission of the object on the calibrated bench.
    changes : ndarray, shape (m, ny, nx)
        Changes of the transmission.
    exponents : ndarray, shape (m, 6)
        Low orders (`LOW_ORDERS`) of the exponent of a factor that belongs to each change: real for an
        amplitude object, and imaginary for a phase object.
    displacements : ndarray, shape (m, 2), optional
        Displacement along x and y in samples that belongs to each change; default: none.
    """

    light: Field
    transmission: ComplexArray
    changes: ComplexArray
    exponents: ComplexArray
    displacements: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @cached_property
    def summary(self) -> BenchUncertainty:
        """Correlations that these errors leave, and what they change in position, phase and amplitude.

        99 % of all such errors reach the correlations. The bound then holds in 95 % of all cases together
        with that of the noise, which holds in 95 %, too.
        """
        random, draws, missed = np.random.default_rng(0), 300, 0.01
        has_factors = bool(np.any(self.exponents) or np.any(self.displacements))
        lit, found = self._lit(self.transmission), np.empty((draws, 2))
        for draw in range(draws):
            sizes = random.standard_normal(len(self.changes)).astype(np.float32)
            other = self.transmission + np.tensordot(sizes, self.changes, 1)
            found[draw] = object_correlation(self._lit(other), lit, self.light)
            if has_factors:
                other = self._with_factors(other, sizes)
                found[draw, 0] = object_correlation(self._lit(other), lit, self.light)
        correlation, without = (
            float(np.nanquantile(one, missed)) if np.isfinite(one).any() else 1.0 for one in found.T
        )
        return BenchUncertainty(
            correlation,
            without,
            _deviations(self.exponents.imag / (2.0 * np.pi)),
            _deviations(self.exponents.real),
            self._position_um(),
        )

    def _position_um(self) -> Mapping[str, float]:
        """Return the standard deviation of the position along each axis; empty on a clear ground."""
        if not np.any(self.displacements):
            return {}
        deviations = 1e3 * self.light.grid.pitch_mm * np.sqrt(np.sum(self.displacements**2, axis=0))
        return dict(zip("xy", deviations.tolist(), strict=True))

    def _with_factors(self, values: ComplexArray, sizes: NDArray[np.floating]) -> ComplexArray:
        """Return a transmission displaced, and multiplied by low orders, by errors of these sizes."""
        if np.any(self.displacements):
            values = values.astype(np.complex64)
            x, y = (-sizes @ self.displacements).tolist()
            displaced_back(values, (x, y))
        return values * low_order_factor(sizes @ self.exponents, values.shape)

    def _lit(self, transmission: ComplexArray) -> Field:
        return self.light.with_values(self.light.values * transmission)


def _deviations(orders: NDArray[np.floating]) -> Mapping[str, float]:
    """Return the standard deviation of each low order by name; empty where all are 0."""
    deviations = np.sqrt(np.sum(orders**2, axis=0))
    by_orders = dict(zip(LOW_ORDERS, deviations.tolist(), strict=True))
    return {ORDER_NAMES[one]: by_orders[one] for one in PHASE_ORDERS} if np.any(deviations) else {}


def object_uncertainty(
    equations: GaussNewtonStep,
    covariance: Array,
    followed: NDArray[Any],
    position: Array | None = None,
    absorbed: Sequence[ComplexArray] = (),
) -> ObjectUncertainty:
    """Return the errors of the object about which normal equations were made.

    Parameters
    ----------
    equations
        Normal equations at the estimates.
    covariance : ndarray, shape (n, n)
        Covariance of the estimates.
    followed : ndarray, shape (n, ny, nx)
        Change of the object that follows a unit of each parameter (:meth:`GaussNewtonStep.eliminated`).
    position : ndarray, shape (2,), optional
        Standard deviations of the position of an object on a dark ground along x and y in samples, beside
        those of the bench; None for an object on a clear ground.
    absorbed : sequence of ndarray, shape (ny, nx)
        Relative changes of the light of one standard deviation each, which the object takes over exactly.
    """
    linear, values = equations.linear, equations.transmission
    light = linear.model.illumination
    changes = [equations.followed_by_object(one, followed) for one in _directions(equations, covariance)]
    exponents = np.zeros((len(changes), len(LOW_ORDERS)), complex)
    power, even = np.abs(light.values) ** 2, np.ones(values.shape)
    for index, change in enumerate(changes):
        exponents[index] = low_order_coefficients(change, values, power)
        low_orders = low_order_polynomial(exponents[index], values.shape) * values
        changes[index] = change - (low_orders if np.iscomplexobj(values) else low_orders.real).astype(
            change.dtype
        )
    displacements = np.zeros((len(changes), 2))
    if position is not None:
        along = displacement_changes(values)
        changes += [np.float32(samples) * change for samples, change in zip(position, along, strict=True)]
        exponents = np.vstack([exponents, np.zeros((2, len(LOW_ORDERS)))])
        displacements, changes = _displacements(changes, along, power)
    if equations.kind != "amplitude":
        of_light = [low_order_coefficients(-change, even, power) for change in absorbed]
        exponents = np.vstack([exponents, *of_light])
        displacements = np.vstack([displacements, np.zeros((len(of_light), 2))])
        changes += [np.zeros_like(values) for _ in absorbed]
    if equations.kind == "phase":
        exponents.real = 0.0
    return ObjectUncertainty(light, values, np.stack(changes), exponents, displacements)


def _displacements(
    changes: Sequence[NDArray[Any]], along: NDArray[Any], power: NDArray[np.floating]
) -> tuple[Array, list[NDArray[Any]]]:
    """Return the displacements in samples that changes contain, shape (m, 2), and what else they are.

    Parameters
    ----------
    changes
        Changes of an amplitude object.
    along : ndarray, shape (2, ny, nx)
        Changes of the object per sample of displacement along x and y.
    power : ndarray, shape (ny, nx)
        Weight of each sample.
    """
    rows = along.reshape(2, -1)
    weighted = rows * power.ravel()
    products = np.array([weighted @ change.ravel() for change in changes])
    found = products @ np.linalg.pinv(weighted @ rows.T, hermitian=True)
    left = [
        change - np.tensordot(one.astype(np.float32), along, 1)
        for one, change in zip(found, changes, strict=True)
    ]
    return found, left


def _directions(equations: GaussNewtonStep, covariance: Array) -> Array:
    """Return independent changes of the bench of one standard deviation each, shape (directions, n).

    Those with the largest effects on the frames, or on the object that compensates them, come first.
    """
    deviations = np.sqrt(np.diag(covariance))
    variances, vectors = np.linalg.eigh(covariance / np.outer(deviations, deviations))
    roots = deviations[:, None] * vectors * np.sqrt(np.maximum(variances, 0.0))
    effects = np.asarray(equations.columns @ equations.columns.T, float)
    lit = np.abs(equations.linear.model.illumination.values) ** 2
    energy = float(np.sum(lit * np.abs(equations.transmission) ** 2))
    for index, change in equations.compensations.items():
        for other, change_of_other in equations.compensations.items():
            effects[index, other] += float(np.sum(lit * change * change_of_other)) / energy
    along = equations.displacements
    products = np.array([[np.sum(lit * one * other) for other in along] for one in along])
    effects += equations.following @ products.reshape(len(along), len(along)) @ equations.following.T / energy
    sizes, turns = np.linalg.eigh(roots.T @ effects @ roots)
    order = np.argsort(sizes)[::-1]
    left = 1.0 - np.cumsum(sizes[order]) / np.sum(sizes)
    count = min(int(np.sum(left > LEFT_OUT)) + 1, MOST_DIRECTIONS)
    # The directions that are left out count as more of the same.
    return np.asarray((roots @ turns[:, order[:count]]).T / math.sqrt(1.0 - left[count - 1]))
