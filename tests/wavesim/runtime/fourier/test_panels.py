"""Transforms along rows and along columns of panels, against NumPy's in double precision."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from wavesim.runtime.fourier.lanes import CACHE_LINE, LANES
from wavesim.runtime.fourier.panels import (
    Panels,
    aligned,
    bytes_of_panels,
    convolved,
    steps_for,
    thread_buffer,
    transform_bytes,
)

ROUNDING = {np.complex64: 1e-6, np.complex128: 3e-15}
# Every radix alone and with others, primes that none takes, and numbers about a vector's.
COUNTS = [1, 2, 3, 4, 5, 7, 8, 11, 13, 15, 16, 17, 31, 32, 33, 48, 60, 77, 97, 101, 121, 169, 210, 432, 1009]


def noise(shape: tuple[int, int], dtype: Any) -> NDArray:
    rng = np.random.default_rng(7)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(dtype)


def filled(values: NDArray, rows_at_a_time: int) -> Panels:
    """With rows put in, some at a time."""
    panels = Panels(values.shape, values.dtype)
    panels.values[...] = np.nan
    for first in range(0, len(values), rows_at_a_time):
        panels.put_rows(values[first : first + rows_at_a_time], first)
    return panels


def on_plane(panels: Panels) -> NDArray:
    """All values as rows."""
    values = panels.values[:, :, 0] + 1j * panels.values[:, :, 1]
    return np.moveaxis(values, 1, 0).reshape(panels.shape[0], -1)


def relative(found: NDArray, exact: NDArray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@given(
    rows=st.sampled_from(COUNTS), columns=st.sampled_from(COUNTS), at_a_time=st.sampled_from([1, 15, 16, 37])
)
def test_a_plane_there_and_back(dtype: Any, rows: int, columns: int, at_a_time: int) -> None:
    """Columns that a last panel has beside the plane's stay 0, whatever was in its memory."""
    values = noise((rows, columns), dtype)
    panels = filled(values, at_a_time)
    for panel in panels.values:
        panels.along_columns(panel, panel, inverse=False)
    found = on_plane(panels)
    assert relative(found[:, :columns], np.fft.fft2(values.astype(complex))) < ROUNDING[dtype]
    assert not found[:, columns:].any()
    for panel in panels.values:
        panels.along_columns(panel, panel, inverse=True)
    again = np.empty_like(values)
    for first in range(0, rows, at_a_time):
        panels.take_rows(first, again[first : first + at_a_time])
    assert relative(again / values.size, values) < 2 * ROUNDING[dtype]


def test_columns_go_into_another_panel_and_rows_come_from_other_values() -> None:
    values = noise((40, 33), np.complex64)
    panels = filled(values, 16)
    before = panels.values.copy()
    target = aligned(panels.values.shape[1:], np.complex64)
    panels.along_columns(panels.values[1], target, inverse=False)
    np.testing.assert_array_equal(panels.values, before)
    expected = np.fft.fft2(values.astype(complex))[:, LANES : 2 * LANES]
    assert relative(target[:, 0] + 1j * target[:, 1], expected) < 1e-6
    other = panels.values[:, 5:24].copy()
    rows = panels.take_rows(2, np.empty((17, 33), np.complex64), other)
    assert relative(rows / 33, values[7:24]) < 1e-6


def test_a_row_is_the_same_whatever_goes_beside_it() -> None:
    """To the bit: results do not depend on the blocks in which rows come."""
    values = noise((35, 54), np.complex64)
    one, other = (on_plane(filled(values, count)) for count in (35, 3))
    np.testing.assert_array_equal(one, other)


@given(st.integers(1, 5000))
def test_radices_make_the_number_or_a_convolution_has_room(count: int) -> None:
    wide = convolved(count)
    assert wide == count or wide >= 2 * count - 1
    steps = steps_for(count, "complex64")
    assert np.prod(steps.radices) == wide
    assert (len(steps.chirp) == 0) == (wide == count)


def test_threads_have_rooms_of_their_own_and_have_them_again() -> None:
    both = Barrier(2)

    def rooms(_: int) -> tuple[NDArray, NDArray]:
        both.wait()
        return thread_buffer("mine", (3, 5), np.complex64), thread_buffer("mine", (3, 5), np.complex64)

    with ThreadPoolExecutor(2) as pool:
        (one, again), (other, _) = pool.map(rooms, range(2))
    assert one is again
    assert not np.shares_memory(one, other)
    assert thread_buffer("mine", (3, 5), np.complex128).dtype == np.float64


@pytest.mark.parametrize("shape", [(64, 64), (97, 40), (30, 1009)])
def test_memory_is_told(shape: tuple[int, int]) -> None:
    """Values with the room between panels; a thread's samples and rooms."""
    panels = Panels(shape, np.complex64)
    assert panels.values.base is not None
    assert panels.values.ctypes.data % CACHE_LINE == 0
    held = bytes_of_panels(shape, np.complex64)
    assert panels.values.nbytes <= held <= panels.values.nbytes * (1 + 16 / shape[0]) + 1

    def rooms() -> int:
        panels.put_rows(noise((16, shape[1]), np.complex64), 0)
        longest = max(shape, key=convolved)
        wide = convolved(longest)
        return thread_buffer(
            "samples", (len(panels.values) * 16 * 32,), np.complex64
        ).nbytes + wide * 8 * 16 * (2 if wide == longest else 3)

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(rooms).result() <= transform_bytes(shape, np.complex64) * 1.25
