"""Exact rays in the meridional plane, for the conversion between a system aperture and the stop's height."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lensdesign.lens.shapes.base import Shape
from lensdesign.lens.shapes.intersection import intersect


@dataclass(frozen=True)
class MeridionalRay:
    """A traced ray in the meridional plane.

    Attributes
    ----------
    heights_mm
        Heights at the surfaces in mm.
    y_mm, z_mm
        Point on the last surface that was traced; z is measured from the first vertex.
    slope
        Slope dy/dz behind that surface.
    """

    heights_mm: tuple[float, ...]
    y_mm: float
    z_mm: float
    slope: float

    def height_at(self, z_mm: float) -> float:
        """Return the height of the ray behind the last surface at a position along the axis."""
        return self.y_mm + (z_mm - self.z_mm) * self.slope


@dataclass(frozen=True)
class MeridionalSystem:
    """A centered sequence of surfaces.

    Attributes
    ----------
    shapes
        Shapes of the surfaces.
    distances_mm
        Distance from each surface to the next in mm; an entry for the last surface is ignored.
    indices
        Refractive indices before the first surface and behind each surface.
    """

    shapes: tuple[Shape, ...]
    distances_mm: tuple[float, ...]
    indices: tuple[float, ...]

    def trace(
        self, y_mm: float, z_mm: float, sine: float, surfaces: int | None = None
    ) -> MeridionalRay | None:
        """Trace a ray through the surfaces by Snell's law.

        Parameters
        ----------
        y_mm, z_mm
            A point of the ray in front of the lens in mm; z is measured from the first vertex.
        sine
            Sine of the angle between the ray and the axis.
        surfaces
            Number of surfaces to trace through (default: all).

        Returns
        -------
        MeridionalRay or None
            The ray; None if it misses a surface or is totally reflected.
        """
        count = len(self.shapes) if surfaces is None else surfaces
        position = np.array([[0.0, y_mm, z_mm]])
        direction = np.array([[0.0, sine, math.sqrt(max(0.0, 1.0 - sine * sine))]])
        heights: list[float] = []
        vertex = 0.0
        with np.errstate(all="ignore"):
            for i, shape in enumerate(self.shapes[:count]):
                local = position - np.array([0.0, 0.0, vertex])
                distance, hit, converged = intersect(local, direction, shape)
                if not (hit[0] and converged[0] and math.isfinite(distance[0])):
                    return None
                local = local + distance[0] * direction
                heights.append(float(local[0, 1]))
                _, by_x, by_y = shape.sag_and_slopes(local[:, 0], local[:, 1])
                refracted = _refracted(
                    direction[0], np.array([-by_x[0], -by_y[0], 1.0]), self.indices[i], self.indices[i + 1]
                )
                if refracted is None:
                    return None
                direction, position = refracted[None], local + np.array([0.0, 0.0, vertex])
                if i + 1 < count:
                    vertex += self.distances_mm[i]
        y, z, slope = float(position[0, 1]), float(position[0, 2]), float(direction[0, 1] / direction[0, 2])
        return MeridionalRay(tuple(heights), y, z, slope) if math.isfinite(slope) else None

    def height_at_stop(self, object_distance_mm: float, sine: float, stop: int) -> float | None:
        """Return the height at the stop of a ray from the axial object point; None if it does not arrive."""
        ray = self.trace(0.0, -object_distance_mm, sine, stop + 1)
        return None if ray is None else abs(ray.heights_mm[stop])

    def sine_through_stop(self, object_distance_mm: float, height_mm: float, stop: int) -> float | None:
        """Return the sine of the ray from the axial object point that meets the stop at a height, or None.

        Bisection finds the smallest such sine: heights increase with the sine until rays miss a surface.
        """
        low, high = 0.0, 1.0
        for _ in range(80):  # 1e-15 is reached after 50 steps
            middle = 0.5 * (low + high)
            height = self.height_at_stop(object_distance_mm, middle, stop)
            if height is not None and height < height_mm:
                low = middle
            else:
                high = middle
            if high - low <= 1e-15:
                break
        sine = 0.5 * (low + high)
        height = self.height_at_stop(object_distance_mm, low, stop)
        if height is None or abs(height - height_mm) > 1e-6 * height_mm:
            return None
        return sine


def _refracted(direction: np.ndarray, normal: np.ndarray, n1: float, n2: float) -> np.ndarray | None:
    """Return the refracted direction by Snell's law in vector form; None for total reflection."""
    normal = normal / math.sqrt(float(normal @ normal))
    ratio = n1 / n2
    cosine = float(direction @ normal)
    inside = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    if not inside >= 0.0 or cosine <= 0.0:
        return None
    bent: np.ndarray = ratio * direction + (math.sqrt(inside) - ratio * cosine) * normal
    return bent
