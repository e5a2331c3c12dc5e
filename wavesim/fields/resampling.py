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
"""Of the coarse samples, over the Nyquist rate of what they hold."""


@dataclass(frozen=True)
class Kernel:
    """Interpolation kernel for samples that are `OVERSAMPLING` times as dense as their band needs.

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


@dataclass(frozen=True, eq=False)
class Weights:
    """Interpolation along one axis.

    Attributes
    ----------
    first : ndarray of int, shape (fine,)
        First coarse sample that counts for each fine one.
    weight : ndarray, shape (fine, taps)
        Of that sample and of those that follow it.
    coarse : int
        Number of coarse samples.
    """

    first: NDArray[np.int64]
    weight: Array
    coarse: int

    def matrix(self) -> csr_array:
        """The same as a sparse matrix, shape (fine, coarse)."""
        fine, taps = self.weight.shape
        columns = self.first[:, None] + np.arange(taps)
        rows = np.arange(fine + 1) * taps
        return csr_array((self.weight.ravel(), columns.ravel(), rows), shape=(fine, self.coarse))

    @cached_property
    def adjoint(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray]:
        """For each coarse sample the first fine one that counts, one past the last, and all their weights."""
        taps, coarse = self.weight.shape[1], np.arange(self.coarse)
        first = np.searchsorted(self.first, coarse - taps + 1)
        last = np.searchsorted(self.first, coarse, side="right")
        fine = first[:, None] + np.arange(int(np.max(last - first)))
        inside = np.minimum(fine, len(self.first) - 1)
        counts = fine < last[:, None]
        tap = np.where(counts, coarse[:, None] - self.first[inside], 0)
        return first, last, np.where(counts, self.weight[inside, tap], self.weight.dtype.type(0))

    def astype(self, dtype: type[np.floating[Any]]) -> Weights:
        """With weights of another precision."""
        return Weights(self.first, self.weight.astype(dtype), self.coarse)


def interpolation(coarse: Array, fine: Array, kernel: Kernel) -> Weights:
    """Weights from values on a coarse axis to those on a fine one, in float64."""
    place = (fine - coarse[0]) / (coarse[1] - coarse[0])
    first = np.floor(place).astype(np.int64) - kernel.taps // 2 + 1
    distance = place[:, None] - (first[:, None] + np.arange(kernel.taps))
    inside = np.maximum(1.0 - (2.0 * distance / kernel.taps) ** 2, 0.0)
    weight = np.sinc(distance) * i0(kernel.beta * np.sqrt(inside)) / i0(kernel.beta)
    return Weights(first, weight, len(coarse))


def add_interpolated(
    coarse: NDArray,
    ways: tuple[Weights, Weights],
    carried: NDArray,
    plane: NDArray,
    place: tuple[int, int] = (0, 0),
    threads: int = THREADS,
) -> None:
    """Add a field on a coarse plane, interpolated and times a carrier, to a part of a fine plane.

    Parameters
    ----------
    coarse
        Values, C-contiguous.
    ways
        Along y and x.
    carried
        Factor of each fine sample of the part.
    plane
        Changed in place; C-contiguous.
    place
        Its row and column where the part begins.
    threads
        That share the work, at most.
    """
    (y, x), real = ways, plane.real.dtype
    fixed = (
        coarse.view(real),
        (y.first, y.weight),
        (x.first, x.weight),
        carried.view(real),
        plane.view(real),
        place,
    )
    in_columns(partial(expand, *fixed), carried.shape[1], threads)


def gathered(
    plane: NDArray,
    ways: tuple[Weights, Weights],
    carried: NDArray,
    place: tuple[int, int] = (0, 0),
    threads: int = THREADS,
) -> NDArray:
    """Conjugate transpose of :func:`add_interpolated`: values on the coarse plane."""
    (y, x), real = ways, carried.real.dtype
    fixed = (plane.view(real), place, carried.view(real), y.adjoint, x.adjoint)

    return onto_coarse(partial(collect, *fixed), ways, carried.dtype, threads)


def in_columns(work: Callable[[int, int], Any], columns: int, threads: int) -> list[Any]:
    """What a loop gives for every block of a fine plane's columns, from one to another."""
    return for_blocks(work, columns, block_width(columns), threads)


def onto_coarse(
    work: Callable[[int, int, int, int], NDArray], ways: tuple[Weights, Weights], dtype: Any, threads: int
) -> NDArray:
    """A coarse plane from what every block of a fine one's columns adds to it.

    Parameters
    ----------
    work
        Gives, as floats, what the last two, columns, add to coarse columns from the first to the second.
    ways
        From the coarse plane to the fine one, along y and x.
    dtype
        Of the values.
    threads
        That share the work, at most.
    """
    y, x = ways

    def part(begin: int, end: int) -> tuple[int, NDArray]:
        left, right = int(x.first[begin]), int(x.first[end - 1]) + x.weight.shape[1]
        return left, work(left, right, begin, end).view(dtype)

    coarse = np.zeros((y.coarse, x.coarse), dtype)
    for left, found in in_columns(part, len(x.first), threads):
        coarse[:, left : left + found.shape[1]] += found
    return coarse
