"""Amplitudes as they were recorded, what noise leaves of them, and how much each pixel weighs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.runtime.threads import row_blocks

Array = NDArray[np.floating[Any]]


HELD = 1e9
"""Largest amplitude, and inverse of the smallest, of whose squares single precision holds the sum."""

APART = 1e9
"""Ratio of two planes' largest amplitudes that none of one light can have."""


DARK = 0.25 * math.sqrt(2.0 * math.pi)
"""Intensity over its standard deviation, below which an amplitude's stated deviation no longer grows."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """An amplitude recorded on one plane.

    Attributes
    ----------
    distance_mm : float
        From the plane in which the field is sought.
    amplitude : ndarray
        Root of the intensity, of the grid's shape. Two planes are in the same units.
    sigma : ndarray, optional
        Standard deviation of each amplitude, in its units; infinite in pixels of which nothing is known, such
        as saturated or dead ones. Left out: all pixels are alike.
    shift_mm : (x, y)
        How far the sensor's middle is from where it should be.
    background : ndarray, optional
        Intensity on each pixel that is none of the object's light, in units of the squared amplitude.
    tilt_deg : (x, y)
        Of the sensor about its middle, as of :class:`wavesim.scene.Placement`.
    """

    distance_mm: float
    amplitude: Array
    sigma: Array | None = None
    shift_mm: tuple[float, float] = (0.0, 0.0)
    background: Array | None = None
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    @property
    def known(self) -> NDArray[np.bool_] | None:
        """Pixels that tell something; None where all do."""
        if self.sigma is None or np.all(np.isfinite(self.sigma)):
            return None
        return np.asarray(np.isfinite(self.sigma))


def recorded_intensity(distance_mm: float, intensity: Array, variance: Array) -> Measurement:
    """Amplitude and its standard deviation from an estimated intensity, as of `estimate_intensity`.

    The amplitude is the root of the intensity, 0 where that is negative; its standard deviation is that of
    the intensity over twice the amplitude. Where it is dark, that ends at the root mean square of the root of
    normal noise, clipped at 0: 0.63 times the root of the intensity's standard deviation.

    Parameters
    ----------
    distance_mm
        As of :class:`Measurement`.
    intensity, variance
        Of one shape; a pixel of infinite variance tells nothing.

    Raises
    ------
    InputError
        If shapes differ, or a variance is not above 0.
    """
    if intensity.shape != variance.shape or not np.all(variance > 0.0):
        raise InputError(
            f"recorded intensity of shape {intensity.shape}, variance of shape {variance.shape}: must have "
            "one shape, and variances above 0"
        )
    known = np.isfinite(variance)
    deviation = np.sqrt(np.where(known, variance, 1.0))
    lowest = DARK * deviation
    sigma = np.where(known, deviation / (2.0 * np.sqrt(np.maximum(intensity, lowest))), np.inf)
    return Measurement(distance_mm, np.sqrt(np.maximum(intensity, 0.0)), sigma)


def amplitude_unit(recorded: Sequence[Measurement]) -> float:
    """Power of two by which amplitudes are divided, so that single precision holds their squares; often 1.

    Raises
    ------
    InputError
        If planes differ by more than any unit can hold.
    """
    largest = [float(plane.amplitude.max()) for plane in recorded]
    dimmest, brightest = (largest.index(pick(largest)) for pick in (min, max))
    if largest[brightest] > APART * largest[dimmest]:
        ratio = largest[brightest] / largest[dimmest]
        raise InputError(
            f"plane {brightest + 1}: amplitudes reach {ratio:.3g} times those of plane {dimmest + 1}: all "
            "planes must be in one unit"
        )
    return power_of_two(largest[brightest])


def power_of_two(largest: float) -> float:
    """The power of two below a value; 1 for values of whose squares single precision holds the sum."""
    return 1.0 if 1.0 / HELD <= largest <= HELD else 2.0 ** math.floor(math.log2(largest))


def in_unit(recorded: Sequence[Measurement], unit: float) -> list[Measurement]:
    """Amplitudes and their standard deviations, divided by a unit; as they are if it is 1."""
    if unit == 1.0:
        return list(recorded)
    return [
        replace(
            p,
            amplitude=p.amplitude / unit,
            sigma=None if p.sigma is None else p.sigma / unit,
            background=None if p.background is None else p.background / unit**2,
        )
        for p in recorded
    ]


def full_weight_sigma(recorded: Sequence[Measurement]) -> float:
    """Standard deviation up to which a pixel weighs 1: that of a plane's brightest known pixel, the smallest.

    Where long exposures know faint light better than that, weights by the smallest of all would leave the
    bright pixels, which hold most of the light, next to none: a descent would not come to them.
    """
    at_brightest = []
    for plane in recorded:
        if plane.sigma is not None:
            brightest = np.argmax(np.where(np.isfinite(plane.sigma), plane.amplitude, -1.0))
            at_brightest.append(float(plane.sigma.flat[int(brightest)]))
    return min(at_brightest, default=1.0)


def noise_misfit(recorded: Sequence[Measurement]) -> float | None:
    """Misfit that the stated noise alone would leave; None where a plane has no standard deviations.

    The misfit is the weighted relative L2 difference of all planes' amplitudes and the recorded ones.
    """
    full = full_weight_sigma(recorded)
    missed = size = 0.0
    for plane in recorded:
        if plane.sigma is None:
            return None
        for rows in row_blocks(len(plane.sigma)):
            known = np.isfinite(plane.sigma[rows])
            stated = plane.sigma[rows][known].astype(float)
            weight = np.minimum(full / stated, 1.0) ** 2
            missed += float(weight @ stated**2)
            size += float(weight @ plane.amplitude[rows][known].astype(float) ** 2)
    return math.sqrt(missed / size)


def weights_of(recorded: Sequence[Measurement]) -> list[Array | None]:
    """Weights of all planes' pixels: (:func:`full_weight_sigma` / standard deviation) squared, 1 at most.

    None for a plane without standard deviations, whose pixels all weigh 1.
    """
    full = full_weight_sigma(recorded)
    return [None if p.sigma is None else np.asarray(np.minimum(full / p.sigma, 1.0) ** 2) for p in recorded]
