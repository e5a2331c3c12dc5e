"""Detection of hot and dead pixels: they contradict their neighbours, or other exposures of themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wavesim.runtime.threads import for_blocks
from wavesim.sensor.frames import Frame
from wavesim.sensor.merged_exposures import stacked
from wavesim.sensor.pixels.kernel import outlying_pixels

Mask = NDArray[np.bool_]

ALONE, ON_ALL = 20.0, 4.0
"""Least ratio of a hot pixel to its brightest neighbour, on a single plane and on each of several. Focused
light reaches a ratio of 8, but not on the same pixel of every plane."""

DEAD, DEAD_NOISE, LIT = 0.02, 3.0, 30.0
"""Largest ratio of a dead pixel to its darkest neighbour, its additional allowance in standard deviations,
and the least signal of that neighbour. The dark point of a vortex has a ratio of one sixth."""


def find_bad_pixels(planes: Sequence[Sequence[Frame]]) -> list[Mask]:
    """Return, for each plane, the mask (ny, nx) of hot, dead or self-contradictory pixels.

    Parameters
    ----------
    planes
        Frames of each plane, all of the same size.
    """
    shape = planes[0][0].counts.shape
    found = [np.zeros(shape, bool) for _ in planes]

    limit = ALONE if len(planes) == 1 else ON_ALL

    def examine_rows(first: int, last: int) -> None:
        start, stop = max(first - 1, 0), min(last + 1, shape[0])
        block, own = slice(first, last), slice(first - start, last - start)
        stacks = [stacked(plane, slice(start, stop)) for plane in planes]
        # Least deviation of a bad pixel, in standard deviations of the noise.
        bad_deviations = 10.0
        outlying = [
            outlying_pixels(*stack.merged(), limit, bad_deviations, DEAD, DEAD_NOISE, LIT)[:, own]
            for stack in stacks
        ]
        hot = np.logical_and.reduce([masks[0] for masks in outlying])
        lit = np.logical_or.reduce([masks[1] for masks in outlying])
        dead = np.logical_or.reduce([masks[2] for masks in outlying]) & ~lit
        # Relative difference of a pixel's intensities in two exposures that is allowed in addition to noise.
        contradiction = 0.1
        for mask, stack in zip(found, stacks, strict=True):
            mask[block] = hot | dead | stack.contradicting(bad_deviations, contradiction)[own]

    for_blocks(examine_rows, shape[0], 64)
    # Largest fraction of bad pixels; a larger one has another cause, and none is marked.
    most_found = 0.01
    return [mask if mask.mean() <= most_found else np.zeros(shape, bool) for mask in found]
