"""Fraction of each cell of a plane grid that a rectangle, a disc or a half-plane covers, in closed form."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError, validate_positive
from wavesim.fields.field import Grid

SAMPLES_PER_FEATURE = 2.0
"""Fewest samples across the narrowest feature of an object. Fewer samples would not resolve it."""

ROUNDING = 1.0 - 1e-9
"""Relative tolerance of comparisons between sizes that are meant to be equal."""


@dataclass(frozen=True)
class Rectangle:
    """A rectangle with sides along x and y, from `left_mm` to `right_mm` and from `low_mm` to `high_mm`."""

    left_mm: float
    right_mm: float
    low_mm: float
    high_mm: float

    @property
    def area_mm2(self) -> float:
        """Area of the rectangle."""
        return (self.right_mm - self.left_mm) * (self.high_mm - self.low_mm)


def rectangle(centre_mm: tuple[float, float], width_mm: float, height_mm: float) -> Rectangle:
    """Return the rectangle with a centre (x, y), a width along x and a height along y."""
    x, y = centre_mm
    return Rectangle(x - 0.5 * width_mm, x + 0.5 * width_mm, y - 0.5 * height_mm, y + 0.5 * height_mm)


def rectangle_coverage(grid: Grid, rectangles: Iterable[Rectangle]) -> Array:
    """Return the fraction of each cell that rectangles cover; they must not overlap.

    Raises
    ------
    InputError
        If the grid is a line, or a rectangle extends beyond it.
    """
    validate_two_dimensional(grid)
    covered = np.zeros(grid.shape)
    for one in rectangles:
        validate_inside(grid, one)
        rows, down = _interval(grid.y_mm, grid.pitch_mm, one.low_mm, one.high_mm)
        columns, across = _interval(grid.x_mm, grid.pitch_mm, one.left_mm, one.right_mm)
        covered[rows, columns] += np.outer(down, across)
    return covered


def disc_coverage(grid: Grid, radius_mm: float, at_mm: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the fraction of each cell inside a disc about a point (x, y) relative to the grid's centre.

    The area of a cell on the circle is the second difference of the area of the disc to the left of and below
    the cell's corners.
    """
    validate_two_dimensional(grid)
    validate_positive("radius_mm", radius_mm)
    edges = [
        grid.pitch_mm * (np.arange(count + 1) - 0.5 * count) - middle
        for count, middle in zip(grid.shape, reversed(at_mm), strict=True)
    ]
    ends = [np.sort(np.abs([edge[:-1], edge[1:]]), axis=0) for edge in edges]
    nearest = [
        np.where(edge[:-1] * edge[1:] < 0.0, 0.0, end[0]) for edge, end in zip(edges, ends, strict=True)
    ]
    whole = np.add.outer(ends[0][1] ** 2, ends[1][1] ** 2) <= radius_mm**2
    rows, columns = np.nonzero((np.add.outer(nearest[0] ** 2, nearest[1] ** 2) < radius_mm**2) & ~whole)
    y, x = edges[0][[rows, rows + 1]], edges[1][[columns, columns + 1]]
    corners = [[_signed_disc_area(radius_mm, b, a) for a in x] for b in y]
    cells = (corners[1][1] - corners[0][1]) - (corners[1][0] - corners[0][0])
    covered = whole.astype(float)
    covered[rows, columns] = np.clip(cells / grid.cell, 0.0, 1.0)
    return covered


def _signed_disc_area(radius: float, y: Array, x: Array) -> Array:
    """Return the signed area of a disc between its axes of symmetry and the lines at y and x."""
    down, across = np.minimum(abs(y), radius), np.minimum(abs(x), radius)

    def under_arc(u: Array) -> Array:
        """Return the area under the circle from 0 to u."""
        return 0.5 * (u * np.sqrt(np.maximum(radius**2 - u**2, 0.0)) + radius**2 * np.arcsin(u / radius))

    arc_start = np.minimum(np.sqrt(np.maximum(radius**2 - down**2, 0.0)), across)
    quarter = down * arc_start + under_arc(across) - under_arc(arc_start)
    return np.asarray(np.sign(y) * np.sign(x) * quarter)


def half_plane_coverage(distance: Array, cosine: Array, sine: Array) -> Array:
    """Return the area of a unit square on the positive side of a line at a distance from its centre."""
    # The square's projection on the normal is a trapezoid, the convolution of two boxes. The lower limit of
    # their widths avoids a division by zero.
    one, two = np.maximum(abs(cosine), 1e-6), np.maximum(abs(sine), 1e-6)

    def ramp(shift: Array) -> Array:
        return np.asarray(0.5 * np.maximum(distance + shift, 0.0) ** 2)

    outer, inner = 0.5 * (one + two), 0.5 * (one - two)
    area = (ramp(outer) - ramp(inner) - ramp(-inner) + ramp(-outer)) / (one * two)
    # Far from the line the squares above nearly cancel; the area is then 0 or 1.
    return np.asarray(np.where(abs(distance) >= outer, distance > 0.0, np.clip(area, 0.0, 1.0)))


def validate_two_dimensional(grid: Grid) -> None:
    """Raise InputError if a grid is not a plane."""
    if grid.is_line:
        raise InputError(f"grid shape = {grid.shape}: must be a plane, (ny, nx)")


def validate_sampling(grid: Grid, width_um: float, what: str) -> None:
    """Raise SamplingError if a feature is narrower than `SAMPLES_PER_FEATURE` samples."""
    pitch_um = 1e3 * grid.pitch_mm
    if width_um < SAMPLES_PER_FEATURE * pitch_um * ROUNDING:
        raise SamplingError(
            f"{what} of {width_um:.4g} µm: narrower than {SAMPLES_PER_FEATURE:g} samples of the grid's pitch "
            f"of {pitch_um:.4g} µm; give a pitch (object_pitch_um) of "
            f"{width_um / SAMPLES_PER_FEATURE:.4g} µm or less"
        )


def validate_inside(grid: Grid, shape: Rectangle) -> None:
    """Raise InputError if a rectangle extends beyond a grid."""
    half_y, half_x = grid.half_widths_mm
    x, y = grid.centre_mm
    reach_x = max(shape.right_mm - x, x - shape.left_mm)
    reach_y = max(shape.high_mm - y, y - shape.low_mm)
    if not (reach_x * ROUNDING <= half_x and reach_y * ROUNDING <= half_y):
        raise InputError(
            f"the object extends {reach_x:.4g} mm along x and {reach_y:.4g} mm along y from the grid's "
            f"centre, but the grid only {half_x:.4g} mm and {half_y:.4g} mm; use a larger grid or a smaller "
            "object"
        )


def _interval(samples_mm: Array, pitch_mm: float, low_mm: float, high_mm: float) -> tuple[slice, Array]:
    """Return the cells that an interval touches, and the fraction of each that it covers."""
    start = float(samples_mm[0]) - 0.5 * pitch_mm
    first = max(0, math.floor((low_mm - start) / pitch_mm))
    last = min(len(samples_mm), math.ceil((high_mm - start) / pitch_mm))
    borders = start + pitch_mm * np.arange(first, last + 1)
    return slice(first, last), np.diff(np.clip(borders, low_mm, high_mm)) / pitch_mm
