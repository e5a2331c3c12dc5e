"""Measured maps of heights: fill values, isolated dropouts, and heights that no figure of a surface has.

Instruments mark points that they could not measure by a fill value such as -9999, and lose single points to
dust and speckle. A fill value lies far from all heights. A single lost point follows from its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError

LARGEST_HEIGHT_MM = 1.0
"""Largest sag error of a made surface. It is a thousand times that of a bad one."""

SPACING_LIMITS_MM = (1e-5, 1e3)
"""Smallest and largest distance between neighbouring points: 10 nm and 1 m."""

LARGEST_DROPOUT = 5
"""Largest extent of a dropout along each axis, in points, that is bridged."""

LARGEST_BRIDGED_FRACTION = 0.05
"""Largest fraction of the points of a map that is bridged."""

FEWEST_COMPARED = 20
"""Number of heights below which none is called implausible."""

_GAP_MM, _GAP_OVER_RANGE = 5e-4, 3.0
"""Heights beyond a gap of both sizes do not belong to the others: 0.5 um, and three times their range."""


@dataclass(frozen=True, eq=False)
class BridgedMap:
    """A map of heights whose isolated dropouts are filled.

    Attributes
    ----------
    height_mm : ndarray, shape (rows, columns)
        Heights in mm; NaN outside the measured area, and in areas that are too large to be bridged.
    bridged : ndarray of bool, shape (rows, columns)
        Points whose height follows from their neighbours.
    """

    height_mm: Array
    bridged: Array


def implausible_heights(height_mm: Array) -> NDArray[np.bool_]:
    """Return which heights lie so far from all others that they are fill values or faults of an instrument.

    The middle half of the distinct heights is extended across gaps of up to 0.5 um, or of up to three times
    the range so far. Heights beyond a larger gap are implausible. A real bump has points on its slopes, and
    therefore no such gap.

    Parameters
    ----------
    height_mm
        Heights in mm; NaN where nothing was measured.

    Returns
    -------
    ndarray of bool, of the same shape
    """
    finite = height_mm[np.isfinite(height_mm)]
    distinct, counts = np.unique(finite, return_counts=True)
    if len(finite) < FEWEST_COMPARED:
        return np.zeros(np.shape(height_mm), bool)
    # Of a few distinct heights the most frequent one counts, so that a single fill value is no quarter.
    fewest = 4
    common = int(np.argmax(counts))
    low, high = (common, common) if len(distinct) < fewest else (len(distinct) // 4, (3 * len(distinct)) // 4)
    gaps = np.diff(distinct)
    while True:
        widest = max(_GAP_MM, _GAP_OVER_RANGE * float(distinct[high] - distinct[low]))
        below, above = np.flatnonzero(gaps[:low] > widest), np.flatnonzero(gaps[high:] > widest)
        lower = int(below[-1]) + 1 if below.size else 0
        upper = high + int(above[0]) if above.size else len(distinct) - 1
        if (lower, upper) == (low, high):
            break
        low, high = lower, upper
    with np.errstate(invalid="ignore"):
        return np.asarray((height_mm < distinct[low]) | (height_mm > distinct[high]))


def validate_heights(height_mm: Array, location: str) -> None:
    """Check that heights may be sag errors of a surface.

    Raises
    ------
    InputError
        If a height exceeds 1 mm.
    """
    largest = float(np.nanmax(np.abs(height_mm), initial=0.0))
    if largest > LARGEST_HEIGHT_MM:
        raise InputError(
            f"{location}: a height of {largest:.4g} mm: sag errors must be at most {LARGEST_HEIGHT_MM:g} mm; "
            "check the unit, and mark points that were not measured"
        )


def validate_spacing(spacing_mm: float, location: str) -> None:
    """Check that a distance between neighbouring points may be that of a map.

    Raises
    ------
    InputError
        If it is outside 1e-5 to 1000 mm.
    """
    least, largest = SPACING_LIMITS_MM
    if not least <= spacing_mm <= largest:
        raise InputError(f"{location} = {spacing_mm:g}: must be {least:g} to {largest:g} mm")


def bridge_dropouts(height_mm: Array) -> BridgedMap:
    """Fill isolated points without data within the measured area from their neighbours.

    Each dropout takes the values of a polynomial of second order that fits the measured points around it.

    Parameters
    ----------
    height_mm
        Heights in mm, shape (rows, columns); NaN where nothing was measured.

    Returns
    -------
    BridgedMap
        Dropouts of more than 5 points along an axis remain NaN. All do if they are more than 5 % of the map.
    """
    from scipy.ndimage import binary_fill_holes, find_objects, label

    measured = np.isfinite(height_mm)
    bridged = np.zeros(measured.shape, bool)
    holes, _ = label(binary_fill_holes(measured) & ~measured, np.ones((3, 3)))
    found = height_mm.copy()
    for index, place in enumerate(find_objects(holes), start=1):
        if max(one.stop - one.start for one in place) > LARGEST_DROPOUT:
            continue
        around = tuple(slice(max(0, one.start - 3), one.stop + 3) for one in place)
        dropout = holes[around] == index
        values = _quadratic(height_mm[around], dropout)
        if values is not None:
            found[around][dropout] = values
            bridged[around] |= dropout
    if np.count_nonzero(bridged) > LARGEST_BRIDGED_FRACTION * np.count_nonzero(measured):
        return BridgedMap(height_mm, np.zeros_like(bridged))
    return BridgedMap(found, bridged)


def main_area(height_mm: Array) -> Array:
    """Return which points belong to the measured area, without specks beside it.

    Areas of less than 1 % of the largest one are specks, such as reflections beside the part.
    """
    from scipy.ndimage import label

    areas, count = label(np.isfinite(height_mm), np.ones((3, 3)))
    sizes = np.bincount(areas.ravel(), minlength=count + 1)
    sizes[0] = 0
    speck = 0.01
    return np.asarray((sizes >= speck * sizes.max(initial=0))[areas] & (areas > 0))


def _quadratic(window: Array, dropout: Array) -> Array | None:
    """Return the fitted values of a dropout; None if too few points around it are measured."""
    y, x = np.mgrid[: window.shape[0], : window.shape[1]] - 0.5 * (np.array(window.shape) - 1)[:, None, None]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    known = np.isfinite(window)
    if np.count_nonzero(known) < 2 * terms.shape[-1]:
        return None
    return np.asarray(terms[dropout] @ np.linalg.lstsq(terms[known], window[known], rcond=None)[0])
