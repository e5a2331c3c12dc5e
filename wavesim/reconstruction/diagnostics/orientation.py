"""Whether a plane's picture would fit its model better mirrored, turned or shifted.

The model of a plane comes from all planes together. If one picture is mirrored against the others and is
noisy, residuals do not show it, but the picture fits better once it is mirrored back: the difference of the
two sums of squared residuals decides, which many pixels know well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from wavesim.metrics.goodness_of_fit import Finding
from wavesim.reconstruction.diagnostics.guesses import shift_pixels
from wavesim.sensor.measurement import Array, Measurement

SURE = 100.0
"""Difference of the sums of squared residuals over variances, from which on another picture fits better."""

LEAST_SHIFT_PIXELS = 0.7
"""Shift from which on a picture is displaced, if the displaced picture fits better."""

ORIENTATIONS: dict[str, Callable[[Any], Any]] = {
    "mirrored left to right": lambda a: a[:, ::-1],
    "mirrored top to bottom": lambda a: a[::-1],
    "turned by 180 deg": lambda a: a[::-1, ::-1],
    "turned by 90 deg": lambda a: a.T[::-1],
    "turned by -90 deg": lambda a: a[::-1].T,
    "transposed": lambda a: a.T,
    "transposed and turned by 180 deg": lambda a: a[::-1, ::-1].T,
}
"""Besides the stated one; all pictures are squares of the middle."""


def misoriented(recorded: Sequence[Measurement], maps: Sequence[Array]) -> list[Finding]:
    """Findings on planes whose pictures fit better in another orientation or place.

    Parameters
    ----------
    recorded
        The planes, with standard deviations.
    maps
        Amplitude of the result less the recorded one.
    """
    found = []
    for number, (plane, error) in enumerate(zip(recorded, maps, strict=True), start=1):
        assert plane.sigma is not None
        fits = {"orientation": _best_orientation(plane, error), "shift": _shift(plane, error)}
        found += [
            Finding(
                cause,
                f"the picture of plane {number} fits better {said} (chi-square lower by {gain:.0f})",
                gain,
            )
            for cause, (said, gain) in fits.items()
            if gain > SURE
        ]
    return found


def _best_orientation(plane: Measurement, error: Array) -> tuple[str, float]:
    """The orientation other than the stated one in which the picture fits best, and by how much better."""
    amplitude, sigma, made = (_square(one) for one in (plane.amplitude, plane.sigma, plane.amplitude + error))
    gains = {
        name: _gain(amplitude, sigma, turn(amplitude), turn(sigma), made)
        for name, turn in ORIENTATIONS.items()
    }
    best = max(gains, key=lambda name: gains[name])
    return best, gains[best]


def _shift(plane: Measurement, error: Array) -> tuple[str, float]:
    """The shift at which the picture fits best, and by how much better."""
    assert plane.sigma is not None
    known = np.isfinite(plane.sigma)
    made = np.maximum(plane.amplitude + error, 0.0).astype(float)
    seen = np.where(known, plane.amplitude, made).astype(float)
    x, y = shift_pixels(seen**2, made**2)
    moved = (-round(y), -round(x))
    if np.hypot(x, y) < LEAST_SHIFT_PIXELS or moved == (0, 0):
        return "", 0.0
    amplitude, sigma = (np.roll(one, moved, (0, 1)) for one in (plane.amplitude, plane.sigma))
    gain = _gain(plane.amplitude, plane.sigma, amplitude, sigma, made)
    return f"shifted by {-x:.1f}, {-y:.1f} pixels", gain


def _gain(amplitude: Array, sigma: Any, other: Array, other_sigma: Any, made: Array) -> float:
    """How much smaller the sum of squared residuals over variances is with the other picture."""
    variance = np.maximum(sigma, other_sigma).astype(float) ** 2
    difference = (amplitude - made).astype(float) ** 2 - (other - made).astype(float) ** 2
    return float(np.sum(difference / variance))  # infinite variances count nothing


def _square(values: Any) -> Any:
    """The middle of a picture, as wide as high."""
    rows, columns = values.shape
    side = min(rows, columns)
    top, left = (rows - side) // 2, (columns - side) // 2
    return values[top : top + side, left : left + side]
