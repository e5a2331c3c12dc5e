"""Rays as polylines from the object to the last plane, with the fields and colours of pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import mechanical_semi_diameter_mm
from lensdesign.raytrace.bundles import launch, pupil_rings
from lensdesign.raytrace.rays import trace
from lensdesign.raytrace.status import Status

FIELD_FRACTIONS = (0.0, 0.7, 1.0)
"""Object points of the pictures, relative to the half field."""

FIELD_COLORS = ("#D55E00", "#009E73", "#0072B2")
"""Red, green and blue that colour-blind readers can distinguish (Okabe and Ito)."""


def ray_paths(lens: Lens, field_mm: tuple[float, float], pupil_points: ArrayLike) -> Array:
    """Return the corners of rays from an object point through stop points to the last plane.

    The rays have the first wavelength of the lens.

    Parameters
    ----------
    lens
        The nominal lens.
    field_mm
        x and y of the object point.
    pupil_points
        Points on the stop relative to its semi-diameter, shape (n, 2).

    Returns
    -------
    ndarray, shape (n, surfaces + 2, 3)
        Object point, a point on each surface, and one on the plane, in mm. A failed ray ends at its last
        point, or before that at the ground edge of the glass; its last corners coincide.
    """
    wavelength_um = lens.wavelengths_um[0]
    origins, directions = launch(lens, [field_mm], pupil_points, wavelength_um)
    rays = trace(lens, origins, directions, wavelength_um, plane_z_mm=lens.sensor_z_mm[-1], record_hits=True)
    assert rays.hits is not None  # record_hits is set
    paths = np.concatenate([origins[:, None], rays.hits, rays.position[:, None]], axis=1)
    for ray in np.flatnonzero(rays.status == Status.CLIPPED):
        surface = int(rays.failed_surface[ray])
        if surface - 1 in lens.glass_fronts:
            radius = mechanical_semi_diameter_mm(lens, lens.glass_fronts.index(surface - 1))
            paths[ray, surface + 1 :] = _to_edge(paths[ray, surface], paths[ray, surface + 1], radius)
    return paths


def _to_edge(start: Array, end: Array, radius: float) -> Array:
    """Return the intersection of the line from `start` to `end` with the edge cylinder, or `end` inside
    it."""
    step = end - start
    a, b = step[:2] @ step[:2], start[:2] @ step[:2]
    c = start[:2] @ start[:2] - radius**2
    if end[:2] @ end[:2] <= radius**2 or c >= 0.0:
        return end
    fraction = (-b + np.sqrt(b * b - a * c)) / a
    return np.asarray(start + fraction * step)


def sized_lens(lens: Lens) -> Lens:
    """Return a lens in which every surface has a clear semi-diameter: its own, or that of its footprint.

    Parameters
    ----------
    lens
        The nominal lens.

    Returns
    -------
    Lens
        The same lens if no semi-diameter is missing.

    Raises
    ------
    InputError
        If no ray reaches a surface without semi_diameter_mm, so that its size is unknown.
    """
    missing = [i for i, s in enumerate(lens.surfaces) if s.semi_diameter_mm is None]
    if not missing:
        return lens
    pupil = pupil_rings(edge=True).points
    heights = np.linspace(0.0, lens.half_field_mm, 5)
    fields = np.stack([np.zeros_like(heights), heights], axis=-1)
    reached = np.zeros(len(lens.surfaces))
    for wavelength_um in lens.wavelengths_um:
        origins, directions = launch(lens, fields, pupil, wavelength_um)
        rays = trace(lens, origins, directions, wavelength_um, record_hits=True)
        assert rays.hits is not None  # record_hits is set
        hits = rays.hits[rays.ok]
        reached = np.maximum(reached, np.max(np.hypot(hits[..., 0], hits[..., 1]), axis=0, initial=0.0))
    for i in missing:
        if reached[i] == 0.0:
            raise InputError(f"surface {i + 1} has no semi_diameter_mm and no ray reaches it; give it one")
        surface = lens.surfaces[i]
        semi = min(float(reached[i]), surface.shape.edge_radius_mm)
        lens = lens.with_surface(i, semi_diameter_mm=semi)
    return lens
