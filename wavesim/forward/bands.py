"""Pixel means of a field, and the change that they cause, in one pass over bands of rows.

The mean over a pixel, and the change that it gives back, involve a few rows on either side. Bands of rows
are processed separately. The samples of a row are computed once and wait until the means of the neighbouring
rows are known and changed. They are then multiplied and transformed back into spectra, all within a core's
cache.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.forward.pixel_kernel import (
    add_halves,
    halves,
    means_along_columns,
    means_along_rows,
    multiply_spread,
)
from wavesim.runtime.threads import for_blocks

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]
Rows = tuple[ComplexArray, ComplexArray]
Result = TypeVar("Result")
Change = Callable[[RealArray, int], Result]
"""Replaces means of rows, given the index of the first one, by relative changes, and returns a result."""

BAND = 128
"""Rows of a band. The rows at its ends are computed twice."""

NEW_ROWS, WAITING_ROWS, REACH = 16, 4, 3
"""Rows computed at a time, rows before them that still wait, and rows on either side that a pixel
involves.
"""


def change_in_bands(
    rows: Rows, phase: ComplexArray, taps: list[float], change: Change[Result]
) -> list[Result]:
    """Multiply a field on a plane by the spread change of its pixels.

    Parameters
    ----------
    rows
        Spectra along each row, through the middles of pixels and through their upper edges. They are
        replaced by half of the spectra of the products.
    phase
        Factors of the frequencies along a row that shift a field by half a sample.
    taps
        Weights of the means: the middle sample, and samples on either side.
    change
        Called with a few rows at a time from several threads, and twice for rows at the ends of bands.

    Returns
    -------
    list
        Results of `change` for all rows, each once and in order, whatever the number of threads.
    """
    height = len(rows[0])
    starts = range(0, height, BAND)
    # The neighbouring rows are copied before another band overwrites them.
    neighbours = [
        [
            part.take([*range(start - REACH, start), *range(stop, stop + REACH)], axis=0, mode="wrap")
            for part in rows
        ]
        for start, stop in ((start, min(start + BAND, height)) for start in starts)
    ]

    def band(start: int, stop: int) -> list[Result]:
        return list(_Band(rows, neighbours[start // BAND], (start, stop), phase, taps).changes(change))

    return [result for one in for_blocks(band, height, BAND) for result in one]


class _Band:
    """A band of rows with its neighbouring rows."""

    def __init__(
        self,
        rows: Rows,
        neighbours: list[ComplexArray],
        ends: tuple[int, int],
        phase: ComplexArray,
        taps: list[float],
    ) -> None:
        self._rows, self._neighbours, self._ends, self._phase = rows, neighbours, ends, phase
        width, real = rows[0].shape[1], rows[0].real.dtype
        self._taps = np.array(taps, real)
        self._twice = 2 * self._taps
        # The window begins with the rows that still wait.
        self._samples = np.empty((4, WAITING_ROWS + NEW_ROWS, width), rows[0].dtype)
        self._along = np.empty((2, WAITING_ROWS + NEW_ROWS, width), real)
        self._means = np.empty((WAITING_ROWS + NEW_ROWS, width), real)

    def changes(self, change: Change[Result]) -> Iterator[Result]:
        """Change all rows, and yield the results of the band's own rows."""
        start, stop = self._ends
        for first in range(start - REACH, stop + REACH, NEW_ROWS):
            end = min(first + NEW_ROWS, stop + REACH)
            zero = first - WAITING_ROWS
            self._make_samples(first, end)
            low, high = max(first - 1, start - 1), end - 1
            if low < high:
                none = self._taps.dtype.type(0.0)
                means_along_columns(*self._along, self._taps, none, self._means, low - zero, high - zero)
            for piece, is_own in self._pieces(low, high):
                result = change(self._means[piece[0] - zero : piece[1] - zero], piece[0] % len(self._rows[0]))
                if is_own:
                    yield result
            low, high = max(first - REACH, start), end - REACH
            if low < high:
                self._write_products(low, high, zero)
            for window in (self._samples, self._along):
                window[:, :WAITING_ROWS] = window[:, NEW_ROWS:]
            self._means[:WAITING_ROWS] = self._means[NEW_ROWS:]

    def _make_samples(self, first: int, end: int) -> None:
        """Compute samples of new rows, and the means along each."""
        start, stop = self._ends
        new_rows = slice(WAITING_ROWS, WAITING_ROWS + end - first)
        for side, (part, neighbours) in enumerate(zip(self._rows, self._neighbours, strict=True)):
            middle, edge = self._samples[2 * side : 2 * side + 2]
            for (low, high), is_own in self._pieces(first, end):
                position = low if is_own else low - start + REACH if low < start else low - stop + REACH
                source = (part if is_own else neighbours)[position : position + high - low]
                to = slice(WAITING_ROWS + low - first, WAITING_ROWS + high - first)
                halves(source, self._phase, middle[to], edge[to])
        samples = self._samples[:, new_rows]
        _transform(scipy.fft.ifft, samples)
        for side in (0, 1):
            middle, edge = samples[2 * side : 2 * side + 2]
            means_along_rows(middle, edge, middle, edge, self._taps, self._along[side, new_rows])

    def _write_products(self, low: int, high: int, zero: int) -> None:
        """Multiply rows by the changes of their pixels, and write them back as spectra."""
        rows = slice(low - zero, high - zero)
        for side, between in enumerate((False, True)):
            middle, edge = self._samples[2 * side : 2 * side + 2, rows]
            multiply_spread(middle, edge, self._means, rows.start, between, self._twice)
        changes = self._samples[:, rows]
        _transform(scipy.fft.fft, changes)
        half = self._taps.dtype.type(0.5)
        for side, part in enumerate(self._rows):
            add_halves(*changes[2 * side : 2 * side + 2], self._phase, half, part[low:high])

    def _pieces(self, low: int, high: int) -> Iterator[tuple[tuple[int, int], bool]]:
        """Yield pieces of contiguous rows, and whether they belong to the band itself."""
        (start, stop), height = self._ends, len(self._rows[0])
        cuts = {start, stop, *range(-(-low // height) * height, high, height)}
        ends = sorted({low, high, *(cut for cut in cuts if low < cut < high)})
        return ((piece, start <= piece[0] < stop) for piece in pairwise(ends))


def _transform(transform: Callable[..., Any], values: ComplexArray) -> None:
    """Transform along the last axis, in place."""
    found = transform(values, axis=-1, overwrite_x=True)
    if not np.may_share_memory(found, values):
        values[...] = found
