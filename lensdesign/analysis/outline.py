"""The outline of a lens on its drawing: the ground diameter of every glass element.

A design need not state the edge of an element. Drawings, meshes, STEP files, scenes and constraints on edge
thickness then use the same ground diameter. It is the clear diameter plus, on each side, a margin for the
mount, the widest protective chamfer and half of the diameter tolerance, rounded up to a step.
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

MOUNT_FRACTION, LEAST_MOUNT_MM = 0.05, 0.1
"""Margin for the mount on each side: as a fraction of the clear semi-diameter, and at least in mm."""

LARGE_MM, LARGE_STEP_MM, SMALL_STEP_MM = 10.0, 0.5, 0.1
"""Ground diameters of `LARGE_MM` and more are multiples of `LARGE_STEP_MM`, smaller ones of
`SMALL_STEP_MM`."""


class EdgeAllowance(NamedTuple):
    """General tolerances at the edge of a part by its size (ISO 10110-11:1996, table 1).

    Attributes
    ----------
    diameter_mm, thickness_mm
        Tolerances (plus and minus) of the ground diameter and of the centre thickness.
    chamfer_mm
        Smallest and largest width of the protective chamfer.
    """

    diameter_mm: float
    thickness_mm: float
    chamfer_mm: tuple[float, float]

    @property
    def margin(self) -> EdgeMargin:
        """Margin that the edge needs in addition to that of the mount."""
        return EdgeMargin(self.chamfer_mm[1], 0.5 * self.diameter_mm, self.thickness_mm)


class EdgeMargin(NamedTuple):
    """Margin that an edge needs for its tolerances, in mm.

    Attributes
    ----------
    chamfer_mm
        Largest width of the chamfer.
    play_mm
        Half of the diameter tolerance.
    thickness_mm
        Tolerance of the thickness.
    """

    chamfer_mm: float
    play_mm: float
    thickness_mm: float


GENERAL_EDGES = {
    10.0: EdgeAllowance(0.2, 0.1, (0.1, 0.3)),
    30.0: EdgeAllowance(0.5, 0.2, (0.2, 0.5)),
    100.0: EdgeAllowance(1.0, 0.4, (0.3, 0.8)),
    300.0: EdgeAllowance(1.5, 0.8, (0.5, 1.6)),
}
"""General tolerances by the largest dimension of a part in mm up to which they apply."""

MarginOf = Callable[[Element], EdgeMargin]


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
        Length of the edge cylinder, without the bevels of the design.
    needed_mm
        Thickness that bevels and thickness tolerance of a drawing with general tolerances need.
    origin
        Origin of the diameter. ``design``: an ``[[edge]]`` table. ``chosen``: the choice for a drawing.
        ``clear aperture``: the element does not close at the diameter that a drawing would have, which is
        `drawn_diameter_mm`.
    drawn_diameter_mm, drawn_thickness_mm
        Ground diameter that a drawing has, or would need, and length of the edge cylinder there; 0 or less
        if the element does not close.
    draft_deg
        Draft of the edge; None if it is not stated.
    has_gate_flat
        Whether the design states a gate flat, which files of the body do not contain.
    """

    element: str
    diameter_mm: float
    clear_mm: float
    thickness_mm: float
    needed_mm: float
    origin: Literal["design", "chosen", "clear aperture"]
    drawn_diameter_mm: float
    drawn_thickness_mm: float
    draft_deg: float | None = None
    has_gate_flat: bool = False

    @property
    def fits(self) -> bool:
        """True if the edge is thick enough for a drawing with general tolerances.

        An edge that the design states has its own tolerances and always fits here.
        """
        return self.origin == "design" or self.drawn_thickness_mm > self.needed_mm

    @property
    def statement(self) -> str:
        """Outline of the element in one sentence, for files and terminals."""
        if self.origin == "clear aperture":
            return (
                f"{self.element}: diameter {self.diameter_mm:g} mm (clear aperture); the element does not "
                f"close at the ground diameter of a drawing, {self.drawn_diameter_mm:g} mm"
            )
        origin = "from the design's [[edge]]" if self.origin == "design" else "chosen as for a drawing"
        warning = (
            ""
            if self.fits
            else f"; a drawing with general tolerances needs more than {self.needed_mm:.4g} mm"
        )
        return (
            f"{self.element}: ground diameter {self.diameter_mm:g} mm, {origin} (clear {self.clear_mm:.6g} "
            f"mm), edge {self.thickness_mm:.4g} mm thick"
            + (f", draft {abs(self.draft_deg):g}°" if self.draft_deg else "")
            + ("; without the gate flat" if self.has_gate_flat else "")
            + warning
        )


