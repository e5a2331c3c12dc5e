"""The compiled loops of one step between two grids, against the same written out with matrices."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from wavesim.fields.carrier_interpolation import CarrierInterpolation, interpolation_weights
from wavesim.fields.resampling import coarse_axis, interpolation, kernel_for
from wavesim.fields.resampling_kernel import BLOCK


@pytest.mark.parametrize(
    ("rows", "columns", "step", "smooth_samples"),
    [(61, 53, 0.11, 30), (430, BLOCK + 30, 0.018, 150)],
    ids=["one block", "blocks and bands"],
)
def test_compiled_loops_against_plain_numpy(
    rows: int, columns: int, step: float, smooth_samples: int
) -> None:
    rng = np.random.default_rng(4)
    fine = (np.linspace(-1.0, 1.0, rows), np.linspace(-0.7, 0.9, columns))
    kernel = kernel_for(1e-3)
    coarse = tuple(coarse_axis(a, step, kernel) for a in fine)
    smooth = tuple(np.linspace(a[0] - 0.2, a[-1] + 0.2, smooth_samples) for a in fine)

    def phase_waves(y: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
        return 1e4 + 30.0 * y[:, None] ** 3 - 12.0 * x**2 + 7.0 * y[:, None] * x

    def edge(y: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
        return (1.2 - y[:, None] ** 2 - x**2) * 2.0 - 0.7

    carrier_interpolation = CarrierInterpolation(
        interpolation_weights((coarse[0], coarse[1]), (smooth[0], smooth[1]), (fine[0], fine[1]), kernel),
        phase_waves(smooth[0], smooth[1]),
        edge(smooth[0], smooth[1]).astype(np.float32),
        (slice(2, 2 + rows), slice(1, 1 + columns)),
    )
    shape = (len(coarse[0]), len(coarse[1]))
    field = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
    found = np.zeros((rows + 9, columns + 7), np.complex64)
    carrier_interpolation.add(field, found)
    some = np.zeros((rows // 2, columns + 7), np.complex64)
    carrier_interpolation.add(field, some, first_row=rows // 3)
    np.testing.assert_allclose(some, found[rows // 3 : rows // 3 + rows // 2], atol=1e-6)
    weights = [interpolation(c, f, kernel).matrix().toarray() for c, f in zip(coarse, fine, strict=True)]
    e = np.clip(edge(*fine), 0.0, 1.0)
    carrier = e * e * (3.0 - 2.0 * e) * np.exp(2j * np.pi * phase_waves(*fine))
    expected = np.zeros_like(found, dtype=complex)
    expected[2 : 2 + rows, 1 : 1 + columns] = carrier * (weights[0] @ field @ weights[1].T)
    assert found == pytest.approx(expected, abs=2e-5)
    other = (rng.normal(size=found.shape) + 1j * rng.normal(size=found.shape)).astype(np.complex64)
    wanted = weights[0].T @ (carrier.conj() * other[2 : 2 + rows, 1 : 1 + columns]) @ weights[1]
    for threads in (1, 3):
        assert carrier_interpolation.collect(other, threads) == pytest.approx(wanted, abs=1e-4)
