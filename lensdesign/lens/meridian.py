"""The meridian of an optical surface: points, tangents, distances from it and enclosed volume."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.shapes.base import Section
from lensdesign.lens.surface import Surface


@dataclass(frozen=True)
class SurfaceMeridian:
    """Meridian of one optical surface, from its vertex to a radial height.

    The parameter t runs from 0 at the vertex to 1 at `end_mm`. It is proportional to the eccentric angle
    of an ellipse, so that the meridian stays smooth where the tangent of a conic is parallel to the axis.

    Attributes
    ----------
    surface
        The surface.
    vertex_z_mm
        z of the vertex.
    end_mm
        Radial height at which the meridian ends.
    azimuth_rad
        Azimuth of the meridian, from +x towards +y. All meridians of a surface of revolution are equal.
    """

    surface: Surface
    vertex_z_mm: float
    end_mm: float
    azimuth_rad: float = 0.5 * math.pi

    @cached_property
    def section(self) -> Section:
        """Section of the surface at the azimuth."""
        return self.surface.shape.section(self.azimuth_rad)

    @property
    def _scale(self) -> float:
        """Eccentric angle at t = 1, or the radial height where the conic has no edge."""
        edge = self.section.edge_radius_mm
        return math.asin(min(1.0, self.end_mm / edge)) if math.isfinite(edge) else self.end_mm

    def points(self, t: Any) -> Array:
        """Return the radial height and z in mm at parameters t, shape (..., 2)."""
        c, conic = self.section.curvature, self.section.conic
        u = self._scale * np.asarray(t, float)
        edge = self.section.edge_radius_mm
        r, root = (
            (edge * np.sin(u), np.cos(u))
            if math.isfinite(edge)
            else (u, np.sqrt(1.0 - (1.0 + conic) * c * c * u * u))
        )
        z = self.vertex_z_mm + c * r * r / (1.0 + root) + self.section.departure(r)[0]
        return np.stack([r, z], axis=-1)

    def tangents(self, t: Any) -> Array:
        """Return the derivatives of :meth:`points` with respect to t, in mm."""
        c, conic = self.section.curvature, self.section.conic
        u = self._scale * np.asarray(t, float)
        edge = self.section.edge_radius_mm
        if math.isfinite(edge):
            r, dr, dz = edge * np.sin(u), edge * np.cos(u), c * edge * edge * np.sin(u)
        else:
            r, dr, dz = u, np.ones_like(u), c * u / np.sqrt(1.0 - (1.0 + conic) * c * c * u * u)
        dz = dz + dr * self.section.departure(r)[1]
        return self._scale * np.stack([dr, dz], axis=-1)

    def parameters(self, r_mm: Any) -> Array:
        """Return the parameters t at radial heights, clipped to 0 ... 1."""
        r, edge = np.asarray(r_mm, float), self.section.edge_radius_mm
        u = np.arcsin(np.clip(r / edge, 0.0, 1.0)) if math.isfinite(edge) else r
        return np.clip(u / self._scale, 0.0, 1.0)

    def distances(self, points_rz_mm: Array) -> Array:
        """Return the shortest distances in mm of points (radial height, z), shape (n, 2), to the meridian."""
        t = self.parameters(points_rz_mm[:, 0])
        for _ in range(20):
            tangent = self.tangents(t)
            step = np.sum((self.points(t) - points_rz_mm) * tangent, axis=-1) / np.sum(tangent**2, axis=-1)
            previous, t = t, np.clip(t - step, 0.0, 1.0)
            if np.max(np.abs(t - previous), initial=0.0) < 1e-9:
                break
        return np.asarray(np.linalg.norm(self.points(t) - points_rz_mm, axis=-1))

    def integral_mm3(self) -> float:
        """Return the integral of 2 pi r z dr from the axis to `end_mm`."""
        nodes, weights = np.polynomial.legendre.leggauss(16)
        panels = np.linspace(0.0, 1.0, 65)
        half = 0.5 * np.diff(panels)[:, None]
        t = panels[:-1, None] + half * (nodes + 1.0)
        r, z = np.moveaxis(self.points(t), -1, 0)
        dr = self.tangents(t)[..., 0]
        return 2.0 * math.pi * float(np.sum(half * weights * r * z * dr))


def ring_volume_mm3(corners: Array) -> float:
    """Return minus the integral of 2 pi r z dr along a polygon of (radial height, z), shape (n, 2).

    This is the volume that the polygon adds outside the heights of its two ends, measured from z = 0.
    """
    (r0, z0), (r1, z1) = corners[:-1].T, corners[1:].T
    frusta = (r1 - r0) * (z0 * (2.0 * r0 + r1) + z1 * (r0 + 2.0 * r1))
    return -math.pi / 3.0 * float(np.sum(frusta))
