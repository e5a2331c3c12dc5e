"""Hot and dead pixels, found in the frames: they disagree with their neighbours, or with themselves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.camera.exposures import merged_intensity
from wavesim.camera.frames import Frame
from wavesim.runtime.threads import for_blocks

Mask = NDArray[np.bool_]

FAR = 10.0
"""Standard deviations of the noise by which a pixel must stand out."""

ALONE, ON_ALL = 20.0, 4.0
"""Times its brightest neighbour that a hot pixel shows on one plane, and on each of several. Light itself
comes to 8 where all of it falls on one pixel; it does not do so on the same pixel of every plane."""

DEAD, DEAD_NOISE, LIT = 0.02, 3.0, 30.0
"""A dead pixel shows so much of its darkest neighbour at most, and so many standard deviations; that one must
show so many at least. The dark point of a vortex leaves a sixth."""

UNLIKE = 0.1
"""Relative difference of a pixel's intensities in two exposures that no noise of the level explains."""

MOST_FOUND = 0.01
"""Share of the pixels from which on these are no bad pixels, but something else."""

ROWS = 64
"""Looked at at a time, by each thread; the lines above and below them are neighbours."""

RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)


def found_bad(planes: Sequence[Sequence[Frame]]) -> list[Mask]:
    """Pixels of each plane that are hot or dead, or whose exposures contradict each other, shape (ny, nx).

    Parameters
    ----------
    planes
        Frames of each plane, all of one size.
    """
    shape = planes[0][0].counts.shape
    found = [np.zeros(shape, bool) for _ in planes]

    def rows(first: int, last: int) -> None:
        start, stop = max(first - 1, 0), min(last + 1, shape[0])
        block, own = slice(first, last), slice(first - start, last - start)
        merged = [merged_intensity(plane, slice(start, stop)) for plane in planes]
        limit = ALONE if len(planes) == 1 else ON_ALL
        hot = np.logical_and.reduce([_stands_out(*one, limit) for one in merged])
        lit = np.logical_or.reduce([i > FAR * np.sqrt(variance) for i, variance in merged])
        dead = np.logical_or.reduce([_dead(*one) for one in merged]) & ~lit
        for mask, plane in zip(found, planes, strict=True):
            mask[block] = (hot | dead)[own] | _contradicting(plane, block)

    for_blocks(rows, shape[0], ROWS)
    return [mask if mask.mean() <= MOST_FOUND else np.zeros(shape, bool) for mask in found]


def _stands_out(intensity: Array, variance: Array, times: float) -> Mask:
    """Pixels far brighter than each of their neighbours."""
    deviation = np.sqrt(variance)
    brightest = np.maximum(scipy.ndimage.maximum_filter(intensity, footprint=RING, mode="nearest"), 0.0)
    return np.asarray((intensity > times * brightest) & (intensity > FAR * deviation))


def _dead(intensity: Array, variance: Array) -> Mask:
    """Pixels without light among such with it."""
    deviation = np.sqrt(variance)
    darkest = scipy.ndimage.minimum_filter(intensity, footprint=RING, mode="nearest")
    dark = intensity < DEAD * darkest + DEAD_NOISE * deviation
    return np.asarray(dark & (darkest > LIT * deviation))


def _contradicting(plane: Sequence[Frame], rows: slice) -> Mask:
    """Pixels whose intensity is another in each exposure: their signal does not come from light."""
    seen = [merged_intensity((frame,), rows) for frame in plane]
    found = np.zeros(seen[0][0].shape, bool)
    for (one, its), (other, other_s) in pairwise(seen):
        difference = np.abs(one - other)
        known = np.isfinite(its + other_s)
        deviation = np.sqrt(np.where(known, its + other_s, 0.0))
        level = UNLIKE * np.maximum(np.abs(one), np.abs(other))
        found |= known & (difference > FAR * deviation + level)
    return found
