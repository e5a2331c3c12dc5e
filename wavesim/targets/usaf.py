"""The USAF 1951 resolution chart: positions and line widths of its elements, and the chart on a grid.

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
    rectangle_coverage,
    validate_sampling,
    validate_two_dimensional,
)
from wavesim.fields.field import Grid, Orientation, axis_of
from wavesim.targets.bars import bar_rectangles
from wavesim.targets.patterns import ComplexArray, Polarity, with_polarity

GROUPS = range(4, 11)
ELEMENTS = range(1, 7)
BARS = 3
LENGTH = 5.0
"""Length of a bar, and side of a set, in line widths."""
GAP = 2.0
"""Distance between sets and between elements, in line widths."""


def usaf_line_width_um(group: int, element: int) -> float:
    """Return the line width of an element (um).

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
    """An element of the chart with its position.

    Attributes
    ----------
    group, element : int
        Group and element number.
    centre_mm : (x, y)
        Centre between its two sets.
    """

    group: int
    element: int
    centre_mm: tuple[float, float]

    @property
    def line_width_um(self) -> float:
        """Width of a bar and of a gap (um)."""
        return usaf_line_width_um(self.group, self.element)

    @property
    def outline(self) -> Rectangle:
        """Smallest rectangle around both sets."""
        across, down = (0.5e-3 * self.line_width_um * side for side in (2.0 * LENGTH + GAP, LENGTH))
        x, y = self.centre_mm
        return Rectangle(x - across, x + across, y - down, y + down)

    def set_centre_mm(self, orientation: Orientation) -> tuple[float, float]:
        """Return the centre (x, y) of the set whose bars are repeated along an axis."""
        offset = 0.5e-3 * self.line_width_um * (LENGTH + GAP)
        x, y = self.centre_mm
        return (x + offset if axis_of(orientation) else x - offset), y

    def bars(self, orientation: Orientation) -> tuple[Rectangle, ...]:
        """Return the three bars of the set whose bars are repeated along an axis."""
        return self._rectangles(orientation, BARS)

    def gaps(self, orientation: Orientation) -> tuple[Rectangle, ...]:
        """Return the two gaps between the bars of a set."""
        return self._rectangles(orientation, BARS - 1)

    def _rectangles(self, orientation: Orientation, count: int) -> tuple[Rectangle, ...]:
        width = 1e-3 * self.line_width_um
        return bar_rectangles(width, count, orientation, self.set_centre_mm(orientation), LENGTH * width)


def usaf_elements(
    groups: Sequence[int] = GROUPS, centre_mm: tuple[float, float] = (0.0, 0.0)
) -> tuple[UsafElement, ...]:
    """Return all six elements of each group in the nested layout, the coarsest first.

    Parameters
    ----------
    groups
        Consecutive groups from 4 to 10.
    centre_mm
        Centre (x, y) of the rectangle around all elements.

    Returns
    -------
    tuple of UsafElement
        Elements with their positions.

    Raises
    ------
    InputError
        If there are no groups, they are not consecutive, or a group is not between 4 and 10.
    """
    chosen = sorted(set(groups))
    if not chosen or any(group not in GROUPS for group in chosen) or chosen[-1] - chosen[0] >= len(chosen):
        raise InputError(
            f"USAF groups = {list(groups)}: must be consecutive groups from 4 to 10, such as 6, 7, 8"
        )
    elements = [
        _positioned(group, element, _square_centre_mm(group - group % 2, chosen[0] - chosen[0] % 2))
        for group in chosen
        for element in ELEMENTS
    ]
    return _centred_at(elements, centre_mm)


def _centred_at(elements: Sequence[UsafElement], centre_mm: tuple[float, float]) -> tuple[UsafElement, ...]:
    """Move elements so that the rectangle around them is centred at a point."""
    around = chart_outline(elements)
    dx = centre_mm[0] - 0.5 * (around.left_mm + around.right_mm)
    dy = centre_mm[1] - 0.5 * (around.low_mm + around.high_mm)
    return tuple(replace(one, centre_mm=(one.centre_mm[0] + dx, one.centre_mm[1] + dy)) for one in elements)


def chart_outline(elements: Sequence[UsafElement]) -> Rectangle:
    """Return the smallest rectangle around all elements."""
    outlines = [one.outline for one in elements]
    return Rectangle(
        min(one.left_mm for one in outlines),
        max(one.right_mm for one in outlines),
        min(one.low_mm for one in outlines),
        max(one.high_mm for one in outlines),
    )


