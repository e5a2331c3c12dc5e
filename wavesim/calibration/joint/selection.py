"""Which parameters of a bench the frames need: a backward elimination by the Bayesian information criterion.

An estimate with its covariance is a quadratic form of the misfit. A parameter is not needed if its return to
the nominal value raises chi-square by less than a multiple of the logarithm of the number of pixels. Such a
parameter is set to nominal, the others move to their new optimum, and the next one is tested.

References
----------
G. Schwarz, "Estimating the dimension of a model", Ann. Statist. 6, 461 (1978).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array


class Selection(NamedTuple):
    """Parameters that are needed, and the values of all parameters; those that are not needed are 0
    (nominal).
    """

    needed: NDArray[np.bool_]
    values: Array


def eliminated_in_turn(estimates: Array, covariance: Array) -> tuple[Selection, ...]:
    """Return selections with fewer and fewer parameters: first all, last none.

    The parameter whose return to nominal raises chi-square least is eliminated first. The others then have
    the values that fit best without it.

    Parameters
    ----------
    estimates : ndarray, shape (n,)
        Differences from nominal.
    covariance : ndarray, shape (n, n)
        Covariance of the estimates.
    """
    precision = np.linalg.inv(covariance)
    needed, values = np.ones(len(estimates), bool), np.array(estimates, float)
    found = [Selection(needed, values)]
    while needed.any():
        indices = np.flatnonzero(needed)
        inverse = np.linalg.inv(precision[np.ix_(indices, indices)])
        least = indices[np.argmin(values[indices] ** 2 / np.diag(inverse))]
        needed, values = needed.copy(), np.zeros(len(estimates))
        needed[least] = False
        indices = np.flatnonzero(needed)
        # The gradient of the form at 0 is precision @ estimates. It includes the parameters that are dropped.
        values[indices] = np.linalg.solve(
            precision[np.ix_(indices, indices)], (precision @ estimates)[indices]
        )
        found.append(Selection(needed, values))
    return tuple(found)


def count_not_needed(selections: Sequence[Selection], covariance: Array, pixels: int) -> int:
    """Return how many parameters of :func:`eliminated_in_turn` the frames do not need.

    Parameters
    ----------
    selections
        The selections.
    covariance : ndarray, shape (n, n)
        Covariance of the estimates.
    pixels
        Number of data from which they were estimated.
    """
    precision = np.linalg.inv(covariance)
    # Multiple of the logarithm of the number of pixels. It exceeds 1 because object and bench are not exactly
    # at their common minimum, and because a parameter with so little effect hardly changes the object.
    penalty = 4.0
    cost = penalty * math.log(max(pixels, 2))
    steps = np.diff([one.values for one in selections], axis=0)
    rises = np.einsum("ki,ij,kj->k", steps, precision, steps)
    above = np.flatnonzero(rises >= cost)
    return int(above[0]) if len(above) else len(rises)
