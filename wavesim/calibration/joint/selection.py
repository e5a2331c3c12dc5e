"""Which parameters of a bench the frames need: a backward elimination by the Bayesian information criterion.

An estimate with its covariance is a quadratic form of the misfit. A parameter whose return to its nominal
value raises the misfit (as chi squared) by less than a few times the logarithm of the number of pixels is not
needed. It goes back to nominal, the others move to where they fit best then, and the next one is looked for.

Source: G. Schwarz, "Estimating the dimension of a model", Ann. Statist. 6, 461 (1978).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array

SURE = 4.0
"""Times the logarithm: object and bench are not quite at their common minimum, whose curvature is taken, and
a parameter that raises the misfit by so little does next to nothing to the object."""


class Selection(NamedTuple):
    """Parameters that are needed, and the values of all; those of the others are nominal: 0."""

    needed: NDArray[np.bool_]
    values: Array


def select_parameters(estimates: Array, covariance: Array, pixels: int) -> Selection:
    """Return which parameters are needed, and the values that fit best with all others at nominal.

    Parameters
    ----------
    estimates : ndarray, shape (n,)
        Differences from nominal.
    covariance : ndarray, shape (n, n)
        Of the estimates.
    pixels
        Number of data from which they were estimated.
    """
    precision = np.linalg.inv(covariance)
    cost, needed = SURE * math.log(max(pixels, 2)), np.ones(len(estimates), bool)
    values = np.array(estimates, float)
    while needed.any():
        kept = np.flatnonzero(needed)
        values = np.zeros(len(estimates))
        inverse = np.linalg.inv(precision[np.ix_(kept, kept)])
        # The form's slope at 0 is precision @ estimates: what is dropped pulls the others along.
        values[kept] = inverse @ (precision @ estimates)[kept]
        gains = values[kept] ** 2 / np.diag(inverse)
        least = int(np.argmin(gains))
        if gains[least] >= cost:
            return Selection(needed, values)
        needed[kept[least]] = False
    return Selection(needed, np.zeros(len(estimates)))
