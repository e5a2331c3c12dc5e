"""The uncertainty of a reconstruction, held against many independent records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from benchmarks.uncertainty import record as record_object
from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.diagnostics.bootstrap import UndeterminedError, uncertainty
from wavesim.reconstruction.object_solver import Reconstructed, reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.sensor.measurement import Measurement

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


def two_bars() -> np.ndarray:
    transmission = np.ones((64, 64))
    transmission[20:44, 22:27] = 0.0
    transmission[20:44, 33:38] = 0.4
    return transmission


def record(
    lit: tuple[Engine, Field],
    seed: int,
    electrons: float = 1e5,
    transmission: np.ndarray | None = None,
    distances_mm: tuple[float, ...] = (0.0, 0.6),
) -> list[Measurement]:
    """Two bars under the field stop, or another object, on planes, with shot noise."""
    engine, light = lit
    if transmission is None:
        transmission = two_bars()
    return record_object(engine, light, transmission, distances_mm, seed, electrons)


def found(lit: tuple[Engine, Field], recorded: list[Measurement]) -> Reconstructed:
    return reconstruct(*lit, recorded, iterations=12, scale=1.0, **SETTINGS)


def test_it_is_the_true_error(lit: tuple[Engine, Field]) -> None:
    """The error includes what the total variation rounds, which independent records have in common."""
    inside = np.abs(lit[1].values) > 0.0
    results = np.array([found(lit, record(lit, seed)).transmission.values for seed in range(SEEDS)])
    scatter = np.std(results, axis=0, ddof=1)
    first = record(lit, 0)
    calls: list[tuple[int, int]] = []
    stated = uncertainty(
        *lit, first, found(lit, first), repeats=6, progress=lambda *done: calls.append(done), **SETTINGS
    )
    assert calls == [(k, 8) for k in range(1, 9)]
    values = stated.values
    assert values.shape == inside.shape
    assert not np.any(values[~inside])
    errors = np.sqrt(np.mean(np.abs(results - two_bars()) ** 2, axis=0))
    assert 0.8 < np.sqrt(np.mean(errors[inside] ** 2) / np.mean(values[inside] ** 2)) < 1.25
    assert np.corrcoef(values[inside], scatter[inside])[0, 1] > 0.5
    parts = np.hypot(stated.noise_rms, stated.starts_rms)
    assert np.sqrt(np.mean(values[inside] ** 2)) == pytest.approx(parts, rel=1e-6)
    assert stated.misfit_over_noise < 1.0
    assert "wrong model of lens" in stated.not_included


def test_less_light_is_less_certain(lit: tuple[Engine, Field]) -> None:
    sizes = []
    for electrons in (1e4, 1e6):
        planes = record(lit, 1, electrons)
        map_ = uncertainty(*lit, planes, found(lit, planes), repeats=2, iterations=6, **SETTINGS)
        sizes.append(map_.noise_rms)
    assert sizes[0] > 3.0 * sizes[1]


def test_an_object_in_a_wrong_hollow_has_no_uncertainty(lit: tuple[Engine, Field]) -> None:
    """A smooth field of random phase, as of a diffuser, of which two planes find another: error 1.2."""
    random = np.random.default_rng(5)
    real, imaginary = (gaussian_filter(random.standard_normal(lit[1].grid.shape), 3.0) for _ in range(2))
    diffuse = real + 1j * imaginary
    diffuse /= np.sqrt(np.mean(np.abs(diffuse) ** 2))
    planes = record(lit, 0, transmission=diffuse)
    settings = {"kind": "complex", "tv_weight": "auto"}
    result = reconstruct(*lit, planes, iterations=30, scale=1.0, **settings)
    inside = np.abs(lit[1].values) > 0.0
    one, true = result.transmission.values[inside], diffuse[inside]
    turned = one * (np.vdot(one, true) / abs(np.vdot(one, true)))
    assert np.linalg.norm(turned - true) > 0.5 * np.linalg.norm(true)
    with pytest.raises(UndeterminedError, match=r"[\d.]+ times the noise"):
        uncertainty(*lit, planes, result, repeats=2, **settings)


def test_objects_that_fit_as_well_and_differ_have_none(lit: tuple[Engine, Field]) -> None:
    """On one plane a complex object has twice as many unknowns as there are amplitudes."""
    planes = record(lit, 0, distances_mm=(0.0,))
    settings = {"kind": "complex", "tv_weight": 0.0}
    result = reconstruct(*lit, planes, iterations=40, scale=1.0, **settings)
    with pytest.raises(UndeterminedError, match="another start"):
        uncertainty(*lit, planes, result, repeats=2, **settings)


def test_a_plane_that_was_held_out_has_its_say(lit: tuple[Engine, Field]) -> None:
    *planes, right = record(lit, 3, distances_mm=(0.0, 0.6, 0.9))
    result = found(lit, planes)
    predicted = uncertainty(*lit, planes, result, held_out=right, repeats=2, iterations=2, **SETTINGS)
    assert 0.6 < predicted.held_out_over_noise < 1.1
    assert "held out" not in predicted.not_included
    (wrong,) = record(lit, 3, transmission=np.ones((64, 64)), distances_mm=(0.9,))
    with pytest.raises(UndeterminedError, match="plane held out"):
        uncertainty(*lit, planes, result, held_out=wrong, repeats=2, **SETTINGS)


def test_refused(lit: tuple[Engine, Field]) -> None:
    planes = record(lit, 1)
    result = reconstruct(*lit, planes, iterations=1, scale=1.0)
    with pytest.raises(InputError, match="repeats = 1"):
        uncertainty(*lit, planes, result, repeats=1)
    with pytest.raises(InputError, match="sigma on every plane"):
        uncertainty(*lit, [replace(planes[0], sigma=None)], result)
