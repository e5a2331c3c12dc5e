"""The outline that a lens has on its drawing: the ground diameter of every glass element.

A design may leave the edge of an element open. Drawings, meshes, STEP files, scenes and constraints on edge
thickness then choose the same ground diameter: the clear diameter, and to each side room for the mount, the
widest protective chamfer and half of the diameter's tolerance, rounded up to a step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.edges import Edge
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import (
    SHARP,
    Element,
    glass_element,
    glass_elements,
    validate_closed,
    validate_edge,
)
from lensdesign.lens.surface import Surface

SEAT_SHARE, LEAST_SEAT_MM = 0.05, 0.1
"""Room for the mount to each side: of the clear semi-diameter, and at least."""

LARGE_MM, LARGE_STEP_MM, SMALL_STEP_MM = 10.0, 0.5, 0.1
"""Ground diameters from the first on are whole multiples of the second, smaller ones of the third."""

RAMP = 0.05
"""Share of a size limit over which the upper bound of the ground height rises to the next size's room."""


class EdgeAllowance(NamedTuple):
    """What ISO 10110-11 (1996, table 1) allows at the edge of a part of some size.

    Attributes
    ----------
    diameter_mm, thickness_mm
        Tolerance of the ground diameter and of the centre thickness, to both sides.
    chamfer_mm
        Least and greatest width of the protective chamfer.
    """

    diameter_mm: float
    thickness_mm: float
    chamfer_mm: tuple[float, float]

    @property
    def room(self) -> EdgeRoom:
        """Room that the edge needs beyond the mount's."""
        return EdgeRoom(self.chamfer_mm[1], 0.5 * self.diameter_mm, self.thickness_mm)


class EdgeRoom(NamedTuple):
    """Room that an edge needs in mm: widest chamfer, half the diameter's tolerance, thickness tolerance."""

    chamfer_mm: float
    play_mm: float
    thickness_mm: float


GENERAL_EDGES = {
    10.0: EdgeAllowance(0.2, 0.1, (0.1, 0.3)),
    30.0: EdgeAllowance(0.5, 0.2, (0.2, 0.5)),
    100.0: EdgeAllowance(1.0, 0.4, (0.3, 0.8)),
    300.0: EdgeAllowance(1.5, 0.8, (0.5, 1.6)),
}
"""By the largest dimension of a part in mm up to which a row holds."""

RoomOf = Callable[[Element], EdgeRoom]


@dataclass(frozen=True)
class DrawnEdge:
    """The ground edge of one glass element.

    Attributes
    ----------
    element
        Name of the element.
    diameter_mm
        Ground diameter of the body.
    clear_mm
        Larger clear diameter of its two surfaces.
    thickness_mm
        Length of the edge cylinder, bevels of the design taken off.
    needed_mm
        What bevels and thickness tolerance of a sheet with general tolerances take of it.
    origin
        ``design``: of an ``[[edge]]`` table. ``chosen``: as drawings choose it. ``clear aperture``: the
        element does not close at the diameter that a drawing would choose, which is `drawn_diameter_mm`.
    drawn_diameter_mm, drawn_thickness_mm
        Ground diameter that a drawing has, or would need, and length of the edge cylinder there; 0 or less
        where the element does not close.
    """

    element: str
    diameter_mm: float
    clear_mm: float
    thickness_mm: float
    needed_mm: float
    origin: Literal["design", "chosen", "clear aperture"]
    drawn_diameter_mm: float
    drawn_thickness_mm: float

    @property
    def fits(self) -> bool:
        """Whether the edge has room for what a sheet with general tolerances takes of it.

        An edge of the design is held to what its own tolerances are.
        """
        return self.origin == "design" or self.drawn_thickness_mm > self.needed_mm

    @property
    def statement(self) -> str:
        """The outline in one sentence, for files and terminals."""
        if self.origin == "clear aperture":
            return (
                f"{self.element}: diameter {self.diameter_mm:g} mm, that of the clear aperture; at the "
                f"ground diameter of a drawing, {self.drawn_diameter_mm:g} mm, the element does not close"
            )
        how = "of the design's [[edge]]" if self.origin == "design" else "chosen as for a drawing"
        room = (
            ""
            if self.fits
            else f"; a drawing with general tolerances needs more than {self.needed_mm:.4g} mm"
        )
        return (
            f"{self.element}: ground diameter {self.diameter_mm:g} mm, {how} (clear {self.clear_mm:.6g} mm), "
            f"edge {self.thickness_mm:.4g} mm thick{room}"
        )


