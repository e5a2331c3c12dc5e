"""Regions of an object plane, margins around them, and windows with soft edges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.coverage import Rectangle
from wavesim.fields.field import Field, Grid

LEAST_SAMPLES = 16
"""Fewest samples along a side of a region; structural similarity and refocusing need them."""

SLACK = 1e-6
"""Tolerance for rounding, as a fraction of a sample."""

Slices = tuple[slice, slice]


def region_grid(grid: Grid, region_mm: Sequence[float], named: str = "region_mm") -> Grid:
    """Return the grid of the samples that hold a region of an object plane.

    Parameters
    ----------
    grid
        Grid of the object plane.
    region_mm
        x and y of the region's centre, its width and its height (mm).
    named
        Name of the region in messages.

    Raises
    ------
    InputError
        If the region reaches beyond the samples, or has fewer than `LEAST_SAMPLES` along a side.
    """
    values = np.broadcast_to(np.False_, grid.shape)
    found, (x_um, y_um) = cut_out(values, 1e3 * grid.pitch_mm, region_mm, named)
    rows, columns = found.shape
    if min(rows, columns) < LEAST_SAMPLES:
        raise InputError(
            f"{named} = {','.join(f'{n:g}' for n in region_mm)}: has {columns} x {rows} samples of "
            f"{1e3 * grid.pitch_mm:.4g} µm; must be at least {LEAST_SAMPLES} x {LEAST_SAMPLES}"
        )
    return replace(grid, shape=(rows, columns), centre_mm=(1e-3 * x_um, 1e-3 * y_um))


def part_of(inner: Grid, wider: Grid) -> Slices:
    """Return the slices (rows, columns) of a grid within a wider grid."""
    slices = inner.at(wider.z_mm).samples_among(wider)
    assert slices is not None
    return slices


def cut_field(field: Field, inner: Grid) -> Field:
    """Return a view of a field on a smaller grid within its own."""
    values = field.values[part_of(inner, field.grid)]
    return Field(inner.at(field.grid.z_mm), values, field.wavelength_um, field.index)


def widened(inner: Grid, grid: Grid, margin_mm: float) -> Grid:
    """Return a grid with a margin on each side, as far as the outer grid reaches."""
    more = math.ceil(margin_mm / grid.pitch_mm)
    rows, columns = part_of(inner, grid)
    return _between(
        grid,
        *(
            slice(max(side.start - more, 0), min(side.stop + more, count))
            for side, count in zip((rows, columns), grid.shape, strict=True)
        ),
    )


def around(rectangle: Rectangle, grid: Grid) -> Grid:
    """Return the grid of the samples whose cells a rectangle touches."""
    spans = ((rectangle.low_mm, rectangle.high_mm), (rectangle.left_mm, rectangle.right_mm))
    found = []
    for (low, high), first, count in zip(spans, (grid.y_mm[0], grid.x_mm[0]), grid.shape, strict=True):
        start, stop = ((edge - first) / grid.pitch_mm + 0.5 for edge in (low, high))
        found.append(slice(max(math.floor(start), 0), min(math.ceil(stop), count)))
    return _between(grid, *found)


def holds(grid: Grid, rectangle: Rectangle) -> bool:
    """Return whether a rectangle lies within the cells of a grid."""
    (half_y, half_x), (x, y) = grid.half_widths_mm, grid.centre_mm
    slack = 2.0 * SLACK * grid.pitch_mm
    return (
        rectangle.left_mm >= x - half_x - slack
        and rectangle.right_mm <= x + half_x + slack
        and rectangle.low_mm >= y - half_y - slack
        and rectangle.high_mm <= y + half_y + slack
    )


def soft_rim(inner: Grid, wider: Grid) -> NDArray[np.float32]:
    """Return a window that is 1 on the inner grid and half of the margin, and falls to 0 beyond."""
    down, across = (
        _ramps(side, count) for side, count in zip(part_of(inner, wider), wider.shape, strict=True)
    )
    return down[:, None] * across


def _ramps(side: slice, count: int) -> NDArray[np.float32]:
    weights = np.ones(count, np.float32)
    for margin, direction in ((side.start, slice(None)), (count - side.stop, slice(None, None, -1))):
        fall = margin // 2
        weights[direction][:fall] = np.sin(0.5 * np.pi * (np.arange(fall) + 0.5) / max(fall, 1)) ** 2
    return weights


def _between(grid: Grid, rows: slice, columns: slice) -> Grid:
    middles = (
        0.5 * (axis[side.start] + axis[side.stop - 1])
        for axis, side in ((grid.x_mm, columns), (grid.y_mm, rows))
    )
    x_mm, y_mm = middles
    shape = (rows.stop - rows.start, columns.stop - columns.start)
    return replace(grid, shape=shape, centre_mm=(float(x_mm), float(y_mm)))


def cut_out(
    values: Any,
    pitch_um: float,
    region_mm: Sequence[float],
    named: str = "region_mm",
    centre_um: tuple[float, float] = (0.0, 0.0),
) -> tuple[Any, tuple[float, float]]:
    """Return the samples within a region, and their centre.

    Parameters
    ----------
    values
        Samples of shape (ny, nx), with y increasing along the rows.
    pitch_um
        Sample pitch (um).
    region_mm
        x and y of the region's centre, its width and its height (mm).
    named
        Name of the region in messages.
    centre_um
        Centre (x, y) of the values (um).

    Returns
    -------
    ndarray, (x, y)
        View of the values, and its centre (um).

    Raises
    ------
    InputError
        If the region has no size, or reaches beyond the samples.
    """
    region_text = f"{named} = {','.join(f'{n:g}' for n in region_mm)}"
    x_mm, y_mm, width_mm, height_mm = region_mm
    if not (all(map(math.isfinite, region_mm)) and min(width_mm, height_mm) > 0.0):
        raise InputError(f"{region_text}: must be finite, and the sides greater than 0")
    found, middles_um = [], []
    for axis, count, middle_um, middle, side in (
        ("x", values.shape[1], centre_um[0], x_mm, width_mm),
        ("y", values.shape[0], centre_um[1], y_mm, height_mm),
    ):
        half, own = 0.5e-3 * count * pitch_um, 1e-3 * middle_um
        if abs(middle - own) + 0.5 * side > half + 1e-3 * pitch_um:
            raise InputError(
                f"{region_text}: reaches beyond the samples, along {axis} from {own - half:.4g} to "
                f"{own + half:.4g} mm"
            )
        first = max(math.floor((middle - own - 0.5 * side + half) * 1e3 / pitch_um + SLACK), 0)
        last = min(math.ceil((middle - own + 0.5 * side + half) * 1e3 / pitch_um - SLACK), count)
        found.append(slice(first, max(last, first + 1)))
        middles_um.append(middle_um + (0.5 * (first + found[-1].stop) - 0.5 * count) * pitch_um)
    return values[found[1], found[0]], (middles_um[0], middles_um[1])
