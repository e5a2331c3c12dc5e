"""Band-limited interpolation between planes of even samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavesim.fields.resampling import (
    OVERSAMPLING,
    Weights,
    add_interpolated,
    coarse_axis,
    gathered,
    interpolation,
    kernel_for,
)
from wavesim.fields.resampling_kernel import BLOCK, BLOCKS, block_width

FINE_Y, FINE_X = np.linspace(-1.0, 1.2, 61), np.linspace(-0.7, 0.9, 47)
BAND = 40.0
STEP = np.pi / (OVERSAMPLING * BAND)


def ways(error: float) -> tuple[tuple[Weights, Weights], tuple[np.ndarray, np.ndarray]]:
    kernel = kernel_for(error)
    coarse = coarse_axis(FINE_Y, STEP, kernel), coarse_axis(FINE_X, STEP, kernel)
    found = tuple(interpolation(c, f, kernel) for c, f in zip(coarse, (FINE_Y, FINE_X), strict=True))
    return (found[0], found[1]), coarse


def noise(shape: tuple[int, int], seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.mark.parametrize("error", [1e-2, 1e-4, 1e-6])
def test_waves_within_the_band_come_out(error: float) -> None:
    (along_y, along_x), (coarse_y, coarse_x) = ways(error)
    for ky, kx in ((BAND, -BAND), (0.0, 0.0), (-0.6 * BAND, BAND), (0.9 * BAND, 0.1 * BAND)):
        coarse = np.exp(1j * (ky * coarse_y[:, None] + kx * coarse_x))
        result = np.zeros((len(FINE_Y), len(FINE_X)), complex)
        add_interpolated(coarse, (along_y, along_x), np.ones_like(result), result)
        exact = np.exp(1j * (ky * FINE_Y[:, None] + kx * FINE_X))
        assert np.abs(result - exact).max() < 6.0 * error


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_same_as_matrices(threads: int) -> None:
    (along_y, along_x), (coarse_y, coarse_x) = ways(1e-4)
    y, x = along_y.matrix().toarray(), along_x.matrix().toarray()
    coarse = noise((len(coarse_y), len(coarse_x)), 1)
    carried, before = noise((61, 47), 2), noise((61, 47), 3)
    carried[:5, 10:] = 0.0
    result = before.copy()
    add_interpolated(coarse, (along_y, along_x), carried, result, threads=threads)
    np.testing.assert_allclose(result, before + carried * (y @ coarse @ x.T), atol=1e-12)
    back = gathered(before, (along_y, along_x), carried, threads=threads)
    np.testing.assert_allclose(back, y.T @ (carried.conj() * before) @ x, atol=1e-12)


def test_single_precision_stays_single() -> None:
    (along_y, along_x), (coarse_y, coarse_x) = ways(1e-3)
    single = along_y.astype(np.float32), along_x.astype(np.float32)
    coarse = noise((len(coarse_y), len(coarse_x)), 1).astype(np.complex64)
    carried = np.ones((61, 47), np.complex64)
    result = np.zeros((80, 60), np.complex64)
    add_interpolated(coarse, single, carried, result, (3, 5))
    exact = along_y.matrix() @ coarse @ along_x.matrix().T
    assert np.abs(result[3:64, 5:52] - exact).max() < 1e-5 * np.abs(exact).max()
    assert not np.any(result[:3])
    assert not np.any(result[:, 52:])
    assert gathered(result, single, carried, (3, 5)).dtype == np.complex64


@pytest.mark.parametrize("step", [1.6, 7.3])
def test_a_part_of_a_plane_of_many_blocks(step: float) -> None:
    """More columns than are done at a time, more rows than are held, and as many where the part begins."""
    kernel, (rows, columns) = kernel_for(1e-3), (700, 2 * BLOCK + 19)
    fine = np.arange(float(rows)), np.arange(float(columns))
    y, x = (interpolation(coarse_axis(axis, step, kernel), axis, kernel) for axis in fine)
    coarse, carried = noise((y.coarse, x.coarse), 1), noise((rows, columns), 2)
    plane = noise((rows + 9, columns + 11), 3)
    part = (slice(4, 4 + rows), slice(7, 7 + columns))
    expected = plane.copy()
    expected[part] += carried * (y.matrix() @ coarse @ x.matrix().T)
    back = gathered(plane, (y, x), carried, (4, 7))
    np.testing.assert_allclose(back, y.matrix().T @ (carried.conj() * plane[part]) @ x.matrix(), atol=1e-11)
    add_interpolated(coarse, (y, x), carried, plane, (4, 7))
    np.testing.assert_allclose(plane, expected, atol=1e-12)


@given(columns=st.integers(0, 20_000))
def test_blocks_of_columns_are_even(columns: int) -> None:
    width = block_width(columns)
    widths = [min(start + width, columns) - start for start in range(0, columns, width)]
    assert 1 <= width <= BLOCK
    assert sum(widths) == columns
    assert len(widths) <= 1 or widths[-1] > width - BLOCKS * (1 + columns // BLOCK)
