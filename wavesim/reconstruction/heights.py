"""Height of a transparent film from its phase at two or more wavelengths, with its standard deviation.

A film of height h and index n in air delays the light by the phase k h, with k = 2 pi (n - 1) / wavelength.
A phase is known up to multiples of 2 pi. Phases at two wavelengths determine the height within the range of
the synthetic wavelength, a b / (b - a) for the wavelengths a < b, over n - 1. The height is
the one that fits the phases of all wavelengths best::

    minimize  sum over wavelengths of ((phase - k h) modulo 2 pi)^2 / s^2,

where s are the standard deviations of the phases. Each order of the shortest wavelength gives one candidate,
for which the other orders follow. The best candidate has the precision of the single wavelengths together,
1 / sqrt(sum of k^2 / s^2). A second candidate that fits almost as well means that the order is ambiguous.

References
----------
J. C. Wyant, "Testing aspherics using two-wavelength holography", Appl. Opt. 10, 2113 (1971).
C. Polhemus, "Two-wavelength interferometry", Appl. Opt. 12, 2071 (1973).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive

SURE = 9.0
"""Least excess of the second best candidate's sum of squares over that of the best: three deviations."""

LARGEST_ORDERS = 2000
"""Largest number of candidates; a wider range of heights is an error."""


@dataclass(frozen=True, eq=False)
class Heights:
    """Heights, their standard deviations, and where their order is ambiguous.

    Attributes
    ----------
    height_um : ndarray
        Height above the ground.
    deviation_um : ndarray
        Standard deviation of a height, if its order is right.
    ambiguous : ndarray of bool
        Where a height of another order fits the phases almost as well.
    """

    height_um: Array
    deviation_um: Array
    ambiguous: NDArray[np.bool_]


@dataclass(frozen=True)
class StepHeight:
    """Difference of the heights of two regions.

    Attributes
    ----------
    height_um, deviation_um : float
        Difference and its standard deviation.
    ambiguous : bool
        Whether another order fits the phases almost as well.
    """

    height_um: float
    deviation_um: float
    ambiguous: bool


def wave_numbers(wavelengths_um: Sequence[float], index: float) -> Array:
    """Return the phase per um of height of a film in air, in rad, for each wavelength.

    Raises
    ------
    InputError
        If a wavelength is not positive, or the index is not above 1.
    """
    for wavelength in wavelengths_um:
        validate_positive("wavelengths_um", wavelength)
    if not 1.0 < index < math.inf:
        raise InputError(f"index = {index!r}: must be finite and above 1")
    return 2.0 * math.pi * (index - 1.0) / np.asarray(wavelengths_um, float)


def unambiguous_um(wavelengths_um: Sequence[float], index: float) -> float:
    """Return the range of heights that phases without noise determine, for two wavelengths or more.

    It is the synthetic wavelength of the closest pair of wavelengths, over (index - 1).

    Examples
    --------
    >>> round(unambiguous_um((0.532, 0.635), 1.5), 2)
    6.56
    """
    numbers = np.sort(wave_numbers(wavelengths_um, index))
    if len(numbers) < 2:
        return float(2.0 * math.pi / numbers[0])
    closest = float(np.diff(numbers).min())
    if closest <= 0.0:
        raise InputError(f"wavelengths_um = {tuple(wavelengths_um)!r}: must differ from each other")
    return 2.0 * math.pi / closest


def candidate_orders(
    wavelengths_um: Sequence[float], index: float, heights_um: tuple[float, float] | None = None
) -> tuple[float, float, range]:
    """Return the lowest and highest possible height, and the orders of the shortest wavelength between them.

    Parameters
    ----------
    wavelengths_um, index, heights_um
        See :func:`heights_from_phases`.

    Raises
    ------
    InputError
        If wavelengths are equal, or the range contains more than `LARGEST_ORDERS` orders.
    """
    half_um = 0.5 * unambiguous_um(wavelengths_um, index)
    low, high = heights_um or (-half_um, half_um)
    period_um = 2.0 * math.pi / float(wave_numbers(wavelengths_um, index).max())
    orders = range(math.floor(low / period_um) - 1, math.ceil(high / period_um) + 2)
    if len(orders) > LARGEST_ORDERS:
        raise InputError(
            f"heights_um = {low:g}, {high:g}: contain {len(orders)} orders of {period_um:.4g} um; at most "
            f"{LARGEST_ORDERS} are allowed: give a smaller range, or wavelengths that differ more"
        )
    return low, high, orders


