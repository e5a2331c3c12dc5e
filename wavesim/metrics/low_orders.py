"""Low orders of an object: the polynomial of second order by which it is multiplied.

Light and mounting change a complex object by such a factor, and frames do not show it: a ramp of the phase is
the direction of the light, its curvature the distance of a source.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.scene.light_errors import LightErrors, Orders, light_mode, sum_of_modes

ComplexArray = NDArray[np.complexfloating]

CURVATURE_ORDERS: tuple[Orders, ...] = ((2, 0), (1, 1), (0, 2))
PHASE_ORDERS: tuple[Orders, ...] = ((1, 0), (0, 1), *CURVATURE_ORDERS)
"""Ramps and curvatures: orders of Legendre polynomials in x and y."""

ORDER_NAMES = dict(
    zip(PHASE_ORDERS, ("ramp x", "ramp y", "curvature x", "curvature xy", "curvature y"), strict=True)
)
"""Names of the orders of a phase; sizes of ramps are those from the centre of the patch to its edge."""

LOW_ORDERS: tuple[Orders, ...] = ((0, 0), *PHASE_ORDERS)
"""All orders up to the second."""


def low_order_coefficients(values: NDArray, reference: NDArray, weight: NDArray[np.floating]) -> ComplexArray:
    """Return the coefficients of the polynomial p with the least weighted |values - p reference|^2.

    Parameters
    ----------
    values, reference, weight : ndarray, shape (ny, nx)
        Two transmissions, and the weights of their samples.
    """
    columns = np.stack([light_mode(orders, values.shape) * reference for orders in LOW_ORDERS])
    columns = columns.reshape(len(LOW_ORDERS), -1)
    weighted = columns.conj() * weight.ravel()
    return np.linalg.lstsq(weighted @ columns.T, weighted @ values.ravel(), rcond=None)[0]


def low_order_polynomial(coefficients: ComplexArray, shape: tuple[int, ...]) -> ComplexArray:
    """Return the polynomial with some coefficients on the samples of a patch."""
    return np.asarray(sum_of_modes(dict(zip(LOW_ORDERS, coefficients, strict=True)), shape), complex)


def low_order_factor(coefficients: ComplexArray, shape: tuple[int, ...]) -> ComplexArray:
    """Return the exponential of the polynomial with some coefficients on the samples of a patch."""
    return np.exp(low_order_polynomial(coefficients, shape))


def smooth_phase_waves(transmission: Field) -> dict[Orders, float]:
    """Return the modes `PHASE_ORDERS` of the phase in waves.

    They are fitted to phase differences of neighbouring samples, which need no unwrapping.
    """
    values = transmission.values
    modes = np.stack([light_mode(orders, values.shape) for orders in PHASE_ORDERS])
    hessian, gradient = np.zeros((len(PHASE_ORDERS), len(PHASE_ORDERS))), np.zeros(len(PHASE_ORDERS))
    for axis in (0, 1):
        current, following = (np.moveaxis(values, axis, 0)[offset] for offset in (slice(-1), slice(1, None)))
        step = following * current.conj()
        changes: NDArray[np.float64] = np.moveaxis(np.diff(modes, axis=axis + 1), axis + 1, 1)
        changes = changes.reshape(len(PHASE_ORDERS), -1)
        weighted = changes * np.abs(step).ravel()
        hessian += weighted @ changes.T
        gradient += weighted @ np.angle(step).ravel()
    solution = np.linalg.solve(hessian, gradient) / (2.0 * np.pi)
    return dict(zip(PHASE_ORDERS, solution.tolist(), strict=True))


def with_low_orders_of(true: Field, found: Field, inside: NDArray[np.bool_]) -> NDArray[np.complex64]:
    """Return a true transmission, multiplied by the low orders that fit the found one best.

    Parameters
    ----------
    true, found
        Transmissions on the same samples.
    inside
        Samples within the field stop.
    """
    values = np.where(inside, true.values, 0.0).astype(complex)
    ratio = found.with_values(np.where(inside, found.values, 0.0) * values.conj())
    waves = smooth_phase_waves(ratio) if np.any(ratio.values) else {}
    near = LightErrors(phase_waves=waves).on(true.with_values(values)).values
    coefficients = low_order_coefficients(found.values, near, inside.astype(float))
    return (near * low_order_polynomial(coefficients, near.shape)).astype(np.complex64)
