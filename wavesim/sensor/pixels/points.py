"""Amplitudes at points that lie some pixels apart, for light whose fringes are many pixels wide.

All pixels around a point count: polynomials of the fourth degree through them tell the intensity
there (A. Savitzky and M. J. E. Golay, "Smoothing and differentiation of data by simplified least squares
procedures" (1964)), and its second derivatives, by which the mean over a pixel's square differs from it. What
would be lost by leaving pixels out is kept: their light.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.ndimage

from lensdesign.common.arrays import Array
from wavesim.runtime.threads import row_blocks
from wavesim.sensor.exposures import merged_intensity
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Measurement, recorded_intensity

DEGREE = 4


def points_among(count: int, apart: int) -> slice:
    """Pixels that lie so far apart, in the middle of a row of so many; all around each of them are in it."""
    room = 2 * apart
    steps = (count - 1 - room) // apart
    first = (count - 1 - steps * apart) // 2
    return slice(first, first + steps * apart + 1, apart)


def recorded_points(
    plane: Sequence[Frame], distance_mm: float, apart: int, fill_factor: float
) -> Measurement:
    """What frames of one plane tell of the amplitude at points.

    A point near which a pixel tells nothing is not known either.

    Parameters
    ----------
    plane
        Frames, as of :func:`wavesim.sensor.exposures.merged_intensity`.
    distance_mm
        As of :class:`wavesim.sensor.measurement.Measurement`.
    apart
        Pixels from one point to the next, two or more; those of :func:`points_among`.
    fill_factor
        Side of a pixel's photosensitive square as a share of the pitch.
    """
    weights = point_weights(apart, fill_factor)
    rows, columns = plane[0].counts.shape
    down, across = points_among(rows, apart), points_among(columns, apart)
    along: list[list[Array]] = [[], [], []]
    for block in row_blocks(rows):
        intensity, variance = merged_intensity(plane, block)
        known = np.isfinite(variance)
        parts = (intensity, weights), (np.where(known, variance, 0.0), weights**2), (~known, weights != 0.0)
        for (values, own), kept in zip(parts, along, strict=True):
            kept.append(_around(values, own, 1)[:, across])
    intensity, variance, unknown = (
        _around(np.concatenate(kept), own, 0)[down]
        for kept, own in zip(along, (weights, weights**2, weights != 0.0), strict=True)
    )
    return recorded_intensity(distance_mm, intensity, np.where(unknown > 0.0, np.inf, variance))


def point_weights(apart: int, fill_factor: float) -> Array:
    """Of the pixels around a point, along one axis, in the intensity there."""
    fitted = np.linalg.pinv(np.vander(np.arange(-apart, apart + 1.0), DEGREE + 1, increasing=True))
    value, bend = fitted[0], 2.0 * fitted[2]
    return np.asarray(value - fill_factor**2 / 24.0 * bend, np.float32)


def _around(values: Array, weights: Array, axis: int) -> Array:
    return np.asarray(scipy.ndimage.correlate1d(values.astype(np.float32), weights.astype(np.float32), axis))
