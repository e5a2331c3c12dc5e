"""Compiled loops of :mod:`wavesim.runtime.fourier.terms`: interpolation between points and a grid.

All terms are processed at once. A cell of the grid holds the real and imaginary parts of all terms, padded to
whole vectors of eight numbers. Weights of taps are computed for a block of points at a time, in loops over
the points. The loop over the taps of a point is too short for a compiler to use vector instructions. Two
functions therefore generate these instructions through LLVM.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy import ceil, complex64, empty, float32, int64, zeros
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")

LANES = 8
"""Number of float32 numbers in a vector."""

MORE_COEFFICIENTS = 2
"""Number of coefficients of a tap's polynomial, minus the number of taps."""

_BLOCK = 256
"""Number of points whose weights are computed at a time."""

_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_FUSED = ("contract",)


class _Taps:
    """Generates code for the cells around a point, as vectors, and for the weights along y and x."""

    def __init__(self, context: Any, builder: Any, given: types.BaseTuple, values: Any) -> None:
        self.builder, self.width = builder, len(given[0])
        _, grid, down, across, y, x, lane, point, own = values
        arrays = zip((grid, down, across, own), (given[1], given[2], given[3], given[8]), strict=True)
        grid, down, across, own = (context.make_array(kind)(context, builder, a) for a, kind in arrays)
        self.strides = cgutils.unpack_tuple(builder, grid.strides)
        self.first = self._moved(grid.data, self._sum_of_products(((y, 0), (x, 1))))
        self.first = self._moved(self.first, builder.mul(lane, self._whole(4)))
        self.own = builder.bitcast(builder.gep(own.data, [lane]), _VECTOR.as_pointer())
        self.down, self.across = (
            [self._alike(weights, t, point) for t in range(self.width)] for weights in (down, across)
        )

    def _whole(self, number: int) -> Any:
        return ir.Constant(ir.IntType(64), number)

    def _sum_of_products(self, pairs: Any) -> Any:
        one, other = (self.builder.mul(number, self.strides[axis]) for number, axis in pairs)
        return self.builder.add(one, other)

    def _moved(self, pointer: Any, bytes_on: Any) -> Any:
        start = self.builder.bitcast(pointer, ir.IntType(8).as_pointer())
        return self.builder.gep(start, [bytes_on])

    def _alike(self, weights: Any, tap: int, point: Any) -> Any:
        """Return a vector whose numbers are all the weight of a tap."""
        stride = cgutils.unpack_tuple(self.builder, weights.strides)[0]
        row = self._moved(weights.data, self.builder.mul(stride, self._whole(tap)))
        row = self.builder.bitcast(row, ir.FloatType().as_pointer())
        weight = self.builder.load(self.builder.gep(row, [point]))
        nothing = ir.Constant(_VECTOR, ir.Undefined)
        one = self.builder.insert_element(nothing, weight, ir.Constant(ir.IntType(32), 0))
        first = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return self.builder.shuffle_vector(one, nothing, first)

    def cell(self, row: int, column: int) -> Any:
        """Return a pointer to one of the cells around the point."""
        offset = self._sum_of_products(((self._whole(row), 0), (self._whole(column), 1)))
        return self.builder.bitcast(self._moved(self.first, offset), _VECTOR.as_pointer())

    def load(self, pointer: Any) -> Any:
        return self.builder.load(pointer, align=4)

    def store(self, value: Any, pointer: Any) -> None:
        self.builder.store(value, pointer, align=4)

    def times(self, one: Any, other: Any) -> Any:
        return self.builder.fmul(one, other, flags=_FUSED)

    def plus_product(self, total: Any, one: Any, other: Any) -> Any:
        return self.builder.fadd(self.times(one, other), total, flags=_FUSED)


