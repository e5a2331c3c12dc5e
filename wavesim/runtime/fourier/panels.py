"""Fourier transforms of the rows and columns of a plane, sixteen at once, in a memory layout that suits both.

In an array with contiguous rows, each value of a column lies in another page of memory. Reading and writing a
few columns then takes longer than transforming them. A panel stores sixteen columns together: a block of
columns is one contiguous piece of memory, and sixteen rows are a few long pieces. Vectors are as wide as the
processor's; those of SciPy hold four numbers. Columns take a third of SciPy's time. Rows, which are copied
from and to panels, take between two thirds and seven sixths of it.
"""

from __future__ import annotations

import math
import threading
from functools import cache
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import DTypeLike, NDArray

from wavesim.runtime.fourier import passes
from wavesim.runtime.fourier.lanes import CACHE_LINE, LANES
from wavesim.runtime.fourier.passes import SAMPLE, Steps

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]

APART = 16
"""Padding rows between panels, since panels at distances of powers of 2 would share the same lines of a
cache."""


class Panels:
    """Complex values on a plane, stored in panels of sixteen columns.

    Parameters
    ----------
    shape
        Rows and columns.
    dtype
        complex64 or complex128.

    Attributes
    ----------
    shape : (int, int)
    dtype : numpy.dtype
    values : ndarray
        Shape (panels, rows, 2, 16): real, then imaginary parts of sixteen columns. Columns of the last panel
        beyond the plane are 0 after :meth:`put_rows`.
    """

    def __init__(self, shape: tuple[int, int], dtype: DTypeLike) -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        count, rows = -(-shape[1] // LANES), shape[0]
        self._flat = aligned((count, (rows + APART) * SAMPLE), self.dtype)
        self.values: RealArray = self._flat.reshape(count, rows + APART, 2, LANES)[:, :rows]
        self._down, self._across = (steps_for(count, self.dtype.name) for count in shape)

    def put_rows(self, rows: ComplexArray, first: int) -> None:
        """Transform rows along x, and store them from row `first` on."""
        width = self.shape[1]
        samples, buffers = self._thread_buffers(width)
        for start in range(0, len(rows), LANES):
            part = rows[start : start + LANES]
            passes.rows_to_samples(part.view(self.values.dtype), samples)
            samples[width * SAMPLE :] = 0.0
            passes.transform(samples, samples, width, self._across, False, buffers)
            passes.samples_to_panels(samples, len(part), self._flat, first + start)

    def take_rows(self, first: int, rows: ComplexArray, values: RealArray | None = None) -> ComplexArray:
        """Fill `rows` with the inverse transform along x of the rows from `first` on, and return them.

        The transform is not divided by the number of columns. It reads `values` instead of the panels'
        own values, if given.
        """
        width = self.shape[1]
        panels = self._flat if values is None else values.reshape(len(values), -1)
        samples, buffers = self._thread_buffers(width)
        for start in range(0, len(rows), LANES):
            part = rows[start : start + LANES]
            passes.panels_to_samples(panels, first + start, len(part), samples)
            passes.transform(samples, samples, width, self._across, True, buffers)
            passes.samples_to_rows(samples, part.view(self.values.dtype))
        return rows

    def along_columns(self, source: RealArray, target: RealArray, inverse: bool) -> None:
        """Transform the columns of a panel; the inverse is not divided by the number of rows.

        Source and target may be the same panel.
        """
        _, buffers = self._thread_buffers(self.shape[0])
        flat_source, flat_target = source.reshape(-1), target.reshape(-1)
        passes.transform(flat_source, flat_target, self.shape[0], self._down, inverse, buffers)

    def _thread_buffers(self, count: int) -> tuple[RealArray, RealArray]:
        """Return this thread's buffers for samples of sixteen rows and for transforms of `count` samples."""
        kind = self.dtype.name
        samples = thread_buffer("samples", (len(self.values) * LANES * SAMPLE,), kind)
        return samples, buffers_for(count, kind)


def bytes_of_panels(shape: tuple[int, int], dtype: DTypeLike) -> int:
    """Return the memory of values on a plane."""
    return -(-shape[1] // LANES) * LANES * (shape[0] + APART) * np.dtype(dtype).itemsize


def transform_bytes(shape: tuple[int, int], dtype: DTypeLike) -> int:
    """Return the working memory of each thread: sixteen rows, and buffers of the longer transform."""
    wide = max(map(convolved, shape))
    buffers = 2 if all(convolved(count) == count for count in shape) else 3
    return (shape[1] + buffers * wide) * LANES * np.dtype(dtype).itemsize


def aligned(shape: tuple[int, ...], dtype: DTypeLike) -> RealArray:
    """Return an uninitialised real array, with the precision of a complex type, that begins at a cache line.

    A vector that crosses the border of two cache lines takes twice the time.
    """
    kind = np.dtype(dtype).type(0).real.dtype
    size = math.prod(shape) * kind.itemsize
    room = np.empty(size + CACHE_LINE, np.uint8)
    start = -room.ctypes.data % CACHE_LINE
    return room[start : start + size].view(kind).reshape(shape)


@cache
def steps_for(count: int, dtype: str) -> Steps:
    """Return the constants of a transform of `count` samples of a complex type."""
    kind: Any = np.dtype(dtype).type(0).real.dtype
    wide = convolved(count)
    radices = _radices(wide)
    if wide == count:
        none = np.zeros(0, kind)
        return Steps(*_twiddles(radices, count, kind), none, none)
    squares = np.arange(count) ** 2 % (2 * count)
    chirp = np.exp(-1j * np.pi * squares / count)
    response = np.zeros(wide, complex)
    response[:count] = chirp.conj()
    response[wide - count + 1 :] = chirp[:0:-1].conj()
    spectrum = scipy.fft.fft(response) / wide
    return Steps(*_twiddles(radices, wide, kind), _interleaved(chirp, kind), _interleaved(spectrum, kind))


def convolved(count: int) -> int:
    """Return the number of samples that are transformed for `count` samples.

    It is larger if there is no pass for a prime factor of `count`; the transform is then a convolution.
    """
    return count if math.prod(_radices(count)) == count else scipy.fft.next_fast_len(2 * count - 1)


def _radices(count: int) -> list[int]:
    """Return those factors of `count` for which there are passes."""
    found = []
    # Radices for which there are passes, in the order in which they are used.
    radices = (8, 4, 2, 3, 5, 7, 11, 13)
    for radix in radices:
        while count % radix == 0:
            found.append(radix)
            count //= radix
    return found


def _twiddles(
    radices: list[int], count: int, kind: Any
) -> tuple[NDArray[np.int64], NDArray[np.int64], RealArray]:
    firsts, twiddles, left = [0], [], count
    for radix in radices:
        angles = np.outer(np.arange(left // radix), np.arange(1, radix)).ravel()
        twiddles.append(np.exp(-2j * np.pi * (angles % left) / left))
        firsts.append(firsts[-1] + len(angles))
        left //= radix
    return np.array(radices, np.int64), np.array(firsts), _interleaved(np.concatenate([*twiddles, []]), kind)


def _interleaved(values: NDArray[np.complex128], kind: Any) -> RealArray:
    """Return an array in which real and imaginary parts alternate."""
    return np.ascontiguousarray(values, complex).view(float).astype(kind)


def buffers_for(count: int, dtype: str) -> RealArray:
    """Return this thread's buffers for transforms of `count` samples of a complex type."""
    buffers, wide = buffers_shape(count)
    return thread_buffer("buffers", (buffers, wide * SAMPLE), dtype)


def buffers_shape(count: int) -> tuple[int, int]:
    """Return the number of buffers that a transform needs, and the number of samples in each."""
    wide = convolved(count)
    return 2 if wide == count else 3, wide


_THREAD = threading.local()


def thread_buffer(name: str, shape: tuple[int, ...], dtype: DTypeLike) -> RealArray:
    """Return a real buffer of this thread. It is reused at every call, since new memory takes time."""
    kept = _THREAD.__dict__
    if name not in kept or (kept[name].shape, kept[name].dtype) != (
        shape,
        np.dtype(dtype).type(0).real.dtype,
    ):
        kept[name] = aligned(shape, dtype)
    found: RealArray = kept[name]
    return found