@dataclass(frozen=True)
class DrawnOutline:
    """A lens with the edges that its drawing has.

    Attributes
    ----------
    lens
        The lens; each glass element has an edge.
    edges
        One for each glass element, front to back.
    """

    lens: Lens
    edges: tuple[DrawnEdge, ...]

    @property
    def statements(self) -> tuple[str, ...]:
        """The outline of each element in one sentence."""
        return tuple(edge.statement for edge in self.edges)

    @property
    def thinnest(self) -> DrawnEdge | None:
        """The element with the thinnest edge; None without glass."""
        return min(self.edges, key=lambda edge: edge.drawn_thickness_mm, default=None)


def drawn_outline(lens: Lens) -> DrawnOutline:
    """Choose the edges that a design leaves open, as drawings with general tolerances choose them.

    Parameters
    ----------
    lens
        Any lens with glass.

    Returns
    -------
    DrawnOutline
        An element that does not close at the chosen diameter keeps that of the clear aperture, and its
        `origin` says so.

    Raises
    ------
    InputError
        As of :func:`lensdesign.lens.solid.glass_elements`.
    """
    edges, found = list[Edge](), list[DrawnEdge]()
    for element in glass_elements(lens):
        given = element.edge.semi_diameter_mm
        wanted = given if given is not None else chosen_semi_diameter_mm(lens, element)
        edged = with_ground_edge(lens, element, wanted)
        closed = given is not None or _closes(edged)
        body = edged if closed else element
        edges.append(body.edge)
        found.append(
            DrawnEdge(
                element.name,
                2.0 * body.edge_mm,
                2.0 * clear_semi_diameter_mm(element),
                body.edge_thickness_mm,
                edge_room_needed_mm(edged, general_room(edged)),
                "design" if given is not None else "chosen" if closed else "clear aperture",
                2.0 * wanted,
                edged.edge_thickness_mm,
            )
        )
    return DrawnOutline(lens.replaced(edges=tuple(edges)), tuple(found))


def thinnest_drawn_edge(lens: Lens) -> DrawnEdge | None:
    """Edge of the element that is thinnest at the ground diameter of its drawing.

    None for a lens without glass, or with an element that has no size.
    """
    try:
        return drawn_outline(lens).thinnest
    except InputError:
        return None


def _closes(element: Element) -> bool:
    try:
        validate_closed(element)
        validate_edge(element)
    except InputError:
        return False
    return True


def clear_semi_diameter_mm(element: Element) -> float:
    """Larger clear semi-diameter of the two surfaces of an element; where none is given, of the lens."""
    own = (m.surface.semi_diameter_mm for m in (element.front, element.back))
    return max((semi for semi in own if semi is not None), default=element.edge_mm)


def with_ground_edge(lens: Lens, element: Element, semi_diameter_mm: float) -> Element:
    """The element with an edge cylinder of a radius; flats, bevels and flange stay."""
    edges = list(lens.edges or [SHARP for _ in lens.glass_fronts])
    edges[element.number] = element.edge.replaced(semi_diameter_mm=semi_diameter_mm)
    # The edge is not yet checked, so that a body that does not close can be reported rather than refused.
    return glass_element(_Edged(lens.surfaces, tuple(edges)), element.number)


class _Edged(NamedTuple):
    """What :func:`glass_element` takes of a lens."""

    surfaces: tuple[Surface, ...]
    edges: tuple[Edge, ...]


def general_room(element: Element) -> EdgeRoom:
    """Room that the general tolerances of an element's size take at its edge.

    The last row of the table stands for larger parts.
    """
    thickness = element.back.vertex_z_mm - element.front.vertex_z_mm
    room = general_edge(max(2.0 * element.edge_mm, thickness)).room
    own = max(bevel for _, bevel in element.edge.sides())
    if element.edge.flange is not None:
        return room._replace(chamfer_mm=own)
    return room._replace(chamfer_mm=own) if own else room


def general_edge(largest_dimension_mm: float) -> EdgeAllowance:
    """Row of the table for a part of some size; the last one for larger parts."""
    return next((row for most, row in GENERAL_EDGES.items() if largest_dimension_mm <= most), _LAST)


_LAST = list(GENERAL_EDGES.values())[-1]


def edge_room_needed_mm(element: Element, room: EdgeRoom) -> float:
    """Thickness that bevels and the thickness tolerance take of an element's edge.

    Bevels of the design are already taken off its edge cylinder.
    """
    bevels = sum(bevel for _, bevel in element.edge.sides())
    return (0.0 if bevels else 2.0 * room.chamfer_mm) + room.thickness_mm


