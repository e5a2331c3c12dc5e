"""A lens as a sheet can state it: with an edge that can be held, and values that a shop can set.

The ground edge leaves room beyond the clear apertures for the mount, the protective chamfer and its own
tolerance. Radii and thicknesses are rounded to about a tenth of their tolerance, and what that does to the
largest spread angle is checked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from lensdesign.analysis.matching import match
from lensdesign.analysis.outline import (
    EdgeRoom,
    chosen_semi_diameter_mm,
    clear_semi_diameter_mm,
    edge_room_needed_mm,
    seat_mm,
    with_ground_edge,
)
from lensdesign.analysis.spread import largest_spread
from lensdesign.errors import InputError
from lensdesign.lens.edges import Edge
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import Element, glass_elements
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances

LEAST_PLAY_MM = 0.01
"""A diameter is toleranced no closer than that."""

SHARE_OF_TOLERANCE = 0.1
LEAST_GROWTH = 1e-3
"""Of the limit: by how much rounding may enlarge the largest spread angle."""

FINER = (1.0, 0.1, 0.01, 1e-3)

ToleranceOf = Callable[[Element], DrawingTolerances]


@dataclass(frozen=True)
class Stated:
    """A lens as its sheets state it.

    Attributes
    ----------
    lens
        With an edge for each element, and rounded.
    notes
        What was chosen and changed, and what that does, in words.
    tolerances
        Of the sheet of each element; empty where they are not yet made.
    """

    lens: Lens
    notes: tuple[str, ...]
    tolerances: tuple[DrawingTolerances, ...] = ()


def stated_lens(lens: Lens, tolerances: ToleranceOf) -> Stated:
    """Choose the edges that a design leaves open, and round its radii and thicknesses.

    Parameters
    ----------
    lens
        As designed.
    tolerances
        Of each element.

    Raises
    ------
    InputError
        If an element cannot be made: the edge of the design, or any edge that leaves room, cuts into a clear
        aperture or leaves no glass.
    """
    notes: list[str] = []
    elements, edges = glass_elements(lens), list[Edge]()
    for element in elements:
        edge, note = _edge(lens, element, tolerances)
        edges.append(edge)
        notes += note
    edged = lens.replaced(edges=tuple(edges))
    for element in glass_elements(edged):
        _refuse_thin(
            element, tolerances(element), chosen=elements[element.number].edge.semi_diameter_mm is None
        )
    rounded, more = _rounded(edged, tolerances)
    return Stated(rounded, (*notes, *more))


def fitting(element: Element, general: DrawingTolerances) -> DrawingTolerances:
    """General tolerances, as far as an edge of the design leaves room for them.

    The cylinder within a flange is moulded and has no protective chamfer.
    """
    if element.edge.semi_diameter_mm is None:
        return general
    if element.edge.flange is not None:
        sides = {"left": general.left, "right": general.right}
        general = general.replaced(**{k: side.replaced(chamfer_mm=None) for k, side in sides.items()})
    room = 2.0 * (element.edge_mm - _least_bevel_mm(element, general) - clear_semi_diameter_mm(element))
    if general.diameter_mm is None or not LEAST_PLAY_MM <= room < general.diameter_mm:
        return general
    return general.replaced(diameter_mm=math.floor(100.0 * room + 1e-6) / 100.0)


def _least_bevel_mm(element: Element, made: DrawingTolerances) -> float:
    """Narrowest bevel that the design or the tolerances ask for."""
    own = max(bevel for _, bevel in element.edge.sides())
    allowed = [side.chamfer_mm[0] for side in (made.left, made.right) if side.chamfer_mm is not None]
    return own or max(allowed, default=0.0)


def _edge(lens: Lens, element: Element, tolerances: ToleranceOf) -> tuple[Edge, list[str]]:
    """The edge of an element, and how it was chosen."""
    clear = clear_semi_diameter_mm(element)
    made = tolerances(element)
    if element.edge.semi_diameter_mm is not None:
        _refuse_narrow(element, clear, made)
        return element.edge, []
    semi = chosen_semi_diameter_mm(lens, element, lambda one: _room(one, tolerances(one)))
    edge = element.edge.replaced(semi_diameter_mm=semi)
    room = _room(element, tolerances(with_ground_edge(lens, element, semi)))
    taken = (
        f"{seat_mm(clear):.3g} mm to each side for the mount, {room.chamfer_mm:g} for the bevel, "
        f"{room.play_mm:g} for its tolerance"
    )
    general = chosen_semi_diameter_mm(lens, element)
    other = (
        ""
        if general == semi
        else f"; exports of the design have {2.0 * general:g} mm, those of the design that --as-drawn writes "
        f"{2.0 * semi:g} mm"
    )
    return edge, [
        f"{element.name}: ground diameter {2.0 * semi:g} mm chosen, clear {2.0 * clear:.6g}: {taken}{other}"
    ]


def _room(element: Element, made: DrawingTolerances) -> EdgeRoom:
    return EdgeRoom(_chamfer_mm(element, made), 0.5 * (made.diameter_mm or 0.0), made.thickness_mm or 0.0)


def _chamfer_mm(element: Element, made: DrawingTolerances) -> float:
    """Widest bevel that the design or the tolerances allow."""
    own = max(bevel for _, bevel in element.edge.sides())
    allowed = [side.chamfer_mm[1] for side in (made.left, made.right) if side.chamfer_mm is not None]
    return own or max(allowed, default=0.0)


def _refuse_narrow(element: Element, clear: float, made: DrawingTolerances) -> None:
    """Refuse an edge of the design that its tolerance and the least bevel take into a clear aperture."""
    bevel = _least_bevel_mm(element, made)
    play = 0.5 * (made.diameter_mm or 0.0)
    left = element.edge_mm - play - bevel
    if left < clear - 1e-9:
        raise InputError(
            f"{element.name}: cannot be made: a ground diameter of {2.0 * element.edge_mm:g} mm leaves "
            f"{2.0 * left:.5g} mm within its tolerance of {2.0 * play:g} and a bevel of {bevel:g}, the clear "
            f"aperture is {2.0 * clear:.5g} mm; allowed: an [[edge]] with a semi_diameter_mm of at least "
            f"{clear + play + bevel:.4g}, a closer diameter_mm in the sheet's tolerances, or no "
            "semi_diameter_mm, and one is chosen"
        )


def _refuse_thin(element: Element, made: DrawingTolerances, chosen: bool) -> None:
    """Refuse an edge without room for its bevels and the tolerance of the thickness."""
    needed = edge_room_needed_mm(element, _room(element, made))
    thickness = min(section.edge_thickness_mm for section in element.sections)
    if not thickness > needed:
        what = "the ground diameter that leaves room" if chosen else "its ground diameter"
        raise InputError(
            f"{element.name}: cannot be made: at {what}, {2.0 * element.edge_mm:g} mm, its edge is "
            f"{thickness:.4g} mm thick, and bevels and tolerance take {needed:.4g} mm; raise thickness_mm "
            f"by {needed - thickness + 0.05:.2f} mm, lower semi_diameter_mm, state closer tolerances "
            "(--sheet), or give the design an [[edge]]"
        )


def _rounded(lens: Lens, tolerances: ToleranceOf) -> tuple[Lens, list[str]]:
    """The lens with rounded values, as coarse as the largest spread angle bears, and what was done."""
    limit, before = match(lens, lens.wavelengths_um[0]).spread_limit_deg, largest_spread(lens).spread_deg
    for finer in FINER:
        changes = list(_changes(lens, tolerances, SHARE_OF_TOLERANCE * finer))
        if not changes:
            return lens, []
        rounded = lens
        for surface, key, _, value in changes:
            rounded = rounded.with_surface(surface, **{key: value})
        after = largest_spread(rounded).spread_deg
        if after <= before + LEAST_GROWTH * limit and (after <= limit or before > limit):
            what = ", ".join(
                f"{key} of surface {surface + 1} {old:.8g} to {new:.8g}" for surface, key, old, new in changes
            )
            return rounded, [f"rounded: {what}; largest spread {after:.4f}°, was {before:.4f}°"]
    return lens, [f"not rounded: the largest spread of {before:.4f}° would miss the limit of {limit:.4f}°"]


def _changes(lens: Lens, tolerances: ToleranceOf, share: float) -> Iterator[tuple[int, str, float, float]]:
    """Surface, key, value and rounded value of what has a tolerance."""
    for element in glass_elements(lens):
        made, (front, back) = tolerances(element), element.surfaces
        for surface, side in ((front, made.left), (back, made.right)):
            own = lens.surfaces[surface]
            allowed = side.radius_allowed_mm(own, made.fringe_wavelength_um)
            if own.radius_mm is not None and allowed:
                yield from _change(surface, "radius_mm", own.radius_mm, share * allowed)
        if made.thickness_mm is not None:
            yield from _change(
                front, "thickness_mm", lens.surfaces[front].thickness_mm or 0.0, share * made.thickness_mm
            )


def _change(surface: int, key: str, value: float, step_mm: float) -> Iterator[tuple[int, str, float, float]]:
    rounded = round(value, -math.floor(math.log10(step_mm)))
    if rounded and rounded != value:
        yield surface, key, value, rounded
