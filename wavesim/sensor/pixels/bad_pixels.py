"""Detection of hot and dead pixels: they contradict their neighbours, or other exposures of themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

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

    Neighbours of a pixel behind a colour filter are the nearest pixels at the same place in the pattern of
    the filters, because different filters transmit too different parts of the light.

    Parameters
    ----------
    planes
        Frames of each plane, all of the same size.
    """
    shape, colours = planes[0][0].counts.shape, planes[0][0].settings.colours
    if colours is None or colours.is_monochrome:
        return _found_among_neighbours(planes)
    found = [np.zeros(shape, bool) for _ in planes]
    rows, columns = len(colours.pattern), len(colours.pattern[0])
    for row, column in product(range(min(rows, shape[0])), range(min(columns, shape[1]))):
        every = slice(row, None, rows), slice(column, None, columns)
        of_place = [[_part_of(frame, every) for frame in plane] for plane in planes]
        for mask, part in zip(found, _found_among_neighbours(of_place), strict=True):
            mask[every] = part
    return found


def _part_of(frame: Frame, every: tuple[slice, slice]) -> Frame:
    """Return a frame of some of the pixels, with their maps."""
    maps = frame.maps
    if maps is not None:
        parts = {name: None if one is None else one[every] for name, one in vars(maps).items()}
        maps = replace(maps, **parts)
    return replace(frame, counts=np.ascontiguousarray(frame.counts[every]), maps=maps)


def _found_among_neighbours(planes: Sequence[Sequence[Frame]]) -> list[Mask]:
    """Return the mask of each plane for pixels of equal response."""
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
