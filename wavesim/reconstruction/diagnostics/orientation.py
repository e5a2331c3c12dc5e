"""Test whether a plane's picture fits its model better when it is mirrored, rotated or shifted.

The model of a plane comes from all planes together. If a single noisy picture is mirrored, the residuals do
not show it, but the picture fits better after it is mirrored back. The difference of the two sums of squared
residuals decides; it is well known because it contains many pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wavesim.metrics.goodness_of_fit import Finding
from wavesim.reconstruction.diagnostics.bench_estimates import shift_pixels
from wavesim.sensor.measurement import Array, Measurement
from wavesim.sensor.orientations import ORIENTATIONS, square_part


def orientation_findings(recorded: Sequence[Measurement], maps: Sequence[Array]) -> list[Finding]:
    """Return findings on planes whose pictures fit better in another orientation or position.

    Parameters
    ----------
    recorded
        Measured planes with standard deviations.
    maps
        For each plane, modelled less measured amplitude.
    """
    found = []
    # Difference of chi-square above which another picture fits better.
    sure_gain = 100.0
    for plane_number, (plane, error) in enumerate(zip(recorded, maps, strict=True), start=1):
        assert plane.sigma is not None
        fits = {"orientation": _best_orientation(plane, error), "shift": _best_shift(plane, error)}
        found += [
            Finding(
                cause,
                f"the picture of plane {plane_number} fits better {description} "
                f"(chi-square lower by {gain:.0f})",
                gain,
            )
            for cause, (description, gain) in fits.items()
            if gain > sure_gain
        ]
    return found


def _best_orientation(plane: Measurement, error: Array) -> tuple[str, float]:
    """Return the best orientation other than the stated one, and its gain of chi-square."""
    amplitude, sigma, modelled = (
        square_part(values) for values in (plane.amplitude, plane.sigma, plane.amplitude + error)
    )
    gains = {
        name: _gain(amplitude, sigma, orientation(amplitude), orientation(sigma), modelled)
        for name, orientation in ORIENTATIONS.items()
    }
    best = max(gains, key=lambda name: gains[name])
    return best, gains[best]


def _best_shift(plane: Measurement, error: Array) -> tuple[str, float]:
    """Return the best shift of a picture, and its gain of chi-square."""
    assert plane.sigma is not None
    is_known = np.isfinite(plane.sigma)
    modelled = np.maximum(plane.amplitude + error, 0.0).astype(float)
    measured = np.where(is_known, plane.amplitude, modelled).astype(float)
    x, y = shift_pixels(measured**2, modelled**2)
    shift = (-round(y), -round(x))
    # Shift in pixels above which a picture counts as displaced if the displaced picture fits better.
    least_shift_pixels = 0.7
    if np.hypot(x, y) < least_shift_pixels or shift == (0, 0):
        return "", 0.0
    amplitude, sigma = (np.roll(values, shift, (0, 1)) for values in (plane.amplitude, plane.sigma))
    gain = _gain(plane.amplitude, plane.sigma, amplitude, sigma, modelled)
    return f"shifted by {-x:.1f}, {-y:.1f} pixels", gain


def _gain(amplitude: Array, sigma: Any, other: Array, other_sigma: Any, modelled: Array) -> float:
    """Return the decrease of chi-square with the other picture."""
    variance = np.maximum(sigma, other_sigma).astype(float) ** 2
    difference = (amplitude - modelled).astype(float) ** 2 - (other - modelled).astype(float) ** 2
    return float(np.sum(difference / variance))  # infinite variances have no weight
