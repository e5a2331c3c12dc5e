"""Planes perpendicular to the axis that cut a curved surface into slices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.engines.slices.compensation import CentreRays, Compensation
from wavesim.scene.scene import Scene

Spacing = Literal["equal", "paper", "equal-phase"]

BINS = 512
"""Bins of height for the density of planes."""


def cutting_planes(
    scene: Scene,
    compensations: Sequence[Compensation],
    heights_mm: Sequence[tuple[float, float]],
    slices: int,
    spacing: Spacing,
) -> list[Array]:
    """Return the cutting planes of every surface, increasing, one more than slices; both ends touch the
    surface.

    Parameters
    ----------
    scene
        Lens, grids and wavelength.
    compensations
        Compensation at each surface; only for a spacing that is not equal.
    heights_mm
        Lowest and highest point of each surface.
    slices
        Number of slices of each surface; the average over the surfaces unless the spacing is equal.
    spacing
        ``equal``: evenly spaced on every surface. ``paper``: spacing in proportion to the local meridional
        radius of curvature, over all surfaces. ``equal-phase``: equal phase errors of the compensation in all
        slices.
    """
    if spacing == "equal":
        return [np.linspace(low, high, (slices if high > low else 1) + 1) for low, high in heights_mm]
    weights = []
    for i, (compensation, span) in enumerate(zip(compensations, heights_mm, strict=True)):
        if span[1] == span[0]:
            weights.append(np.zeros(BINS))
            continue
        ray = compensation.ray
        density = 1.0 / _local_radius_mm(scene, i, ray) if spacing == "paper" else compensation.density
        weights.append(_binned(ray.z_mm, density, span))
    total = sum(float(weight.sum()) for weight in weights) or 1.0
    counts = [max(1, round(slices * len(weights) * float(weight.sum()) / total)) for weight in weights]
    return [
        _planes_of(weight, span, count)
        for weight, span, count in zip(weights, heights_mm, counts, strict=True)
    ]


def _local_radius_mm(scene: Scene, surface: int, ray: CentreRays) -> Array:
    """Return the surface's meridional radius of curvature at the crossings of the rays, 1e9 mm at most."""
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
    """Return the relative number of planes in each bin of height, by the mean of their density."""
    order = np.argsort(z_mm)
    width = (span[1] - span[0]) / BINS
    middles = span[0] + width * (np.arange(BINS) + 0.5)
    return np.asarray(width * np.interp(middles, z_mm[order], density[order]))


def _planes_of(weight: Array, span: tuple[float, float], count: int) -> Array:
    if weight.sum() == 0.0:
        return np.linspace(*span, count + 1)
    reached = np.concatenate([[0.0], np.cumsum(weight)])
    edges = np.linspace(*span, BINS + 1)
    planes = np.interp(np.linspace(0.0, reached[-1], count + 1), reached, edges)
    planes[[0, -1]] = span
    return np.asarray(planes)