@dataclass(frozen=True)
class DrawnOutline:
    """A lens with the edges of its drawing.

    Attributes
    ----------
    lens
        The lens, in which each glass element has an edge.
    edges
        Description of the edge of each glass element, front to back.
    """

    lens: Lens
    edges: tuple[DrawnEdge, ...]

    @property
    def statements(self) -> tuple[str, ...]:
        """Outline of each element in one sentence."""
        return tuple(edge.statement for edge in self.edges)

    @property
    def thinnest(self) -> DrawnEdge | None:
        """Edge of the element whose edge is thinnest; None without glass."""
        return min(self.edges, key=lambda edge: edge.drawn_thickness_mm, default=None)


def drawn_outline(lens: Lens) -> DrawnOutline:
    """Return a lens with all edges; those that the design does not state are as in its drawing.

    Parameters
    ----------
    lens
        Any lens with glass.

    Returns
    -------
    DrawnOutline
        An element that does not close at the chosen diameter has that of the clear aperture, with the
        `origin` ``clear aperture``.

    Raises
    ------
    InputError
        If the lens has no glass or an element has no size.
    """
    edges, found = list[Edge](), list[DrawnEdge]()
    for element in glass_elements(lens):
        given = element.edge.semi_diameter_mm
        ground_mm = given if given is not None else chosen_semi_diameter_mm(lens, element)
        edged = with_ground_edge(lens, element, ground_mm)
        closed = given is not None or _closes(edged)
        body = edged if closed else element
        edges.append(body.edge)
        found.append(
            DrawnEdge(
                element.name,
                2.0 * body.edge_mm,
                2.0 * clear_semi_diameter_mm(element),
                body.edge_thickness_mm,
                needed_edge_thickness_mm(edged, general_margin(edged)),
                "design" if given is not None else "chosen" if closed else "clear aperture",
                2.0 * ground_mm,
                edged.edge_thickness_mm,
                body.edge.draft_deg,
                body.edge.gate is not None,
            )
        )
    return DrawnOutline(lens.replaced(edges=tuple(edges)), tuple(found))


def thinnest_drawn_edge(lens: Lens) -> DrawnEdge | None:
    """Return the thinnest edge at the ground diameters of the drawing.

    It is None for a lens without glass, or with an element that has no size.
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
    """Return the larger clear semi-diameter of an element's surfaces, or else that of its edge."""
    own = (m.surface.semi_diameter_mm for m in (element.front, element.back))
    return max((semi for semi in own if semi is not None), default=element.edge_mm)


def with_ground_edge(lens: Lens, element: Element, semi_diameter_mm: float) -> Element:
    """Return the element with another radius of the edge cylinder; flats, bevels and flange stay."""
    edges = list(lens.edges or [SHARP for _ in lens.glass_fronts])
    edges[element.index] = element.edge.replaced(semi_diameter_mm=semi_diameter_mm)
    # The edge is not checked here, so that a body that does not close can be reported.
    return glass_element(_Edged(lens.surfaces, tuple(edges)), element.index)


class _Edged(NamedTuple):
    """Surfaces and edges of a lens, the input of :func:`glass_element`."""

    surfaces: tuple[Surface, ...]
    edges: tuple[Edge, ...]


def general_margin(element: Element) -> EdgeMargin:
    """Return the margin that the general tolerances of an element's size need at its edge."""
    thickness = element.center_thickness_mm
    margin = general_edge(max(2.0 * element.edge_mm, thickness)).margin
    bevel_mm = max(bevel for _, bevel in element.edge.sides())
    if bevel_mm or element.edge.flange is not None:
        return margin._replace(chamfer_mm=bevel_mm)
    return margin


def general_edge(largest_dimension_mm: float) -> EdgeAllowance:
    """Return the general tolerances of a part by its size; larger parts have those of the last size."""
    last = list(GENERAL_EDGES.values())[-1]
    return next((row for most, row in GENERAL_EDGES.items() if largest_dimension_mm <= most), last)


def needed_edge_thickness_mm(element: Element, margin: EdgeMargin) -> float:
    """Return the edge thickness that bevels and the thickness tolerance of an element need.

    Bevels of the design count as 0, since the edge cylinder is already shorter by them.
    """
    bevels = sum(bevel for _, bevel in element.edge.sides())
    return (0.0 if bevels else 2.0 * margin.chamfer_mm) + margin.thickness_mm


