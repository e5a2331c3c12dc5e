"""Annular slices: steps, blocks and single precision."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from engine_checks import dot_product_mismatch

from lensdesign import Lens, scaled
from wavesim.engines.slices.engine import AnnularSlices
from wavesim.engines.slices.steps import propagated, step_factor
from wavesim.engines.slices.windows import Waves
from wavesim.engines.surfaces.waves import Medium
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.scene.scene import Scene

WAVELENGTH_UM = 0.532

pytestmark = pytest.mark.filterwarnings("ignore::wavesim.fields.sampling_checks.SamplingWarning")


@pytest.fixture(scope="module", params=["line", "plane"])
def engine(request: pytest.FixtureRequest, paper_lens: Lens) -> AnnularSlices:
    """A small twin of the paper's lens."""
    twin = scaled(paper_lens, 1.0 / 200.0)
    sides = 1 if request.param == "line" else 2
    grids = Grid((40, 42)[:sides], 4e-4, twin.object_z_mm), Grid((60, 50)[:sides], 2e-3, 0.08)
    return AnnularSlices(Scene(twin, *grids, WAVELENGTH_UM), slices=6)


def noise(grid: Grid, kind: Any) -> Field:
    rng = np.random.default_rng(len(grid.shape))
    values = rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape)
    return Field(grid, values.astype(kind), WAVELENGTH_UM)


def waves(shape: tuple[int, ...] = (30, 28)) -> Waves:
    """More than half of the orders of a window."""
    band = 0.4 * 2e3 * math.pi / WAVELENGTH_UM
    return Waves(Medium(Grid(shape, 4e-4, 0.0), WAVELENGTH_UM, 1.5, band))


@pytest.mark.parametrize(("kind", "same"), [(np.complex128, 1e-8), (np.complex64, 1e-6)])
def test_a_step_is_that_of_free_space(kind: Any, same: float) -> None:
    """Blocks in threads, and :meth:`Medium.over`, which has all waves at once."""
    known = waves()
    medium, (down, across) = known.medium, known.orders
    places = np.ix_(*(np.arange(-m, m + 1) % n for m, n in zip(known.orders, (30, 28), strict=True)))
    whole = medium.waves.transfer_function(123.4)[places]
    assert 0.5 < np.mean(whole != 0.0) < 0.9
    factor = step_factor(known, 123.4, np.dtype(kind))
    assert factor.dtype == kind
    assert factor == pytest.approx(whole[down:, across:], abs=same)
    assert propagated(known, np.ones(known.shape, kind), 123.4) == pytest.approx(whole, abs=same)


def test_blocks_are_as_the_whole(engine: AnnularSlices, monkeypatch: pytest.MonkeyPatch) -> None:
    field = noise(engine.scene.object_grid, complex)
    whole = engine.forward(field).values
    monkeypatch.setattr("wavesim.engines.slices.windows.BLOCK_BYTES", 1)
    monkeypatch.setattr("wavesim.engines.slices.samples.BLOCK", 100)
    parts = AnnularSlices(engine.scene, slices=6).forward(field).values
    assert relative_error(parts, whole) < 1e-12


def test_single_precision_of_numpy(engine: AnnularSlices) -> None:
    lean = AnnularSlices(engine.scene, slices=6, precision="single")
    field = noise(engine.scene.object_grid, complex)
    found = lean.forward(field).values
    assert found.dtype == np.complex64
    assert relative_error(found, engine.forward(field).values) < 1e-5
    assert dot_product_mismatch(lean) < 1e-5
    assert lean.cost().peak_bytes < engine.cost().peak_bytes
