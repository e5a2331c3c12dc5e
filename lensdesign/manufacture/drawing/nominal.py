"""Nominal values of a drawing: ground edges for elements without one, and rounded radii and thicknesses.

The ground edge leaves a margin beyond the clear apertures for the mount, the protective chamfer and its own
tolerance. Radii and thicknesses are rounded to about a tenth of their tolerance; the effect on the largest
spread angle is checked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from lensdesign.analysis.exit_beam import largest_spread_angle
from lensdesign.analysis.outline import (
    EdgeMargin,
    chosen_semi_diameter_mm,
    clear_semi_diameter_mm,
    mount_margin_mm,
    needed_edge_thickness_mm,
    with_ground_edge,
)
from lensdesign.analysis.space_bandwidth import match
from lensdesign.errors import InputError
from lensdesign.lens.edges import Edge
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import Element, glass_elements
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances

ToleranceOf = Callable[[Element], DrawingTolerances]


@dataclass(frozen=True)
class Stated:
    """A lens with the nominal values of its drawing.

    Attributes
    ----------
    lens
        The lens with an edge for each element and rounded values.
    notes
        Sentences on chosen and rounded values and their effect.
    tolerances
        Tolerances of the sheet of each element; empty before they are known.
    """

    lens: Lens
    notes: tuple[str, ...]
    tolerances: tuple[DrawingTolerances, ...] = ()


def stated_lens(lens: Lens, tolerances: ToleranceOf) -> Stated:
    """Choose edges for elements without one, and round radii and thicknesses.

    Parameters
    ----------
    lens
        The lens as designed.
    tolerances
        Function that returns the tolerances of an element.

    Raises
    ------
    InputError
        If an element cannot be manufactured: its edge cuts into a clear aperture, or is too thin for bevels
        and tolerances.
    """
    notes: list[str] = []
    elements, edges = glass_elements(lens), list[Edge]()
    for element in elements:
        edge, note = _edge(lens, element, tolerances)
        edges.append(edge)
        notes += note
    edged = lens.replaced(edges=tuple(edges))
    for element in glass_elements(edged):
        _check_edge_thickness(
            element, tolerances(element), chosen=elements[element.index].edge.semi_diameter_mm is None
        )
    rounded, more = _rounded(edged, tolerances)
    return Stated(rounded, (*notes, *more))


def fitting(element: Element, general: DrawingTolerances) -> DrawingTolerances:
    """Return the general tolerances, with a tighter diameter if the edge of the design requires it.

    The cylinder within a flange is moulded and has no protective chamfer.
    """
    if element.edge.semi_diameter_mm is None:
        return general
    if element.edge.flange is not None:
        sides = {"left": general.left, "right": general.right}
        general = general.replaced(**{k: side.replaced(chamfer_mm=None) for k, side in sides.items()})
    margin = 2.0 * (
        min(element.edge_radii_mm) - _bevel_mm(element, general, 0) - clear_semi_diameter_mm(element)
    )
    min_tolerance_mm = 0.01
    if general.diameter_mm is None or not min_tolerance_mm <= margin < general.diameter_mm:
        return general
    return general.replaced(diameter_mm=math.floor(100.0 * margin + 1e-6) / 100.0)


def _bevel_mm(element: Element, stated: DrawingTolerances, limit: int) -> float:
    """Return the bevel of the design, or the chamfer of the tolerances (`limit` 0: smallest, 1: largest)."""
    own = max(bevel for _, bevel in element.edge.sides())
    allowed = [side.chamfer_mm[limit] for side in (stated.left, stated.right) if side.chamfer_mm is not None]
    return own or max(allowed, default=0.0)


def _edge(lens: Lens, element: Element, tolerances: ToleranceOf) -> tuple[Edge, list[str]]:
    """Return the edge of an element and a note on its choice."""
    clear = clear_semi_diameter_mm(element)
    if element.edge.semi_diameter_mm is not None:
        _check_diameter(element, clear, tolerances(element))
        return element.edge, []
    semi = chosen_semi_diameter_mm(lens, element, lambda one: _edge_margins(one, tolerances(one)))
    edge = element.edge.replaced(semi_diameter_mm=semi)
    margins = _edge_margins(element, tolerances(with_ground_edge(lens, element, semi)))
    reasons = (
        f"{mount_margin_mm(clear):.3g} mm to each side for the mount, {margins.chamfer_mm:g} for the bevel, "
        f"{margins.play_mm:g} for the tolerance of the diameter"
    )
    general = chosen_semi_diameter_mm(lens, element)
    other = (
        ""
        if general == semi
        else f"; exports of this design have {2.0 * general:g} mm, those of the design written by --as-drawn "
        f"{2.0 * semi:g} mm"
    )
    return edge, [
        f"{element.name}: ground diameter {2.0 * semi:g} mm chosen, clear {2.0 * clear:.6g}: {reasons}{other}"
    ]


def _edge_margins(element: Element, stated: DrawingTolerances) -> EdgeMargin:
    bevel_mm = _bevel_mm(element, stated, 1)
    return EdgeMargin(bevel_mm, 0.5 * (stated.diameter_mm or 0.0), stated.thickness_mm or 0.0)


def _check_diameter(element: Element, clear: float, stated: DrawingTolerances) -> None:
    """Raise an error if tolerance and smallest bevel of the design's edge reach into a clear aperture."""
    bevel = _bevel_mm(element, stated, 0)
    tolerance = 0.5 * (stated.diameter_mm or 0.0)
    remaining = min(element.edge_radii_mm) - tolerance - bevel
    if remaining < clear - 1e-9:
        narrow = (
            f" at the narrow end of its draft of {element.edge.draft_deg:g}°" if any(element.draft_mm) else ""
        )
        least = clear + tolerance + bevel + max(element.draft_mm)
        raise InputError(
            f"{element.name}: cannot be made: a ground diameter of {2.0 * element.edge_mm:g} mm leaves "
            f"{2.0 * remaining:.5g} mm after its tolerance of {2.0 * tolerance:g} and a bevel of {bevel:g}"
            f"{narrow}, but the clear aperture is {2.0 * clear:.5g} mm; allowed: an [[edge]] with a "
            f"semi_diameter_mm of at least {least:.4g}, a closer diameter_mm in the sheet's tolerances, or "
            "no semi_diameter_mm (it is then chosen)"
        )


