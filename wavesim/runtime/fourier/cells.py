"""Compiled loops: transforms along rows or columns of which several complex numbers lie side by side.

These may be the terms in a cell of a grid, or neighbouring columns. Four of them are a part; a sample of
sixteen (:mod:`wavesim.runtime.fourier.passes`) takes parts from four places.
"""

# mypy: disable-error-code="misc, operator"

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit, drop_outdated
from wavesim.runtime.fourier import lanes, passes
from wavesim.runtime.fourier.lanes import LANES, Lanes, lane_numbers, load, store, vector_at
from wavesim.runtime.fourier.passes import SAMPLE, Steps

_jit = cached_njit(nogil=True, fastmath={"contract"}, error_model="numpy")

PART = 8
"""Numbers of a cell that a vector takes: real and imaginary part in turn."""

CELLS = SAMPLE // PART
"""That lie in one sample."""


@intrinsic
def take_cells(_: Any, grid: Any, first: Any, apart: Any) -> Any:
    """Real and imaginary parts, as vectors, from four places of a flat grid, given how far each is on."""
    vector = Lanes(grid.dtype)

    def made(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        flat, start, steps = values
        byte = grid.dtype.bitwidth // 8
        ends = [builder.add(start, step) for step in cgutils.unpack_tuple(builder, steps)]
        places = [vector_at(context, builder, signature.args[0], flat, end, PART) for end in ends]
        cells = [builder.load(place, align=byte) for place in places]
        halves = [
            builder.shuffle_vector(cells[n], cells[n + 1], lane_numbers(range(2 * PART))) for n in (0, 2)
        ]
        parts = [builder.shuffle_vector(*halves, lane_numbers(range(k, 2 * LANES, 2))) for k in (0, 1)]
        return context.make_tuple(builder, signature.return_type, parts)

    return types.UniTuple(vector, 2)(grid, first, apart), made


@intrinsic
def put_cells(_: Any, grid: Any, first: Any, apart: Any, real: Any, imaginary: Any) -> Any:
    """Store real and imaginary parts in cells of a grid."""

    def made(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        flat, start, steps, *parts = values
        byte = grid.dtype.bitwidth // 8
        for number, step in enumerate(cgutils.unpack_tuple(builder, steps)):
            lanes_of_cell = range(number * PART // 2, (number + 1) * PART // 2)
            turn = lane_numbers([n + LANES * part for n in lanes_of_cell for part in (0, 1)])
            cell = builder.shuffle_vector(*parts, turn)
            there = vector_at(context, builder, signature.args[0], flat, builder.add(start, step), PART)
            builder.store(cell, there, align=byte)
        return context.get_dummy_value()

    return types.void(grid, first, apart, real, imaginary), made


@_jit
def _through(
    source: NDArray,
    first: int,
    along: int,
    target: NDArray,
    first_there: int,
    along_there: int,
    apart: tuple[int, int, int, int],
    count: int,
    steps: Steps,
    inverse: bool,
    samples: NDArray,
    buffers: NDArray,
) -> None:
    """Transform what begins at four places of flat arrays, from one to the other, which may be the same."""
    for j in range(count):
        real, imaginary = take_cells(source, first + j * along, apart)
        store(samples, j * SAMPLE, real)
        store(samples, j * SAMPLE + LANES, imaginary)
    passes.transform(samples, samples, count, steps, inverse, buffers)
    for j in range(count):
        real, imaginary = load(samples, j * SAMPLE), load(samples, j * SAMPLE + LANES)
        put_cells(target, first_there + j * along_there, apart, real, imaginary)


@_jit
def transform_cells(
    grid: NDArray,
    start: int,
    stop: int,
    axis: int,
    steps: Steps,
    inverse: bool,
    samples: NDArray,
    buffers: NDArray,
) -> None:
    """Transform rows or columns of a grid in place, forward or inverse, without a factor.

    Parameters
    ----------
    grid
        Shape (rows, columns, numbers of a cell), these a multiple of eight; contiguous.
    start, stop
        Of the columns where `axis` is 0, else of the rows.
    axis
        Along which is transformed.
    steps, inverse, buffers
        As of :func:`wavesim.runtime.fourier.passes.transform`.
    samples
        Room for those along the axis.
    """
    flat, numbers = grid.reshape(-1), grid.shape[2]
    row = grid.shape[1] * numbers
    along, across = (row, numbers) if axis == 0 else (numbers, row)
    for first in range(start, stop, CELLS):
        # The last cell replaces missing ones, and is written back as often.
        last = stop - 1 - first
        apart = (0, min(1, last) * across, min(2, last) * across, min(3, last) * across)
        for part in range(0, numbers, PART):
            at = first * across + part
            _through(
                flat, at, along, flat, at, along, apart, grid.shape[axis], steps, inverse, samples, buffers
            )


@_jit
def transform_columns(
    source: NDArray, target: NDArray, steps: Steps, inverse: bool, samples: NDArray, buffers: NDArray
) -> None:
    """Transform columns into those of another array, forward, or inverse without a factor.

    Parameters
    ----------
    source, target
        Real and imaginary parts in turn along each row, of one shape; rows may lie apart.
    steps, inverse, samples, buffers
        As of :func:`transform_cells`.
    """
    (count, width), whole = source.shape, (0, PART, 2 * PART, 3 * PART)
    if width < SAMPLE:
        _few_columns(source, target, steps, inverse, samples, buffers)
        return
    given, along = _flat(source), source.strides[0] // source.itemsize
    taking, along_there = _flat(target), target.strides[0] // target.itemsize
    for start in range(0, width, SAMPLE):
        # The last sixteen begin where as many are left.
        at = min(start, width - SAMPLE)
        _through(given, at, along, taking, at, along_there, whole, count, steps, inverse, samples, buffers)


@_jit
def _few_columns(
    source: NDArray, target: NDArray, steps: Steps, inverse: bool, samples: NDArray, buffers: NDArray
) -> None:
    """Fewer than sixteen."""
    count, width = source.shape
    samples[: count * SAMPLE] = 0.0
    for j in range(count):
        for i in range(width):
            samples[j * SAMPLE + i // 2 + i % 2 * LANES] = source[j, i]
    passes.transform(samples, samples, count, steps, inverse, buffers)
    for j in range(count):
        for i in range(width):
            target[j, i] = samples[j * SAMPLE + i // 2 + i % 2 * LANES]


@_jit
def _flat(rows: NDArray) -> NDArray:
    """Return a flat view of the memory of rows, from the first value to the last."""
    size = (rows.shape[0] - 1) * (rows.strides[0] // rows.itemsize) + rows.shape[1]
    return as_strided(rows, (size,), (rows.itemsize,))


drop_outdated(transform_cells, {__name__, lanes.__name__, passes.__name__})
