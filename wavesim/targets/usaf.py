"""The USAF 1951 resolution chart: where its elements are, how wide their lines, and the chart on a grid.

Element e of group g has 2^(g + (e - 1)/6) line pairs per mm, lines of 500 / 2^(g + (e - 1)/6) um, and two
sets of three bars, five line widths long (MIL-STD-150A). An even group and the next odd one share a square:
the even group's element 1 lies in the lower right corner, its elements 2 to 6 in the left column, the odd
group in the right column. The next two groups fill the space between, four times smaller. Gaps between sets
and between elements are two line widths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from lensdesign.errors import InputError, SamplingError, validate_positive
from wavesim.fields.coverage import (
    SAMPLES_PER_FEATURE,
    Rectangle,
    bar_rectangles,
    rectangle_coverage,
    validate_sampling,
    validate_two_dimensional,
)
from wavesim.fields.field import Grid, Orientation, axis_of
from wavesim.targets.patterns import ComplexArray, Ground, on_ground

GROUPS = range(4, 11)
ELEMENTS = range(1, 7)
BESIDE = 8
"""Coarsest group of charts beside the one in the middle."""
BARS = 3
LENGTH = 5.0
"""Of a bar, and side of a set, in line widths."""
GAP = 2.0
"""Between sets and between elements, in line widths."""

_SIDE = 26.0
"""Of the square of two groups, in line widths of its coarsest element."""


def usaf_line_width_um(group: int, element: int) -> float:
    """Width of an element's lines.

    Raises
    ------
    InputError
        If the group is not one of 4 to 10, or the element not one of 1 to 6.
    """
    if group not in GROUPS or element not in ELEMENTS:
        raise InputError(
            f"USAF group {group!r}, element {element!r}: allowed: groups 4 to 10, elements 1 to 6"
        )
    return float(500.0 / 2.0 ** (group + (element - 1) / 6.0))


@dataclass(frozen=True)
class UsafElement:
    """One element of the chart, in place.

    Attributes
    ----------
    group, element : int
        Its number.
    centre_mm : (x, y)
        Middle between its two sets.
    """

    group: int
    element: int
    centre_mm: tuple[float, float]

    @property
    def line_width_um(self) -> float:
        """Width of a bar and of a gap."""
        return usaf_line_width_um(self.group, self.element)

    @property
    def outline(self) -> Rectangle:
        """Smallest rectangle around both sets."""
        across, down = (0.5e-3 * self.line_width_um * side for side in (2.0 * LENGTH + GAP, LENGTH))
        x, y = self.centre_mm
        return Rectangle(x - across, x + across, y - down, y + down)

    def set_centre_mm(self, orientation: Orientation) -> tuple[float, float]:
        """Middle (x, y) of the set whose bars follow each other along an axis."""
        offset = 0.5e-3 * self.line_width_um * (LENGTH + GAP)
        x, y = self.centre_mm
        return (x + offset if axis_of(orientation) else x - offset), y

    def bars(self, orientation: Orientation) -> tuple[Rectangle, ...]:
        """The three bars of the set whose bars follow each other along an axis."""
        return self._rectangles(orientation, BARS)

    def gaps(self, orientation: Orientation) -> tuple[Rectangle, ...]:
        """The two gaps between them."""
        return self._rectangles(orientation, BARS - 1)

    def _rectangles(self, orientation: Orientation, count: int) -> tuple[Rectangle, ...]:
        width = 1e-3 * self.line_width_um
        return bar_rectangles(width, count, orientation, self.set_centre_mm(orientation), LENGTH * width)


def usaf_elements(
    groups: Sequence[int] = GROUPS, centre_mm: tuple[float, float] = (0.0, 0.0)
) -> tuple[UsafElement, ...]:
    """All six elements of each of some groups in the nested layout, the coarsest first.

    Parameters
    ----------
    groups
        From 4 to 10, without gaps between them.
    centre_mm
        Middle (x, y) of the rectangle around them.

    Raises
    ------
    InputError
        If there are no groups, or they do not follow each other, or are not between 4 and 10.
    """
    chosen = sorted(set(groups))
    if not chosen or any(group not in GROUPS for group in chosen) or chosen[-1] - chosen[0] >= len(chosen):
        raise InputError(f"USAF groups = {list(groups)}: give neighbours from 4 to 10, such as 6, 7, 8")
    placed = [
        _place(group, element, _middle_of_square(group - group % 2, chosen[0] - chosen[0] % 2))
        for group in chosen
        for element in ELEMENTS
    ]
    return _about(placed, centre_mm)


def _about(elements: Sequence[UsafElement], centre_mm: tuple[float, float]) -> tuple[UsafElement, ...]:
    """Elements moved such that the middle of the rectangle around them lies at a point."""
    around = chart_outline(elements)
    dx = centre_mm[0] - 0.5 * (around.left_mm + around.right_mm)
    dy = centre_mm[1] - 0.5 * (around.low_mm + around.high_mm)
    return tuple(replace(one, centre_mm=(one.centre_mm[0] + dx, one.centre_mm[1] + dy)) for one in elements)


def chart_outline(elements: Sequence[UsafElement]) -> Rectangle:
    """Smallest rectangle around some elements."""
    outlines = [one.outline for one in elements]
    return Rectangle(
        min(one.left_mm for one in outlines),
        max(one.right_mm for one in outlines),
        min(one.low_mm for one in outlines),
        max(one.high_mm for one in outlines),
    )


def usaf_elements_within(grid: Grid, side_mm: float) -> tuple[UsafElement, ...]:
    """The groups that fit a square about the grid's centre, down to the finest element that the grid shows.

    Parameters
    ----------
    grid
        A plane.
    side_mm
        Of the square; the square inside a disc has 1 / sqrt(2) of its diameter.

    Raises
    ------
    InputError
        If the side is not usable, or no group fits.
    SamplingError
        If the grid is too coarse for every element that fits.
    """
    validate_two_dimensional(grid)
    validate_positive("side_mm", side_mm)
    for coarsest in GROUPS:
        elements = usaf_elements(range(coarsest, GROUPS.stop), grid.centre_mm)
        around = chart_outline(elements)
        if max(around.right_mm - around.left_mm, around.high_mm - around.low_mm) <= side_mm:
            break
    else:
        raise InputError(f"side_mm = {side_mm:g}: too small for group {GROUPS[-1]}, the finest of the chart")
    return _shown(elements, grid, f"fit {side_mm:g} mm")


def usaf_elements_beside(
    grid: Grid,
    centre_mm: tuple[float, float],
    field_stop_mm: float,
    charts: Sequence[Sequence[UsafElement]],
) -> tuple[UsafElement, ...]:
    """Fine groups about a point beside other charts: 8 to 10, or fewer where there is no room for all.

    Parameters
    ----------
    grid
        A plane.
    centre_mm
        Middle (x, y) of the chart, from the grid's centre.
    field_stop_mm
        Diameter of the round field stop about the grid's centre, in which the chart must lie.
    charts
        Elements of each chart that is there already.

    Raises
    ------
    InputError
        If not even the finest group fits between the others and the field stop's edge.
    SamplingError
        If the grid is too coarse for every element that fits.
    """
    validate_two_dimensional(grid)
    x, y = centre_mm
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"chart at {x!r}, {y!r} mm: must be finite")
    middle = (grid.centre_mm[0] + x, grid.centre_mm[1] + y)
    others = [chart_outline(chart) for chart in charts]
    finest = _shown(usaf_elements(range(BESIDE, GROUPS.stop)), grid, f"stand {x:g}, {y:g} mm off the middle")
    said = ""
    for coarsest in range(BESIDE, finest[-1].group + 1):
        elements = _about([one for one in finest if one.group >= coarsest], middle)
        around = chart_outline(elements)
        said = _no_room(around, grid.centre_mm, 0.5 * field_stop_mm, others)
        if not said:
            return elements
    sides = f"{around.right_mm - around.left_mm:.3g} mm x {around.high_mm - around.low_mm:.3g} mm"
    raise InputError(f"chart at {x:g}, {y:g} mm: even of group {coarsest} alone, {sides}, it {said}")


def _no_room(
    around: Rectangle, centre_mm: tuple[float, float], radius_mm: float, others: list[Rectangle]
) -> str:
    """Why a chart cannot stand in a rectangle; nothing if it can."""
    corners = [(x, y) for x in (around.left_mm, around.right_mm) for y in (around.low_mm, around.high_mm)]
    if any(math.dist(corner, centre_mm) > radius_mm for corner in corners):
        return f"reaches beyond the field stop of {2.0 * radius_mm:g} mm"
    apart = (
        around.left_mm > one.right_mm
        or one.left_mm > around.right_mm
        or around.low_mm > one.high_mm
        or one.low_mm > around.high_mm
        for one in others
    )
    return "" if all(apart) else "overlaps another chart"


def _shown(elements: Sequence[UsafElement], grid: Grid, where: str) -> tuple[UsafElement, ...]:
    """Elements whose lines a grid shows."""
    narrowest = SAMPLES_PER_FEATURE * 1e3 * grid.pitch_mm
    shown = tuple(one for one in elements if one.line_width_um >= narrowest)
    if not shown:
        raise SamplingError(
            f"the grid's pitch of {1e3 * grid.pitch_mm:.4g} um: too coarse for lines of "
            f"{elements[0].line_width_um:.4g} um, the widest that {where}; give "
            f"{elements[0].line_width_um / SAMPLES_PER_FEATURE:.4g} um or less"
        )
    return shown


def usaf_chart(grid: Grid, elements: Sequence[UsafElement], ground: Ground = "bright") -> ComplexArray:
    """Transmission of some elements on a plane grid; edges are integrated exactly over the cells.

    Parameters
    ----------
    grid
        A plane.
    elements
        From :func:`usaf_elements` or :func:`usaf_elements_within`.
    ground
        "bright": opaque bars, bright field; "dark": clear bars, dark field.

    Raises
    ------
    InputError
        If there are no elements, or they reach beyond the grid.
    SamplingError
        If lines are narrower than two samples.
    """
    if not elements:
        raise InputError("a USAF chart needs one element at least")
    finest = min(elements, key=lambda one: one.line_width_um)
    validate_sampling(grid, finest.line_width_um, f"lines (group {finest.group}, element {finest.element})")
    bars = [bar for one in elements for way in _ORIENTATIONS for bar in one.bars(way)]
    return on_ground(rectangle_coverage(grid, bars), ground)


_ORIENTATIONS: tuple[Orientation, Orientation] = ("x", "y")


def _middle_of_square(even: int, outermost: int) -> tuple[float, float]:
    """Middle of the square of two groups, from that of the outermost square.

    Each lies halfway between the columns around it.
    """
    x = 0.0
    for group in range(outermost, even, 2):
        width = 1e-3 * usaf_line_width_um(group, 1)
        left, right = ((2.0 * LENGTH + GAP) * width * part for part in (2.0 ** (-1.0 / 6.0), 0.5))
        x += 0.5 * (left - right)
    return x, 0.0


def _place(group: int, element: int, middle_mm: tuple[float, float]) -> UsafElement:
    """An element in the square about a middle."""
    width = 1e-3 * usaf_line_width_um(group, element)
    side = _SIDE * 1e-3 * usaf_line_width_um(group - group % 2, 1)
    half_across, half_down = 0.5 * (2.0 * LENGTH + GAP) * width, 0.5 * LENGTH * width
    x, y = middle_mm
    if group % 2 == 0 and element == 1:
        return UsafElement(group, element, (x + 0.5 * side - half_across, y - 0.5 * side + half_down))
    # Columns start at the top; the even group's with element 2.
    above = range(2 - group % 2, element)
    top = 0.5 * side - math.fsum((LENGTH + GAP) * 1e-3 * usaf_line_width_um(group, one) for one in above)
    column = 0.5 * side - half_across
    return UsafElement(group, element, (x + (column if group % 2 else -column), y + top - half_down))
