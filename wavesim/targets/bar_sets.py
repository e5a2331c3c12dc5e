"""Contrast of a set of three bars at its position on the chart."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.fields.coverage import Rectangle, bar_rectangles, rectangle_coverage
from wavesim.fields.field import Grid, Orientation, axis_of
from wavesim.targets.patterns import Polarity
from wavesim.targets.usaf import BARS, UsafElement

MIDDLE_ACROSS, MIDDLE_ALONG = 0.5, 3.0
"""Size of the averaged area of each bar and gap (line widths): its middle, away from edges and ends."""


@dataclass(frozen=True, eq=False)
class SetContrast:
    """Contrast of one set of three bars.

    Attributes
    ----------
    contrast : float
        (bright - dark) / (bright + dark) of the mean intensities of bars and gaps; negative if the contrast
        is reversed, NaN without light.
    weakest_contrast : float
        Contrast of the dimmest area that should be bright and the brightest area that should be dark.
    across_um, intensity : ndarray, shape (n,)
        Profile on the samples: coordinate across the bars from the set's centre, and mean along the bars.
    """

    contrast: float
    weakest_contrast: float
    across_um: Array
    intensity: Array


def set_contrast(
    intensity: Array, grid: Grid, element: UsafElement, orientation: Orientation, polarity: Polarity
) -> SetContrast:
    """Return the contrast of the set of an element whose bars are repeated along an axis.

    Intensity is averaged over the middle of each bar and gap, half a line width across and three along. Cells
    are weighted by their covered fraction.

    Parameters
    ----------
    intensity
        Intensity on the grid, shape (ny, nx).
    grid
        Grid of the object plane.
    element
        Element of the chart.
    orientation
        Axis along which the bars of the set are repeated.
    polarity
        "dark" for clear bars on a dark field, "bright" for opaque bars on a bright field.

    Raises
    ------
    InputError
        If the set reaches beyond the grid.
    """
    width, centre = 1e-3 * element.line_width_um, element.set_centre_mm(orientation)
    bars, gaps = (
        [_mean(intensity, grid, area) for area in _middles(width, centre, orientation, count)]
        for count in (BARS, BARS - 1)
    )
    bright, dark = (bars, gaps) if polarity == "dark" else (gaps, bars)
    across, profile = _profile(intensity, grid, width, centre, orientation)
    return SetContrast(
        _michelson(float(np.mean(bright)), float(np.mean(dark))),
        _michelson(float(np.min(bright)), float(np.max(dark))),
        across,
        profile,
    )


def _middles(
    width: float, centre: tuple[float, float], orientation: Orientation, count: int
) -> list[Rectangle]:
    """Return the averaged areas of `count` bars, or of the gaps between one bar more."""
    axis = axis_of(orientation)
    shrink = 0.5 * (1.0 - MIDDLE_ACROSS) * width
    made = []
    for one in bar_rectangles(width, count, orientation, centre, MIDDLE_ALONG * width):
        dx, dy = (shrink, 0.0) if axis == 0 else (0.0, shrink)
        made.append(Rectangle(one.left_mm + dx, one.right_mm - dx, one.low_mm + dy, one.high_mm - dy))
    return made


def _mean(intensity: Array, grid: Grid, area: Rectangle) -> float:
    weights = rectangle_coverage(grid, [area])
    chosen = weights > 0.0
    return float(np.average(intensity[chosen], weights=weights[chosen]))


def _profile(
    intensity: Array, grid: Grid, width: float, centre: tuple[float, float], orientation: Orientation
) -> tuple[Array, Array]:
    """Return the mean along the bars for each sample across them, from the set and two widths around it."""
    axis = axis_of(orientation)
    coordinates = (grid.x_mm, grid.y_mm)
    across = coordinates[axis] - centre[axis]
    along = np.abs(coordinates[1 - axis] - centre[1 - axis])
    weights = np.clip((0.5 * MIDDLE_ALONG * width - along) / grid.pitch_mm + 0.5, 0.0, 1.0)
    chosen = np.abs(across) <= 0.5 * 9.0 * width
    lines = intensity[:, chosen].T if axis == 0 else intensity[chosen]
    return 1e3 * across[chosen], np.asarray(lines[:, weights > 0.0] @ weights[weights > 0.0] / weights.sum())


def _michelson(bright: float, dark: float) -> float:
    total = bright + dark
    return (bright - dark) / total if total > 0.0 else math.nan
