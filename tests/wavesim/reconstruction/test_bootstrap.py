"""The uncertainty of a reconstruction, held against many independent records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.camera.recorded import Recorded, recorded_intensity
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.fields.plane_waves import fft_frequencies, transfer
from wavesim.reconstruction.bootstrap import uncertainty
from wavesim.reconstruction.from_object import Reconstructed, reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene

SEEDS = 10
SETTINGS = {"kind": "amplitude", "tv_weight": "auto"}


@pytest.fixture(scope="module")
def lit() -> tuple[Engine, Field]:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    grid = Grid((64, 64), 4.2e-4, lens.object_z_mm)
    exit_grid = Grid((216, 216), 3.2e-3, lens.exit_vertex_z_mm + 0.08)
    engine = engine_for(Scene(lens, grid, exit_grid, 0.532), "eikonal", error=0.3)
    stop = (np.hypot(grid.y_mm[:, None], grid.x_mm) < 0.012).astype(np.complex64)
    return engine, Field(grid, stop, 0.532)


def record(lit: tuple[Engine, Field], seed: int, electrons: float = 1e5) -> list[Recorded]:
    """Two bars under the field stop, on two planes, with shot noise."""
    engine, light = lit
    transmission = np.ones(light.grid.shape)
    transmission[20:44, 22:27] = 0.0
    transmission[20:44, 33:38] = 0.4
    at_exit = engine.forward(light.with_values((transmission * light.values).astype(np.complex64)))
    random = np.random.default_rng(seed)
    planes = []
    for distance in (0.0, 0.6):
        way = transfer(fft_frequencies(at_exit.grid.shape, 3.2e-3), 0.532, 1.0, distance)
        intensity = np.abs(np.fft.ifft2(np.fft.fft2(at_exit.values) * way)) ** 2
        gain = electrons / intensity.max()
        counts = random.poisson(gain * intensity)
        made = recorded_intensity(distance, counts / gain, np.maximum(counts, 1.0) / gain**2)
        amplitude, sigma = (np.asarray(v, np.float32) for v in (made.amplitude, made.sigma))
        planes.append(replace(made, amplitude=amplitude, sigma=sigma))
    return planes


def found(lit: tuple[Engine, Field], recorded: list[Recorded]) -> Reconstructed:
    return reconstruct(*lit, recorded, iterations=12, scale=1.0, **SETTINGS)


def test_it_is_the_scatter_of_independent_records(lit: tuple[Engine, Field]) -> None:
    inside = np.abs(lit[1].values) > 0.0
    results = np.array([found(lit, record(lit, seed)).transmission.values for seed in range(SEEDS)])
    scatter = np.std(results, axis=0, ddof=1)
    first = record(lit, 0)
    told: list[tuple[int, int]] = []
    told_by_one = uncertainty(
        *lit, first, found(lit, first), repeats=6, progress=lambda *done: told.append(done), **SETTINGS
    )
    assert told == [(k, 6) for k in range(1, 7)]
    assert told_by_one.shape == inside.shape
    assert not np.any(told_by_one[~inside])
    ratio = np.sqrt(np.mean(told_by_one[inside] ** 2) / np.mean(scatter[inside] ** 2))
    assert 0.6 < ratio < 1.6
    assert np.corrcoef(told_by_one[inside], scatter[inside])[0, 1] > 0.5


def test_less_light_is_less_certain(lit: tuple[Engine, Field]) -> None:
    sizes = []
    for electrons in (1e4, 1e6):
        planes = record(lit, 1, electrons)
        map_ = uncertainty(*lit, planes, found(lit, planes), repeats=2, iterations=6, **SETTINGS)
        sizes.append(np.sqrt(np.mean(map_**2)))
    assert sizes[0] > 3.0 * sizes[1]


def test_refused(lit: tuple[Engine, Field]) -> None:
    planes = record(lit, 1)
    result = reconstruct(*lit, planes, iterations=1, scale=1.0)
    with pytest.raises(InputError, match="repeats = 1"):
        uncertainty(*lit, planes, result, repeats=1)
    with pytest.raises(InputError, match="sigma on every plane"):
        uncertainty(*lit, [replace(planes[0], sigma=None)], result)
