"""Test of the stated noise: residuals that are too small, and the noise parameter that would explain them.

A pixel that was held out from the fit keeps its own noise. Its residual is at least the noise, whatever the
model. Smaller residuals mean that the noise is overstated, or that pictures were smoothed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wavesim.metrics.plane_residuals import PlaneResidual

TOO_SMALL, TOO_SMALL_DARK = 0.8, 0.6
"""Residuals over the stated noise below which the noise is overstated: for all or bright pixels, and for dark
pixels. The amplitudes of dim pixels scatter less than their standard deviation.
"""

ROUNDED = 0.4
"""The same limit where most of a dark pixel's variance is due to rounding."""

LEAST_PIXELS = 50
"""Least number of held-out pixels that determine a ratio."""

DARK, BRIGHT = 1.5, 2.0
"""Multiples of a dark pixel's noise: read noise dominates below the first, shot noise above the second."""


class NoiseCheck(NamedTuple):
    """Residuals on held-out pixels over the stated noise alone.

    Attributes
    ----------
    ratio : float
        Ratio over all held-out pixels.
    dark_ratio, bright_ratio : float or None
        Ratio over the pixels in which read noise or shot noise dominates; None if they are too few.
    is_too_small : bool
        True if the noise cannot be as large as stated.
    explanation : str
        Noise parameter that would explain it; empty if nothing is wrong.
    """

    ratio: float
    dark_ratio: float | None
    bright_ratio: float | None
    is_too_small: bool
    explanation: str


def noise_check(planes: Sequence[PlaneResidual], rounding: float = 0.0) -> NoiseCheck | None:
    """Compare residuals on held-out pixels with the stated noise.

    Parameters
    ----------
    planes
        Residuals of all planes. Planes whose pixels were all held out are ignored.
    rounding
        Fraction of a dark pixel's variance that is due to rounding to counts. If it is above one half, dark
        pixels that always round to the same count have less noise than stated, and only a ratio below
        `ROUNDED` is a finding.

    Returns
    -------
    NoiseCheck or None
        None if fewer than `LEAST_PIXELS` pixels were held out.
    """
    some = [plane for plane in planes if 0 < len(plane.held) < plane.error.size]
    if sum(len(plane.held) for plane in some) < LEAST_PIXELS:
        return None
    error = np.concatenate([plane.error.ravel()[plane.held] for plane in some]).astype(float)
    amplitude = np.concatenate([plane.amplitude.ravel()[plane.held] for plane in some]).astype(float)
    sigma = np.concatenate([plane.held_sigma for plane in some]).astype(float)
    # Intensity over its standard deviation, below which a standard deviation of the amplitude is that of a
    # dark pixel, as in :func:`wavesim.sensor.measurement.recorded_intensity`.
    dark_ratio = 0.25 * math.sqrt(2.0 * math.pi)
    is_bright = amplitude >= 2.0 * dark_ratio * sigma
    deviation = np.where(is_bright, 2.0 * amplitude, 4.0 * dark_ratio * sigma) * sigma
    floor = float(np.quantile(deviation, 0.02))
    ratio, effective_pixels = _ratio(error, sigma, np.ones(len(sigma), bool))
    dark, _ = _ratio(error, sigma, deviation <= DARK * floor)
    bright, _ = _ratio(error, sigma, deviation >= BRIGHT * floor)
    assert ratio is not None
    # The ratio must be smaller than 1 by four of its standard deviations.
    sure = 4.0 / math.sqrt(2.0 * effective_pixels)
    if rounding > 0.5:
        overstated = ratio < ROUNDED
    else:
        overstated = min(ratio, bright or 1.0) < TOO_SMALL or (dark or 1.0) < TOO_SMALL_DARK
    is_too_small = overstated and ratio < 1.0 - sure
    return NoiseCheck(
        ratio, dark, bright, is_too_small, _explanation(ratio, dark, bright) if is_too_small else ""
    )


def _ratio(error: np.ndarray, sigma: np.ndarray, chosen: np.ndarray) -> tuple[float | None, float]:
    """Return the root mean square of residuals over that of the stated noise, and its number of pixels.

    With several exposures a few pixels, which only the shortest one does not saturate, have nearly all of the
    noise. If they are effectively fewer than `LEAST_PIXELS`, each pixel's residual counts relative to its own
    noise. The ratio is None if too few pixels are chosen.
    """
    if np.count_nonzero(chosen) < LEAST_PIXELS:
        return None, 0.0
    squared, variance = error[chosen] ** 2, sigma[chosen] ** 2
    effective = float(np.sum(variance)) ** 2 / float(np.sum(variance**2))
    if effective >= LEAST_PIXELS:
        return math.sqrt(float(np.sum(squared)) / float(np.sum(variance))), effective
    return math.sqrt(float(np.mean(squared / variance))), float(len(variance))


def _explanation(ratio: float, dark: float | None, bright: float | None) -> str:
    """Return the noise parameter whose error would explain residuals that are too small."""
    finding = f"residuals on held-out pixels are {ratio:.2g} times the stated noise, and cannot be below 1"
    smoothed = "pictures that were smoothed, averaged or compressed"
    if bright is None:
        factor = (ratio if dark is None else dark) ** 2
        return (
            f"{finding}. A read noise {factor:.2g} times as large as stated would explain it, as would "
            f"another gain, or {smoothed}"
        )
    if dark is not None and dark < TOO_SMALL < bright:
        return f"{finding}. A read noise {dark**2:.2g} times as large as stated would explain it"
    gain = f"a gain (electrons per count) {bright**-2:.2g} times as large as stated"
    # Ratio of dark pixels over that of bright ones, up to which a gain explains both: it acts on both alike,
    # in amplitudes, while smoothing by a factor f changes dark pixels by its root.
    same_ratio = 1.25
    if dark is None or dark < same_ratio * bright:
        return f"{finding}. {gain.capitalize()} would explain it, or {smoothed}"
    return f"{finding}. {smoothed.capitalize()} would explain it, or {gain}"
