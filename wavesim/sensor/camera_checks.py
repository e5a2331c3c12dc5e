"""Checks of a camera's stated black level and largest count against the counts of its frames.

Pixels without light have the black level as their mean, and the noise of dark pixels. Light raises the mean
and adds shot noise. Dark pixels with a mean above the stated level, but without more noise, therefore
contradict it, and so do pixels with a mean below it. The darkest part of a picture is selected by half of its
pixels, and measured on the other half, since pixels that select themselves would seem too dark.

Where a camera clips, many pixels share the largest count. Without clipping, noise spreads the counts of the
brightest pixels, and few have the largest one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavesim.sensor.frames import Frame
from wavesim.sensor.merged_exposures import electrons_of, fixed_variance, known_in

BLOCK = 8
"""Side of the squares among which the darkest ones are selected (pixels)."""

DARKEST, LEAST_BLOCKS = 0.1, 4
"""Fraction of the squares that count as the darkest part, and smallest number of them."""

EXAMINED = 4_000_000
"""Approximate number of pixels that are examined; of larger frames, rows of squares are left out."""


class DarkPart(NamedTuple):
    """The darkest part of a frame.

    Attributes
    ----------
    counts : float
        Mean count, without the dark signal of a dark frame.
    electrons, deviation : float
        Mean signal above the stated black level, and its standard deviation.
    variance : float
        Variance of a pixel in squared electrons.
    """

    counts: float
    electrons: float
    deviation: float
    variance: float


def dark_part(frame: Frame) -> DarkPart | None:
    """Return the darkest part of a frame; None for frames that are too small.

    Parameters
    ----------
    frame
        The frame, with its pixel maps.
    """
    rows, columns = (BLOCK * (n // BLOCK) for n in frame.counts.shape)
    every = 1 + rows * columns // EXAMINED
    selects = np.add.outer(np.arange(BLOCK), np.arange(BLOCK)) % 2 == 0
    selecting, measured = [], []
    for start in range(0, rows, BLOCK * every):
        part = slice(start, start + BLOCK)
        electrons, known = electrons_of(frame, part), known_in(frame, part)
        squares, is_known = (
            values[:, :columns].reshape(BLOCK, -1, BLOCK).swapaxes(0, 1) for values in (electrons, known)
        )
        squares = squares[is_known.all(axis=(1, 2))]
        selecting.append(squares[:, selects])
        measured.append(squares[:, ~selects])
    if not selecting:
        return None
    brightness = np.concatenate(selecting).mean(axis=1)
    values: NDArray[np.float64] = np.concatenate(measured).astype(np.float64)
    count = max(math.ceil(DARKEST * len(values)), LEAST_BLOCKS)
    if len(values) < count:
        return None
    darkest = values[np.argsort(brightness, kind="stable")[:count]]
    # Hot and dead pixels would shift the mean.
    middle, spread = float(np.median(darkest)), 5.0 * math.sqrt(fixed_variance(frame))
    spread = max(spread, 5.0 * 1.4826 * float(np.median(np.abs(darkest - middle))))
    darkest = np.clip(darkest, middle - spread, middle + spread)
    # The median, since a few squares may contain the edge of something bright.
    level, variance = float(darkest.mean()), float(np.median(np.var(darkest, axis=1, ddof=1)))
    own = frame.settings
    counts = own.offset_counts + level / own.gain_electrons_per_count
    return DarkPart(counts, level, float(darkest.std()) / math.sqrt(darkest.size), variance)


def contradicts_black_level(frame: Frame, dark: DarkPart) -> bool:
    """Return whether the darkest part of a frame contradicts the stated black level.

    Parameters
    ----------
    frame, dark
        The frame and its darkest part.
    """
    fixed = fixed_variance(frame)
    # Error of the black level that is not reported: a fraction of the noise of a dark pixel, and standard
    # deviations of the measured level.
    tolerated = 0.5 * math.sqrt(fixed) + 5.0 * dark.deviation
    if dark.electrons < -tolerated:
        return True
    # Without a stated read noise, nothing is known about the noise of dark pixels.
    rounding = frame.settings.gain_electrons_per_count**2 / 12.0
    if frame.settings.read_noise_electrons**2 < rounding:
        return False
    # Variances of a pixel without light, over the stated one: stated noise has an error.
    lowest, highest = 0.5, 1.3
    if not lowest * fixed <= dark.variance <= highest * fixed:
        return False
    most_light = max(dark.variance - (2.0 - highest) * fixed, 0.0)  # light of which this would be the noise
    return dark.electrons - most_light > 0.3 * math.sqrt(fixed) + 5.0 * dark.deviation


def clipping_counts(frame: Frame) -> int | None:
    """Return the count at which a frame is clipped below its largest possible count; None if it is not.

    Parameters
    ----------
    frame
        The frame. With a stated `saturation_counts` the result is None.
    """
    own, counts = frame.settings, frame.counts
    if own.saturation_counts is not None:
        return None
    counts = counts if frame.bad is None else counts[~frame.bad]
    top = int(counts.max(initial=0))
    at_top = int(np.count_nonzero(counts == top))
    # Fewest pixels that show clipping. A frame with more than half of its pixels at one count is even.
    least_pixels, largest_fraction = 6, 0.5
    if top >= own.top_counts or not least_pixels <= at_top <= largest_fraction * counts.size:
        return None
    every = 1 + counts.size // EXAMINED
    # Counts of fewer bits may be stored as multiples.
    step = int(np.gcd.reduce(counts.ravel()[::every].astype(np.int64) - int(counts.min()))) or 1
    light = max(top - own.offset_counts, 0.0) * own.gain_electrons_per_count
    noise = math.sqrt(light + fixed_variance(frame)) / own.gain_electrons_per_count
    # Counts below the largest one, over which noise spreads the brightest pixels.
    near = max(4, math.ceil(2.0 * noise / step))
    pixels_near = int(np.count_nonzero(counts >= top - near * step))
    # Pixels at the largest count over those of an even distribution, above which noise does not explain them.
    excess = 3.0
    return top if at_top > excess * pixels_near / (near + 1) else None
