"""The glass bodies of a lens as exact solids of revolution: meridian, edge, closure, volume.

An element is bounded by two optical surfaces, each prolonged with its own sag to the mechanical
semi-diameter of the lens, and by the ground edge cylinder between them. Where a conic ends before that
edge, a flat annulus goes on from its clear semi-diameter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign import surfaces as shapes
from lensdesign.errors import InputError
from lensdesign.system import Lens, Surface, mechanical_semi_diameter_mm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SurfaceMeridian:
    """Meridian of one optical surface, from its vertex to a radial height.

    The parameter t runs from 0 at the vertex to 1 at `end_mm`. It is proportional to the eccentric angle
    of an ellipse, so that the meridian stays smooth where a conic's tangent stands upright.

    Attributes
    ----------
    surface
        The surface.
    vertex_z_mm
        z of its vertex.
    end_mm
        Radial height at which the meridian ends.
    """

    surface: Surface
    vertex_z_mm: float
    end_mm: float

    @property
    def _edge_mm(self) -> float:
        return shapes.edge_radius_mm(self.surface.curvature, self.surface.conic)

    @property
    def _scale(self) -> float:
        """Eccentric angle (or radial height, where the conic has no edge) at t = 1."""
        edge = self._edge_mm
        return math.asin(min(1.0, self.end_mm / edge)) if math.isfinite(edge) else self.end_mm

    def points(self, t: Any) -> Array:
        """Radial height and z in mm at parameters t, shape (..., 2)."""
        c, conic, asphere = self.surface.curvature, self.surface.conic, self.surface.asphere
        u = self._scale * np.asarray(t, float)
        edge = self._edge_mm
        r, root = (
            (edge * np.sin(u), np.cos(u))
            if math.isfinite(edge)
            else (u, np.sqrt(1.0 - (1.0 + conic) * c * c * u * u))
        )
        z = self.vertex_z_mm + c * r * r / (1.0 + root) + shapes.sag(r * r, 0.0, 0.0, asphere)
        return np.stack([r, z], axis=-1)

    def tangents(self, t: Any) -> Array:
        """Derivatives of :meth:`points` with respect to t, in mm."""
        c, conic, asphere = self.surface.curvature, self.surface.conic, self.surface.asphere
        u = self._scale * np.asarray(t, float)
        edge = self._edge_mm
        if math.isfinite(edge):
            r, dr, dz = edge * np.sin(u), edge * np.cos(u), c * edge * edge * np.sin(u)
        else:
            r, dr, dz = u, np.ones_like(u), c * u / np.sqrt(1.0 - (1.0 + conic) * c * c * u * u)
        dz = dz + dr * shapes.sag_slope(r, 0.0, 0.0, asphere)
        return self._scale * np.stack([dr, dz], axis=-1)

    def parameters(self, r_mm: Any) -> Array:
        """Parameters t at radial heights, clipped to 0 ... 1."""
        r, edge = np.asarray(r_mm, float), self._edge_mm
        u = np.arcsin(np.clip(r / edge, 0.0, 1.0)) if math.isfinite(edge) else r
        return np.clip(u / self._scale, 0.0, 1.0)

    def distances(self, points_rz_mm: Array) -> Array:
        """Shortest distances in mm of points (radial height, z), shape (n, 2), to the meridian."""
        t = self.parameters(points_rz_mm[:, 0])
        for _ in range(20):
            tangent = self.tangents(t)
            step = np.sum((self.points(t) - points_rz_mm) * tangent, axis=-1) / np.sum(tangent**2, axis=-1)
            before, t = t, np.clip(t - step, 0.0, 1.0)
            if np.max(np.abs(t - before), initial=0.0) < 1e-9:
                break
        return np.asarray(np.linalg.norm(self.points(t) - points_rz_mm, axis=-1))

    def integral_mm3(self, edge_mm: float) -> float:
        """Integral of 2 pi r z dr from the axis to `edge_mm`, with a flat annulus from `end_mm` on."""
        nodes, weights = np.polynomial.legendre.leggauss(16)
        panels = np.linspace(0.0, 1.0, 65)
        half = 0.5 * np.diff(panels)[:, None]
        t = panels[:-1, None] + half * (nodes + 1.0)
        r, z = np.moveaxis(self.points(t), -1, 0)
        dr = self.tangents(t)[..., 0]
        curved = float(np.sum(half * weights * r * z * dr))
        rim_z = float(self.points(1.0)[1])
        return 2.0 * math.pi * curved + math.pi * rim_z * (edge_mm**2 - self.end_mm**2)


@dataclass(frozen=True)
class Element:
    """One body of glass.

    Attributes
    ----------
    number
        Position among the elements of the lens, from 0.
    surfaces
        Indices of its front and back surface in the lens, from 0.
    front, back
        Meridians of the two surfaces; z from the front vertex of the lens.
    edge_mm
        Radius of the ground edge cylinder.
    """

    number: int
    surfaces: tuple[int, int]
    front: SurfaceMeridian
    back: SurfaceMeridian
    edge_mm: float

    @property
    def name(self) -> str:
        """`element 1 (surfaces 1 and 2)`: people count from one."""
        return f"element {self.number + 1} (surfaces {self.surfaces[0] + 1} and {self.surfaces[1] + 1})"

    @property
    def edge_thickness_mm(self) -> float:
        """Length of the ground edge cylinder."""
        return float(self.back.points(1.0)[1] - self.front.points(1.0)[1])

    @property
    def volume_mm3(self) -> float:
        """Volume by Gauss-Legendre quadrature over the two meridians."""
        return self.back.integral_mm3(self.edge_mm) - self.front.integral_mm3(self.edge_mm)

    def profiles(self, front_t: Array, back_t: Array) -> tuple[Array, Array]:
        """Both surfaces from the axis to the edge, flat annulus included.

        Parameters
        ----------
        front_t, back_t
            Parameters of the two meridians, each from 0 to 1.

        Returns
        -------
        front, back : ndarray, shape (n, 2)
            Radial height (rising, from 0 to `edge_mm`) and z in mm.
        """
        return self._profile(self.front, front_t), self._profile(self.back, back_t)

    def outline(self, points: int = 129) -> Array:
        """Meridian of the body, from the front vertex round the edge to the back vertex.

        Parameters
        ----------
        points
            Number of points on each optical surface.

        Returns
        -------
        ndarray, shape (n, 2)
            Radial height and z in mm.
        """
        t = np.linspace(0.0, 1.0, points)
        front, back = self.profiles(t, t)
        return np.concatenate([front, back[::-1]])

    def _profile(self, meridian: SurfaceMeridian, t: Array) -> Array:
        points = meridian.points(t)
        points[0, 0], points[-1, 0] = 0.0, meridian.end_mm
        if meridian.end_mm < self.edge_mm:
            points = np.concatenate([points, [[self.edge_mm, points[-1, 1]]]])
        return points


def glass_elements(lens: Lens) -> list[Element]:
    """The bodies of glass in a lens, front to back.

    Parameters
    ----------
    lens
        Any lens; a cemented doublet has two elements, which share a surface.

    Returns
    -------
    list of Element

    Raises
    ------
    InputError
        If the lens holds no glass, or an element has no size (neither of its surfaces has a
        semi_diameter_mm).
    """
    index = lens.indices(lens.wavelengths_um[0])
    fronts = [i for i in range(len(lens.surfaces) - 1) if index[i + 1] != 1.0]
    if not fronts:
        raise InputError("the lens holds no glass: no surface but the last is followed by a material")
    return [_element(lens, number, i) for number, i in enumerate(fronts)]


def closed_elements(lens: Lens) -> list[Element]:
    """As :func:`glass_elements`, for those who need solids.

    Raises
    ------
    InputError
        Also if an element does not close: edge thickness of 0 or less, or surfaces that cross.
    """
    elements = glass_elements(lens)
    for element in elements:
        refuse_open(element)
    return elements


def _element(lens: Lens, number: int, i: int) -> Element:
    edge = mechanical_semi_diameter_mm(lens)
    pair = (lens.surfaces[i], lens.surfaces[i + 1])
    if all(s.semi_diameter_mm is None for s in pair):
        raise InputError(
            f"element {number + 1} has no size: give surface {i + 1} or {i + 2} a semi_diameter_mm"
        )
    front, back = (_meridian(lens, j, edge) for j in (i, i + 1))
    return Element(number, (i, i + 1), front, back, edge)


def _meridian(lens: Lens, i: int, edge_mm: float) -> SurfaceMeridian:
    surface = lens.surfaces[i]
    ends = shapes.edge_radius_mm(surface.curvature, surface.conic)
    end = edge_mm if ends >= edge_mm else surface.semi_diameter_mm
    if end is None:
        raise InputError(
            f"surface {i + 1} ends at a radial height of {ends:.6g} mm, inside the mechanical semi-diameter "
            f"of {edge_mm:g} mm; give it a semi_diameter_mm of at most {ends:.6g}"
        )
    return SurfaceMeridian(surface, float(lens.vertex_z_mm[i]), end)


def smallest_gap(front: Array, back: Array) -> tuple[float, float]:
    """Where two polygonal profiles come nearest to each other along z, and how near.

    Parameters
    ----------
    front, back
        Radial height (rising) and z in mm, shape (n, 2).

    Returns
    -------
    r_mm, gap_mm : float
        The gap is negative where they have crossed.
    """
    r = np.union1d(front[:, 0], back[:, 0])
    gap = np.interp(r, *back.T) - np.interp(r, *front.T)
    where = int(np.argmin(gap))
    return float(r[where]), float(gap[where])


def refuse_open(element: Element) -> None:
    """Refuse a body with an edge thickness of 0 or less, or with surfaces that cross.

    Raises
    ------
    InputError
        Saying where.
    """
    t = np.linspace(0.0, 1.0, 1025)
    r, gap = smallest_gap(*element.profiles(t, t))
    thickness = element.edge_thickness_mm
    if thickness > 0.0 and gap > 0.0:
        return
    where = (
        f"its edge thickness is {thickness:.6g} mm"
        if not thickness > 0.0
        else f"its surfaces cross at a radial height of {r:.6g} mm (gap {gap:.6g} mm)"
    )
    raise InputError(
        f"{element.name} does not close: {where}, with the ground edge at the mechanical semi-diameter of "
        f"{element.edge_mm:g} mm; raise thickness_mm or lower semi_diameter_mm"
    )
