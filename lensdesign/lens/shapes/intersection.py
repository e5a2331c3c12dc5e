"""Intersection of rays with a surface in NumPy, real or complex, for few rays and for derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.lens.shapes.base import Shape
from lensdesign.lens.shapes.registry import code_of

Array = NDArray[Any]
SagError = Callable[[Array, Array], tuple[Array, Array, Array]]
"""Function of (x, y) in mm that returns the sag error in mm and its slopes along x and y."""

RIM_TOLERANCE = 1e-9
"""Relative tolerance of clipping: rounding must not clip a ray through the rim of its stop."""

NEWTON_STEPS = 20
"""Largest number of Newton steps from the conic to the surface; rays that need more get a status."""

ROUNDED_STEP = 1e-14
"""Step, over 1 mm plus the distance, that is rounding."""

ROUNDED_RESIDUAL = 1e-13
"""Residual in mm, over 1 mm plus the length of the path, that rounding may leave. Steps of a grazing ray are
longer and never settle, although its point lies on the surface.
"""


def has_settled(step: Array, before: Array, distance: Array) -> Array:
    """Return whether the next step of Newton's method would be rounding, also in compiled code.

    A step is smaller than the one before it by a factor that shrinks, or stays where two roots meet. The next
    step is then at most this one times their ratio. Steps and distance are in mm; the first step has 0 before
    it.
    """
    rounding = ROUNDED_STEP * (1.0 + abs(distance))
    return step * step <= rounding * np.maximum(abs(before), rounding)


def sag_and_slopes(
    shape: Shape, x: Array, y: Array, sag_error: SagError | None
) -> tuple[Array, Array, Array]:
    """Return the sag at (x, y) in mm and its slopes along x and y, including the sag error."""
    nominal = shape.sag_and_slopes(x, y)
    if sag_error is None:
        return nominal
    z, dx, dy = (a + b for a, b in zip(nominal, sag_error(x, y), strict=True))
    return z, dx, dy


def intersect(
    position: Array, direction: Array, shape: Shape, sag_error: SagError | None = None
) -> tuple[Array, Array, Array]:
    """Return the distance along each ray to the surface, in the surface's own frame (vertex at the origin).

    The root for a conic is C / (B + sqrt(B^2 - A C)). It stays exact as the curvature goes to zero, and it is
    the intersection at which a ray crosses from the front to the back. Where B is negative (a ray that starts
    beyond the centre of curvature), the same root is (B - sqrt(B^2 - A C)) / A without cancellation. For
    other shapes, or with a surface figure, Newton's method continues from this point. A ray that could only
    cross from the back to the front misses.

    Parameters
    ----------
    position, direction
        Positions in mm and directions of unit length, shape (n, 3), real or complex (for complex-step
        derivatives).
    shape
        Shape of the surface.
    sag_error
        Sag error that is added to the shape (default: none).

    Returns
    -------
    distance : ndarray, shape (n,)
        Distance in mm; undefined where the ray misses.
    hit : ndarray of bool, shape (n,)
        False where the ray misses the surface.
    converged : ndarray of bool, shape (n,)
        False where Newton's method did not converge.
    """
    shape = shape.traced
    curvature, conic = shape.start(shape.terms)
    x, y, z = np.moveaxis(position, -1, 0)
    dx, dy, dz = np.moveaxis(direction, -1, 0)
    a = curvature * (1.0 + conic * dz * dz)
    b = dz - curvature * (x * dx + y * dy + (1.0 + conic) * z * dz)
    c = curvature * (x * x + y * y + (1.0 + conic) * z * z) - 2.0 * z
    discriminant = b * b - a * c
    hit = np.real(discriminant) >= 0.0
    root = np.sqrt(np.where(hit, discriminant, 1.0))
    stable = np.real(b) >= 0.0
    denominator = np.where(stable, b + root, a)
    hit &= denominator != 0.0
    distance = np.where(stable, c, b - root) / np.where(hit, denominator, 1.0)
    hit &= np.real(1.0 - (1.0 + conic) * curvature * (z + distance * dz)) > 0.0
    if code_of(shape) == 0 and sag_error is None:
        return distance, hit, np.ones_like(hit)
    return _newton(position, direction, distance, hit, shape, sag_error)


def _newton(
    position: Array, direction: Array, distance: Array, hit: Array, shape: Shape, sag_error: SagError | None
) -> tuple[Array, Array, Array]:
    converged = np.zeros_like(hit)
    before = np.zeros(hit.shape)
    for _ in range(NEWTON_STEPS):
        x, y, z = np.moveaxis(position + distance[..., None] * direction, -1, 0)
        height, by_x, by_y = sag_and_slopes(shape, x, y, sag_error)
        residual = z - height
        slope = direction[..., 2] - (by_x * direction[..., 0] + by_y * direction[..., 1])
        hit = hit & np.isfinite(np.real(residual)) & (np.abs(slope) > 1e-12)
        step = np.where(hit, residual, 0.0) / np.where(hit, slope, 1.0)
        distance = distance - step
        settled = has_settled(np.real(step), before, np.real(distance))
        # Derivatives in the imaginary part settle one step later.
        if np.all(converged | ~hit):
            break
        converged, before = converged | hit & settled, np.real(step)
    converged |= hit & (np.abs(np.real(residual)) <= ROUNDED_RESIDUAL * (1.0 + np.abs(np.real(distance))))
    return distance, hit & (~converged | (np.real(slope) > 0.0)), converged
