"""Samples of a refracting surface at the transverse points of a grid, and its transmission."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebval2d, chebvander2d
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError
from lensdesign.raytrace.compiled import CompiledSystem
from wavesim.fields.field import Grid
from wavesim.rays.interfaces import Crossings, crossings, surface_map, transmission
from wavesim.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Samples of a surface at the transverse points of a grid, in order of height; arrays of shape (n,).

    Attributes
    ----------
    pixels : ndarray of int
        Flat indices of the samples in the grid.
    z_mm : ndarray
        Heights, increasing.
    slopes : tuple of ndarray
        dh/dy, and on a plane also dh/dx.
    transmission : ndarray
        Transmission of the field, real if the coatings change no phase.
    rim_z_mm : float
        Height of the sample farthest from the centre of the grid.
    """

    pixels: NDArray[np.int64]
    z_mm: Array
    slopes: tuple[Array, ...]
    transmission: NDArray[np.inexact]
    rim_z_mm: float


def sample_surfaces(scene: Scene, grid: Grid, reach_mm: tuple[float, ...]) -> list[SurfaceSamples]:
    """Sample every surface up to a distance from the centre of the grid.

    Raises
    ------
    SamplingError
        If no sample of the grid lies on a surface.
    """
    rays = crossings(scene, scene.object_grid.centre_mm)
    return [_sample(scene, grid, reach_mm[i], i, crossing) for i, crossing in enumerate(rays)]


def _sample(scene: Scene, grid: Grid, reach_mm: float, surface: int, crossing: Crossings) -> SurfaceSamples:
    x, y = (c.ravel() for c in np.broadcast_arrays(grid.x_mm, grid.y_mm[:, None]))
    away = np.hypot(x - grid.centre_mm[0], y - grid.centre_mm[1])
    near = np.flatnonzero(away <= reach_mm + grid.pitch_mm)
    found = surface_map(scene.system, surface, x[near], y[near])
    lit = rim_weight(np.minimum(found.inwards_mm, reach_mm - away[near]), grid.pitch_mm)
    exists = np.isfinite(found.z_mm) & (lit > 0.0)
    pixels, z, lit, away = near[exists], found.z_mm[exists], lit[exists], away[near[exists]]
    if not len(pixels):
        raise SamplingError(
            f"no sample of the working grid of {grid.pitch_mm:g} mm lies on surface {surface}"
        )
    rim = float(z[np.argmax(away)])
    order = np.argsort(z, kind="stable")
    pixels, z, lit = pixels[order], z[order], lit[order]
    x, y = x[pixels], y[pixels]
    slopes = surface_slopes(scene.system, surface, x, y, z)
    passed = lit * transmission_at(scene, surface, crossing, x, y)
    return SurfaceSamples(pixels, z, slopes[:1] if grid.is_line else slopes, passed, rim)


def rim_weight(inwards_mm: Array, pitch_mm: float) -> Array:
    """Return the weights of samples next to a rim, such that sums over samples integrate up to the rim.

    They are exact for functions that are linear between samples, and keep the position of the rim.
    """
    depth = np.clip(inwards_mm / pitch_mm, -1.0, 1.0)
    return np.asarray(np.where(depth < 0.0, 0.5 * (1.0 + depth) ** 2, 1.0 - 0.5 * (1.0 - depth) ** 2))


def surface_slopes(
    system: CompiledSystem, surface: int, x_mm: Array, y_mm: Array, z_mm: Array
) -> tuple[Array, Array]:
    """Return dh/dy and dh/dx of a surface, with its tilt and decenter, at points on it."""
    rotation = system.rotation[0, surface]
    offset = np.stack(np.broadcast_arrays(x_mm, y_mm, z_mm), axis=-1) - system.vertex[0, surface]
    local = offset @ rotation
    _, by_x, by_y = system.sag_and_slopes(surface, local[..., 0], local[..., 1])
    fixed = np.stack([-by_x, -by_y, np.ones_like(by_x)], axis=-1) @ rotation.T
    return -fixed[..., 1] / fixed[..., 2], -fixed[..., 0] / fixed[..., 2]


def transmission_at(
    scene: Scene, surface: int, crossing: Crossings, x: Array, y: Array
) -> NDArray[np.inexact]:
    """Return the field's transmission for rays of the object's centre; beyond them the nearest value."""
    known = transmission(scene, surface, crossing.incidence, crossing.refraction)
    if not np.iscomplexobj(known):
        return _interpolated(scene, crossing, np.asarray(known, float), x, y)
    middle = np.exp(-1j * np.angle(np.mean(known)))  # keeps the phase away from pi
    size, phase = (
        _interpolated(scene, crossing, part, x, y) for part in (np.abs(known), np.angle(known * middle))
    )
    return np.asarray(size * np.exp(1j * phase) / middle)


def _interpolated(scene: Scene, crossing: Crossings, known: Array, x: Array, y: Array) -> Array:
    """Return values at rays of the object's centre at other points; beyond the rays the nearest value."""
    if scene.object_grid.is_line:
        order = np.argsort(crossing.y_mm)
        return np.interp(y, crossing.y_mm[order], known[order])
    middle = np.array([np.mean(crossing.x_mm), np.mean(crossing.y_mm)])
    radius = float(np.max(np.hypot(crossing.x_mm - middle[0], crossing.y_mm - middle[1])))
    u, v = (crossing.x_mm - middle[0]) / radius, (crossing.y_mm - middle[1]) / radius
    # Degree of the polynomials in x and y for a surface's transmission.
    degree = 10
    powers = np.add.outer(np.arange(degree + 1), np.arange(degree + 1))
    basis = chebvander2d(u, v, (degree, degree))[:, powers.ravel() <= degree]
    # Normal equations without BLAS, whose threads would wait for each other longer than this takes.
    square = np.einsum("ni,nj->ij", basis, basis)
    square[np.diag_indices_from(square)] += 1e-12 * len(known)
    terms = np.zeros(powers.shape)
    terms[powers <= degree] = np.linalg.solve(square, np.einsum("ni,n->i", basis, known))
    result = np.empty(len(x))
    # Points at which the polynomials are evaluated at a time.
    block = 1 << 15
    for start in range(0, len(x), block):
        part = slice(start, start + block)
        u, v = (x[part] - middle[0]) / radius, (y[part] - middle[1]) / radius
        beyond = np.maximum(np.hypot(u, v), 1.0)
        result[part] = chebval2d(u / beyond, v / beyond, terms)
    return np.clip(result, np.min(known), np.max(known))


def other_transmission(scene: Scene) -> float:
    """Return the largest relative error of using the transmission of light from the object's centre."""
    grid = scene.object_grid
    (x, y), half = grid.centre_mm, (0.0, *grid.half_widths_mm[::-1])[-2:]
    middle, worst = crossings(scene, (x, y)), 0.0
    for side in (-1.0, 1.0):
        try:
            other = crossings(scene, (x + side * half[0], y + side * half[1]))
        except InputError:
            continue
        total = 0.0
        for i, (known, new) in enumerate(zip(middle, other, strict=True)):
            actual = transmission(scene, i, new.incidence, new.refraction)
            assumed = transmission_at(scene, i, known, new.x_mm, new.y_mm)
            total += float(np.mean(np.abs(assumed / actual - 1.0) ** 2))
        worst = max(worst, math.sqrt(total))
    return worst
