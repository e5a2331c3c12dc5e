"""Fourier transforms of a plane's rows and of its columns, sixteen at once, in memory that suits both.

Where rows lie one after the other, a few columns are as many places as there are rows, each in a page of
memory of its own: to read and write them takes longer than to transform them. In panels sixteen columns lie
together, so that a block of columns is one piece of memory, and of sixteen rows pieces are long. With vectors
as wide as the processor's, where SciPy's hold four numbers, columns take a third of its time; rows, which are
gathered and put back, between two thirds and a sixth more.
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
    """Complex values on a plane, sixteen columns after sixteen.

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
        Shape (panels, rows, 2, 16): real, then imaginary parts of sixteen columns. Those that a last panel
        has beyond the plane are 0 once rows have been put in.
    """

    def __init__(self, shape: tuple[int, int], dtype: DTypeLike) -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        count, rows = -(-shape[1] // LANES), shape[0]
        self._flat = aligned((count, (rows + APART) * SAMPLE), self.dtype)
        self.values: RealArray = self._flat.reshape(count, rows + APART, 2, LANES)[:, :rows]
        self._down, self._across = (steps_for(count, self.dtype.name) for count in shape)

    def put_rows(self, rows: ComplexArray, first: int) -> None:
        """Transform rows along themselves, and put them in from one row on."""
        width = self.shape[1]
        samples, buffers = self._at_work(width)
        for start in range(0, len(rows), LANES):
            part = rows[start : start + LANES]
            passes.rows_to_samples(part.view(self.values.dtype), samples)
            samples[width * SAMPLE :] = 0.0
            passes.transform(samples, samples, width, self._across, False, buffers)
            passes.samples_to_panels(samples, len(part), self._flat, first + start)

    def take_rows(self, first: int, rows: ComplexArray, values: RealArray | None = None) -> ComplexArray:
        """Apply the inverse transform without its factor along rows from one on; to other values if given."""
        width = self.shape[1]
        panels = self._flat if values is None else values.reshape(len(values), -1)
        samples, buffers = self._at_work(width)
        for start in range(0, len(rows), LANES):
            part = rows[start : start + LANES]
            passes.panels_to_samples(panels, first + start, len(part), samples)
            passes.transform(samples, samples, width, self._across, True, buffers)
            passes.samples_to_rows(samples, part.view(self.values.dtype))
        return rows

    def along_columns(self, source: RealArray, target: RealArray, inverse: bool) -> None:
        """Transform a panel's columns, forward or inverse without a factor; both may be the same."""
        _, buffers = self._at_work(self.shape[0])
        given, taking = source.reshape(-1), target.reshape(-1)
        passes.transform(given, taking, self.shape[0], self._down, inverse, buffers)

    def _at_work(self, count: int) -> tuple[RealArray, RealArray]:
        """This thread's samples of sixteen rows, and buffers for transforms of a count."""
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
    """Real numbers of a complex type's precision that begin where a vector may.

    A vector that lies in two cache lines takes twice the time.
    """
    kind = np.dtype(dtype).type(0).real.dtype
    size = math.prod(shape) * kind.itemsize
    room = np.empty(size + CACHE_LINE, np.uint8)
    start = -room.ctypes.data % CACHE_LINE
    return room[start : start + size].view(kind).reshape(shape)


@cache
def steps_for(count: int, dtype: str) -> Steps:
    """Return the factors of a transform of a number of samples of a complex type."""
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
    return Steps(*_twiddles(radices, wide, kind), _in_turn(chirp, kind), _in_turn(spectrum, kind))


def convolved(count: int) -> int:
    """Return the transformed number of samples, which is larger where no pass handles a prime factor."""
    return count if math.prod(_radices(count)) == count else scipy.fft.next_fast_len(2 * count - 1)


def _radices(count: int) -> list[int]:
    """Return the factors for which there are passes."""
    found = []
    # Radices of the passes, in this order; with other prime factors a transform is a convolution.
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
    return np.array(radices, np.int64), np.array(firsts), _in_turn(np.concatenate([*twiddles, []]), kind)


def _in_turn(values: NDArray[np.complex128], kind: Any) -> RealArray:
    """Return real and imaginary parts one after the other."""
    return np.ascontiguousarray(values, complex).view(float).astype(kind)


def buffers_for(count: int, dtype: str) -> RealArray:
    """Return a thread's own buffers for transforms of a number of samples of a complex type."""
    buffers, wide = buffers_shape(count)
    return thread_buffer("buffers", (buffers, wide * SAMPLE), dtype)


def buffers_shape(count: int) -> tuple[int, int]:
    """Return the number of buffers of a transform, and the samples in each."""
    wide = convolved(count)
    return 2 if wide == count else 3, wide


_THREAD = threading.local()


def thread_buffer(name: str, shape: tuple[int, ...], dtype: DTypeLike) -> RealArray:
    """Return a real buffer of a thread, the same at every call, since touching new memory takes time."""
    kept = _THREAD.__dict__
    if name not in kept or (kept[name].shape, kept[name].dtype) != (
        shape,
        np.dtype(dtype).type(0).real.dtype,
    ):
        kept[name] = aligned(shape, dtype)
    found: RealArray = kept[name]
    return found
