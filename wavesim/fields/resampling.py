"""Band-limited interpolation between evenly spaced samples.

Each fine sample is a weighted sum of the coarse samples around it, with the weights of a sinc under a Kaiser
window; see A. V. Oppenheim and R. W. Schafer, "Discrete-Time Signal Processing", section 7.5.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import i0

from lensdesign.common.arrays import Array
from wavesim.fields.resampling_kernel import block_width, collect, expand
from wavesim.runtime.threads import THREADS, for_blocks

OVERSAMPLING = 1.6
"""Density of the coarse samples, relative to the Nyquist rate of the interpolated function."""


@dataclass(frozen=True)
class Kernel:
    """Interpolation kernel for samples that are oversampled by `OVERSAMPLING`.

    Attributes
    ----------
    taps : int
        Number of coarse samples that contribute to a fine one; even.
    beta : float
        Shape parameter of the Kaiser window.
    """

    taps: int
    beta: float


def kernel_for(error: float, largest_error: float = 10.0**-2.5) -> Kernel:
    """Return the shortest kernel for an interpolation error, by Kaiser's formulas.

    Larger errors than the largest one, which is at most 0.03, give the kernel of the largest one.
    """
    attenuation_db = -20.0 * math.log10(min(error, largest_error))
    transition = 2.0 * math.pi * (1.0 - 1.0 / OVERSAMPLING)
    taps = 2 * math.ceil(0.5 * (attenuation_db - 8.0) / (2.285 * transition))
    if attenuation_db >= 50.0:
        return Kernel(taps, 0.1102 * (attenuation_db - 8.7))
    beyond_db = attenuation_db - 21.0
    return Kernel(taps, 0.5842 * beyond_db**0.4 + 0.07886 * beyond_db)


def coarse_axis(fine: Array, step: float, kernel: Kernel) -> Array:
    """Return evenly spaced samples that include all neighbours of a fine axis."""
    count = math.ceil((fine[-1] - fine[0]) / step) + kernel.taps + 1
    return np.asarray(0.5 * (fine[0] + fine[-1]) + step * (np.arange(count) - 0.5 * (count - 1)))


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of an interpolation along one axis.

    Attributes
    ----------
    first : ndarray of int, shape (fine,)
        First coarse sample that contributes to each fine one.
    weight : ndarray, shape (fine, taps)
        Weights of that sample and of those that follow it.
    coarse : int
        Number of coarse samples.
    """

    first: NDArray[np.int64]
    weight: Array
    coarse: int

    def matrix(self) -> csr_array:
        """Return the weights as a sparse matrix, shape (fine, coarse)."""
        fine, taps = self.weight.shape
        columns = self.first[:, None] + np.arange(taps)
        rows = np.arange(fine + 1) * taps
        return csr_array((self.weight.ravel(), columns.ravel(), rows), shape=(fine, self.coarse))

    @cached_property
    def adjoint(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray]:
        """Transposed weights: for each coarse sample the first fine one, one past the last, and weights."""
        taps, coarse = self.weight.shape[1], np.arange(self.coarse)
        first = np.searchsorted(self.first, coarse - taps + 1)
        last = np.searchsorted(self.first, coarse, side="right")
        fine = first[:, None] + np.arange(int(np.max(last - first)))
        inside = np.minimum(fine, len(self.first) - 1)
        counts = fine < last[:, None]
        tap = np.where(counts, coarse[:, None] - self.first[inside], 0)
        return first, last, np.where(counts, self.weight[inside, tap], self.weight.dtype.type(0))

    def astype(self, dtype: type[np.floating[Any]]) -> Weights:
        """Return the weights in another precision."""
        return Weights(self.first, self.weight.astype(dtype), self.coarse)


def interpolation(coarse: Array, fine: Array, kernel: Kernel) -> Weights:
    """Return the weights of an interpolation from a coarse axis to a fine one, in float64."""
    position = (fine - coarse[0]) / (coarse[1] - coarse[0])
    first = np.floor(position).astype(np.int64) - kernel.taps // 2 + 1
    distance = position[:, None] - (first[:, None] + np.arange(kernel.taps))
    inside = np.maximum(1.0 - (2.0 * distance / kernel.taps) ** 2, 0.0)
    weight = np.sinc(distance) * i0(kernel.beta * np.sqrt(inside)) / i0(kernel.beta)
    return Weights(first, weight, len(coarse))


def add_interpolated(
    coarse: NDArray,
    weights: tuple[Weights, Weights],
    carrier: NDArray,
    plane: NDArray,
    origin: tuple[int, int] = (0, 0),
    threads: int = THREADS,
) -> None:
    """Interpolate a field from a coarse plane, multiply it by a carrier, and add it to part of a fine plane.

    Parameters
    ----------
    coarse
        Field on the coarse plane, C-contiguous.
    weights
        Interpolation weights along y and x.
    carrier
        Factor of each fine sample of the part.
    plane
        Fine plane, C-contiguous; changed in place.
    origin
        Row and column of the plane at which the part begins.
    threads
        Most threads.
    """
    (y, x), real = weights, plane.real.dtype
    fixed = (
        coarse.view(real),
        (y.first, y.weight),
        (x.first, x.weight),
        carrier.view(real),
        None,
        plane.view(real),
        origin,
    )
    for_column_blocks(partial(expand, *fixed), carrier.shape[1], threads)


def gathered(
    plane: NDArray,
    weights: tuple[Weights, Weights],
    carrier: NDArray,
    origin: tuple[int, int] = (0, 0),
    threads: int = THREADS,
) -> NDArray:
    """Return the conjugate transpose of :func:`add_interpolated` applied to a plane: a coarse field."""
    (y, x), real = weights, carrier.real.dtype
    fixed = (plane.view(real), origin, carrier.view(real), None, y.adjoint, x.adjoint)

    return onto_coarse(partial(collect, *fixed), weights, carrier.dtype, threads)


def for_column_blocks(work: Callable[[int, int], Any], columns: int, threads: int) -> list[Any]:
    """Return what a loop gives for every block of a fine plane's columns, called with its begin and end."""
    return for_blocks(work, columns, block_width(columns), threads)


def onto_coarse(
    work: Callable[[int, int, int, int], NDArray], weights: tuple[Weights, Weights], dtype: Any, threads: int
) -> NDArray:
    """Sum the contributions of all blocks of a fine plane's columns to a coarse plane.

    Parameters
    ----------
    work
        Returns, as floats, the contribution of the fine columns from its third to its fourth argument to the
        coarse columns from its first to its second argument.
    weights
        Interpolation weights from the coarse plane to the fine one, along y and x.
    dtype
        Data type of the values.
    threads
        Most threads.
    """
    y, x = weights

    def contribution(begin: int, end: int) -> tuple[int, NDArray]:
        left, right = int(x.first[begin]), int(x.first[end - 1]) + x.weight.shape[1]
        return left, work(left, right, begin, end).view(dtype)

    coarse = np.zeros((y.coarse, x.coarse), dtype)
    for left, found in for_column_blocks(contribution, len(x.first), threads):
        coarse[:, left : left + found.shape[1]] += found
    return coarse
