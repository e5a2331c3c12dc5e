"""Band-limited interpolation between evenly spaced samples, as sparse matrices.

Each fine sample is a weighted sum of the coarse samples around it, with the weights of a sinc under a Kaiser
window; see A. V. Oppenheim and R. W. Schafer, "Discrete-Time Signal Processing", section 7.5.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import i0

Array = NDArray[np.float64]

OVERSAMPLING = 2.0
"""Of the coarse samples, over the Nyquist rate of what they hold."""


@dataclass(frozen=True)
class Kernel:
    """Interpolation kernel for samples that are twice as dense as their band needs.

    Attributes
    ----------
    taps : int
        Coarse samples that count for a fine one; even.
    beta : float
        Of the Kaiser window.
    """

    taps: int
    beta: float


def kernel_for(error: float) -> Kernel:
    """The shortest kernel of an interpolation error, by Kaiser's formulas."""
    attenuation_db = max(-20.0 * math.log10(error), 50.0)
    transition = 2.0 * math.pi * (1.0 - 1.0 / OVERSAMPLING)
    taps = 2 * math.ceil(0.5 * (attenuation_db - 8.0) / (2.285 * transition))
    return Kernel(taps, 0.1102 * (attenuation_db - 8.7))


def coarse_axis(fine: Array, step: float, kernel: Kernel) -> Array:
    """Even samples that hold all neighbours of a fine axis."""
    count = math.ceil((fine[-1] - fine[0]) / step) + kernel.taps + 1
    return np.asarray(0.5 * (fine[0] + fine[-1]) + step * (np.arange(count) - 0.5 * (count - 1)))


def interpolation(coarse: Array, fine: Array, kernel: Kernel) -> csr_array:
    """Matrix from values on a coarse axis to those on a fine one, in float64."""
    step = coarse[1] - coarse[0]
    place = (fine - coarse[0]) / step
    first = np.floor(place).astype(int) - kernel.taps // 2 + 1
    columns = first[:, None] + np.arange(kernel.taps)
    distance = place[:, None] - columns
    inside = np.maximum(1.0 - (2.0 * distance / kernel.taps) ** 2, 0.0)
    weights = np.sinc(distance) * i0(kernel.beta * np.sqrt(inside)) / i0(kernel.beta)
    rows = np.arange(len(fine) + 1) * kernel.taps
    return csr_array((weights.ravel(), columns.ravel(), rows), shape=(len(fine), len(coarse)))