def chosen_semi_diameter_mm(lens: Lens, element: Element, margin_of: MarginOf = general_margin) -> float:
    """Return the ground semi-diameter that a drawing uses for an element.

    Parameters
    ----------
    lens, element
        The lens, and one of its elements.
    margin_of
        Function of an element that returns the margin for its tolerances (default: general tolerances).
    """
    semi = clear = clear_semi_diameter_mm(element)
    for _ in range(2):  # general tolerances depend on the chosen size
        semi = ground_semi_diameter_mm(clear, margin_of(with_ground_edge(lens, element, semi)))
    return semi


def ground_semi_diameter_mm(clear_mm: float, margin: EdgeMargin) -> float:
    """Return the semi-diameter of the ground edge around a clear semi-diameter, rounded up to a step."""
    needed = 2.0 * (clear_mm + mount_margin_mm(clear_mm) + margin.chamfer_mm + margin.play_mm)
    step = LARGE_STEP_MM if needed >= LARGE_MM else SMALL_STEP_MM
    return 0.5 * round(step * math.ceil(needed / step - 1e-9), 6)


def mount_margin_mm(clear_mm: float) -> float:
    """Return the margin for the mount on each side."""
    return max(MOUNT_FRACTION * clear_mm, LEAST_MOUNT_MM)


def highest_ground_mm(clear_mm: float, thickness_mm: float) -> tuple[float, float, float]:
    """Return a continuous upper bound of the ground semi-diameter of a drawing, for optimization.

    The bound assumes that rounding up adds a whole step. The margin rises to that of the next size of the
    general tolerances over the last 5 % before the size limit.

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
    mount_by = MOUNT_FRACTION if MOUNT_FRACTION * clear_mm > LEAST_MOUNT_MM else 0.0
    # Below the limit of a size, its margin fits around the clear semi-diameter.
    by_size, slope = _ramp(clear_mm, [_clear_at(limit, row) for limit, row in GENERAL_EDGES.items()])
    by_thickness, slope_t = _ramp(thickness_mm, list(GENERAL_EDGES))
    margin, by_clear, by_thick = (
        (by_size, slope, 0.0) if by_size >= by_thickness else (by_thickness, 0.0, slope_t)
    )
    return clear_mm + mount_margin_mm(clear_mm) + margin, 1.0 + mount_by + by_clear, by_thick


def _clear_at(limit_mm: float, row: EdgeAllowance) -> float:
    """Return the clear semi-diameter from which a part exceeds the ground diameter of a size."""
    available = 0.5 * limit_mm - row.margin.chamfer_mm - row.margin.play_mm
    clear = available / (1.0 + MOUNT_FRACTION)
    return clear if MOUNT_FRACTION * clear > LEAST_MOUNT_MM else available - LEAST_MOUNT_MM


def _ramp(value: float, limits: list[float]) -> tuple[float, float]:
    """Return the margin of the size to which a value belongs, and its derivative."""
    rows = list(GENERAL_EDGES.values())
    heights = [_margin_mm(row, limit) for row, limit in zip(rows, GENERAL_EDGES, strict=True)]
    for k, (limit, height) in enumerate(zip(limits, heights, strict=True)):
        if value <= limit:
            start = 0.95 * limit
            if value <= start or k + 1 == len(heights):
                return height, 0.0
            slope = (heights[k + 1] - height) / (limit - start)
            return height + slope * (value - start), slope
    return heights[-1], 0.0


def _margin_mm(row: EdgeAllowance, limit_mm: float) -> float:
    step = SMALL_STEP_MM if limit_mm <= LARGE_MM else LARGE_STEP_MM
    return row.margin.chamfer_mm + row.margin.play_mm + 0.5 * step


def drawn_edge_thicknesses_mm(lens: Lens) -> list[float]:
    """Return the thickness of every glass element at the ground diameter that its drawing has or would need.

    A surface whose conic ends inside that diameter continues as a flat ring. The thickness is negative where
    surfaces have crossed. Flats and bevels of the design are ignored.
    """
    found = []
    for index in range(len(lens.glass_fronts)):
        element = glass_element(lens, index)
        ground_mm = element.edge.semi_diameter_mm or chosen_semi_diameter_mm(lens, element)
        bare = glass_element(
            _Edged(lens.surfaces, tuple(Edge(semi_diameter_mm=ground_mm) for _ in lens.glass_fronts)), index
        )
        gaps = [s.back.points(1.0)[1] - s.front.points(1.0)[1] for s in bare.sections]
        found.append(float(np.min(gaps)))
    return found
