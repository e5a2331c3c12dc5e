"""Object-domain reconstruction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.engine import Engine, Scene
from wavesim.engines import make_engine
from wavesim.fields import Field, Grid, correlation
from wavesim.free_space import transfer_function
from wavesim.reconstruction import prox_tv, reconstruct
from wavesim.retrieval import Recorded


@dataclass(frozen=True, eq=False)
class Case:
    engine: Engine
    illumination: Field
    transmission: np.ndarray
    recorded: list[Recorded]


@pytest.fixture(scope="module")
def case() -> Case:
    """Bars of 0.9 to 3 um within a field stop, through a small twin of the paper's lens, onto two planes."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    object_grid = Grid((120, 120), 4.2e-4, lens.object_z_mm)
    exit_grid = Grid((216, 216), 3.2e-3, lens.exit_vertex_z_mm + 0.08)
    engine = make_engine("eikonal", Scene(lens, object_grid, exit_grid, 0.532), error=0.1)
    y, x = object_grid.y_mm[:, None], object_grid.x_mm
    stop = (np.hypot(y, x) < 0.024).astype(np.complex64)
    rng = np.random.default_rng(7)
    transmission = np.ones(object_grid.shape)
    for _ in range(12):
        width, cy, cx = rng.uniform(0.9e-3, 3e-3), *rng.uniform(-0.02, 0.02, 2)
        for bar in range(3):
            transmission[
                (np.abs(x - cx - 2 * bar * width) < 0.5 * width) & (np.abs(y - cy) < 2.5 * width)
            ] = 0.0
    lit = Field(object_grid, stop, 0.532)
    at_exit = engine.forward(lit.with_values((transmission * stop).astype(np.complex64))).values
    planes = []
    for distance in (0.0, 0.6):
        way = transfer_function(exit_grid.shape, 3.2e-3, 0.532, 1.0, distance, band_limit=False)
        planes.append(Recorded(distance, np.abs(np.fft.ifft2(np.fft.fft2(at_exit) * way)).astype(np.float32)))
    return Case(engine, lit, transmission, planes)


def score(case: Case, found: Field) -> float:
    """Correlation of what the object adds to its illumination, inside the field stop."""
    inside = np.abs(case.illumination.values) > 0.0
    return correlation((found.values - 1.0)[inside], (case.transmission - 1.0)[inside])


def test_an_amplitude_object_comes_back(case: Case) -> None:
    found = reconstruct(
        case.engine,
        case.illumination,
        case.recorded,
        kind="amplitude",
        tv_weight=0.02,
        iterations=40,
        scale=1.0,
    )
    assert score(case, found.transmission) > 0.97
    assert found.misfit[-1] < 0.1 * found.misfit[0]
    values = found.transmission.values
    assert np.all(values.imag == 0.0)
    assert np.all((values.real >= 0.0) & (values.real <= 1.0))
    assert not np.any(values[np.abs(case.illumination.values) == 0.0])
    size = np.sqrt(sum(np.sum(p.amplitude.astype(float) ** 2) for p in case.recorded))
    left = np.sqrt(sum(np.sum(m.astype(float) ** 2) for m in found.residual_maps)) / size
    assert left == pytest.approx(found.misfit[-1], rel=0.5)


def test_a_complex_object_is_found_to_the_data(case: Case) -> None:
    found = reconstruct(
        case.engine, case.illumination, case.recorded, tv_weight=0.02, iterations=40, scale=1.0
    )
    assert score(case, found.transmission) > 0.8
    assert found.misfit[-1] < 0.25 * found.misfit[0]


def test_one_plane_is_worse_than_two(case: Case) -> None:
    scores = [
        score(
            case,
            reconstruct(
                case.engine,
                case.illumination,
                planes,
                kind="amplitude",
                tv_weight=0.02,
                iterations=15,
                scale=1.0,
            ).transmission,
        )
        for planes in (case.recorded[:1], case.recorded)
    ]
    assert scores[0] < scores[1]


def test_the_scale_is_found(case: Case) -> None:
    louder = [Recorded(p.distance_mm, 7.0 * p.amplitude) for p in case.recorded]
    found = reconstruct(
        case.engine, case.illumination, louder, kind="amplitude", tv_weight=0.02, iterations=30
    )
    assert found.scale == pytest.approx(7.0, rel=0.25)
    assert score(case, found.transmission) > 0.9


def test_the_truth_stays(case: Case) -> None:
    start = case.illumination.with_values(case.transmission.astype(np.complex64))
    found = reconstruct(
        case.engine, case.illumination, case.recorded, kind="amplitude", iterations=5, scale=1.0, start=start
    )
    assert max(found.misfit) < 1e-4
    assert score(case, found.transmission) > 0.9999


def test_progress_and_early_stop(case: Case) -> None:
    told: list[int] = []
    start = case.illumination.with_values(case.transmission.astype(np.complex64))
    found = reconstruct(
        case.engine,
        case.illumination,
        case.recorded,
        kind="amplitude",
        iterations=60,
        tv_weight=0.02,
        scale=1.0,
        start=start,
        progress=lambda k, _: told.append(k),
    )
    assert told == list(range(len(found.misfit)))
    assert found.stopped_early == (len(found.misfit) < 60)


@settings(max_examples=20)
@given(st.integers(0, 1000), st.floats(0.01, 2.0))
def test_proximal_map_of_the_total_variation(seed: int, weight: float) -> None:
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((12, 9)) + 1j * rng.standard_normal((12, 9))

    def variation(v: np.ndarray) -> float:
        dy, dx = np.diff(v, axis=0, append=v[-1:]), np.diff(v, axis=1, append=v[:, -1:])
        return float(np.sum(np.sqrt(np.abs(dy) ** 2 + np.abs(dx) ** 2)))

    def cost(v: np.ndarray) -> float:
        return 0.5 * float(np.sum(np.abs(v - values) ** 2)) + weight * variation(v)

    found = prox_tv(values, weight, 400)
    assert found.mean() == pytest.approx(values.mean(), abs=1e-9)
    best = cost(found)
    assert best <= cost(values)
    for _ in range(5):
        other = found + 0.05 * (rng.standard_normal((12, 9)) + 1j * rng.standard_normal((12, 9)))
        assert best <= cost(other) + 1e-6


def test_proximal_map_of_a_step_is_known() -> None:
    """Two levels, n samples each: both move towards each other by weight / n."""
    values = np.concatenate([np.zeros(10), np.ones(10)]).astype(complex)
    found = prox_tv(values, 0.5, 3000)
    np.testing.assert_allclose(found, np.concatenate([np.full(10, 0.05), np.full(10, 0.95)]), atol=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recorded": []}, "one plane at least"),
        ({"recorded": [Recorded(0.0, np.ones((3, 3)))]}, "shape"),
        ({"recorded": [Recorded(0.0, np.zeros((216, 216)))]}, "all dark"),
        ({"recorded": [Recorded(0.0, np.full((216, 216), np.nan))]}, "finite"),
        ({"recorded": [Recorded(np.nan, np.ones((216, 216)))]}, "distance_mm = nan"),
        ({"kind": "phase"}, "kind = 'phase'"),
        ({"tv_weight": -1.0}, "tv_weight"),
        ({"iterations": 0}, "iterations = 0"),
        ({"scale": 0.0}, "scale = 0.0"),
    ],
)
def test_refused(case: Case, change: dict, message: str) -> None:
    arguments = {"recorded": case.recorded} | change
    with pytest.raises(InputError, match=message):
        reconstruct(case.engine, case.illumination, **arguments)
