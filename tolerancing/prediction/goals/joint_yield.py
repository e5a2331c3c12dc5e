"""The joint yield of all limits of a study as a smooth function of the scores of drawn lenses.

A lens is good if it meets all limits. The load of a lens on a limit is the square
of the limited quantity divided by the square of the limit; a lens with a load above 1 fails. A logistic
function of the worst load, whose width is the softness of that limit, replaces the step from good to bad.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from lensdesign.common.arrays import Array

WAVEFRONT_SOFTNESS = 0.06
"""Softness of a limit on wavefronts, as a fraction of the limit's square."""

RAY_SOFTNESS, LEAST_SOFTNESS = 0.15, 1e-4
"""Softness of a limit on rays, as a fraction of the standard deviation of its loads, and its smallest value.

Squares of angles and footprints scatter by a per cent or less, and a fixed softness would hide that."""


class DrawnLoads(Protocol):
    """Loads of t drawn lenses on one limit, for v variables.

    Attributes
    ----------
    softness : float or None
        Softness of the limit; None derives it from the standard deviation of the loads.
    sign : float
        1 if larger loads are worse, -1 if smaller ones are.
    """

    @property
    def loads(self) -> Array:
        """Return the loads, shape (t,)."""

    @property
    def softness(self) -> float | None: ...

    @property
    def sign(self) -> float: ...

    def weighted(self, weights: Array) -> Array:
        """Return derivatives of the weighted sum of the loads by the variables, shape (v,)."""


def failing_fraction(limits: Sequence[DrawnLoads], variables: int) -> tuple[float, Array]:
    """Return the smoothed fraction of lenses that miss a limit, and its derivatives by the variables.

    Parameters
    ----------
    limits
        Loads on the limits, at least one; all for the same drawn lenses.
    variables
        Number of variables; 0 computes no derivatives.
    """
    softness = np.array([_softness(one) for one in limits])
    loads = np.stack([one.loads for one in limits])
    signs = np.array([one.sign for one in limits])
    away = signs[:, None] * (loads - 1.0) / softness[:, None]
    worst = np.argmax(away, axis=0)
    draws = np.arange(loads.shape[1])
    soft = 1.0 / (1.0 + np.exp(np.clip(-away[worst, draws], -500.0, 500.0)))
    by = np.zeros(variables)
    slope = soft * (1.0 - soft) / len(draws)
    for k, one in enumerate(limits) if variables else ():
        own = np.where(worst == k, slope, 0.0)
        if not np.any(own):
            continue
        weights = own * signs[k] / softness[k]
        if one.softness is None:
            by_softness = -float(own @ away[k]) / softness[k]
            spread = (one.loads - np.mean(one.loads)) / len(draws)
            weights = weights + by_softness * RAY_SOFTNESS**2 * spread / softness[k]
        by += one.weighted(weights)
    return float(np.mean(soft)), by


def _softness(one: DrawnLoads) -> float:
    if one.softness is not None:
        return one.softness
    return float(np.hypot(RAY_SOFTNESS * np.std(one.loads), LEAST_SOFTNESS))
