"""What the uncertainty of a calibrated bench leaves open in its object.

The object follows an error of the bench, so that the frames stay as they are. The covariance of the estimates
is :math:`C = V V^T`, with one column of V for each independent direction. The object then has the independent
changes :math:`x_k`, of one standard deviation each, where :math:`x_k` follows the change :math:`v_k` of the
bench (:mod:`wavesim.reconstruction.object_response`). A complex or phase object also takes over all errors of
the light that were not sought; they have the standard deviations that are expected.

Ramp and curvature of an object's phase are exchanged with light and mounting, and those of its amplitude
with the unevenness of the light. The phase may be whole waves, so that these low orders are a factor of the
object, :math:`\\exp(a + i \\phi)`, and not a small change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.calibration.joint.gauss_newton_step import GaussNewtonStep
from wavesim.fields.field import Field
from wavesim.metrics.contrast import object_correlation
from wavesim.metrics.goodness_of_fit import BenchUncertainty
from wavesim.metrics.low_orders import (
    LOW_ORDERS,
    ORDER_NAMES,
    PHASE_ORDERS,
    low_order_coefficients,
    low_order_factor,
    low_order_polynomial,
)
from wavesim.reconstruction.object_response import following_change

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
    """

    light: Field
    transmission: ComplexArray
    changes: ComplexArray
    exponents: ComplexArray

    @cached_property
    def summary(self) -> BenchUncertainty:
        """Correlations that these errors leave, and the low orders of phase and amplitude."""
        with_all = self.least_correlation()
        without = self.least_correlation(low_orders=False) if np.any(self.exponents) else with_all
        waves = _deviations(self.exponents.imag / (2.0 * np.pi))
        return BenchUncertainty(with_all, without, waves, _deviations(self.exponents.real))

    def least_correlation(self, *, low_orders: bool = True) -> float:
        """Return the correlation with the true object that 99 % of all such errors reach.

        The bound then holds in 95 % of all cases together with that of the noise, which holds in 95 %, too.

        Parameters
        ----------
        low_orders
            Whether errors of low orders count; False: after their removal.
        """
        random, draws, missed = np.random.default_rng(0), 300, 0.01
        values = self.transmission
        lit = self.light.with_values(self.light.values * values)
        found = []
        for _ in range(draws):
            sizes = random.standard_normal(len(self.changes)).astype(np.float32)
            other = values + np.tensordot(sizes, self.changes, 1)
            if low_orders and np.any(self.exponents):
                other = other * low_order_factor(sizes @ self.exponents, values.shape)
            found.append(
                object_correlation(self.light.with_values(self.light.values * other), lit, self.light)
            )
        return float(np.nanquantile(found, missed)) if np.isfinite(found).any() else 1.0


def _deviations(orders: NDArray[np.floating]) -> Mapping[str, float]:
    """Return the standard deviation of each low order by name; empty where all are 0."""
    deviations = np.sqrt(np.sum(orders**2, axis=0))
    by_orders = dict(zip(LOW_ORDERS, deviations.tolist(), strict=True))
    return {ORDER_NAMES[one]: by_orders[one] for one in PHASE_ORDERS} if np.any(deviations) else {}


def object_uncertainty(
    equations: GaussNewtonStep,
    covariance: Array,
    absorbed: Sequence[ComplexArray] = (),
    progress: Callable[[int, int], None] = lambda completed, total: None,
) -> ObjectUncertainty:
    """Return the errors of the object about which normal equations were made.

    Parameters
    ----------
    equations
        Normal equations at the estimates.
    covariance : ndarray, shape (n, n)
        Covariance of the estimates.
    absorbed : sequence of ndarray, shape (ny, nx)
        Relative changes of the light of one standard deviation each, which the object takes over exactly.
    progress
        Callback `progress(completed, total)` of the directions.
    """
    linear, values = equations.linear, equations.transmission
    light = linear.model.illumination
    directions = _directions(equations, covariance)
    changes = []
    for index, direction in enumerate(directions):
        progress(index, len(directions))
        column = (direction.astype(equations.columns.dtype) @ equations.columns).reshape(
            linear.residual.shape
        )
        change, _ = following_change(linear, column, equations.free_samples, equations.kind, values)
        for parameter, compensation in equations.compensations.items():
            change = change + np.float32(direction[parameter]) * compensation
        changes.append(change)
    exponents = np.zeros((len(changes), len(LOW_ORDERS)), complex)
    power, even = np.abs(light.values) ** 2, np.ones(values.shape)
    for index, change in enumerate(changes):
        exponents[index] = low_order_coefficients(change, values, power)
        low_orders = low_order_polynomial(exponents[index], values.shape) * values
        changes[index] = change - (low_orders if np.iscomplexobj(values) else low_orders.real).astype(
            change.dtype
        )
    if equations.kind != "amplitude":
        of_light = [low_order_coefficients(-change, even, power) for change in absorbed]
        exponents = np.vstack([exponents, *of_light])
        changes += [np.zeros_like(values) for _ in absorbed]
    if equations.kind == "phase":
        exponents.real = 0.0
    return ObjectUncertainty(light, values, np.stack(changes), exponents)


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
    sizes, turns = np.linalg.eigh(roots.T @ effects @ roots)
    order = np.argsort(sizes)[::-1]
    left = 1.0 - np.cumsum(sizes[order]) / np.sum(sizes)
    count = min(int(np.sum(left > LEFT_OUT)) + 1, MOST_DIRECTIONS)
    # The directions that are left out count as more of the same.
    return np.asarray((roots @ turns[:, order[:count]]).T / math.sqrt(1.0 - left[count - 1]))
