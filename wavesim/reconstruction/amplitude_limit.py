"""Upper limit of an amplitude object whose scale is not known: the brightness of its brightest parts.

Frames determine the product of scale and transmission. No part of a passive object exceeds 1, so the largest
product is the scale if the brightest part is clear; this convention is used. It also helps the search, since
noise cannot brighten a clear ground. The first search fits the scale to an object that is bright everywhere.
That scale is right for charts on a clear ground, and too low for photographs and for objects with a dark
ground, whose bright parts it would clip.

The object found is therefore tested: a few iterations without a limit show where its samples at the limit
tend to. Where the frames raise them by more than noise does, two searches without a limit follow, and the
brightest parts of the better result become the limit. One continues. The other starts anew from an even
object, because a limit that is far too low can lead to an object from which the first does not return. Where
hardly any sample is at the limit, the limit is too high and is lowered to the transmission of the parts
through which the brightest fifth of the light has passed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Protocol

import numpy as np

from wavesim.fields.field import Field
from wavesim.reconstruction.object_solver import Reconstructed
from wavesim.reconstruction.total_variation import Values, prox_tv

TEST_ITERATIONS = 3
"""Iterations without a limit that show where samples at the limit tend to."""

LEAST_LOWERED = 0.9
"""Smallest factor by which a limit is lowered. A lower one would be that of a search that has failed."""

LARGEST_RISE = 0.01
"""Mean rise of the samples at the limit up to which the limit is right. Charts on a clear ground reach 0.007,
photographs whose limit is 5 % too low 0.02.
"""

SMOOTHING = 2.0
"""Weight of the total variation that smooths an object before its samples are compared with the limit, over
the noise of a step. Samples at the limit are those that noise has brightened, so that their own mean is too
high.
"""

LEAST_AT_LIMIT = 0.2
"""Smallest fraction of the light behind the object that passed samples at a limit that is not too high."""

BRIGHTEST = 0.01
"""Fraction of the illumination that falls on the brightest parts, after a search without a limit. With 0.003,
overshoots of a single letter would be its brightest parts, and its scale a quarter too high.
"""

OVERSHOOTS = 0.1
"""Weight of the total variation that removes fine overshoots of a search without a limit, which would seem to
be the brightest parts, over the root mean square transmission.
"""


class LimitedSolver(Protocol):
    """Searches an amplitude object at a stated scale, from a start or, without one, from an even object.

    The amplitude is limited to 1 or not; without a number of iterations, it searches until it has converged.
    """

    def __call__(
        self, start: Field | None, scale: float, *, bounded: bool, iterations: int | None = None
    ) -> Reconstructed: ...


def with_own_limit(
    solve: LimitedSolver, found: Reconstructed, light: Field, noise_of_step: float
) -> Reconstructed:
    """Return the amplitude object whose brightest parts are 1, and its scale.

    Parameters
    ----------
    solve
        Searches on, or anew.
    found
        Object of the first search, whose scale was fitted.
    light
        Illumination of the object.
    noise_of_step
        Standard deviation that noise causes in a step at scale 1
        (:func:`wavesim.forward.step_noise.noise_of_step`).

    Returns
    -------
    Reconstructed
        The object itself if its limit is right, or that of further searches, with the misfits of all
        iterations that led to it.
    """
    power = np.abs(light.values) ** 2
    power[power < 1e-3 * power.max()] = 0.0  # samples in the rim of the field stop are known too poorly
    may_be_lowered = True
    while _real(found).max() <= 1.0:
        lifted = solve(found.transmission, found.scale, bounded=False, iterations=TEST_ITERATIONS)
        is_at_limit = _real(found) >= 1.0 - 1e-6
        passed = power * _real(lifted) ** 2
        if not np.any(passed):
            return found
        fraction = float(passed[is_at_limit].sum() / passed.sum())
        lower = _brightest(_real(lifted), passed, LEAST_AT_LIMIT)
        if may_be_lowered and fraction < LEAST_AT_LIMIT and LEAST_LOWERED < lower < 1.0:
            found = _after(found, lifted, solve(_over(lifted, lower), lower * found.scale, bounded=True))
            may_be_lowered = False
            continue
        smoothed = _smoothed(lifted, power, SMOOTHING * noise_of_step / found.scale)
        if fraction == 0.0 or _mean(smoothed, power * is_at_limit) <= 1.0 + LARGEST_RISE:
            return found
        searches = [solve(start, found.scale, bounded=False) for start in (lifted.transmission, None)]
        found = _after(found, lifted, min(searches, key=lambda search: search.misfit[-1]))
        break
    smoothed = _smoothed(found, power, OVERSHOOTS * _root_mean_square(_real(found), power))
    brightest = _brightest(smoothed, power, BRIGHTEST)
    if brightest <= 0.0:
        return found
    return _after(found, solve(_over(found, brightest), brightest * found.scale, bounded=True))


def _after(*searches: Reconstructed) -> Reconstructed:
    """Return the result of the last search with the misfits of all iterations that led to it."""
    misfit = sum((search.misfit for search in searches), ())
    return replace(searches[-1], misfit=misfit)


def _real(found: Reconstructed) -> Values:
    return found.transmission.values.real


def _smoothed(found: Reconstructed, power: Values, weight: float) -> Values:
    return prox_tv(_real(found) * (power > 0.0), weight, 40)


def _brightest(values: Values, power: Values, fraction: float) -> float:
    """Return the transmission that is exceeded where this fraction of the light passes."""
    lit = power > 0.0
    order = np.argsort(values[lit])
    passed = np.cumsum(power[lit][order], dtype=float)
    index = np.searchsorted(passed, (1.0 - fraction) * passed[-1])
    return float(values[lit][order][min(int(index), len(order) - 1)])


def _mean(values: Values, weight: Values) -> float:
    return float(np.sum(values * weight) / np.sum(weight))


def _root_mean_square(values: Values, weight: Values) -> float:
    return math.sqrt(_mean(values**2, weight))


def _over(found: Reconstructed, limit: float) -> Field:
    """Return the transmission in units of a limit, which it does not exceed."""
    transmission = found.transmission
    values = np.clip(transmission.values.real / limit, 0.0, 1.0)
    return transmission.with_values(values.astype(transmission.values.dtype))