@intrinsic
def _gather_vector(
    _: Any, pieces: Any, grid: Any, down: Any, across: Any, y: Any, x: Any, lane: Any, point: Any, own: Any
) -> Any:
    """Set own[lane:] to the sum over t, s of down[t, point] across[s, point] grid[y + t, x + s, lane:]."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        taps = _Taps(context, builder, signature.args, values)
        total = ir.Constant(_VECTOR, [0.0] * LANES)
        for s in range(taps.width):
            column = taps.times(taps.load(taps.cell(0, s)), taps.down[0])
            for t in range(1, taps.width):
                column = taps.plus_product(column, taps.load(taps.cell(t, s)), taps.down[t])
            total = taps.plus_product(total, column, taps.across[s])
        taps.store(total, taps.own)
        return context.get_dummy_value()

    whole = types.intp
    return types.void(pieces, grid, down, across, whole, whole, whole, whole, own), codegen


@intrinsic
def _spread_vector(
    _: Any, pieces: Any, grid: Any, down: Any, across: Any, y: Any, x: Any, lane: Any, point: Any, own: Any
) -> Any:
    """Add down[t, point] across[s, point] own[lane:] to grid[y + t, x + s, lane:] for all taps (t, s).

    This is the transpose of :func:`_gather_vector`.
    """

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        taps = _Taps(context, builder, signature.args, values)
        given = taps.load(taps.own)
        for s in range(taps.width):
            column = taps.times(given, taps.across[s])
            for t in range(taps.width):
                cell = taps.cell(t, s)
                taps.store(taps.plus_product(taps.load(cell), column, taps.down[t]), cell)
        return context.get_dummy_value()

    whole = types.intp
    return types.void(pieces, grid, down, across, whole, whole, whole, whole, own), codegen


@_jit
def _weigh(
    angles: NDArray,
    start: int,
    stop: int,
    cells: int,
    pieces: tuple[NDArray, ...],
    first: NDArray,
    weight: NDArray,
) -> None:
    """Compute the first cell and the weights of the taps along one axis; cell 0 is at the angle -pi.

    The first cell lies within the period of the grid. The last one may lie in the halo.
    """
    per_turn = cells / (2.0 * math.pi)
    width = len(pieces)
    part = empty(_BLOCK, float32)
    for j in range(stop - start):
        position = (angles[start + j] + math.pi) * per_turn
        low = ceil(position - 0.5 * width)
        cell = int64(low)
        first[j] = cell if 0 <= cell < cells else cell % cells
        part[j] = float32(2.0 * (low - position) + (width - 1))
    for t in range(width):
        piece = pieces[t]
        for j in range(stop - start):
            value = piece[0]
            for d in range(1, width + MORE_COEFFICIENTS):
                value = value * part[j] + piece[d]
            weight[t, j] = value


@_jit
def gather(
    grid: NDArray,
    cells: tuple[int, int],
    y: NDArray,
    x: NDArray,
    pieces: tuple[Any, Any],
    weights: NDArray | None,
    values: NDArray,
) -> None:
    """Interpolate values at points from a periodic grid.

    Parameters
    ----------
    grid
        Shape (rows, columns, numbers of a cell), float32, with a halo that repeats its first cells.
    cells
        Rows and columns of one period, without the halo.
    y, x
        Angles of the points.
    pieces
        Coefficients of the polynomial of each tap along y and along x, the highest order first.
    weights
        Weights of the terms in a sum, shape (terms, points); None: no sum.
    values
        Result, changed in place: complex64, shape (terms, points), or (1, points) for a sum.
    """
    numbers, width = grid.shape[2], len(pieces[0])
    first_y, first_x = empty(_BLOCK, int64), empty(_BLOCK, int64)
    down, across = empty((width, _BLOCK), float32), empty((width, _BLOCK), float32)
    own = empty(numbers, float32)
    for start in range(0, y.shape[0], _BLOCK):
        stop = min(start + _BLOCK, y.shape[0])
        _weigh(y, start, stop, cells[0], pieces[0], first_y, down)
        _weigh(x, start, stop, cells[1], pieces[1], first_x, across)
        for j in range(stop - start):
            top, left = first_y[j], first_x[j]
            for lane in range(0, numbers, LANES):
                _gather_vector(pieces[0], grid, down, across, top, left, lane, j, own)
            if weights is None:
                for r in range(values.shape[0]):
                    values[r, start + j] = complex64(complex(own[2 * r], own[2 * r + 1]))
            else:
                real = imaginary = float32(0.0)
                for r in range(weights.shape[0]):
                    weight = weights[r, start + j]
                    real += weight.real * own[2 * r] - weight.imag * own[2 * r + 1]
                    imaginary += weight.real * own[2 * r + 1] + weight.imag * own[2 * r]
                values[0, start + j] = complex64(complex(real, imaginary))


@_jit
def spread(
    grid: NDArray,
    cells: tuple[int, int],
    y: NDArray,
    x: NDArray,
    pieces: tuple[Any, Any],
    weights: NDArray | None,
    values: NDArray,
) -> None:
    """Add values at points to a grid and its halo: the conjugate transpose of :func:`gather`."""
    numbers, width = grid.shape[2], len(pieces[0])
    first_y, first_x = empty(_BLOCK, int64), empty(_BLOCK, int64)
    down, across = empty((width, _BLOCK), float32), empty((width, _BLOCK), float32)
    own = zeros(numbers, float32)
    for start in range(0, y.shape[0], _BLOCK):
        stop = min(start + _BLOCK, y.shape[0])
        _weigh(y, start, stop, cells[0], pieces[0], first_y, down)
        _weigh(x, start, stop, cells[1], pieces[1], first_x, across)
        for j in range(stop - start):
            top, left = first_y[j], first_x[j]
            if weights is None:
                for r in range(values.shape[0]):
                    own[2 * r] = values[r, start + j].real
                    own[2 * r + 1] = values[r, start + j].imag
            else:
                value = values[0, start + j]
                for r in range(weights.shape[0]):
                    weight = weights[r, start + j]
                    own[2 * r] = weight.real * value.real + weight.imag * value.imag
                    own[2 * r + 1] = weight.real * value.imag - weight.imag * value.real
            for lane in range(0, numbers, LANES):
                _spread_vector(pieces[0], grid, down, across, top, left, lane, j, own)


@_jit
def put_modes(
    modes: NDArray,
    factors: NDArray | None,
    rows: NDArray,
    columns: NDArray,
    along_y: NDArray,
    along_x: NDArray,
    grid: NDArray,
) -> None:
    """Write modes, shape (terms, ny, nx), times a factor of each axis to their cells of a grid.

    If `factors` of this shape are given, modes have the shape (1, ny, nx), and each term is their product
    with its factors.
    """
    terms = modes.shape[0] if factors is None else factors.shape[0]
    for i in range(modes.shape[1]):
        for c in range(modes.shape[2]):
            row, column, factor = rows[i], columns[c], along_y[i] * along_x[c]
            for r in range(terms):
                value = modes[r, i, c] if factors is None else factors[r, i, c] * modes[0, i, c]
                grid[row, column, 2 * r] = factor * value.real
                grid[row, column, 2 * r + 1] = factor * value.imag


@_jit
def take_modes(
    modes: NDArray,
    factors: NDArray | None,
    rows: NDArray,
    columns: NDArray,
    along_y: NDArray,
    along_x: NDArray,
    grid: NDArray,
) -> None:
    """Compute modes from a grid, in place: the conjugate transpose of :func:`put_modes`."""
    terms = modes.shape[0] if factors is None else factors.shape[0]
    for i in range(modes.shape[1]):
        if factors is not None:
            modes[0, i] = 0.0
        for r in range(terms):
            for c in range(modes.shape[2]):
                factor = along_y[i] * along_x[c]
                real = factor * grid[rows[i], columns[c], 2 * r]
                imaginary = factor * grid[rows[i], columns[c], 2 * r + 1]
                value = complex64(complex(real, imaginary))
                if factors is None:
                    modes[r, i, c] = value
                else:
                    modes[0, i, c] += factors[r, i, c].conjugate() * value
