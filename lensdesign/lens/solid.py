"""The glass bodies of a lens as exact solids: meridian, edge, closure and volume.

An element is bounded by two optical surfaces, each extended with its own sag, and by its edge: a cylinder, or
the frustum of a cone if it has a draft, with flat rings, bevels at 45 degrees and a flange where the design
has them. A surface whose conic ends inside that edge continues as a flat ring from its clear semi-diameter.
If the body is not rotationally symmetric, flat rings and bevels follow the rim of their surface. The flat of
a gate is not part of the solid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.edges import Edge
from lensdesign.lens.glass import is_gap
from lensdesign.lens.meridian import SurfaceMeridian, ring_volume_mm3
from lensdesign.lens.shapes.base import azimuths_rad
from lensdesign.lens.surface import Surface, vertex_z_mm

SHARP = Edge()
"""An edge without flats, bevels and flange."""


class Surfaces(Protocol):
    """The attributes of a lens that define its glass bodies."""

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Surfaces, front to back."""

    @property
    def edges(self) -> tuple[Edge, ...]:
        """An edge for each glass element, or none."""


@dataclass(frozen=True)
class Element:
    """A body of glass.

    Attributes
    ----------
    index
        Index among the elements of the lens, from 0.
    surfaces
        Indices of its front and back surface in the lens, from 0.
    front, back
        Meridians of the two surfaces, at one azimuth; z is measured from the front vertex of the lens.
    edge_mm
        Radius of the edge cylinder, or of the wide end of an edge with draft.
    edge
        Draft, flats, bevels, flange and gate.
    draft_mm
        Amounts by which the radius of the edge is smaller than `edge_mm` at the front and at the back; both 0
        without draft.
    """

    index: int
    surfaces: tuple[int, int]
    front: SurfaceMeridian
    back: SurfaceMeridian
    edge_mm: float
    edge: Edge = SHARP
    draft_mm: tuple[float, float] = (0.0, 0.0)

    @property
    def edge_radii_mm(self) -> tuple[float, float]:
        """Radius of the edge at its front and at its back end; equal without draft."""
        return self.edge_mm - self.draft_mm[0], self.edge_mm - self.draft_mm[1]

    @property
    def name(self) -> str:
        """Name with numbers from 1, such as `element 1 (surfaces 1 and 2)`."""
        return f"element {self.index + 1} (surfaces {self.surfaces[0] + 1} and {self.surfaces[1] + 1})"

    @property
    def rotational(self) -> bool:
        """True if the body is rotationally symmetric."""
        return all(m.surface.shape.ROTATIONAL for m in (self.front, self.back))

    @property
    def sections(self) -> tuple[Element, ...]:
        """Half sections of the body by azimuth; a single one if the body is rotationally symmetric."""
        return tuple(
            replace(
                self,
                front=replace(self.front, azimuth_rad=float(azimuth)),
                back=replace(self.back, azimuth_rad=float(azimuth)),
            )
            for azimuth in azimuths_rad(self.front.surface.shape, self.back.surface.shape)
        )

    @property
    def ends(self) -> tuple[Array, Array]:
        """Corners of flat ring and bevel of front and back, shape (n, 2) each with n from 0 to 2.

        They lead from the rim of each surface to the edge cylinder, without the rim itself. The columns are
        the radial height, and z relative to the rim.
        """
        front, back = (
            self._end(m, bevel, radius)
            for m, (_, bevel), radius in zip(
                (self.front, self.back), self.edge.sides(), self.edge_radii_mm, strict=True
            )
        )
        return front, back * [1.0, -1.0]

    def _end(self, meridian: SurfaceMeridian, bevel_mm: float, radius_mm: float) -> Array:
        inner = radius_mm - bevel_mm
        corners = [(inner, 0.0)] if meridian.end_mm < inner else []
        return np.array(corners + ([(radius_mm, bevel_mm)] if bevel_mm else [])).reshape(-1, 2)

    @property
    def cylinder_z_mm(self) -> tuple[float, float]:
        """z at which the edge begins and ends, at the azimuth where it is shortest."""
        fronts, backs = zip(*(section._cylinder_z_mm for section in self.sections), strict=True)
        return max(fronts), min(backs)

    @property
    def _cylinder_z_mm(self) -> tuple[float, float]:
        front, back = (
            float(m.points(1.0)[1] + (end[-1, 1] if len(end) else 0.0))
            for m, end in zip((self.front, self.back), self.ends, strict=True)
        )
        return front, back

    @property
    def edge_thickness_mm(self) -> float:
        """Length of the edge along the axis, at the azimuth where it is shortest."""
        front, back = self.cylinder_z_mm
        return back - front

    @property
    def longest_edge_mm(self) -> float:
        """Length of the edge along the axis, at the azimuth where it is longest."""
        return max(back - front for front, back in (section._cylinder_z_mm for section in self.sections))

    @property
    def center_thickness_mm(self) -> float:
        """Thickness on the axis."""
        return self.back.vertex_z_mm - self.front.vertex_z_mm

    @property
    def outer_mm(self) -> float:
        """Largest radius of the body: the radius of the flange, or of the edge cylinder."""
        return self.edge_mm if self.edge.flange is None else self.edge.flange.semi_diameter_mm

    @property
    def rim(self) -> Array:
        """Corners from the rim of the front surface around the edge to the rim of the back surface.

        Radial height and z in mm, shape (n, 2): flat rings, bevels, edge cylinder and flange.
        """
        profiles = (
            np.concatenate([m.points(1.0)[None], m.points(1.0) * [0.0, 1.0] + end])
            for m, end in zip((self.front, self.back), self.ends, strict=True)
        )
        front, back = profiles
        return np.concatenate([front, self.flange_corners, back[::-1]])

    @property
    def edge_profile(self) -> Array:
        """Corners of the edge from its front to its back end, with those of the flange.

        Radial height and z in mm, shape (2, 2) or (6, 2).
        """
        front, back = self._cylinder_z_mm
        ends = np.array([self.edge_radii_mm, (front, back)]).T
        return np.concatenate([ends[:1], self.flange_corners, ends[1:]])

    def on_edge(self, corners: Array) -> NDArray[np.bool_]:
        """Return which points (radial height, z), shape (n, 2), are corners of :attr:`edge_profile`."""
        off = np.linalg.norm(corners[:, None] - self.edge_profile, axis=-1)
        return np.asarray(np.min(off, axis=1) <= 1e-9 * self.edge_mm)

    @property
    def flange_corners(self) -> Array:
        """Radial height and z of the flange's four corners, front to back; empty without one."""
        ring = self.edge.flange
        if ring is None:
            return np.empty((0, 2))
        front = self.front.vertex_z_mm + ring.distance_mm
        back = front + ring.thickness_mm
        inner, outer = (
            np.interp([front, back], self._cylinder_z_mm, self.edge_radii_mm),
            ring.semi_diameter_mm,
        )
        return np.array([(inner[0], front), (outer, front), (outer, back), (inner[1], back)])

    @property
    def volume_mm3(self) -> float:
        """Volume: Gauss-Legendre quadrature over the two meridians, exact sums around the edge."""
        # The volume of any body equals the mean of the volumes of revolution of its half sections.
        cores = (s.back.integral_mm3() - s.front.integral_mm3() for s in self.sections)
        rims = (ring_volume_mm3(s.rim) for s in self.sections)
        return float(np.mean([core + rim for core, rim in zip(cores, rims, strict=True)]))

    @property
    def gate_flat_volume_mm3(self) -> float:
        """Volume that the flat of the gate removes from the body; 0 without a gate.

        At a radial height r the flat, at the distance h from the axis, removes an arc of 2 acos(h / r). The
        volume is exact for a body of revolution. Otherwise the mean of the half sections is used.
        """
        if self.edge.gate is None:
            return 0.0
        flat_mm = self.outer_mm - self.edge.gate.flat_depth_mm
        t = np.linspace(0.0, 1.0, 2049)
        nodes, weights = np.polynomial.legendre.leggauss(512)
        # The square root of the arc's length at r = h is removed by r = h + (R - h) s^2.
        s = 0.5 * (nodes + 1.0)
        r = flat_mm + (self.outer_mm - flat_mm) * s * s
        by_s = 2.0 * (self.outer_mm - flat_mm) * s
        arcs = 2.0 * np.arccos(flat_mm / r)
        thickness = np.mean([section._thickness_at(r, t) for section in self.sections], axis=0)
        return float(0.5 * np.sum(weights * thickness * r * arcs * by_s))

    def _thickness_at(self, r_mm: Array, t: Array) -> Array:
        """Return the thickness of the half section along z at radial heights up to `outer_mm`."""
        front, back = self.profiles(t, t)
        (front_z, back_z), (front_mm, back_mm) = (front[-1, 1], back[-1, 1]), self.edge_radii_mm
        corners = self.flange_corners
        if len(corners):
            inside = np.maximum(corners[[0, -1], 0], [front_mm, back_mm])
            front = np.concatenate([front, [[inside[0], corners[0, 1]]], corners[1:2]])
            back = np.concatenate([back, [[inside[1], corners[-1, 1]]], corners[2:3]])
            return np.interp(r_mm, *back.T) - np.interp(r_mm, *front.T)
        # Beyond the narrow end, the edge itself bounds the body.
        if front_mm < back_mm:
            front = np.concatenate([front, [[back_mm, back_z]]])
        elif back_mm < front_mm:
            back = np.concatenate([back, [[front_mm, front_z]]])
        return np.interp(r_mm, *back.T) - np.interp(r_mm, *front.T)

    def profiles(self, front_t: Array, back_t: Array) -> tuple[Array, Array]:
        """Return both sides from the axis to the edge cylinder, including flat ring and bevel.

        Parameters
        ----------
        front_t, back_t
            Parameters of the two meridians, each from 0 to 1.

        Returns
        -------
        front, back : ndarray, shape (n, 2)
            Radial height (rising, from 0 to the radius of the edge at this side) and z in mm.
        """
        front, back = (
            _profile(m, t, end)
            for m, t, end in zip((self.front, self.back), (front_t, back_t), self.ends, strict=True)
        )
        return front, back

    def outline(self, points: int = 129) -> Array:
        """Return the meridian of the body, from the front vertex around the edge to the back vertex.

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
        return np.concatenate([front, self.flange_corners, back[::-1]])


def _profile(meridian: SurfaceMeridian, t: Array, end: Array) -> Array:
    points = meridian.points(t)
    points[0, 0], points[-1, 0] = 0.0, meridian.end_mm
    return np.concatenate([points, points[-1] * [0.0, 1.0] + end])


def glass_fronts(lens: Surfaces) -> tuple[int, ...]:
    """Return the index of the front surface of every glass element, front to back."""
    return tuple(i for i, s in enumerate(lens.surfaces[:-1]) if not is_gap(s.material))


def mechanical_semi_diameter_mm(lens: Surfaces, index: int) -> float:
    """Return the radius of the edge cylinder of a glass element, given by its index from 0.

    It is that of the design file, or else the largest clear semi-diameter of all surfaces of the lens.
    """
    given = lens.edges[index].semi_diameter_mm if lens.edges else None
    largest = max(s.semi_diameter_mm for s in lens.surfaces if s.semi_diameter_mm is not None)
    return largest if given is None else given


def glass_elements(lens: Surfaces) -> list[Element]:
    """Return the glass elements of a lens, front to back.

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
        If the lens has no glass, or an element has no size (neither of its surfaces has a
        semi_diameter_mm).
    """
    fronts = glass_fronts(lens)
    if not fronts:
        raise InputError("the lens has no glass: give a material to a surface before the last one")
    elements = [glass_element(lens, index) for index in range(len(fronts))]
    for element in elements:
        _check_size(element)
    return elements


def glass_element(lens: Surfaces, index: int) -> Element:
    """Return one glass element by its index from 0, whether or not its size is well defined.

    A surface whose conic ends inside the edge continues as a flat ring from its clear semi-diameter, or from
    the end of the conic if it has none.

    Raises
    ------
    InputError
        If the draft of the edge narrows it to nothing.
    """
    edge = lens.edges[index] if lens.edges else SHARP
    whole = _with_draft(lens, index, edge, (0.0, 0.0))
    if not edge.draft_deg or whole.longest_edge_mm <= 0.0:
        return whole
    from scipy.optimize import brentq

    tangent = math.tan(math.radians(abs(edge.draft_deg)))

    def drafted(by_mm: float) -> Element:
        assert edge.draft_deg is not None
        return _with_draft(lens, index, edge, (0.0, by_mm) if edge.draft_deg > 0.0 else (by_mm, 0.0))

    # The length of the edge depends on the sag at the narrow end.
    def excess_mm(by_mm: float) -> float:
        return tangent * drafted(by_mm).longest_edge_mm - by_mm

    bevels_mm = max(bevel for _, bevel in edge.sides())
    most_mm = (1.0 - 1e-6) * (whole.edge_mm - bevels_mm)
    if not (most_mm > 0.0 and excess_mm(most_mm) < 0.0):
        raise InputError(
            f"{whole.name}: a draft_deg of {edge.draft_deg:g} narrows its edge of semi_diameter_mm = "
            f"{whole.edge_mm:g} to nothing; give a smaller draft_deg"
        )
    return drafted(float(brentq(excess_mm, 0.0, most_mm, xtol=1e-13)))


def _with_draft(lens: Surfaces, index: int, edge: Edge, draft_mm: tuple[float, float]) -> Element:
    i = glass_fronts(lens)[index]
    radius = mechanical_semi_diameter_mm(lens, index)
    z = vertex_z_mm(lens.surfaces)
    front, back = (
        _meridian(lens.surfaces[j], float(z[j]), radius - by_mm - bevel if flat is None else flat)
        for j, (flat, bevel), by_mm in zip((i, i + 1), edge.sides(), draft_mm, strict=True)
    )
    return Element(index, (i, i + 1), front, back, radius, edge, draft_mm)


def _meridian(surface: Surface, z_mm: float, height_mm: float) -> SurfaceMeridian:
    ends = surface.shape.edge_radius_mm
    end = height_mm if ends >= height_mm else surface.semi_diameter_mm or ends
    return SurfaceMeridian(surface, z_mm, end)


def _check_size(element: Element) -> None:
    front, back = element.surfaces
    pair = (element.front, element.back)
    if all(m.surface.semi_diameter_mm is None for m in pair) and element.edge.semi_diameter_mm is None:
        raise InputError(
            f"element {element.index + 1} has no size: give surface {front + 1} or {back + 1} a "
            "semi_diameter_mm"
        )
    for i, meridian in zip(element.surfaces, pair, strict=True):
        ends = meridian.surface.shape.edge_radius_mm
        if meridian.surface.semi_diameter_mm is None and meridian.end_mm == ends < element.edge_mm:
            raise InputError(
                f"surface {i + 1} ends at a radial height of {ends:.6g} mm, inside the edge at "
                f"{element.edge_mm:g} mm; give it a semi_diameter_mm of at most {ends:.6g}"
            )


def closed_elements(lens: Surfaces) -> list[Element]:
    """Return the glass elements of a lens, all of which are closed solids.

    Parameters
    ----------
    lens
        Any lens.

    Returns
    -------
    list of Element
        Front to back; see :func:`glass_elements`.

    Raises
    ------
    InputError
        If the lens has no glass, an element has no size, its edge thickness is 0 or less, or its surfaces
        cross.
    """
    elements = glass_elements(lens)
    for element in elements:
        validate_closed(element)
    return elements


def smallest_gap(front_profile: Array, back_profile: Array) -> tuple[float, float]:
    """Return the radial height of the smallest gap between two polygonal profiles along z, and the gap.

    Parameters
    ----------
    front_profile, back_profile
        Radial height (increasing) and z in mm, shape (n, 2).

    Returns
    -------
    r_mm, gap_mm : float
        The gap is negative where the profiles have crossed.
    """
    r = np.union1d(front_profile[:, 0], back_profile[:, 0])
    gap = np.interp(r, *back_profile.T) - np.interp(r, *front_profile.T)
    smallest = int(np.argmin(gap))
    return float(r[smallest]), float(gap[smallest])


def validate_closed(element: Element) -> None:
    """Check that an element is a closed solid.

    Raises
    ------
    InputError
        If its edge thickness is 0 or less, or its surfaces cross; the message names the radial height.
    """
    t = np.linspace(0.0, 1.0, 1025)
    gaps = (smallest_gap(*section.profiles(t, t)) for section in element.sections)
    r, gap = min(gaps, key=lambda found: found[1])
    thickness = element.edge_thickness_mm
    if not (thickness > 0.0 and gap > 0.0):
        fault = (
            f"its edge thickness is {thickness:.6g} mm"
            if not thickness > 0.0
            else f"its surfaces cross at a radial height of {r:.6g} mm (gap {gap:.6g} mm)"
        )
        raise InputError(
            f"{element.name} does not close: {fault}, with the edge cylinder at a radial height of "
            f"{element.edge_mm:g} mm; raise thickness_mm or lower semi_diameter_mm"
        )


def validate_edge(element: Element) -> None:
    """Check the bevels and the flange of an element.

    Raises
    ------
    InputError
        If a bevel removes no glass, or the flange is not on the edge cylinder; the message names the allowed
        range.
    """
    for section in element.sections:
        _check_bevels(section)
    front, back = element.cylinder_z_mm
    corners = element.flange_corners[:, 1]
    if len(corners) and not (front <= corners[0] and corners[-1] <= back):
        lead = front - element.front.vertex_z_mm
        raise InputError(
            f"{element.name}: its flange is not on the edge cylinder, which extends from {lead:.6g} to "
            f"{lead + back - front:.6g} mm behind the front vertex; allowed: distance_mm of at least "
            f"{lead:.6g}, and distance_mm + thickness_mm of at most {lead + back - front:.6g}"
        )


def _check_bevels(element: Element) -> None:
    """Refuse a bevel at a surface that slopes by 45 degrees or more, from which it removes no glass."""
    sides = zip(
        (element.front, element.back), element.edge.sides(), (1.0, -1.0), element.edge_radii_mm, strict=True
    )
    for i, (meridian, (_, bevel_mm), inward, radius_mm) in zip(element.surfaces, sides, strict=True):
        end = meridian.end_mm
        slope = inward * float(meridian.section.sag_and_slope(end)[1])
        if bevel_mm and end >= radius_mm - bevel_mm and not slope < 1.0:
            raise InputError(
                f"{element.name}: a bevel at 45 degrees removes no glass from surface {i + 1}, whose slope "
                f"there is {math.degrees(math.atan(slope)):.4g} degrees; leave the bevel out, or end the "
                "surface in a flat ring"
            )
