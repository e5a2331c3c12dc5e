"""Planes perpendicular to the axis that cut a curved surface into slices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.engines.slices.compensation import CentreRays
from wavesim.scene.scene import Scene

Spacing = Literal["equal", "paper", "equal-phase"]

BINS = 512
"""Of height, in which the density of planes is held."""


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
