"""Planes perpendicular to the axis that cut a curved surface into slices, and the samples of each slice.

A slice is where the surface lies between two neighbouring planes (Eq. C2), whatever its shape; that of a
surface of revolution is an annulus (Eq. C1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import SamplingError
from wavesim.engines.slices.compensation import CentreRays
from wavesim.engines.surfaces.grids import WorkingGrid
from wavesim.rays.interfaces import surface_map
from wavesim.scene.scene import Scene

Spacing = Literal["equal", "paper", "equal-phase"]

BINS = 512
"""Of height, in which the density of planes is held."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """The samples of a grid at which light meets a surface.

    Attributes
    ----------
    pixels : ndarray of int, shape (n,)
        Which samples, counted through the grid.
    x_mm, y_mm, z_mm : ndarray, shape (n,)
        Points on the surface.
    """

    pixels: NDArray[np.intp]
    x_mm: Array
    y_mm: Array
    z_mm: Array


def surface_points(scene: Scene, working: WorkingGrid, surface: int) -> SurfacePoints:
    """Points on a surface within its clear aperture and within reach of the light.

    Raises
    ------
    SamplingError
        If there are none.
    """
    grid = working.grid
    x, y = np.broadcast_arrays(grid.x_mm, grid.y_mm[:, None])
    found = surface_map(scene.system, surface, x, y)
    away2 = (x - grid.centre_mm[0]) ** 2 + (y - grid.centre_mm[1]) ** 2
    inside = found.inside & (away2 <= working.reach_mm[surface] ** 2)
    if not np.any(inside):
        raise SamplingError(
            f"no sample of the working grid of {grid.pitch_mm:g} mm lies on surface {surface + 1}"
        )
    return SurfacePoints(np.flatnonzero(inside), x[inside], y[inside], found.z_mm[inside])


def cutting_planes(
    scene: Scene,
    rays: Sequence[CentreRays],
    heights_mm: Sequence[tuple[float, float]],
    slices: int,
    spacing: Spacing,
    oblique: bool,
) -> list[Array]:
    """Planes through every surface, increasing, one more than slices; both ends touch the surface.

    Parameters
    ----------
    scene
        What is carried where.
    rays
        Of the middle of the object, at each surface.
    heights_mm
        Lowest and highest point of each surface.
    slices
        Of each surface; unless the spacing is equal, on average.
    spacing
        ``equal``: every surface by itself, evenly. ``paper``: the smaller the radius of curvature, the
        smaller the spacing; here in proportion to the local meridional radius, over all surfaces.
        ``equal-phase``: the compensation errs by the same phase in every slice.
    oblique
        Which compensation errs.
    """
    if spacing == "equal":
        return [np.linspace(low, high, (slices if high > low else 1) + 1) for low, high in heights_mm]
    shares = []
    for i, (ray, span) in enumerate(zip(rays, heights_mm, strict=True)):
        if span[1] == span[0]:
            shares.append(np.zeros(BINS))
            continue
        density = 1.0 / _local_radius_mm(scene, i, ray) if spacing == "paper" else ray.density(oblique)
        shares.append(_binned(ray.z_mm, density, span))
    total = sum(float(share.sum()) for share in shares) or 1.0
    counts = [max(1, round(slices * len(shares) * float(share.sum()) / total)) for share in shares]
    return [
        _planes_of(share, span, count) for share, span, count in zip(shares, heights_mm, counts, strict=True)
    ]


def _local_radius_mm(scene: Scene, surface: int, ray: CentreRays) -> Array:
    """Meridional radius of curvature of the surface itself where the rays cross it; at most 1e9 mm."""
    system = scene.system
    offset = np.stack([ray.x_mm, ray.y_mm, ray.z_mm], axis=-1) - system.vertex[0, surface]
    local = offset @ system.rotation[0, surface]
    x, y = local[:, 0], local[:, 1]
    shape = system.shapes[surface].trial(0)
    _, by_x, by_y = shape.sag_and_slopes(x, y)
    xx, xy, yy = shape.second_derivatives(x, y)
    r = np.hypot(x, y)
    ux, uy = np.where(r > 0.0, x, 0.0), np.where(r > 0.0, y, 1.0)
    ux, uy = (part / np.where(r > 0.0, r, 1.0) for part in (ux, uy))
    bend = np.abs(ux * (xx * ux + xy * uy) + uy * (xy * ux + yy * uy))
    slope = by_x * ux + by_y * uy
    return np.asarray((1.0 + slope**2) ** 1.5 / np.maximum(bend, 1e-9))


def _binned(z_mm: Array, density: Array, span: tuple[float, float]) -> Array:
    """Share of the planes in each bin of height, not normalized: the mean of a density per mm of height."""
    order = np.argsort(z_mm)
    width = (span[1] - span[0]) / BINS
    middles = span[0] + width * (np.arange(BINS) + 0.5)
    return np.asarray(width * np.interp(middles, z_mm[order], density[order]))


def _planes_of(share: Array, span: tuple[float, float], count: int) -> Array:
    if share.sum() == 0.0:
        return np.linspace(*span, count + 1)
    reached = np.concatenate([[0.0], np.cumsum(share)])
    edges = np.linspace(*span, BINS + 1)
    planes = np.interp(np.linspace(0.0, reached[-1], count + 1), reached, edges)
    planes[[0, -1]] = span
    return np.asarray(planes)


@dataclass(frozen=True, eq=False)
class SlicedSurface:
    """Samples of a surface, slice by slice; slices without samples are left out.

    Attributes
    ----------
    pixels : ndarray of int, shape (n,)
        Samples of the grid, by slice.
    factors : ndarray of complex, shape (n,)
        Phase compensation and transmission.
    parts : tuple of slice
        Samples of each slice.
    before_mm, behind_mm : ndarray
        z at which each slice's light is taken from the medium in front, and given to the one behind.
    """

    pixels: NDArray[np.intp]
    factors: NDArray[np.complex128]
    parts: tuple[slice, ...]
    before_mm: Array
    behind_mm: Array


def sliced(
    samples: SurfacePoints,
    factors: NDArray[np.complex128],
    which: NDArray[np.intp],
    before_mm: Array,
    behind_mm: Array,
) -> SlicedSurface:
    """Order samples by slice."""
    order = np.argsort(which, kind="stable")
    ends = np.searchsorted(which[order], np.arange(len(before_mm) + 1))
    full = np.flatnonzero(np.diff(ends))
    parts = tuple(slice(int(a), int(b)) for a, b in pairwise(ends) if b > a)
    return SlicedSurface(samples.pixels[order], factors[order], parts, before_mm[full], behind_mm[full])
