"""Compiled loops: transforms along rows or columns in which several complex numbers are contiguous.

These numbers are the terms in a cell of a grid, or neighbouring columns. Four of them form a part. A sample
of sixteen complex numbers (:mod:`wavesim.runtime.fourier.passes`) consists of parts from four positions.
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
"""Number of real numbers in a part: alternating real and imaginary parts of four complex numbers."""

CELLS = SAMPLE // PART
"""Number of parts in a sample."""


@intrinsic
def take_cells(_: Any, grid: Any, first: Any, offsets: Any) -> Any:
    """Return vectors of real and imaginary parts, from four parts of a flat grid.

    The parts begin at `first` plus each of the four numbers of `offsets`.
    """
    vector = Lanes(grid.dtype)

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        flat, start, steps = values
        byte = grid.dtype.bitwidth // 8
        ends = [builder.add(start, step) for step in cgutils.unpack_tuple(builder, steps)]
        pointers = [vector_at(context, builder, signature.args[0], flat, end, PART) for end in ends]
        cells = [builder.load(pointer, align=byte) for pointer in pointers]
        halves = [
            builder.shuffle_vector(cells[n], cells[n + 1], lane_numbers(range(2 * PART))) for n in (0, 2)
        ]
        parts = [builder.shuffle_vector(*halves, lane_numbers(range(k, 2 * LANES, 2))) for k in (0, 1)]
        return context.make_tuple(builder, signature.return_type, parts)

    return types.UniTuple(vector, 2)(grid, first, offsets), codegen


@intrinsic
def put_cells(_: Any, grid: Any, first: Any, offsets: Any, real: Any, imaginary: Any) -> Any:
    """Store vectors of real and imaginary parts in a flat grid: the inverse of :func:`take_cells`."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        flat, start, steps, *parts = values
        byte = grid.dtype.bitwidth // 8
        for number, step in enumerate(cgutils.unpack_tuple(builder, steps)):
            lanes_of_cell = range(number * PART // 2, (number + 1) * PART // 2)
            alternating = lane_numbers([n + LANES * part for n in lanes_of_cell for part in (0, 1)])
            cell = builder.shuffle_vector(*parts, alternating)
            pointer = vector_at(context, builder, signature.args[0], flat, builder.add(start, step), PART)
            builder.store(cell, pointer, align=byte)
        return context.get_dummy_value()

    return types.void(grid, first, offsets, real, imaginary), codegen


@_jit
def _transform_parts(
    source: NDArray,
    first: int,
    step: int,
    target: NDArray,
    target_first: int,
    target_step: int,
    offsets: tuple[int, int, int, int],
    count: int,
    steps: Steps,
    inverse: bool,
    samples: NDArray,
    buffers: NDArray,
) -> None:
    """Transform `count` samples, made of parts at four offsets; source and target may be the same."""
    for j in range(count):
        real, imaginary = take_cells(source, first + j * step, offsets)
        store(samples, j * SAMPLE, real)
        store(samples, j * SAMPLE + LANES, imaginary)
    passes.transform(samples, samples, count, steps, inverse, buffers)
    for j in range(count):
        real, imaginary = load(samples, j * SAMPLE), load(samples, j * SAMPLE + LANES)
        put_cells(target, target_first + j * target_step, offsets, real, imaginary)


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
    """Transform rows or columns of a grid in place.

    Parameters
    ----------
    grid
        Contiguous array, shape (rows, columns, numbers of a cell). A cell has a multiple of eight numbers.
    start, stop
        Range of columns if `axis` is 0, or of rows if it is 1.
    axis
        Axis of the transform.
    steps, inverse, buffers
        As in :func:`wavesim.runtime.fourier.passes.transform`.
    samples
        Buffer for the samples along the axis.
    """
    flat, numbers = grid.reshape(-1), grid.shape[2]
    row = grid.shape[1] * numbers
    along, across = (row, numbers) if axis == 0 else (numbers, row)
    for first in range(start, stop, CELLS):
        # The last cell replaces missing ones; it is written several times with the same values.
        last = stop - 1 - first
        offsets = (0, min(1, last) * across, min(2, last) * across, min(3, last) * across)
        for part in range(0, numbers, PART):
            at = first * across + part
            _transform_parts(
                flat, at, along, flat, at, along, offsets, grid.shape[axis], steps, inverse, samples, buffers
            )


@_jit
def transform_columns(
    source: NDArray, target: NDArray, steps: Steps, inverse: bool, samples: NDArray, buffers: NDArray
) -> None:
    """Transform the columns of an array, and write the result to another array.

    Parameters
    ----------
    source, target
        Arrays of equal shape. Real and imaginary parts alternate along each row, which is contiguous; rows
        may have gaps between them.
    steps, inverse, samples, buffers
        As in :func:`transform_cells`.
    """
    (count, width), offsets = source.shape, (0, PART, 2 * PART, 3 * PART)
    if width < SAMPLE:
        _few_columns(source, target, steps, inverse, samples, buffers)
        return
    flat_source, source_step = _flat(source), source.strides[0] // source.itemsize
    flat_target, target_step = _flat(target), target.strides[0] // target.itemsize
    for start in range(0, width, SAMPLE):
        # The last sixteen columns may overlap with those before them.
        at = min(start, width - SAMPLE)
        _transform_parts(
            flat_source,
            at,
            source_step,
            flat_target,
            at,
            target_step,
            offsets,
            count,
            steps,
            inverse,
            samples,
            buffers,
        )


@_jit
def _few_columns(
    source: NDArray, target: NDArray, steps: Steps, inverse: bool, samples: NDArray, buffers: NDArray
) -> None:
    """Transform fewer than sixteen columns."""
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
