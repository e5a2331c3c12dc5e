"""How large an error may be, as pictures of a plane and an object's phase tell it."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.scene.bench import Orders, light_mode
from wavesim.sensor.measurement import Array

DARK = 1e-3
"""Of the brightest modelled intensity, below which what is recorded tells the background."""

BENDS: tuple[Orders, ...] = ((2, 0), (1, 1), (0, 2))
SHAPES: tuple[Orders, ...] = ((1, 0), (0, 1), *BENDS)
"""Of a phase: its tilts, and how it is bent."""


def shift_pixels(seen: Array, made: Array) -> tuple[float, float]:
    """How far a picture is shifted against another (x, y), by the peak of their cross-correlation."""
    one, other = (scipy.fft.rfft2(values - values.mean()) for values in (seen, made))
    product = scipy.fft.irfft2(one * other.conj(), seen.shape)
    peak = np.unravel_index(int(np.argmax(product)), product.shape)
    found = []
    for axis in (1, 0):
        line = np.moveaxis(product, axis, 0)[:, peak[1 - axis]]
        near = [float(line[(peak[axis] + step) % len(line)]) for step in (-1, 0, 1)]
        curvature = near[0] - 2.0 * near[1] + near[2]
        part = 0.5 * (near[0] - near[2]) / curvature if curvature < 0.0 else 0.0
        count = product.shape[axis]
        found.append((int(peak[axis]) + count // 2) % count - count // 2 + float(part))
    return found[0], found[1]


def centre(intensity: Array) -> tuple[float, float]:
    """Centre of gravity (x, y) in pixels."""
    rows, columns = (np.arange(count) for count in intensity.shape)
    total = float(intensity.sum())
    return float(intensity.sum(axis=0) @ columns) / total, float(intensity.sum(axis=1) @ rows) / total


def background(seen: Array, made: Array) -> tuple[float, float]:
    """Even light where a result is dark: as a share of the mean, and itself."""
    dark = made < DARK * made.max()
    level = float(np.mean(seen[dark] - made[dark])) if np.any(dark) else 0.0
    return level / float(seen.mean()), level


def smooth_phase_waves(transmission: Field) -> dict[Orders, float]:
    """The phase's `SHAPES`, by a fit to its slopes from sample to sample, which need no unwrapping."""
    values = transmission.values
    modes = np.stack([light_mode(orders, values.shape) for orders in SHAPES])
    normal, right = np.zeros((len(SHAPES), len(SHAPES))), np.zeros(len(SHAPES))
    for axis in (0, 1):
        here, there = (np.moveaxis(values, axis, 0)[part] for part in (slice(-1), slice(1, None)))
        step = there * here.conj()
        changes: NDArray[np.float64] = np.moveaxis(np.diff(modes, axis=axis + 1), axis + 1, 1)
        changes = changes.reshape(len(SHAPES), -1)
        weighted = changes * np.abs(step).ravel()
        normal += weighted @ changes.T
        right += weighted @ np.angle(step).ravel()
    found = np.linalg.solve(normal, right) / (2.0 * np.pi)
    return dict(zip(SHAPES, found.tolist(), strict=True))
