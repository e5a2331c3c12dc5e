"""Nonuniform transform of several terms at once, against sums over all modes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import finufft
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from wavesim.runtime.fourier.nonuniform import Precision, adjoint_of_terms, plan_of_terms, sum_of_terms
from wavesim.runtime.fourier.terms import TermsTransform, axes_for, pieces_of

ROUNDING = 2e-6  # of sums of some thousand values in float32
"""Of float32, in sums of some hundred products."""


def noise(shape: tuple[int, ...], seed: int) -> NDArray[np.complex64]:
    rng = np.random.default_rng(seed)
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)


def scattered(count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Points all over the plane, the first ones at half a turn either way and in the middle."""
    points = np.random.default_rng(5).uniform(-np.pi, np.pi, (2, count))
    ends = [-np.pi, 0.0, np.pi]
    points[:, :9] = np.repeat(ends, 3), np.tile(ends, 3)
    y, x = points.astype(np.float32)
    return y, x


def waves(count: int, angles: NDArray[np.float32]) -> NDArray[np.complex128]:
    """exp(-i k angle), shape (angles, modes k)."""
    return np.exp(-1j * np.outer(angles.astype(float), np.arange(count) - count // 2))


def summed(modes: NDArray, y: NDArray, x: NDArray) -> NDArray[np.complex128]:
    """What a transform of type 2 gives, shape (terms, points)."""
    along_x = np.einsum("rkl,pl->rkp", modes, waves(modes.shape[2], x))
    return np.asarray(np.einsum("pk,rkp->rp", waves(modes.shape[1], y), along_x))


def summed_back(values: NDArray, y: NDArray, x: NDArray, shape: tuple[int, ...]) -> NDArray[np.complex128]:
    """What a transform of type 1 gives, shape (terms, along y, along x)."""
    along_x = np.einsum("rp,pl->rpl", values, waves(shape[2], x).conj())
    return np.asarray(np.einsum("pk,rpl->rkl", waves(shape[1], y).conj(), along_x))


def relative(found: NDArray, exact: NDArray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def both_ways(shape: tuple[int, ...], error: float, y: NDArray, x: NDArray) -> tuple[NDArray, NDArray]:
    """Transforms of noise there and back, with their axis of terms."""
    there, back = (TermsTransform(kind, shape, error) for kind in (2, 1))
    for transform in (there, back):
        transform.setpts(y, x)
    values = there.execute(noise(shape, 1)).reshape(shape[0], -1)
    return values, back.execute(noise((shape[0], len(y)), 2)).reshape(shape)


@pytest.mark.parametrize("error", [1e-2, 5e-4, 1e-5])
@pytest.mark.parametrize(
    "shape", [(1, 30, 41), (4, 31, 40), (4, 12, 12), (5, 20, 33), (9, 17, 16), (4, 1, 40), (3, 90, 7)]
)
def test_errors_are_below_what_is_asked_for(shape: tuple[int, ...], error: float) -> None:
    y, x = scattered(700)
    there, back = both_ways(shape, error, y, x)
    assert relative(there, summed(noise(shape, 1), y, x)) < error
    assert relative(back, summed_back(noise((shape[0], 700), 2), y, x, shape)) < error


@pytest.mark.parametrize(("shape", "error"), [((1, 18, 18), 5e-4), ((4, 5, 3), 1e-5), ((5, 2, 18), 1e-2)])
def test_few_modes_whose_kernels_often_reach_over_the_end_of_the_grid(
    shape: tuple[int, ...], error: float
) -> None:
    """Points lie around both ends of both axes, some of them a rounding error beyond half a turn."""
    ends = np.random.default_rng(6).choice([-np.pi, np.pi], (2, 900))
    inwards = np.abs(np.random.default_rng(7).normal(size=ends.shape)) * 0.4
    inwards[:, ::9] = 0.0
    y, x = (ends - np.sign(ends) * np.minimum(inwards, np.pi)).astype(np.float32)
    width, cells = axes_for(shape[1:], error)[0].width, [axis.cells for axis in axes_for(shape[1:], error)]
    beyond = np.pi * (1.0 - width / np.array(cells))
    assert np.mean((abs(y) > beyond[0]) | (abs(x) > beyond[1])) > 0.5
    assert float(y.max()) > np.pi
    given_modes, given_values = noise(shape, 1), noise((shape[0], len(y)), 2)
    there, back = both_ways(shape, error, y, x)
    assert relative(there, summed(given_modes, y, x)) < error
    assert relative(back, summed_back(given_values, y, x, shape)) < error
    left = np.vdot(given_values.astype(complex), there)
    right = np.vdot(back.astype(complex), given_modes)
    assert abs(left - right) < ROUNDING * np.linalg.norm(there) * np.linalg.norm(given_values)


@given(
    terms=st.integers(1, 9), rows=st.integers(10, 40), columns=st.integers(10, 40), points=st.integers(9, 600)
)
def test_types_are_each_others_conjugate_transpose(terms: int, rows: int, columns: int, points: int) -> None:
    shape = (terms, rows, columns)
    there, back = both_ways(shape, 5e-4, *scattered(points))
    given_values, given_modes = noise((terms, points), 2), noise(shape, 1)
    left = np.vdot(given_values.astype(complex), there)
    right = np.vdot(back.astype(complex), given_modes)
    assert abs(left - right) < ROUNDING * np.linalg.norm(there) * np.linalg.norm(given_values)


@given(
    terms=st.integers(1, 9), rows=st.integers(10, 40), columns=st.integers(10, 40), points=st.integers(9, 600)
)
def test_weighted_terms_are_those_apart_added_up(terms: int, rows: int, columns: int, points: int) -> None:
    """In one pass as in several, both ways."""
    shape, places = (terms, rows, columns), scattered(points)
    factors, weights = noise(shape, 3), noise((terms, points), 4)
    there, back = (TermsTransform(kind, shape, 5e-4) for kind in (2, 1))
    modes, values = noise(shape[1:], 1), noise((points,), 2)
    for transform in (there, back):
        transform.setpts(*places)
    apart = there.execute(factors * modes).reshape(terms, -1)
    found = sum_of_terms(there, modes, factors, weights)
    assert relative(found, (weights * apart).sum(axis=0)) < ROUNDING
    apart = back.execute(weights.conj() * values).reshape(shape)
    assert (
        relative(adjoint_of_terms(back, values, factors, weights), (factors.conj() * apart).sum(0)) < ROUNDING
    )


def test_the_same_as_finufft_over_a_tile() -> None:
    """Points row by row within a disc, more than a block, some rows of them around the grid's end."""
    shape, error = (4, 60, 57), 5e-4
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, 101), np.linspace(-1.0, 1.0, 98), indexing="ij")
    inside = y**2 + x**2 < 1.0
    angles = [(np.pi * a[inside] * (1.0 - 0.04 * y[inside] ** 2)).astype(np.float32) for a in (y, x)]
    there, back = both_ways(shape, error, angles[0], angles[1])
    exact = [a.astype(float) for a in angles]
    modes, values = noise(shape, 1).astype(complex), noise((4, len(angles[0])), 2).astype(complex)
    assert relative(there, finufft.nufft2d2(*exact, modes, eps=1e-9, isign=-1)) < error
    assert relative(back, finufft.nufft2d1(*exact, values, shape[1:], eps=1e-9, isign=1)) < error


def test_each_use_begins_anew() -> None:
    shape, (y, x) = (3, 20, 22), scattered(50)
    for kind, given_shape in ((2, shape), (1, (3, 50))):
        transform = TermsTransform(kind, shape, 1e-3)
        transform.setpts(y, x)
        first = transform.execute(noise(given_shape, 1))
        transform.execute(noise(given_shape, 2))
        transform.setpts(x, y)
        transform.execute(noise(given_shape, 3))
        transform.setpts(y, x)
        assert np.array_equal(transform.execute(noise(given_shape, 1)), first)


def test_one_term_comes_without_its_axis_and_no_points_are_dark() -> None:
    none = np.empty(0, np.float32)
    there, back = (TermsTransform(kind, (1, 12, 14), 1e-3) for kind in (2, 1))
    for transform in (there, back):
        transform.setpts(none, none)
    assert there.execute(noise((12, 14), 1)).shape == (0,)
    assert np.array_equal(back.execute(noise((0,), 1)), np.zeros((12, 14)))


@pytest.mark.parametrize("width", [3, 6, 12])
def test_pieces_join_and_are_even(width: int) -> None:
    values = [(np.polyval(piece, -1.0), np.polyval(piece, 1.0)) for piece in pieces_of(width, 1.8 * width)]
    assert len(values) == width
    for (_, end), (begin, _) in pairwise(values):
        assert end == pytest.approx(begin, abs=1e-3)
    for (low, high), (other_low, other_high) in zip(values, values[::-1], strict=True):
        assert (low, high) == pytest.approx((other_high, other_low), abs=2e-6)


def test_finer_errors_take_wider_kernels() -> None:
    widths = [axes_for((288, 200), error)[0].width for error in (1e-2, 5e-4, 5e-5, 1e-5)]
    assert widths == [4, 6, 8, 9]


def test_single_precision_on_planes_takes_it_and_all_else_finufft() -> None:
    single, double = (Precision(np.dtype(kind), 1e-3, 1e-3) for kind in (np.complex64, np.complex128))
    assert isinstance(plan_of_terms(2, (4, 20, 20), single), TermsTransform)
    assert isinstance(plan_of_terms(2, (4, 20, 20), double), finufft.Plan)
    assert isinstance(plan_of_terms(2, (4, 20), single), finufft.Plan)


@pytest.mark.parametrize("kind", [1, 2])
def test_threads_may_share_a_transform(kind: int) -> None:
    transform, shape = TermsTransform(kind, (3, 60, 50), 1e-4), (3, 60, 50) if kind == 2 else (3, 4000)
    transform.setpts(*scattered(4000))
    given = [noise(shape, seed) for seed in range(16)]
    alone = [transform.execute(one) for one in given]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(transform.execute, given))
    np.testing.assert_array_equal(together, alone)