def heights_from_phases(
    phases: Array,
    deviations: Array,
    wavelengths_um: Sequence[float],
    index: float,
    heights_um: tuple[float, float] | None = None,
) -> Heights:
    """Return the heights that fit phases at several wavelengths best.

    Parameters
    ----------
    phases : ndarray, shape (wavelengths, ...)
        Phases in rad relative to the ground, up to multiples of 2 pi.
    deviations : ndarray, shape (wavelengths, ...)
        Their standard deviations, above 0.
    wavelengths_um
        Vacuum wavelengths.
    index
        Refractive index of the film.
    heights_um
        Lowest and highest possible height. Default: the unambiguous range about 0.

    Returns
    -------
    Heights
        Heights of the shape of one wavelength's phases.

    Raises
    ------
    InputError
        If shapes differ, a deviation is not above 0, or the range contains too many orders.

    Examples
    --------
    A step of 2.3 um, which is more than two waves:

    >>> import numpy as np
    >>> wavelengths = (0.532, 0.635)
    >>> phases = np.angle(np.exp(1j * wave_numbers(wavelengths, 1.5) * 2.3))[:, None]
    >>> found = heights_from_phases(phases, np.full((2, 1), 0.05), wavelengths, 1.5)
    >>> found.height_um.round(4).tolist(), found.deviation_um.round(4).tolist(), found.ambiguous.tolist()
    ([2.3], [0.0065], [False])
    """
    phases, deviations = np.asarray(phases, float), np.asarray(deviations, float)
    count = len(wavelengths_um)
    if phases.shape != deviations.shape or len(phases) != count:
        raise InputError(
            f"phases of shape {phases.shape}, deviations of shape {deviations.shape}: must be equal, with "
            f"{count} wavelengths first"
        )
    if not np.all(deviations > 0.0):
        raise InputError("deviations: must be above 0")
    numbers = wave_numbers(wavelengths_um, index)
    low, high, orders = candidate_orders(wavelengths_um, index, heights_um)
    column = numbers.reshape(-1, *[1] * (phases.ndim - 1))
    precision = column / deviations**2
    information = np.sum(column * precision, axis=0)
    first = int(np.argmax(numbers))
    shape = phases.shape[1:]
    best_um, best, second = np.zeros(shape), np.full(shape, np.inf), np.full(shape, np.inf)
    for order in orders:
        start_um = (phases[first] + 2.0 * math.pi * order) / numbers[first]
        remaining = wrapped(phases - column * start_um)
        height_um = start_um + np.sum(precision * remaining, axis=0) / information
        squares = np.sum((wrapped(phases - column * height_um) / deviations) ** 2, axis=0)
        # A margin of three deviations keeps the height of a sample at an end of the range.
        margin = 3.0 / np.sqrt(information)
        squares = np.where((height_um < low - margin) | (height_um > high + margin), np.inf, squares)
        is_best = squares < best
        second = np.where(is_best, best, np.minimum(second, squares))
        best_um, best = np.where(is_best, height_um, best_um), np.where(is_best, squares, best)
    ambiguous = ~(second > best + SURE) | ~np.isfinite(best)
    return Heights(best_um, 1.0 / np.sqrt(information), ambiguous)


def wrapped(phase: Array) -> Array:
    """Return phases modulo 2 pi, from -pi to pi."""
    return np.asarray(np.angle(np.exp(1j * phase)))


def common_phases(transmissions: NDArray[np.complexfloating], inside: NDArray[np.bool_]) -> Array:
    """Return the most common phase of an object at each wavelength, of the same samples at all of them.

    The samples are selected at one wavelength after the other: those whose phase lies near the largest value
    of its smoothed histogram, among those that are left.

    Parameters
    ----------
    transmissions : ndarray, shape (wavelengths, ny, nx)
        Transmission at each wavelength.
    inside
        Samples of the object.
    """
    values = transmissions[:, inside]
    chosen = np.ones(values.shape[1], bool)
    bins = 48
    for one in values:
        histogram, edges = np.histogram(
            np.angle(one[chosen]), bins, (-math.pi, math.pi), weights=np.abs(one[chosen])
        )
        smoothed = histogram + np.roll(histogram, 1) + np.roll(histogram, -1)
        middle = 0.5 * (edges[:-1] + edges[1:])[int(np.argmax(smoothed))]
        # Three bins on either side, about the width of the histogram of a flat ground with noise.
        chosen &= np.abs(wrapped(np.angle(one) - middle)) < 3.0 * (edges[1] - edges[0])
    return np.angle(np.sum(values[:, chosen], axis=1))
