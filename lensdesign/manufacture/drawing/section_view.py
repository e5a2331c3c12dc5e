"""Section view of a glass element to scale, with dimensions and datum axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.edges import Flange
from lensdesign.lens.solid import Element
from lensdesign.manufacture.drawing.moulding_list import GATE_NAME
from lensdesign.manufacture.drawing.primitives import (
    ASCENT,
    CENTRE_LINE_DASHES,
    THICK_MM,
    Area,
    Item,
    Stroke,
    Text,
    frame,
    line,
    text_width_mm,
)
from lensdesign.manufacture.drawing.table import clear_text
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances

SCALES = tuple(sorted(m * 10.0**n for m in (1.0, 2.0, 5.0) for n in range(-6, 7)))
"""Preferred scales of ISO 5455, extended in both directions."""

LEFT_MM, RIGHT_MM, TOP_MM, BOTTOM_MM = 24.0, 42.0, 20.0, 18.0
"""Margins for dimensions around the view."""

CLEAR_OFFSET_MM, GROUND_OFFSET_MM, THICKNESS_OFFSET_MM = 13.0, 26.0, 9.0
"""Distances from the body to the dimension lines of clear diameters, ground diameter and thicknesses."""

FLANGE_MARGIN_MM, FLANGE_ROW_MM = 13.0, 9.0
"""Additional margins at the left and below for the dimensions of a flange."""

TEXT_MM, NAME_MM, ARROW_MM = 3.2, 4.2, 2.4
"""Height of texts of dimensions and of the names of surfaces; length of an arrow head."""

HATCH_MM, HATCH_STROKE_MM = 5.0, 4.0
"""Distance between groups of strokes; length of the middle stroke."""


@dataclass(frozen=True)
class SectionView:
    """A view and its scale: lengths on paper divided by lengths of the part."""

    items: tuple[Item, ...]
    scale: float

    @property
    def scale_text(self) -> str:
        """Scale in words, such as `2:1` for twice the size."""
        return f"{self.scale:g}:1" if self.scale >= 1.0 else f"1:{1.0 / self.scale:g}"


@dataclass(frozen=True)
class _Body:
    """Coordinates of a body on paper.

    Attributes
    ----------
    front, back : ndarray, shape (n, 2)
        Profiles of the two surfaces: height above the axis, and x.
    axis_y
        y of the axis.
    clear
        x and height of the rim of both clear apertures; None for a surface without one.
    flange : ndarray, shape (0 or 4, 2)
        Corners of the flange: height above the axis, and x.
    gate_flat
        Height of the gate flat below the axis; inf without one.
    """

    front: Array
    back: Array
    axis_y: float
    clear: tuple[tuple[float, float] | None, tuple[float, float] | None]
    flange: Array
    gate_flat: float = math.inf

    @property
    def half(self) -> float:
        """Half of the ground diameter, at the wide end of an edge with draft."""
        return float(max(self.front[-1, 0], self.back[-1, 0]))

    @property
    def wide_x(self) -> float:
        """x of the end of the edge with the ground diameter: the right end of a cylinder."""
        return float(self.front[-1, 1] if self.front[-1, 0] > self.back[-1, 0] else self.back[-1, 1])

    @property
    def outer(self) -> float:
        """Half of the largest diameter, that of the flange if there is one."""
        return float(np.max(self.flange[:, 0], initial=self.half))

    @property
    def leftmost(self) -> float:
        return float(np.min(self.front[:, 1]))

    @property
    def rightmost(self) -> float:
        return float(np.max(self.back[:, 1]))

    def contains(self, x: Array, y: Array, margin: float) -> Array:
        """Return which points are inside the body by at least a margin."""
        r = np.abs(y - self.axis_y)
        front, back = (np.interp(r, *profile.T) for profile in (self.front, self.back))
        half = np.where(y < self.axis_y, min(self.narrow, self.gate_flat), self.narrow)
        return np.asarray((r <= half - margin) & (x >= front + margin) & (x <= back - margin))

    @property
    def narrow(self) -> float:
        """Half of the diameter at the narrow end of the edge."""
        return float(min(self.front[-1, 0], self.back[-1, 0]))


def section_view(element: Element, tolerances: DrawingTolerances, area: Area) -> SectionView:
    """Draw an element at the largest preferred scale that fits.

    Parameters
    ----------
    element
        A body that closes.
    tolerances
        Tolerances of the element; thickness and diameter are used.
    area
        Area of the view and its dimensions on the sheet.
    """
    t = np.linspace(0.0, 1.0, 129)
    front, back = element.profiles(t, t)
    length = float(np.max(back[:, 1]) - np.min(front[:, 1]))
    if element.edge.flange is not None:
        area = area._replace(left=area.left + FLANGE_MARGIN_MM, bottom=area.bottom + FLANGE_ROW_MM)
    width, height = area.width - LEFT_MM - RIGHT_MM, area.height - TOP_MM - BOTTOM_MM
    largest = min(width / length, height / (2.0 * element.outer_mm))
    scale = max((s for s in SCALES if s <= largest), default=SCALES[0])
    body = _body_on_paper(element, front, back, scale, area)
    thickness = element.center_thickness_mm
    items = [*_outline(body), *_hatching(body), *_axis(body), *_names(body)]
    items += _clear_diameters(body, element)
    items += _ground_diameter(body, _toleranced(2.0 * element.edge_mm, tolerances, "diameter_mm", "Ø "))
    items += _thickness(body, _toleranced(thickness, tolerances, "thickness_mm"))
    items += _edge_thickness(body, f"({back[-1, 1] - front[-1, 1]:.4g})")
    if not element.rotational:
        items.append(_orientation_mark(body))
    items += _flange(body, element.edge.flange)
    return SectionView(tuple(items), scale)


def _toleranced(value: float, tolerances: DrawingTolerances, name: str, prefix: str = "") -> str:
    """Return the text of a dimension with its tolerance, if it has one."""
    allowed = getattr(tolerances, name)
    return f"{prefix}{value:.6g}" + (f" ±{allowed:g}{tolerances.mark(name)}" if allowed is not None else "")


def _body_on_paper(
    element: Element, front_profile: Array, back_profile: Array, scale: float, area: Area
) -> _Body:
    middle = 0.5 * (float(np.min(front_profile[:, 1])) + float(np.max(back_profile[:, 1])))
    x0 = 0.5 * (area.left + LEFT_MM + area.right - RIGHT_MM)
    axis_y = 0.5 * (area.bottom + BOTTOM_MM + area.top - TOP_MM)

    def on_paper(points: Array) -> Array:
        return np.stack([scale * points[:, 0], x0 + scale * (points[:, 1] - middle)], axis=-1)

    def rim(meridian_profile: Array, semi: float | None) -> tuple[float, float] | None:
        if semi is None:
            return None
        return float(np.interp(scale * semi, *meridian_profile.T)), scale * semi

    profiles, flange = (on_paper(front_profile), on_paper(back_profile)), on_paper(element.flange_corners)
    sides = zip(profiles, (element.front, element.back), strict=True)
    left, right = (rim(profile, meridian.surface.semi_diameter_mm) for profile, meridian in sides)
    gate = element.edge.gate
    gate_flat = math.inf if gate is None else scale * (element.outer_mm - gate.flat_depth_mm)
    return _Body(*profiles, axis_y, (left, right), flange, gate_flat)


def _outline(body: _Body) -> list[Item]:
    half = np.concatenate([body.front, body.flange, body.back[::-1]])
    lower = _cut(half, body.gate_flat)
    around = np.concatenate([half, lower[::-1] * [-1.0, 1.0]])
    points = tuple((float(x), body.axis_y + float(r)) for r, x in around)
    items: list[Item] = [Stroke(points, THICK_MM, closed=True)]
    if math.isfinite(body.gate_flat):
        on_flat = lower[np.isclose(lower[:, 0], body.gate_flat)]
        tip = float(np.mean(on_flat[:, 1])), body.axis_y - body.gate_flat
        # Left of the body and between the extension lines of diameters and thicknesses.
        name = Text(body.leftmost - 4.0, body.axis_y - body.outer - 4.4, GATE_NAME, TEXT_MM, "end")
        start = name.x_mm + 0.8, name.y_mm + 0.4 * TEXT_MM
        length = math.dist(start, tip)
        along = (tip[0] - start[0]) / length, (tip[1] - start[1]) / length
        items += [line(*start, *tip), _arrow(*tip, *along), name]
    return items


def _cut(half: Array, height: float) -> Array:
    """Return an outline of points (height, x) without what lies above a height: the flat of a gate."""
    above = np.flatnonzero(half[:, 0] > height)
    if not len(above):
        return half
    first, last = int(above[0]), int(above[-1])

    def crossing(inside: Array, outside: Array) -> Array:
        fraction = (height - inside[0]) / (outside[0] - inside[0])
        return np.asarray(inside + fraction * (outside - inside))

    ends = [crossing(half[first - 1], half[first]), crossing(half[last + 1], half[last])]
    return np.concatenate([half[:first], ends, half[last + 1 :]])


def _hatching(body: _Body) -> list[Item]:
    """Draw the hatching of glass in section: groups of a long stroke between two short ones."""
    margin = 0.6
    s = 0.5 * math.sqrt(0.5) * HATCH_STROKE_MM
    shifts, lengths = 1.1 * math.sqrt(0.5) * np.array([-1.0, 0.0, 1.0]), np.array([0.45, 1.0, 0.45])
    items: list[Item] = []
    across = 0.5 * (body.rightmost - body.leftmost)
    columns = 0.5 * (body.leftmost + body.rightmost) + HATCH_MM * _centred(across / HATCH_MM)
    along = np.linspace(-1.0, 1.0, 9)
    for row in _centred(body.half / HATCH_MM):
        y = body.axis_y + HATCH_MM * row
        for x in columns + 0.25 * HATCH_MM * (-1.0) ** (row + 0.5):
            px = x + shifts[:, None] + lengths[:, None] * s * along
            py = y - shifts[:, None] + lengths[:, None] * s * along
            if np.all(body.contains(px, py, margin)):
                ends = zip(px[:, [0, -1]].tolist(), py[:, [0, -1]].tolist(), strict=True)
                items += [line(a[0], b[0], a[1], b[1], 0.18) for a, b in ends]
    return items


def _centred(limit: float) -> Array:
    """Return the half-integers ..., -0.5, 0.5, 1.5, ... within a limit."""
    count = math.ceil(limit)
    return np.arange(-count, count, dtype=float) + 0.5


def _axis(body: _Body) -> list[Item]:
    y = body.axis_y
    return [Stroke(((body.leftmost - 8.0, y), (body.rightmost + 8.0, y)), dashes_mm=CENTRE_LINE_DASHES)]


def _names(body: _Body) -> list[Item]:
    """Draw the names L and R of the left and right surface, clear of the axis and extension lines."""
    items: list[Item] = []
    ends = (("L", body.front, -5.0, ()), ("R", body.back, 5.0, (body.half,)))
    for (name, profile, offset, levels), rim in zip(ends, body.clear, strict=True):
        lines = (*levels, rim[1]) if rim else levels
        y = body.axis_y + _clear_of(lines, 2.2, NAME_MM) + 0.3
        items.append(Text(float(profile[0, 1]) + offset, y, name, NAME_MM, "middle"))
    return items


def _clear_of(levels: Sequence[float], foot: float, height: float) -> float:
    """Return the lowest y from `foot` upwards at which a text of this height crosses none of the levels."""
    margin = 1.0
    for level in sorted(levels):
        if foot - margin < level < foot + height + margin:
            foot = level + margin
    return foot


def _arrow(x: float, y: float, dx: float, dy: float) -> Stroke:
    """Return an arrow head with its tip at (x, y), pointing along (dx, dy)."""
    back_x, back_y, wide = x - ARROW_MM * dx, y - ARROW_MM * dy, 0.16 * ARROW_MM
    corners = ((x, y), (back_x - wide * dy, back_y + wide * dx), (back_x + wide * dy, back_y - wide * dx))
    return Stroke(corners, 0.1, closed=True, filled=True)


@dataclass(frozen=True)
class _Dimension:
    """A vertical dimension and the y of the upper end of its line."""

    items: tuple[Item, ...]
    top: float


def _vertical(
    x: float, y0: float, y1: float, start: float, text: str, crossing: float = -math.inf
) -> _Dimension:
    """Draw a dimension line from y0 to y1 at x, with extension lines from x = `start`.

    A text that does not fit is drawn above the line, and above a line at y = `crossing` that it would cross.
    """
    width = text_width_mm(text, TEXT_MM)
    inside = y1 - y0 > max(width + 1.0, 3.0 * ARROW_MM)
    foot = _clear_of((crossing,), y1 + 2.0 * ARROW_MM, width)
    top = y1 if inside else foot + width + 1.0
    bottom = y0 if inside else y0 - 2.0 * ARROW_MM
    outward = 1.0 if inside else -1.0
    side = math.copysign(1.0, x - start)
    middle = 0.5 * (y0 + y1) if inside else foot + 0.5 * width
    items: tuple[Item, ...] = (
        line(x, bottom, x, top),
        _arrow(x, y1, 0.0, outward),
        _arrow(x, y0, 0.0, -outward),
        *(line(start + 0.8 * side, y, x + 1.5 * side, y) for y in (y0, y1)),
        Text(x - 1.2, middle, text, TEXT_MM, "middle", upward=True),
    )
    return _Dimension(items, top)


def _horizontal(
    y: float, x0: float, x1: float, from_y: tuple[float, float], text: str, side: float, clear: bool = True
) -> list[Item]:
    """Draw a dimension line from x0 to x1 at y, with extension lines from y = `from_y`.

    A text that does not fit, or that other lines would cross (not `clear`), is drawn at one side (-1 or 1).
    """
    width = text_width_mm(text, TEXT_MM)
    inside = clear and x1 - x0 > width + 2.0 * ARROW_MM
    items: list[Item] = []
    for x, start in zip((x0, x1), from_y, strict=True):
        sign = math.copysign(1.0, y - start)
        items.append(line(x, start + 0.8 * sign, x, y + 1.5 * sign))
    if inside:
        items += [line(x0, y, x1, y), _arrow(x0, y, -1.0, 0.0), _arrow(x1, y, 1.0, 0.0)]
        items.append(Text(0.5 * (x0 + x1), y + 1.0, text, TEXT_MM, "middle"))
        return items
    reach = 2.0 * ARROW_MM
    left, right = x0 - reach, x1 + reach
    if side > 0.0:
        right += width + 1.0
        items.append(Text(right, y + 1.0, text, TEXT_MM, "end"))
    else:
        left -= width + 1.0
        items.append(Text(left, y + 1.0, text, TEXT_MM))
    items += [line(left, y, right, y), _arrow(x0, y, 1.0, 0.0), _arrow(x1, y, -1.0, 0.0)]
    return items


def _clear_diameters(body: _Body, element: Element) -> list[Item]:
    items: list[Item] = []
    # The extension line of the ground diameter crosses the right dimension, that of a flange the left one.
    positions = (
        (body.leftmost - CLEAR_OFFSET_MM, body.axis_y + body.outer if len(body.flange) else -math.inf),
        (body.rightmost + CLEAR_OFFSET_MM, body.axis_y + body.half),
    )
    for (x, crossing), rim, meridian in zip(
        positions, body.clear, (element.front, element.back), strict=True
    ):
        if rim is not None:
            text = clear_text(meridian.surface.semi_diameter_mm or 0.0)
            start, height = rim
            low, high = body.axis_y - height, body.axis_y + height
            items += _vertical(x, low, high, start, text, crossing).items
    return items


def _ground_diameter(body: _Body, text: str) -> list[Item]:
    """Draw the ground diameter with the datum triangle, which makes the axis of the edge the datum."""
    x, edge_x = body.rightmost + GROUND_OFFSET_MM, body.wide_x
    low, high = body.axis_y - body.half, body.axis_y + body.half
    dimension = _vertical(x, low, high, edge_x, text)
    items, base = list(dimension.items), dimension.top
    side, top = 5.0, base + 5.0
    items.append(Stroke(((x - 1.4, base), (x + 1.4, base), (x, base + 2.4)), 0.1, closed=True, filled=True))
    items.append(line(x, base, x, top))
    items.append(frame(Area(x - 0.5 * side, top, x + 0.5 * side, top + side)))
    items.append(Text(x, top + 0.5 * side - 0.36 * TEXT_MM, "A", TEXT_MM, "middle"))
    return items


def _thickness(body: _Body, text: str) -> list[Item]:
    y = body.axis_y - body.outer - THICKNESS_OFFSET_MM
    x0, x1 = float(body.front[0, 1]), float(body.back[0, 1])
    clear = len(body.flange) == 0
    # A flange's extension lines cross this dimension.
    left_of_flange = not clear and float(np.mean(body.flange[:, 1])) > 0.5 * (x0 + x1)
    side = -1.0 if left_of_flange else 1.0
    return _horizontal(y, x0, x1, (body.axis_y, body.axis_y), text, side, clear)


def _edge_thickness(body: _Body, text: str) -> list[Item]:
    """Draw the edge thickness, in brackets because it follows from the other dimensions."""
    edges = body.axis_y + float(body.front[-1, 0]), body.axis_y + float(body.back[-1, 0])
    x0, x1 = float(body.front[-1, 1]), float(body.back[-1, 1])
    y = body.axis_y + body.outer + TOP_MM - 3.0 - 2.0 * ASCENT * TEXT_MM
    return _horizontal(y, x0, x1, edges, text, side=-1.0)


def _orientation_mark(body: _Body) -> Stroke:
    """Return a triangle on the edge that shows the orientation of a body without rotational symmetry."""
    (front_r, front_x), (back_r, back_x) = body.front[-1], body.back[-1]
    edge = body.outer if len(body.flange) else 0.5 * float(front_r + back_r)
    x, y = 0.5 * float(front_x + back_x), body.axis_y + edge
    height, half = 2.4, 1.2
    return Stroke(((x, y), (x - half, y + height), (x + half, y + height)), 0.1, closed=True, filled=True)


def _flange(body: _Body, flange: Flange | None) -> list[Item]:
    """Draw the flange's diameter at the left; below, its distance from the vertex and its thickness."""
    if flange is None:
        return []
    x = body.leftmost - CLEAR_OFFSET_MM - FLANGE_MARGIN_MM
    low, high = body.axis_y - body.outer, body.axis_y + body.outer
    front, back = float(body.flange[0, 1]), float(body.flange[-1, 1])
    items = list(_vertical(x, low, high, front, f"Ø {2.0 * flange.semi_diameter_mm:.6g}").items)
    vertex = (float(body.front[0, 1]), body.axis_y)
    y = low - THICKNESS_OFFSET_MM - FLANGE_ROW_MM
    (x0, y0), (x1, y1) = sorted([vertex, (front, low)])
    items += _horizontal(y, x0, x1, (y0, y1), f"{flange.distance_mm:.6g}", side=-1.0)
    items += _horizontal(y, front, back, (low, low), f"{flange.thickness_mm:.6g}", side=1.0)
    return items