def _check_edge_thickness(element: Element, stated: DrawingTolerances, chosen: bool) -> None:
    """Raise an error if the edge is too thin for its bevels and the tolerance of the thickness."""
    needed = needed_edge_thickness_mm(element, _edge_margins(element, stated))
    thickness = min(section.edge_thickness_mm for section in element.sections)
    if not thickness > needed:
        diameter = "the chosen ground diameter" if chosen else "its ground diameter"
        raise InputError(
            f"{element.name}: cannot be made: at {diameter}, {2.0 * element.edge_mm:g} mm, its edge is "
            f"{thickness:.4g} mm thick, but bevels and tolerance need {needed:.4g} mm; raise thickness_mm "
            f"by {needed - thickness + 0.05:.2f} mm, lower semi_diameter_mm, state closer tolerances "
            "(--sheet), or give the design an [[edge]]"
        )


def _rounded(lens: Lens, tolerances: ToleranceOf) -> tuple[Lens, list[str]]:
    """Return the lens with the coarsest rounding that the largest spread angle permits, and a note."""
    limit, before = (
        match(lens, lens.wavelengths_um[0]).spread_limit_deg,
        largest_spread_angle(lens).spread_deg,
    )
    for fraction in (0.1, 0.1 * 0.1, 0.1 * 0.01, 0.1 * 1e-3):
        changes = list(_changes(lens, tolerances, fraction))
        if not changes:
            return lens, []
        rounded = lens
        for surface, key, _, value in changes:
            rounded = rounded.with_surface(surface, **{key: value})
        after = largest_spread_angle(rounded).spread_deg
        # Rounding may enlarge the spread angle by a thousandth of its limit.
        if after <= before + 1e-3 * limit and (after <= limit or before > limit):
            values = ", ".join(
                f"{key} of surface {surface + 1} {old:.8g} to {new:.8g}" for surface, key, old, new in changes
            )
            return rounded, [f"rounded: {values}; largest spread {after:.4f}°, was {before:.4f}°"]
    return lens, [f"not rounded: the largest spread of {before:.4f}° would miss the limit of {limit:.4f}°"]


def _changes(lens: Lens, tolerances: ToleranceOf, fraction: float) -> Iterator[tuple[int, str, float, float]]:
    """Yield surface, key, value and rounded value of each toleranced radius and thickness."""
    for element in glass_elements(lens):
        stated, (front, back) = tolerances(element), element.surfaces
        for surface, side in ((front, stated.left), (back, stated.right)):
            own = lens.surfaces[surface]
            allowed = side.radius_allowed_mm(own, stated.fringe_wavelength_um)
            if own.radius_mm is not None and allowed:
                yield from _change(surface, "radius_mm", own.radius_mm, fraction * allowed)
        if stated.thickness_mm is not None:
            thickness = lens.surfaces[front].thickness_mm or 0.0
            yield from _change(front, "thickness_mm", thickness, fraction * stated.thickness_mm)


def _change(surface: int, key: str, value: float, step_mm: float) -> Iterator[tuple[int, str, float, float]]:
    rounded = round(value, -math.floor(math.log10(step_mm)))
    if rounded and rounded != value:
        yield surface, key, value, rounded
