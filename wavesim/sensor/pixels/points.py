"""Amplitudes at points several pixels apart, for light whose fringes are many pixels wide.

A polynomial of fourth degree is fitted to all pixels around a point, so that none of their light is lost. It
gives the intensity at the point, and its second derivatives, which determine the difference between the
intensity at the point and its mean over the pixel's square.

References
----------
A. Savitzky and M. J. E. Golay, "Smoothing and differentiation of data by simplified least squares
procedures", Anal. Chem. 36, 1627 (1964).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.ndimage

from lensdesign.common.arrays import Array
from wavesim.runtime.threads import row_blocks
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Measurement, recorded_intensity
from wavesim.sensor.merged_exposures import merged_intensity


def points_among(count: int, apart: int) -> slice:
    """Return the slice of points `apart` pixels apart, centred in `count` pixels, without the margins."""
    steps = (count - 1 - 2 * apart) // apart
    first = (count - 1 - steps * apart) // 2
    return slice(first, first + steps * apart + 1, apart)


def recorded_points(
    plane: Sequence[Frame], distance_mm: float, apart: int, fill_factor: float
) -> Measurement:
    """Return the amplitude and its standard deviation at points, from frames of one plane.

    A point is unknown if one of the pixels around it is unknown.

    Parameters
    ----------
    plane
        Frames, see :func:`wavesim.sensor.merged_exposures.merged_intensity`.
    distance_mm
        Distance of the plane, see :class:`wavesim.sensor.measurement.Measurement`.
    apart
        Pixels from one point to the next, at least 2; see :func:`points_among`.
    fill_factor
        Linear fill factor of a pixel (0 to 1).
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
    """Return the weights of the pixels around a point, along one axis, in the intensity at the point."""
    degree = 4
    fitted = np.linalg.pinv(np.vander(np.arange(-apart, apart + 1.0), degree + 1, increasing=True))
    value, second_derivative = fitted[0], 2.0 * fitted[2]
    return np.asarray(value - fill_factor**2 / 24.0 * second_derivative, np.float32)


def _around(values: Array, weights: Array, axis: int) -> Array:
    return np.asarray(scipy.ndimage.correlate1d(values.astype(np.float32), weights.astype(np.float32), axis))
