"""Coordinates of the pictures of a lens: its section with rays, and the spots on the sensor planes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import glass_elements
from lensdesign.raytrace.bundles import launch, pupil_fan, pupil_hexapolar
from lensdesign.raytrace.paths import FIELD_FRACTIONS, ray_paths, sized_lens
from lensdesign.raytrace.rays import trace


@dataclass(frozen=True, eq=False)
class Layout:
    """Meridional section of a lens; z and y in mm.

    Attributes
    ----------
    glass
        Outline of each element, shape (n, 2).
    surfaces
        Section of each surface, shape (n, 2).
    rays
        Corners of the rays of each field, shape (rays, corners, 2).
    spots
        x and y of the rays' points for each sensor plane and field, shape (n, 2).
    """

    glass: tuple[Array, ...]
    surfaces: tuple[Array, ...]
    rays: tuple[Array, ...]
    spots: tuple[tuple[Array, ...], ...]


def field_heights_mm(lens: Lens) -> tuple[float, ...]:
    """Return the heights of the three field points in mm."""
    return tuple(fraction * lens.half_field_mm for fraction in FIELD_FRACTIONS)


def layout_of(lens: Lens) -> Layout:
    """Return the layout of a lens with rays of three fields.

    Raises
    ------
    InputError
        If a surface's size is neither given nor can be determined from rays.
    """
    lens = sized_lens(lens)
    heights = field_heights_mm(lens)
    fan = pupil_fan(11).points
    rays = tuple(ray_paths(lens, (0.0, h), fan)[..., [2, 1]] for h in heights)
    outlines = [element.outline()[:, ::-1] for element in glass_elements(lens)]
    glass = tuple(np.concatenate([upper, upper[::-1] * [1.0, -1.0]]) for upper in outlines)
    return Layout(glass, _sections(lens), rays, _spots(lens, heights))


def _sections(lens: Lens) -> tuple[Array, ...]:
    found = []
    for surface, z in zip(lens.surfaces, lens.vertex_z_mm.tolist(), strict=True):
        y = np.linspace(-1.0, 1.0, 41) * (surface.semi_diameter_mm or 0.0)
        found.append(np.column_stack([z + surface.sag_mm(np.abs(y)), y]))
    return tuple(found)


def _spots(lens: Lens, heights: tuple[float, ...]) -> tuple[tuple[Array, ...], ...]:
    points = pupil_hexapolar(7).points
    by_field = []
    for height in heights:
        origins, directions = launch(lens, [(0.0, height)], points, lens.wavelengths_um[0])
        rays = trace(lens, origins, directions, lens.wavelengths_um[0], plane_z_mm=lens.sensor_z_mm[0])
        own = []
        for z in lens.sensor_z_mm:
            distance = (z - rays.position[:, 2:]) / rays.direction[:, 2:]
            own.append((rays.position + distance * rays.direction)[rays.ok, :2])
        by_field.append(own)
    return tuple(tuple(own[k] for own in by_field) for k in range(len(lens.sensor_z_mm)))
