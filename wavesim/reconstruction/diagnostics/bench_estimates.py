"""Estimates of errors of the bench from pictures of a plane and from the phase of an object."""

from __future__ import annotations

import numpy as np
import scipy.fft

from wavesim.sensor.measurement import Array


def shift_pixels(measured: Array, modelled: Array) -> tuple[float, float]:
    """Return the shift (x, y) in pixels between two pictures, from the peak of their cross-correlation."""
    first, second = (scipy.fft.rfft2(values - values.mean()) for values in (measured, modelled))
    product = scipy.fft.irfft2(first * second.conj(), measured.shape)
    peak = np.unravel_index(int(np.argmax(product)), product.shape)
    shifts = []
    for axis in (1, 0):
        line = np.moveaxis(product, axis, 0)[:, peak[1 - axis]]
        neighbours = [float(line[(peak[axis] + step) % len(line)]) for step in (-1, 0, 1)]
        curvature = neighbours[0] - 2.0 * neighbours[1] + neighbours[2]
        offset = 0.5 * (neighbours[0] - neighbours[2]) / curvature if curvature < 0.0 else 0.0
        count = product.shape[axis]
        shifts.append((int(peak[axis]) + count // 2) % count - count // 2 + float(offset))
    return shifts[0], shifts[1]


def centroid(intensity: Array) -> tuple[float, float]:
    """Return the center of gravity (x, y) in pixels."""
    rows, columns = (np.arange(count) for count in intensity.shape)
    total = float(intensity.sum())
    return float(intensity.sum(axis=0) @ columns) / total, float(intensity.sum(axis=1) @ rows) / total


def background(measured: Array, modelled: Array) -> tuple[float, float]:
    """Return the constant intensity where a result is dark: over the mean intensity, and its level."""
    # Fraction of the peak modelled intensity below which a measured intensity counts as background.
    dark_fraction = 1e-3
    dark = modelled < dark_fraction * modelled.max()
    level = float(np.mean(measured[dark] - modelled[dark])) if np.any(dark) else 0.0
    return level / float(measured.mean()), level
