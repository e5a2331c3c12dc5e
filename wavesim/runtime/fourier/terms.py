"""Nonuniform Fourier transform of several terms on one plane at once, in single precision.

Each term is divided by the transform of a kernel, and carried by a fast Fourier transform onto a somewhat
finer grid; a sum of the cells around a point, weighted by the kernel, is its value there. See A. H. Barnett,
J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019). The kernel is that of J. I. Jackson,
C. H. Meyer, D. G. Nishimura, A. Macovski, IEEE Trans. Med. Imaging 10, 473 (1991), a Kaiser-Bessel window,
whose transform is known, with the shape of P. J. Beatty, D. G. Nishimura, J. M. Pauly, IEEE Trans. Med.
Imaging 24, 799 (2005).

FINUFFT carries one term after the other, and evaluates the kernel for each. Here four terms lie beside each
other in every cell, as one vector.
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
from wavesim.runtime.fourier.cells import transform_cells
from wavesim.runtime.fourier.panels import aligned, steps_for, thread_buffer
from wavesim.runtime.fourier.passes import SAMPLE
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
    width : int
        Cells under the kernel.
    modes : ndarray of int
        From -n // 2 on.
    """

    cells: int
    width: int
    modes: NDArray[np.int64]

    @property
    def beta(self) -> float:
        """Kernel values."""
        finer = self.cells / len(self.modes)
        return math.pi * math.sqrt(max((self.width / finer * (finer - 0.5)) ** 2 - 0.8, 0.0))

    def transformed(self, modes: NDArray[np.int64]) -> Array:
        """The kernel's integral over its cells times exp(i x mode), for a cell of unit width."""
        rest = self.beta**2 - (math.pi * self.width * modes / self.cells) ** 2
        root = np.sqrt(np.abs(rest)) + 1e-12
        return np.asarray(
            self.width * np.where(rest > 0.0, np.sinh(root), np.sin(root)) / root / i0(self.beta)
        )

    @property
    def squared_error(self) -> float:
        """Return the relative aliasing error for modes of equal size."""
        # Periods of the grid that are looked at.
        periods = np.array([*range(-8, 0), *range(1, 9)])
        repeats = self.modes + self.cells * periods[:, None]
        return float(np.mean(np.sum((self.transformed(repeats) / self.transformed(self.modes)) ** 2, axis=0)))

    @property
    def places(self) -> NDArray[np.int64]:
        """Positions of the modes among the cells."""
        return self.modes % self.cells

    @property
    def factors(self) -> NDArray[np.float32]:
        """Return the factor of each mode; cell 0 of the grid is at a phase of minus half a turn."""
        return ((-1.0) ** (self.modes % 2) / self.transformed(self.modes)).astype(np.float32)


@cache
def axes_for(shape: tuple[int, ...], error: float) -> tuple[Axis, ...]:
    """Grid and the narrowest kernel for so many modes (along y, along x) and a relative error."""
    # Cells of the grid over modes.
    oversampling = 1.25
    # Cells under a kernel that there may be.
    widths = range(3, 13)
    for width in widths:
        axes = tuple(
            Axis(
                # Of 2, 3 and 5 alone, as a real one's are.
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
    """The kernel as a polynomial for each tap, over where within its cell from -1 to 1 the point lies."""
    count = width + MORE_COEFFICIENTS
    nodes = np.cos(math.pi * (np.arange(count) + 0.5) / count)
    pieces = []
    for tap in range(width):
        share = (nodes + (2 * tap + 1 - width)) / width
        values = i0(beta * np.sqrt(np.maximum(1.0 - share**2, 0.0))) / i0(beta)
        pieces.append(np.polyfit(nodes, values, count - 1).astype(np.float32))
    return tuple(pieces)


class TermsTransform:
    """Nonuniform transform of type 2, or of type 1, its conjugate transpose; methods as FINUFFT's plans have.

    Parameters
    ----------
    kind
        2: the sum over modes (k, l) of modes[k, l] exp(-i (k y + l x)) at points (y, x). 1: its conjugate
        transpose.
    shape
        Number of terms, then of modes along y and x, from -n // 2 on.
    error
        Relative L2 error, of modes that are all alike.
    """

    def __init__(self, kind: int, shape: tuple[int, ...], error: float) -> None:
        self._kind, self._shape = kind, shape
        self._axes = axes_for(shape[1:], error)
        self._pieces = tuple(pieces_of(axis.width, axis.beta) for axis in self._axes)
        self._onto = (*(axis.places for axis in self._axes), *(axis.factors for axis in self._axes))
        numbers = LANES * math.ceil(2 * shape[0] / LANES)
        self._cells = (*(axis.cells for axis in self._axes), numbers)
        self._steps = tuple(steps_for(axis.cells, "complex64") for axis in self._axes)

    def setpts(self, y: NDArray[np.float32], x: NDArray[np.float32]) -> None:
        """Set the points, angles within half a turn; the arrays are kept."""
        self._points = y, x

    def execute(self, data: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Transform.

        Parameters
        ----------
        data
            Modes, shape (terms, along y, along x), or values at points, shape (terms, points); of one term
            the first axis may be left out, as it is of what comes back.
        """
        terms = self._shape[0]
        given = data.reshape(self._shape) if self._kind == 2 else data.reshape(terms, -1)
        result = self._carried(given, None, None)
        return result if terms > 1 else result[0]

    def weighted(
        self, data: NDArray[np.complex64], factors: NDArray[np.complex64], weights: NDArray[np.complex64]
    ) -> NDArray[np.complex64]:
        """Type 2: the sum over terms of weights times the transform of factors times modes; type 1: its
        conjugate transpose. Nothing of each term leaves the processor's cache but the grid.

        Parameters
        ----------
        data
            Modes that all terms share, shape (along y, along x), or values at points, shape (points,).
        factors
            Of modes, shape (terms, along y, along x).
        weights
            Of points, shape (terms, points).
        """
        return self._carried(*map(np.ascontiguousarray, (data[None], factors, weights)))[0]

    def _carried(self, data: Any, factors: Any, weights: Any) -> NDArray[np.complex64]:
        grid, count = aligned(self._cells, np.complex64), self._shape[0] if factors is None else 1
        grid[...] = 0.0
        if self._kind == 2:
            put_modes(data, factors, *self._onto, grid)
            for rows in self._rows_of_modes:
                self._transform(grid, rows, 1)
            self._transform(grid, slice(None), 0)
            result = np.empty((count, len(self._points[0])), np.complex64)
            gather(grid, *self._points, self._pieces, weights, result)
        else:
            spread(grid, *self._points, self._pieces, weights, data)
            self._transform(grid, slice(None), 0)
            for rows in self._rows_of_modes:
                self._transform(grid, rows, 1)
            result = np.empty((count, *self._shape[1:]), np.complex64)
            take_modes(result, factors, *self._onto, grid)
        return result

    @property
    def _rows_of_modes(self) -> tuple[slice, slice]:
        """Rows of the grid that hold modes; the others are 0, or not needed."""
        cells, count = self._axes[0].cells, self._shape[1]
        return slice(0, count - count // 2), slice(cells - count // 2, cells)

    def _transform(self, grid: NDArray[np.float32], rows: slice, axis: int) -> None:
        """Fast Fourier transform of rows of the grid along themselves, or of all columns, in place."""
        start, stop, _ = rows.indices(self._cells[1 - axis])
        # Samples of an axis, and the two rooms of its passes.
        room = thread_buffer("cells", (3, max(self._cells[:2]) * SAMPLE), "complex64")
        transform_cells(grid, start, stop, axis, self._steps[axis], self._kind == 1, room[0], room[1:])
