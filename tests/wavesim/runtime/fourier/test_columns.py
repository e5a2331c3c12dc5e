"""Transforms of columns where they lie, and of a grid's cells, against NumPy's in double precision."""

from __future__ import annotations

import threading
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from wavesim.runtime import threads
from wavesim.runtime.fourier.cells import transform_cells
from wavesim.runtime.fourier.columns import bytes_of_columns, transform_columns
from wavesim.runtime.fourier.panels import aligned, buffers_for, steps_for
from wavesim.runtime.fourier.passes import SAMPLE

ROUNDING = {np.complex64: 1e-6, np.complex128: 3e-15}
# Every radix, odd ones after others and before each other, and a prime that none takes.
COUNTS = [1, 2, 7, 11, 13, 16, 63, 77, 91, 143, 169, 338, 440, 73]


def noise(shape: tuple[int, ...], dtype: Any) -> NDArray:
    rng = np.random.default_rng(7)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(dtype)


def relative(found: NDArray, exact: NDArray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@pytest.mark.parametrize("back", [False, True])
@given(
    count=st.sampled_from(COUNTS),
    width=st.integers(1, 50),
    beside=st.tuples(st.integers(0, 5), st.integers(0, 5)),
)
def test_some_columns_of_a_plane(
    dtype: Any, back: bool, count: int, width: int, beside: tuple[int, int]
) -> None:
    """Those beside them stay as they are, and so does the source."""
    left, right = beside
    source, target = (noise((count, left + width + right), dtype) for _ in range(2))
    given, before, some = source.copy(), target.copy(), slice(left, left + width)
    transform_columns(source[:, some], target[:, some], back)
    values = given[:, some].astype(complex)
    exact = np.fft.ifft(values, axis=0, norm="forward") if back else np.fft.fft(values, axis=0)
    assert relative(target[:, some], exact) < ROUNDING[dtype]
    assert np.array_equal(source, given)
    before[:, some] = target[:, some]
    assert np.array_equal(target, before)


@pytest.mark.parametrize("axis", [0, 1])
@given(
    count=st.sampled_from(COUNTS),
    across=st.integers(1, 13),
    terms=st.sampled_from([4, 8, 12]),
    part=st.tuples(st.integers(0, 12), st.integers(0, 12)),
)
def test_some_rows_or_columns_of_a_grid(
    axis: int, count: int, across: int, terms: int, part: tuple[int, int]
) -> None:
    """All terms of a cell, in place; other rows or columns stay as they are."""
    start, stop = sorted(min(one, across) for one in part)
    shape = (count, across, 2 * terms) if axis == 0 else (across, count, 2 * terms)
    grid = aligned(shape, np.complex64)
    grid.view(np.complex64)[...] = noise((*shape[:2], terms), np.complex64)
    exact = grid.view(np.complex64).astype(complex)
    some = (slice(None), slice(start, stop)) if axis == 0 else (slice(start, stop),)
    exact[some] = np.fft.fft(exact[some], axis=axis) if stop > start else exact[some]
    steps, samples = steps_for(count, "complex64"), aligned((count * SAMPLE,), np.complex64)
    rooms = buffers_for(count, "complex64")
    before = grid.copy()
    transform_cells(grid, start, stop, axis, steps, False, samples, rooms)
    assert relative(grid.view(np.complex64), exact) < 1e-6
    transform_cells(grid, start, stop, axis, steps, True, samples, rooms)
    if stop > start:
        grid[some] /= count
    assert relative(grid, before) < 2e-6


@pytest.mark.parametrize("count", [600, 601])
def test_what_a_thread_keeps_is_told(count: int) -> None:
    """Also where a convolution takes the place of a prime number of samples."""
    source = noise((count, 40), np.complex64)
    target = np.empty_like(source)
    kept: list[int] = []

    def first_time() -> None:
        before, _ = tracemalloc.get_traced_memory()
        transform_columns(source, target, False)
        kept.append(tracemalloc.get_traced_memory()[0] - before)

    transform_columns(source, target, False)  # steps and compiled loops are kept for all threads
    tracemalloc.start()
    try:
        thread = threading.Thread(target=first_time)
        thread.start()
        thread.join()
    finally:
        tracemalloc.stop()
    assert kept[0] == pytest.approx(bytes_of_columns(count, np.complex64) / threads.THREADS, rel=0.02)
