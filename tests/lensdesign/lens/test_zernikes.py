"""Zernike polynomials against their definitions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from lensdesign.errors import InputError
from lensdesign.lens.zernikes import HIGHEST_INDEX, HIGHEST_ORDER, zernike, zernike_orders
from lensdesign.raytrace.bundles import pupil_rings

RHO, THETA = np.random.default_rng(3).random((2, 500)) * [[1.0], [2.0 * math.pi]]

# As tables of ANSI Z80.28 print them.
WRITTEN_OUT = {
    0: np.ones(500),
    1: 2.0 * RHO * np.sin(THETA),
    2: 2.0 * RHO * np.cos(THETA),
    3: math.sqrt(6.0) * RHO**2 * np.sin(2.0 * THETA),
    4: math.sqrt(3.0) * (2.0 * RHO**2 - 1.0),
    5: math.sqrt(6.0) * RHO**2 * np.cos(2.0 * THETA),
    6: math.sqrt(8.0) * RHO**3 * np.sin(3.0 * THETA),
    7: math.sqrt(8.0) * (3.0 * RHO**3 - 2.0 * RHO) * np.sin(THETA),
    8: math.sqrt(8.0) * (3.0 * RHO**3 - 2.0 * RHO) * np.cos(THETA),
    12: math.sqrt(5.0) * (6.0 * RHO**4 - 6.0 * RHO**2 + 1.0),
    24: math.sqrt(7.0) * (20.0 * RHO**6 - 30.0 * RHO**4 + 12.0 * RHO**2 - 1.0),
}


@pytest.mark.parametrize("index", WRITTEN_OUT)
def test_low_orders_are_those_of_the_tables(index: int) -> None:
    assert zernike(index, RHO, THETA) == pytest.approx(WRITTEN_OUT[index], abs=1e-13)


def test_orders_run_through_the_pyramid() -> None:
    pyramid = [(n, m) for n in range(HIGHEST_ORDER + 1) for m in range(-n, n + 1, 2)]
    assert [zernike_orders(j) for j in range(HIGHEST_INDEX + 1)] == pyramid


def test_all_are_orthonormal_over_the_disc() -> None:
    samples = pupil_rings(20, 72)
    rho, theta = np.hypot(*samples.points.T), np.arctan2(samples.points[:, 1], samples.points[:, 0])
    basis = np.stack([zernike(j, rho, theta) for j in range(HIGHEST_INDEX + 1)])
    assert (basis * samples.weights) @ basis.T == pytest.approx(np.eye(len(basis)), abs=1e-11)


@pytest.mark.parametrize("index", [-1, HIGHEST_INDEX + 1, 2.0, True, "4"])
def test_other_indices_are_refused(index: Any) -> None:
    with pytest.raises(InputError, match="0 to 135"):
        zernike(index, 0.5, 0.0)
