"""Annular slices on arrays of another library than NumPy, and in single precision."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.fft
import stand_in_device

from lensdesign import Lens, scaled
from wavesim.engines.slices.engine import AnnularSlices
from wavesim.engines.slices.steps import BLOCK_SAMPLES, _factor, _keep_band
from wavesim.engines.surfaces.waves import Medium
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.scene.scene import Scene

WAVELENGTH_UM = 0.532

pytestmark = pytest.mark.filterwarnings("ignore::wavesim.fields.guards.SamplingWarning")


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


@pytest.mark.parametrize(("kind", "same"), [(np.complex128, 1e-9), (np.complex64, 1e-5)])
@pytest.mark.parametrize("back", [False, True])
def test_arrays_of_a_device_stay_there(engine: AnnularSlices, kind: Any, same: float, back: bool) -> None:
    field = noise(engine.scene.exit_grid if back else engine.scene.object_grid, kind)
    carry = engine.adjoint if back else engine.forward
    plain = carry(field).values
    assert plain.dtype == np.complex128
    with scipy.fft.set_backend(stand_in_device):
        held = stand_in_device.asarray(field.values)
        found = carry(Field(field.grid, held, WAVELENGTH_UM)).values
    assert isinstance(found, stand_in_device.DeviceArray)
    assert found.dtype == kind
    assert relative_error(found.get(), plain) < same


def test_factors_made_in_blocks_are_those_made_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wavesim.engines.slices.steps.BLOCK_SAMPLES", 100)
    assert BLOCK_SAMPLES > 100
    medium = Medium(Grid((30, 28), 4e-4, 0.0), WAVELENGTH_UM, 1.5, 0.4 * 2e3 * math.pi / WAVELENGTH_UM)
    assert 0.1 < np.mean(medium.inside) < 0.9
    for kind, same in ((np.complex64, 1e-6), (np.complex128, 1e-12)):
        like = stand_in_device.asarray(np.ones(medium.grid.shape, kind))
        made = _factor(medium, like, 123.4).get()
        assert made.dtype == kind
        assert made == pytest.approx(medium.over(123.4), abs=1e4 * same if kind == np.complex128 else same)
        _keep_band(medium, like)
        assert np.array_equal(like.get(), medium.inside.astype(kind))
