"""Nonuniform Fourier transform of several terms on one plane at once, in single precision.

Each term is divided by the Fourier transform of a kernel. A fast Fourier transform then gives its values on
a somewhat finer grid. The value at a point is the sum of the cells around it, weighted by the kernel. The
grid is periodic, and a halo behind its end repeats its first cells for points whose kernel reaches beyond the
end. See A. H. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019). The kernel is a
Kaiser-Bessel window, whose Fourier transform is known (J. I. Jackson, C. H. Meyer, D. G. Nishimura,
A. Macovski, IEEE Trans. Med. Imaging 10, 473, 1991). Its shape parameter follows P. J. Beatty,
D. G. Nishimura, J. M. Pauly, IEEE Trans. Med. Imaging 24, 799 (2005).

FINUFFT transforms one term after the other, and evaluates the kernel for each. Here the terms of a cell are
contiguous, and one vector holds four of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.special import i0

from lensdesign.common.arrays import Array
from wavesim.runtime.fourier.lanes import CACHE_LINE
from wavesim.runtime.fourier.terms_kernel import (
    LANES,
    MORE_COEFFICIENTS,
    gather,
    put_modes,
    spread,
    take_modes,
)


@dataclass(frozen=True, eq=False)
class Axis:
    """Modes and grid along one axis.

    Attributes
    ----------
    cells : int
        Number of cells of the grid.
    width : int
        Width of the kernel in cells.
    modes : ndarray of int
        Mode numbers, ascending from -n // 2.
    """

    cells: int
    width: int
    modes: NDArray[np.int64]

    @property
    def beta(self) -> float:
        """Shape parameter of the Kaiser-Bessel kernel."""
        finer = self.cells / len(self.modes)
        return math.pi * math.sqrt(max((self.width / finer * (finer - 0.5)) ** 2 - 0.8, 0.0))

    def transformed(self, modes: NDArray[np.int64]) -> Array:
        """Return the Fourier transform of the kernel at mode numbers, for cells of unit width."""
        rest = self.beta**2 - (math.pi * self.width * modes / self.cells) ** 2
        root = np.sqrt(np.abs(rest)) + 1e-12
        return np.asarray(
            self.width * np.where(rest > 0.0, np.sinh(root), np.sin(root)) / root / i0(self.beta)
        )

    @property
    def squared_error(self) -> float:
        """Square of the relative aliasing error, for modes of equal size."""
        # Periods of the grid whose aliases are added.
        periods = np.array([*range(-8, 0), *range(1, 9)])
        repeats = self.modes + self.cells * periods[:, None]
        return float(np.mean(np.sum((self.transformed(repeats) / self.transformed(self.modes)) ** 2, axis=0)))

    @property
    def places(self) -> NDArray[np.int64]:
        """Positions of the modes among the cells."""
        return self.modes % self.cells

    @property
    def factors(self) -> NDArray[np.float32]:
        """Factor of each mode. Cell 0 of the grid is at the angle -pi."""
        return ((-1.0) ** (self.modes % 2) / self.transformed(self.modes)).astype(np.float32)


@cache
def axes_for(shape: tuple[int, ...], error: float) -> tuple[Axis, ...]:
    """Return the axes (y, x) for numbers of modes, with the narrowest kernel that meets a relative error."""
    # Number of cells over number of modes.
    oversampling = 1.25
    # Possible widths of the kernel in cells.
    widths = range(3, 13)
    for width in widths:
        axes = tuple(
            Axis(
                # `real=True` gives products of 2, 3 and 5 only.
                scipy.fft.next_fast_len(max(math.ceil(oversampling * n), 2 * width), real=True),
                width,
                np.arange(n) - n // 2,
            )
            for n in shape
        )
        if sum(axis.squared_error for axis in axes) <= error**2:
            break
    return axes


@cache
def pieces_of(width: int, beta: float) -> tuple[NDArray[np.float32], ...]:
    """Return the coefficients of the kernel's polynomial for each tap.

    Its argument is the position of the point within a cell, from -1 to 1.
    """
    count = width + MORE_COEFFICIENTS
    nodes = np.cos(math.pi * (np.arange(count) + 0.5) / count)
    pieces = []
    for tap in range(width):
        position = (nodes + (2 * tap + 1 - width)) / width
        values = i0(beta * np.sqrt(np.maximum(1.0 - position**2, 0.0))) / i0(beta)
        pieces.append(np.polyfit(nodes, values, count - 1).astype(np.float32))
    return tuple(pieces)


class TermsTransform:
    """Nonuniform Fourier transform of type 2 or 1, with the methods of a plan of FINUFFT.

    Parameters
    ----------
    kind
        2: the sum over modes (k, l) of modes[k, l] exp(-i (k y + l x)) at points (y, x). 1: its conjugate
        transpose.
    shape
        Number of terms, and of modes along y and x. Mode numbers begin at -n // 2.
    error
        Relative L2 error, for modes of equal size.
    """

    def __init__(self, kind: int, shape: tuple[int, ...], error: float) -> None:
        self._kind, self._shape = kind, shape
        self._axes = axes_for(shape[1:], error)
        self._pieces = tuple(pieces_of(axis.width, axis.beta) for axis in self._axes)
        self._onto = (*(axis.places for axis in self._axes), *(axis.factors for axis in self._axes))
        self._cells = self._axes[0].cells, self._axes[1].cells
        # Number of cells of the halo, which every kernel that begins within the grid reaches at most.
        self._halo = self._axes[0].width - 1

    def setpts(self, y: NDArray[np.float32], x: NDArray[np.float32]) -> None:
        """Set the points, as angles from -pi to pi. The arrays are not copied."""
        self._points = y, x

    def execute(self, data: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Return the transform of modes (type 2) or of values at points (type 1).

        Parameters
        ----------
        data
            Modes, shape (terms, ny, nx), or values at points, shape (terms, points). With one term the first
            axis may be omitted; the result then has no such axis either.
        """
        terms = self._shape[0]
        given = data.reshape(self._shape) if self._kind == 2 else data.reshape(terms, -1)
        result = self._carried(given, None, None)
        return result if terms > 1 else result[0]

    def weighted(
        self, data: NDArray[np.complex64], factors: NDArray[np.complex64], weights: NDArray[np.complex64]
    ) -> NDArray[np.complex64]:
        """Return the sum over terms of weights times the transform of factors times modes (type 2).

        Type 1 is the conjugate transpose. Besides the grid, intermediate values of terms stay in the
        processor's cache.

        Parameters
        ----------
        data
            Modes that all terms share, shape (ny, nx), or values at points, shape (points,).
        factors
            Factors of the modes, shape (terms, ny, nx).
        weights
            Weights of the points, shape (terms, points).
        """
        return self._carried(*map(np.ascontiguousarray, (data[None], factors, weights)))[0]

    def _carried(self, data: Any, factors: Any, weights: Any) -> NDArray[np.complex64]:
        grid, count = self._empty_grid(), self._shape[0] if factors is None else 1
        if self._kind == 2:
            put_modes(data, factors, *self._onto, grid)
            for rows in self._rows_of_modes:
                self._transform(grid, rows, 1)
            self._transform(grid, slice(None), 0)
            self._fill_halo(grid)
            result = np.empty((count, len(self._points[0])), np.complex64)
            gather(grid, self._cells, *self._points, self._pieces, weights, result)
        else:
            spread(grid, self._cells, *self._points, self._pieces, weights, data)
            self._add_halo(grid)
            self._transform(grid, slice(None), 0)
            for rows in self._rows_of_modes:
                self._transform(grid, rows, 1)
            result = np.empty((count, *self._shape[1:]), np.complex64)
            take_modes(result, factors, *self._onto, grid)
        return result

    def _empty_grid(self) -> NDArray[np.float32]:
        """Return a grid of zeros with its halo, shape (rows, columns, numbers of a cell).

        It begins at a cache line, since a vector that crosses the border of two lines takes twice the time.
        """
        numbers = LANES * math.ceil(2 * self._shape[0] / LANES)
        shape = (*(cells + self._halo for cells in self._cells), numbers)
        room = np.zeros(4 * math.prod(shape) + CACHE_LINE, np.uint8)
        start = -room.ctypes.data % CACHE_LINE
        return room[start : start + 4 * math.prod(shape)].view(np.float32).reshape(shape)

    def _fill_halo(self, grid: NDArray[np.float32]) -> None:
        """Copy the first cells along both axes to the halo."""
        (rows, columns), halo = self._cells, self._halo
        grid[:, columns:] = grid[:, :halo]
        grid[rows:] = grid[:halo]

    def _add_halo(self, grid: NDArray[np.float32]) -> None:
        """Add the halo to the first cells along both axes: the transpose of :meth:`_fill_halo`."""
        (rows, columns), halo = self._cells, self._halo
        grid[:halo] += grid[rows:]
        grid[:, :halo] += grid[:, columns:]

    @property
    def _rows_of_modes(self) -> tuple[slice, slice]:
        """Rows of the grid that contain modes. The other rows are 0 (type 2) or not needed (type 1)."""
        cells, count = self._cells[0], self._shape[1]
        return slice(0, count - count // 2), slice(cells - count // 2, cells)

    def _transform(self, grid: NDArray[np.float32], rows: slice, axis: int) -> None:
        """Transform the cells of some rows along an axis, in place."""
        cells = grid.view(np.complex64)[: self._cells[0], : self._cells[1], : self._shape[0]][rows]
        # Type 1 has positive exponents. Neither type is divided by the number of cells.
        if self._kind == 2:
            transformed = scipy.fft.fft(cells, axis=axis, overwrite_x=True)
        else:
            transformed = scipy.fft.ifft(cells, axis=axis, norm="forward", overwrite_x=True)
        # SciPy may write the result to the array that it was given, but does not promise it.
        if transformed.ctypes.data != cells.ctypes.data:
            cells[...] = transformed