def usaf_elements_within(grid: Grid, side_mm: float) -> tuple[UsafElement, ...]:
    """Return the groups that fit a square at the grid's centre, down to the finest element on the grid.

    Parameters
    ----------
    grid
        Grid of the object plane.
    side_mm
        Side of the square. The square inside a disc has 1 / sqrt(2) of its diameter.

    Returns
    -------
    tuple of UsafElement
        Elements with their positions.

    Raises
    ------
    InputError
        If the side is not positive and finite, or no group fits.
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
    return _resolved_by_grid(elements, grid, f"fit {side_mm:g} mm")


def usaf_elements_beside(
    grid: Grid,
    centre_mm: tuple[float, float],
    field_stop_mm: float,
    charts: Sequence[Sequence[UsafElement]],
) -> tuple[UsafElement, ...]:
    """Return groups 8 to 10 around a point beside other charts, or fewer if the space does not suffice.

    Parameters
    ----------
    grid
        Grid of the object plane.
    centre_mm
        Centre (x, y) of the chart, from the grid's centre.
    field_stop_mm
        Diameter of the round field stop at the grid's centre, in which the chart must lie.
    charts
        Elements of each existing chart.

    Returns
    -------
    tuple of UsafElement
        Elements with their positions.

    Raises
    ------
    InputError
        If not even the finest group fits between the other charts and the edge of the field stop.
    SamplingError
        If the grid is too coarse for every element that fits.
    """
    validate_two_dimensional(grid)
    x, y = centre_mm
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"chart at {x!r}, {y!r} mm: must be finite")
    middle = (grid.centre_mm[0] + x, grid.centre_mm[1] + y)
    others = [chart_outline(chart) for chart in charts]
    first_group = 8
    finest = _resolved_by_grid(
        usaf_elements(range(first_group, GROUPS.stop)), grid, f"are {x:g}, {y:g} mm from the centre"
    )
    reason = ""
    for coarsest in range(first_group, finest[-1].group + 1):
        elements = _centred_at([one for one in finest if one.group >= coarsest], middle)
        around = chart_outline(elements)
        reason = _misfit_reason(around, grid.centre_mm, 0.5 * field_stop_mm, others)
        if not reason:
            return elements
    sides = f"{around.right_mm - around.left_mm:.3g} mm x {around.high_mm - around.low_mm:.3g} mm"
    raise InputError(f"chart at {x:g}, {y:g} mm: even group {coarsest} alone ({sides}) {reason}")


def _misfit_reason(
    around: Rectangle, centre_mm: tuple[float, float], radius_mm: float, others: list[Rectangle]
) -> str:
    """Return why a chart does not fit in a rectangle; empty if it fits."""
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


def _resolved_by_grid(elements: Sequence[UsafElement], grid: Grid, condition: str) -> tuple[UsafElement, ...]:
    """Return the elements whose lines the grid resolves. `condition` describes them in the message."""
    narrowest = SAMPLES_PER_FEATURE * 1e3 * grid.pitch_mm
    shown = tuple(one for one in elements if one.line_width_um >= narrowest)
    if not shown:
        raise SamplingError(
            f"the grid's pitch of {1e3 * grid.pitch_mm:.4g} µm: too coarse for lines of "
            f"{elements[0].line_width_um:.4g} µm, the widest that {condition}; give a pitch "
            f"(object_pitch_um) of {elements[0].line_width_um / SAMPLES_PER_FEATURE:.4g} µm or less"
        )
    return shown


def usaf_chart(grid: Grid, elements: Sequence[UsafElement], polarity: Polarity = "bright") -> ComplexArray:
    """Return the transmission of a USAF 1951 chart (MIL-STD-150A) on a grid.

    The value of a cell is its mean transmission: cells at the edge of a bar are partly transparent.

    Parameters
    ----------
    grid
        Grid of the object plane.
    elements
        Elements from :func:`usaf_elements` or :func:`usaf_elements_within`.
    polarity
        "bright" for opaque bars on a bright field, "dark" for clear bars on a dark field.

    Returns
    -------
    ndarray, shape (ny, nx)
        Complex transmission of each cell.

    Raises
    ------
    InputError
        If there are no elements, or they reach beyond the grid.
    SamplingError
        If lines are narrower than two samples.

    Examples
    --------
    Group 8, with lines of 1.95 um and less, on samples of 0.25 um:

    >>> from wavesim import Grid, usaf_chart
    >>> from wavesim.targets import usaf_elements
    >>> chart = usaf_chart(Grid((256, 256), 2.5e-4, 0.0), usaf_elements([8]), "dark")
    >>> chart.shape, round(float(chart.real.mean()), 2)
    ((256, 256), 0.1)
    """
    if not elements:
        raise InputError("a USAF chart needs at least one element")
    finest = min(elements, key=lambda one: one.line_width_um)
    validate_sampling(grid, finest.line_width_um, f"lines (group {finest.group}, element {finest.element})")
    orientations: tuple[Orientation, Orientation] = ("x", "y")
    bars = [bar for one in elements for orientation in orientations for bar in one.bars(orientation)]
    return with_polarity(rectangle_coverage(grid, bars), polarity)


def _square_centre_mm(even_group: int, outermost: int) -> tuple[float, float]:
    """Return the centre of the square of two groups, relative to that of the outermost square.

    Each square lies halfway between the columns around it.
    """
    x = 0.0
    for group in range(outermost, even_group, 2):
        width = 1e-3 * usaf_line_width_um(group, 1)
        left, right = ((2.0 * LENGTH + GAP) * width * factor for factor in (2.0 ** (-1.0 / 6.0), 0.5))
        x += 0.5 * (left - right)
    return x, 0.0


def _positioned(group: int, element: int, square_centre_mm: tuple[float, float]) -> UsafElement:
    """Return an element at its position in the square of its two groups."""
    width = 1e-3 * usaf_line_width_um(group, element)
    side = 26.0 * 1e-3 * usaf_line_width_um(group - group % 2, 1)  # 26 line widths of the coarsest element.
    half_across, half_down = 0.5 * (2.0 * LENGTH + GAP) * width, 0.5 * LENGTH * width
    x, y = square_centre_mm
    if group % 2 == 0 and element == 1:
        return UsafElement(group, element, (x + 0.5 * side - half_across, y - 0.5 * side + half_down))
    # Columns start at the top; the even group's with element 2.
    above = range(2 - group % 2, element)
    top = 0.5 * side - math.fsum((LENGTH + GAP) * 1e-3 * usaf_line_width_um(group, one) for one in above)
    column = 0.5 * side - half_across
    return UsafElement(group, element, (x + (column if group % 2 else -column), y + top - half_down))
