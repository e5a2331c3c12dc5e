"""Bars with gaps of their own width: positions, samples, contrast, profile, and the finest that are resolved.

All bars are repeated along an axis with a period of two line widths. A gap is as wide as a bar. Contrast is
(bright - dark) / (bright + dark) of the intensity at bars and gaps. It is negative if both are exchanged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import takewhile
from typing import TypeVar

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.fields.coverage import Rectangle, rectangle, rectangle_coverage
from wavesim.fields.field import Grid, Orientation, axis_of

Line = TypeVar("Line")

RESOLVED_CONTRAST = 0.2
"""Least contrast of resolved lines, as in `smallest_resolved_line_width_um`."""

MIDDLE_ACROSS, MIDDLE_ALONG = 0.5, 3.0
"""Size of the averaged area of each bar and gap (line widths): its middle, away from edges and ends."""


def bar_centres(line_width: float, bars: int) -> Array:
    """Return the centres of bars about 0. The gaps between bars have the centres of one bar less."""
    return np.asarray(line_width * (2.0 * np.arange(bars) - (bars - 1)))


def bar_and_gap_centres(line_width: float, bars: int) -> Array:
    """Return the centres of all bars, then those of all gaps, about 0."""
    return np.concatenate([bar_centres(line_width, bars), bar_centres(line_width, bars - 1)])


def bar_rectangles(
    line_width_mm: float,
    bars: int,
    orientation: Orientation,
    centre_mm: tuple[float, float],
    length_mm: float,
) -> tuple[Rectangle, ...]:
    """Return parallel bars about a centre (x, y)."""
    (x, y), axis = centre_mm, axis_of(orientation)
    return tuple(
        rectangle((x + offset, y), line_width_mm, length_mm)
        if axis == 0
        else rectangle((x, y + offset), length_mm, line_width_mm)
        for offset in bar_centres(line_width_mm, bars).tolist()
    )


def bar_coverage(samples: Array, pitch: float, line_width: float, bars: int) -> Array:
    """Return the fraction of the cell of each sample of a line that bars about 0 cover."""
    cells, centres = samples[:, None], bar_centres(line_width, bars)
    ends = np.minimum(cells + 0.5 * pitch, centres + 0.5 * line_width)
    starts = np.maximum(cells - 0.5 * pitch, centres - 0.5 * line_width)
    return np.asarray(np.maximum(ends - starts, 0.0).sum(axis=1) / pitch)


def michelson(bright: float, dark: float) -> float:
    """Return (bright - dark) / (bright + dark); NaN without light."""
    total = bright + dark
    return (bright - dark) / total if total > 0.0 else math.nan


@dataclass(frozen=True, eq=False)
class BarContrast:
    """Contrast of one set of bars: of all bars and gaps, and of the worst bar and gap."""

    # Contrast of the mean intensities of bars and gaps; NaN without light.
    contrast: float
    # Contrast of the dimmest area that should be bright and the brightest area that should be dark.
    weakest_contrast: float

    def resolved(self, threshold: float = RESOLVED_CONTRAST) -> bool:
        """Return True if the bars reach a contrast and each is brighter than every gap, or darker."""
        return self.contrast >= threshold and self.weakest_contrast > 0.0


def bar_contrasts(bright: Array, dark: Array) -> tuple[float, float]:
    """Return both contrasts of :class:`BarContrast` from intensities that should be bright, and dark."""
    return (
        michelson(float(np.mean(bright)), float(np.mean(dark))),
        michelson(float(np.min(bright)), float(np.max(dark))),
    )


def bar_levels(
    intensity: Array,
    grid: Grid,
    line_width_mm: float,
    bars: int,
    orientation: Orientation,
    centre_mm: tuple[float, float],
) -> tuple[Array, Array]:
    """Return the mean intensities of the middles of bars, and of gaps.

    A middle is half a line width across and three along. Cells count by the fraction that lies inside.
    """
    axis = axis_of(orientation)
    shrink = 0.5 * (1.0 - MIDDLE_ACROSS) * line_width_mm
    dx, dy = (shrink, 0.0) if axis == 0 else (0.0, shrink)

    def mean(bar: Rectangle) -> float:
        middle = Rectangle(bar.left_mm + dx, bar.right_mm - dx, bar.low_mm + dy, bar.high_mm - dy)
        weights = rectangle_coverage(grid, [middle])
        chosen = weights > 0.0
        return float(np.average(intensity[chosen], weights=weights[chosen]))

    of_bars, of_gaps = (
        np.array(
            [
                mean(bar)
                for bar in bar_rectangles(
                    line_width_mm, count, orientation, centre_mm, MIDDLE_ALONG * line_width_mm
                )
            ]
        )
        for count in (bars, bars - 1)
    )
    return of_bars, of_gaps


def bar_profile(
    intensity: Array,
    grid: Grid,
    line_width_mm: float,
    bars: int,
    orientation: Orientation,
    centre_mm: tuple[float, float],
) -> tuple[Array, Array]:
    """Return coordinates across bars from their centre (um), and the mean intensity along the bars.

    The profile covers the bars and two line widths beyond them.
    """
    axis = axis_of(orientation)
    coordinates = (grid.x_mm, grid.y_mm)
    across = coordinates[axis] - centre_mm[axis]
    along = np.abs(coordinates[1 - axis] - centre_mm[1 - axis])
    weights = np.clip((0.5 * MIDDLE_ALONG * line_width_mm - along) / grid.pitch_mm + 0.5, 0.0, 1.0)
    chosen = np.abs(across) <= 0.5 * (2 * bars + 3) * line_width_mm
    lines = intensity[:, chosen].T if axis == 0 else intensity[chosen]
    return 1e3 * across[chosen], np.asarray(lines[:, weights > 0.0] @ weights[weights > 0.0] / weights.sum())


def resolved_lines(lines: Iterable[Line], resolved: Callable[[Line], bool]) -> list[Line]:
    """Return lines, given from the widest to the finest, up to the first that is not resolved.

    Finer lines that are resolved again are false resolution and do not count.
    """
    return list(takewhile(resolved, lines))