def chosen_semi_diameter_mm(lens: Lens, element: Element, room_of: RoomOf = general_room) -> float:
    """Ground semi-diameter that a drawing chooses for an element.

    Parameters
    ----------
    lens, element
        The element, and its lens.
    room_of
        Room that the tolerances of an element take at its edge; by default the general ones of its size.
    """
    semi = clear = clear_semi_diameter_mm(element)
    for _ in range(2):  # general tolerances depend on the size that is chosen
        semi = ground_semi_diameter_mm(clear, room_of(with_ground_edge(lens, element, semi)))
    return semi


def ground_semi_diameter_mm(clear_mm: float, room: EdgeRoom) -> float:
    """Semi-diameter of the ground edge round a clear semi-diameter, rounded up to a step."""
    needed = 2.0 * (clear_mm + seat_mm(clear_mm) + room.chamfer_mm + room.play_mm)
    step = LARGE_STEP_MM if needed >= LARGE_MM else SMALL_STEP_MM
    return 0.5 * round(step * math.ceil(needed / step - 1e-9), 6)


def seat_mm(clear_mm: float) -> float:
    """Room for the mount to each side."""
    return max(SEAT_SHARE * clear_mm, LEAST_SEAT_MM)


def highest_ground_mm(clear_mm: float, thickness_mm: float) -> tuple[float, float, float]:
    """Continuous upper bound of the ground semi-diameter that a drawing chooses, for searches.

    Rounding up is taken to add a whole step, and the room rises to that of the next size of the general
    table over the last 5 % before its limit.

    Parameters
    ----------
    clear_mm
        Larger clear semi-diameter of the element's surfaces.
    thickness_mm
        Centre thickness.

    Returns
    -------
    height_mm, by_clear, by_thickness : float
        The bound, and its derivatives.
    """
    seat_by = SEAT_SHARE if SEAT_SHARE * clear_mm > LEAST_SEAT_MM else 0.0
    # Below the limit of a size the clear semi-diameter has room for that size's edge.
    by_size, slope = _ramp(clear_mm, [_clear_at(limit, row) for limit, row in GENERAL_EDGES.items()])
    by_thickness, slope_t = _ramp(thickness_mm, list(GENERAL_EDGES))
    room, by_clear, by_thick = (
        (by_size, slope, 0.0) if by_size >= by_thickness else (by_thickness, 0.0, slope_t)
    )
    return clear_mm + seat_mm(clear_mm) + room, 1.0 + seat_by + by_clear, by_thick


def _clear_at(limit_mm: float, row: EdgeAllowance) -> float:
    """Clear semi-diameter from which a part no longer fits a size's ground diameter."""
    beyond = 0.5 * limit_mm - row.room.chamfer_mm - row.room.play_mm
    share = beyond / (1.0 + SEAT_SHARE)
    return share if SEAT_SHARE * share > LEAST_SEAT_MM else beyond - LEAST_SEAT_MM


def _ramp(value: float, limits: list[float]) -> tuple[float, float]:
    """Room of the size that a value falls in, with its derivative."""
    rows = list(GENERAL_EDGES.values())
    heights = [_room_mm(row, limit) for row, limit in zip(rows, GENERAL_EDGES, strict=True)]
    for k, (limit, height) in enumerate(zip(limits, heights, strict=True)):
        if value <= limit:
            start = (1.0 - RAMP) * limit
            if value <= start or k + 1 == len(heights):
                return height, 0.0
            slope = (heights[k + 1] - height) / (limit - start)
            return height + slope * (value - start), slope
    return heights[-1], 0.0


def _room_mm(row: EdgeAllowance, limit_mm: float) -> float:
    step = SMALL_STEP_MM if limit_mm <= LARGE_MM else LARGE_STEP_MM
    return row.room.chamfer_mm + row.room.play_mm + 0.5 * step


def drawn_edge_thicknesses_mm(lens: Lens) -> list[float]:
    """Thickness of every glass element at the ground diameter that its drawing has or would need.

    A surface whose conic ends before goes on as a flat ring. Negative where surfaces have crossed. Flats
    and bevels of the design are not taken off.
    """
    found = []
    for number in range(len(lens.glass_fronts)):
        element = glass_element(lens, number)
        wanted = element.edge.semi_diameter_mm or chosen_semi_diameter_mm(lens, element)
        bare = glass_element(
            _Edged(lens.surfaces, tuple(Edge(semi_diameter_mm=wanted) for _ in lens.glass_fronts)), number
        )
        gaps = [s.back.points(1.0)[1] - s.front.points(1.0)[1] for s in bare.sections]
        found.append(float(np.min(gaps)))
    return found
