"""Rays as polylines from the object to the last plane, with the fields and colours of pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import mechanical_semi_diameter_mm
from lensdesign.raytrace.bundles import launch, pupil_rings
from lensdesign.raytrace.rays import RayTrace, trace
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
    ndarray, shape (n, surfaces + 2, 3), or (n, surfaces + 4, 3) with a cover glass
        Object point, a point on each surface, one on each face of the sensor's cover glass, and one on the
        plane, in mm. A failed ray ends at its last point, or before that at the ground edge of the glass; its
        last corners coincide.
    """
    wavelength_um = lens.wavelengths_um[0]
    origins, directions = launch(lens, [field_mm], pupil_points, wavelength_um)
    rays = trace(lens, origins, directions, wavelength_um, plane_z_mm=lens.sensor_z_mm[-1], record_hits=True)
    assert rays.hits is not None  # record_hits is set
    ends = np.concatenate([*_on_cover_glass(lens, rays), rays.position[:, None]], axis=1)
    paths = np.concatenate([origins[:, None], rays.hits, ends], axis=1)
    for ray in np.flatnonzero(rays.status == Status.CLIPPED):
        surface = int(rays.failed_surface[ray])
        if surface - 1 in lens.glass_fronts:
            radius = mechanical_semi_diameter_mm(lens, lens.glass_fronts.index(surface - 1))
            paths[ray, surface + 1 :] = _to_edge(paths[ray, surface], paths[ray, surface + 1], radius)
    return paths


def _on_cover_glass(lens: Lens, rays: RayTrace) -> tuple[Array, ...]:
    """Return where rays to the last plane meet the front and the rear of its cover glass, if it has one."""
    glass = lens.sensor.cover_glass
    if glass is None:
        return ()
    direction = np.where(rays.ok[:, None], rays.direction, [0.0, 0.0, 1.0])
    slopes = direction[:, :2] / direction[:, 2:]
    rear, front = rays.position.copy(), rays.position.copy()
    index = lens.cover_glass_index(lens.wavelengths_um[0])
    inside = direction[:, :2] / np.sqrt(index**2 - np.sum(direction[:, :2] ** 2, axis=1, keepdims=True))
    rear[:, :2] -= glass.distance_mm * slopes
    front[:, :2] = rear[:, :2] - glass.thickness_mm * inside
    rear[:, 2] -= glass.distance_mm
    front[:, 2] -= glass.depth_mm
    arrived = rays.ok[:, None]
    return tuple(np.where(arrived, face, rays.position)[:, None] for face in (front, rear))


def _to_edge(start: Array, end: Array, radius: float) -> Array:
    """Return where the line from `start` to `end` meets the edge cylinder; `end` if it lies inside."""
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
