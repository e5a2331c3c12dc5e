"""Hot and dead pixels, found in the frames: they disagree with their neighbours, or with themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wavesim.runtime.threads import for_blocks
from wavesim.sensor.exposures import stacked
from wavesim.sensor.frames import Frame
from wavesim.sensor.pixels.kernel import outlying_pixels

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


def find_bad_pixels(planes: Sequence[Sequence[Frame]]) -> list[Mask]:
    """Pixels of each plane that are hot or dead, or whose exposures contradict each other, shape (ny, nx).

    Parameters
    ----------
    planes
        Frames of each plane, all of one size.
    """
    shape = planes[0][0].counts.shape
    found = [np.zeros(shape, bool) for _ in planes]

    limit = ALONE if len(planes) == 1 else ON_ALL

    def rows(first: int, last: int) -> None:
        start, stop = max(first - 1, 0), min(last + 1, shape[0])
        block, own = slice(first, last), slice(first - start, last - start)
        stacks = [stacked(plane, slice(start, stop)) for plane in planes]
        seen = [
            outlying_pixels(*stack.merged(), limit, FAR, DEAD, DEAD_NOISE, LIT)[:, own] for stack in stacks
        ]
        hot = np.logical_and.reduce([one[0] for one in seen])
        lit = np.logical_or.reduce([one[1] for one in seen])
        dead = np.logical_or.reduce([one[2] for one in seen]) & ~lit
        for mask, stack in zip(found, stacks, strict=True):
            mask[block] = hot | dead | stack.contradicting(FAR, UNLIKE)[own]

    for_blocks(rows, shape[0], ROWS)
    return [mask if mask.mean() <= MOST_FOUND else np.zeros(shape, bool) for mask in found]
