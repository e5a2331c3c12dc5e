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


def select_parameters(estimates: Array, covariance: Array, pixels: int) -> Selection:
    """Return which parameters are needed, and the values that fit best with all others at nominal.

    Parameters
    ----------
    estimates : ndarray, shape (n,)
        Differences from nominal.
    covariance : ndarray, shape (n, n)
        Covariance of the estimates.
    pixels
        Number of data from which they were estimated.
    """
    precision = np.linalg.inv(covariance)
    # Multiple of the logarithm of the number of pixels. It exceeds 1 because object and bench are not exactly
    # at their common minimum, and because a parameter with so little effect hardly changes the object.
    penalty = 4.0
    cost, needed = penalty * math.log(max(pixels, 2)), np.ones(len(estimates), bool)
    values = np.array(estimates, float)
    while needed.any():
        needed_indices = np.flatnonzero(needed)
        values = np.zeros(len(estimates))
        inverse = np.linalg.inv(precision[np.ix_(needed_indices, needed_indices)])
        # The gradient of the form at 0 is precision @ estimates. It includes the parameters that are dropped.
        values[needed_indices] = inverse @ (precision @ estimates)[needed_indices]
        gains = values[needed_indices] ** 2 / np.diag(inverse)
        least = int(np.argmin(gains))
        if gains[least] >= cost:
            return Selection(needed, values)
        needed[needed_indices[least]] = False
    return Selection(needed, np.zeros(len(estimates)))
