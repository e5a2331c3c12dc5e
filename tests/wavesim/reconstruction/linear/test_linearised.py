"""Slopes of a recording's model, and the way back to the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_twins import small_twin

from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.linear.linearised import Linearised
from wavesim.reconstruction.linear.measurement_operator import FreeSpaceMeasurement
from wavesim.sensor.measurement import Measurement


@pytest.fixture(scope="module")
def parts() -> tuple:
    """A model with two planes, and a transmission that is not the one that they recorded."""
    engine, lit = small_twin()
    rng = np.random.default_rng(1)
    truth, now = (0.7 + 0.2 * rng.standard_normal(lit.grid.shape) for _ in range(2))
    blank = [Measurement(d, np.ones(engine.scene.exit_grid.shape)) for d in (0.0, 0.6)]
    seen = ForwardModel(engine, lit, blank, 1.0, 1.0).amplitudes(truth.astype(complex))
    planes = [
        replace(p, amplitude=2.0 * a, sigma=1.0 + rng.random(a.shape), background=np.full(a.shape, 0.01))
        for p, a in zip(blank, seen, strict=True)
    ]
    return engine, lit, planes, now.astype(complex)


def linear(
    parts: tuple,
    *,
    changed: dict | None = None,
    transmission: np.ndarray | None = None,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
) -> Linearised:
    engine, lit, planes, now = parts
    planes = [replace(p, tilt_deg=tilt_deg) for p in (planes[0], replace(planes[1], **(changed or {})))]
    model = ForwardModel(engine, lit, planes, None, 1.0)
    return Linearised(model, now if transmission is None else transmission, True)


def test_the_way_back_is_the_adjoint(parts: tuple) -> None:
    here, rng = linear(parts), np.random.default_rng(2)
    change = rng.standard_normal(parts[3].shape) + 1j * rng.standard_normal(parts[3].shape)
    left = rng.standard_normal(here.residual.shape)
    there = float(np.vdot(here.of_object(change), left))
    assert float(np.vdot(change, here.to_object(left)).real) == pytest.approx(there, rel=1e-5)


def test_slopes_are_those_of_the_residuals(parts: tuple) -> None:
    """The scale follows by itself, so that what it does is left out of the differences too."""
    here, small = linear(parts), 1e-3
    way, seen = np.random.default_rng(3).standard_normal(parts[3].shape), here.sight
    assert isinstance(seen, FreeSpaceMeasurement)
    cases = {
        "object": (here.of_object(way), linear(parts, transmission=parts[3] + 1e-4 * way), 1e-4),
        "distance": (
            here.of_plane(1, seen.by_distance(1)),
            linear(parts, changed={"distance_mm": 0.6 + small}),
            small,
        ),
        "tilt": (here.of_planes(seen.by_tilt(1)), linear(parts, tilt_deg=(0.0, 1e-3)), 1e-3),
        "shift": (
            here.of_plane(1, seen.by_shift(1, 0)),
            linear(parts, changed={"shift_mm": (1e-5, 0.0)}),
            1e-2,
        ),
    }
    for name, (slope, there, step) in cases.items():
        found = here.without_scale((here.residual - there.residual) / step)
        assert np.linalg.norm(found - slope) < 0.05 * np.linalg.norm(slope), name


def test_a_background_adds_its_share_of_the_mean(parts: tuple) -> None:
    plane = parts[2][1]
    mean = float(np.mean(plane.amplitude**2))
    here, there = linear(parts), linear(parts, changed={"background": plane.background + 1e-3 * mean})
    found = here.without_scale((here.residual - there.residual) / 1e-3)
    assert np.linalg.norm(found - here.of_background(1)) < 0.05 * np.linalg.norm(found)
