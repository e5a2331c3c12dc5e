"""Rows of a plane, seen by pixels and changed in one pass.

A pixel's mean, and what its change gives back, reach a few rows to either side. Bands of rows go by
themselves: the samples of a row are made once, wait until the means of the rows about them are known and
changed, are multiplied, and go back into spectra, all while they lie in a core's cache.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import scipy.fft
from numpy.typing import DTypeLike, NDArray

from wavesim.reconstruction.recording.kernel import (
    add_halves,
    halves,
    means_along_columns,
    means_along_rows,
    multiply_spread,
)
from wavesim.runtime.threads import THREADS, for_blocks

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]
Rows = tuple[ComplexArray, ComplexArray]
Told = TypeVar("Told")
Change = Callable[[RealArray, int], Told]
"""Replaces means of rows, given with the first one's number, by relative changes, and tells of them."""

BAND = 128
"""Rows that go by themselves; those at their ends are made twice."""

NEW, LAG, REACH = 16, 4, 3
"""Rows that are made at a time; rows before them that still wait; rows to either side that one sees."""


def change_in_bands(rows: Rows, phase: ComplexArray, taps: list[float], change: Change[Told]) -> list[Told]:
    """Multiply a field on a plane by the spread change of its pixels.

    Parameters
    ----------
    rows
        Spectra along each row, through the middles of pixels and through their upper edges; replaced by those
        of the products, at half their size.
    phase
        Of the frequencies along a row, that take a field half a sample on.
    taps
        Of the means: the middle's weight, and those of samples to either side.
    change
        Called with few rows at a time, from several threads, and for rows at the ends of bands twice.

    Returns
    -------
    list
        What `change` tells of all rows, each once, in their order, however many threads there are.
    """
    height = len(rows[0])
    starts = range(0, height, BAND)
    # Copied before a neighbour overwrites them.
    beside = [
        [
            part.take([*range(start - REACH, start), *range(stop, stop + REACH)], axis=0, mode="wrap")
            for part in rows
        ]
        for start, stop in ((start, min(start + BAND, height)) for start in starts)
    ]

    def band(start: int, stop: int) -> list[Told]:
        return list(_Band(rows, beside[start // BAND], (start, stop), phase, taps).changed(change))

    return [told for one in for_blocks(band, height, BAND) for told in one]


def bytes_of_bands(shape: tuple[int, ...], dtype: DTypeLike) -> int:
    """What :func:`change_in_bands` takes for fields of a shape and type."""
    rows, width = math.prod(shape[:-1]), shape[-1]
    bands = -(-rows // BAND)
    # A window has four samples, two means along rows and one over pixels for each of a row's.
    held = 2 * 2 * REACH * bands + 5.5 * (NEW + LAG) * min(THREADS, bands)
    return round(held * width * np.dtype(dtype).itemsize)


class _Band:
    """Some rows, with those beside them."""

    def __init__(
        self,
        rows: Rows,
        beside: list[ComplexArray],
        ends: tuple[int, int],
        phase: ComplexArray,
        taps: list[float],
    ) -> None:
        self._rows, self._beside, self._ends, self._phase = rows, beside, ends, phase
        width, real = rows[0].shape[1], rows[0].real.dtype
        self._taps = np.array(taps, real)
        self._twice = 2 * self._taps
        # The first of the window's rows lies so many before the first new one.
        self._samples = np.empty((4, LAG + NEW, width), rows[0].dtype)
        self._along = np.empty((2, LAG + NEW, width), real)
        self._means = np.empty((LAG + NEW, width), real)

    def changed(self, change: Change[Told]) -> Iterator[Told]:
        """Change all rows; gives what is told of them."""
        start, stop = self._ends
        for first in range(start - REACH, stop + REACH, NEW):
            end = min(first + NEW, stop + REACH)
            zero = first - LAG
            self._make(first, end)
            low, high = max(first - 1, start - 1), end - 1
            if low < high:
                none = self._taps.dtype.type(0.0)
                means_along_columns(*self._along, self._taps, none, self._means, low - zero, high - zero)
            for piece, is_own in self._pieces(low, high):
                told = change(self._means[piece[0] - zero : piece[1] - zero], piece[0] % len(self._rows[0]))
                if is_own:
                    yield told
            low, high = max(first - REACH, start), end - REACH
            if low < high:
                self._back(low, high, zero)
            for window in (self._samples, self._along):
                window[:, :LAG] = window[:, NEW:]
            self._means[:LAG] = self._means[NEW:]

    def _make(self, first: int, end: int) -> None:
        """Samples of new rows, and their means along each."""
        start, stop = self._ends
        fresh = slice(LAG, LAG + end - first)
        for number, (part, beside) in enumerate(zip(self._rows, self._beside, strict=True)):
            middle, edge = self._samples[2 * number : 2 * number + 2]
            for (low, high), is_own in self._pieces(first, end):
                place = low if is_own else low - start + REACH if low < start else low - stop + REACH
                source = (part if is_own else beside)[place : place + high - low]
                to = slice(LAG + low - first, LAG + high - first)
                halves(source, self._phase, middle[to], edge[to])
        made = self._samples[:, fresh]
        _transform(scipy.fft.ifft, made)
        for number in (0, 1):
            middle, edge = made[2 * number : 2 * number + 2]
            means_along_rows(middle, edge, middle, edge, self._taps, self._along[number, fresh])

    def _back(self, low: int, high: int, zero: int) -> None:
        """Rows whose pixels' changes are known, times these, as spectra."""
        rows = slice(low - zero, high - zero)
        for number, between in enumerate((False, True)):
            middle, edge = self._samples[2 * number : 2 * number + 2, rows]
            multiply_spread(middle, edge, self._means, rows.start, between, self._twice)
        changed = self._samples[:, rows]
        _transform(scipy.fft.fft, changed)
        half = self._taps.dtype.type(0.5)
        for number, part in enumerate(self._rows):
            add_halves(*changed[2 * number : 2 * number + 2], self._phase, half, part[low:high])

    def _pieces(self, low: int, high: int) -> Iterator[tuple[tuple[int, int], bool]]:
        """Rows that lie beside each other on the plane, and whether they are the band's own."""
        (start, stop), height = self._ends, len(self._rows[0])
        cuts = {start, stop, *range(-(-low // height) * height, high, height)}
        ends = sorted({low, high, *(cut for cut in cuts if low < cut < high)})
        return ((piece, start <= piece[0] < stop) for piece in pairwise(ends))


def _transform(transform: Callable[..., Any], values: ComplexArray) -> None:
    """Transform along the last axis, in place."""
    found = transform(values, axis=-1, overwrite_x=True)
    if not np.may_share_memory(found, values):
        values[...] = found
