"""Rotationally symmetric surfaces: plane, sphere, conic, even asphere; and any of them with a figure.

One formula covers all four (ISO 10110-12)::

    z(r) = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)) + a4 r^4 + a6 r^6 + ...

with curvature c = 1/radius (0 for a plane), conic constant k, and asphere terms from r^4 on. All
functions take arrays, work for real and complex input, and give NaN (real input) beyond the edge. Where a
figure is taken, it adds to this; it is a function of x and y in mm that gives the sag error and its slopes
along x and y.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
Figure = Callable[[Array, Array], tuple[Array, Array, Array]]


def surface_kind(curvature: float, conic: float, asphere: Sequence[float]) -> str:
    """Name of the simplest shape that holds these values: plane, sphere, conic or even asphere."""
    if any(asphere):
        return "even asphere"
    if curvature == 0.0:
        return "plane"
    return "sphere" if conic == 0.0 else "conic"


def edge_radius_mm(curvature: float, conic: float) -> float:
    """Radial height in mm where the conic ends (its tangent stands upright); inf if it never does."""
    shape = (1.0 + conic) * curvature * curvature
    return 1.0 / math.sqrt(shape) if shape > 0.0 else math.inf


def sag(r2: ArrayLike, curvature: Any, conic: Any, asphere: Sequence[Any] = ()) -> Array:
    """Sag at squared radial height.

    Parameters
    ----------
    r2
        Squared radial height in mm^2.
    curvature, conic, asphere
        1/mm; conic constant; coefficients of r^4, r^6, ... in mm^-3, mm^-5, ...

    Returns
    -------
    ndarray
        Sag in mm; NaN beyond the conic's edge.
    """
    r2 = np.asarray(r2)
    with np.errstate(invalid="ignore"):
        result = curvature * r2 / (1.0 + np.sqrt(1.0 - (1.0 + conic) * curvature**2 * r2))
    power = r2 * r2
    for coefficient in asphere:
        result = result + coefficient * power
        power = power * r2
    return np.asarray(result)


def sag_gradient(r2: ArrayLike, curvature: Any, conic: Any, asphere: Sequence[Any] = ()) -> Array:
    """Derivative of the sag with respect to r^2 (so that dz/dr = 2 r times this), in 1/mm."""
    r2 = np.asarray(r2)
    with np.errstate(invalid="ignore", divide="ignore"):
        result = 0.5 * curvature / np.sqrt(1.0 - (1.0 + conic) * curvature**2 * r2)
    power = r2
    for order, coefficient in enumerate(asphere, start=2):
        result = result + order * coefficient * power
        power = power * r2
    return np.asarray(result)


def sag_slope(r: ArrayLike, curvature: Any, conic: Any, asphere: Sequence[Any] = ()) -> Array:
    """Slope dz/dr at radial height r in mm (dimensionless)."""
    r = np.asarray(r)
    return np.asarray(2.0 * r * sag_gradient(r * r, curvature, conic, asphere))


def sag_and_slopes(
    x: Array,
    y: Array,
    curvature: Any,
    conic: Any,
    asphere: Sequence[Any] = (),
    figure: Figure | None = None,
) -> tuple[Array, Array, Array]:
    """Sag above (x, y) in mm, and its slopes along x and y."""
    r2 = x * x + y * y
    gradient = 2.0 * sag_gradient(r2, curvature, conic, asphere)
    nominal = sag(r2, curvature, conic, asphere), gradient * x, gradient * y
    if figure is None:
        return nominal
    z, dx, dy = (a + b for a, b in zip(nominal, figure(x, y), strict=True))
    return z, dx, dy


def normal(
    x: Array,
    y: Array,
    curvature: Any,
    conic: Any,
    asphere: Sequence[Any] = (),
    figure: Figure | None = None,
) -> Array:
    """Unit normal, pointing along +z, at the surface point above (x, y); shape (..., 3)."""
    _, dx, dy = sag_and_slopes(x, y, curvature, conic, asphere, figure)
    vector = np.stack([-dx, -dy, np.ones_like(dx)], axis=-1)
    return np.asarray(vector / np.sqrt(np.sum(vector * vector, axis=-1, keepdims=True)))


def intersect(
    position: Array,
    direction: Array,
    curvature: Any,
    conic: Any,
    asphere: Sequence[Any] = (),
    figure: Figure | None = None,
) -> tuple[Array, Array, Array]:
    """Distance along each ray to the surface, in the surface's own frame (vertex at the origin).

    The conic's root is C / (B + sqrt(B^2 - A C)), which stays exact as the curvature goes to zero and
    picks the hit at which a ray crosses from the front to the back; where B is negative (a ray that
    starts beyond the centre of curvature) the same root is had without cancellation as
    (B - sqrt(B^2 - A C)) / A. An even asphere, or a surface with a figure, goes on from there by Newton's
    method. A ray that could only cross from the back to the front misses.

    Parameters
    ----------
    position, direction
        Shape (n, 3); directions of unit length. Real or complex (for complex-step derivatives).

    Returns
    -------
    distance : ndarray, shape (n,)
        In mm; meaningless where the ray misses.
    hit : ndarray of bool, shape (n,)
        False where the ray misses the surface.
    converged : ndarray of bool, shape (n,)
        False where Newton's method did not settle.
    """
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
    converged = np.ones_like(hit)
    if len(asphere) or figure is not None:
        distance, hit, converged = _newton(
            position, direction, distance, hit, (curvature, conic, asphere, figure), tolerance_mm=1e-14
        )
    return distance, hit, converged


def _newton(
    position: Array, direction: Array, distance: Array, hit: Array, shape: Any, tolerance_mm: float
) -> tuple[Array, Array, Array]:
    converged = np.zeros_like(hit)
    for _ in range(NEWTON_STEPS):
        x, y, z = np.moveaxis(position + distance[..., None] * direction, -1, 0)
        height, by_x, by_y = sag_and_slopes(x, y, *shape)
        residual = z - height
        slope = direction[..., 2] - (by_x * direction[..., 0] + by_y * direction[..., 1])
        hit = hit & np.isfinite(np.real(residual)) & (np.abs(slope) > 1e-12)
        step = np.where(hit, residual, 0.0) / np.where(hit, slope, 1.0)
        distance = distance - step
        scale = 1.0 + np.abs(np.real(distance))
        settled = np.abs(np.real(step)) <= tolerance_mm * scale
        if np.all(settled & converged | ~hit):
            break
        converged = settled
    return distance, hit & (~converged | (np.real(slope) > 0.0)), converged


RIM_TOLERANCE = 1e-9
"""Relative; a ray launched through the very rim of its stop must not be lost to rounding."""

NEWTON_STEPS = 20
"""Most steps that a ray may take to a surface from its conic; rays that need more are reported."""
