"""Unknowns that frames determine against their noise: Lanczos bounds beside dense matrices."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from lensdesign import load_design, scaled
from wavesim.calibration.planning import random_objects
from wavesim.engines.choosing import engine_for
from wavesim.reconstruction.information import (
    WhitenedJacobian,
    _quadratures,
    information_of,
    singular_values,
)
from wavesim.scene.settings import PatchSettings, PlanSettings
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.imaging import image
from wavesim.sensor.windows import exit_scene
from wavesim.targets.patch import lit, object_patch

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
Kind = Literal["amplitude", "phase", "complex"]


def jacobian(kind: Kind, exposures: tuple[float, ...] = (1.0,), planes: int = 1) -> WhitenedJacobian:
    """Return the derivative for a random object of some hundred unknowns."""
    patch = object_patch(LENS, 0.006)
    objects = random_objects(patch, PlanSettings(kind="amplitude" if kind == "amplitude" else "complex"))
    target = objects["grains" if kind == "amplitude" else "dense"]
    if kind == "phase":
        target = target.with_values(np.exp(1j * np.angle(target.values)).astype(np.complex64))
    planes_mm = LENS.sensor.plane_distances_mm[:planes]
    imaged = image(
        LENS,
        target,
        planes_mm=planes_mm,
        exposures=exposures,
        engine="eikonal",
        read_noise_electrons=20.0,
    )
    engine = engine_for(exit_scene(LENS, patch, imaged.sensor, planes_mm[0]), "eikonal", error=0.05)
    light = lit(patch, PatchSettings())
    recorded = recorded_planes(imaged.frames)
    return WhitenedJacobian(engine, light, recorded, target, kind, patch.inside)


@pytest.mark.parametrize("kind", ["amplitude", "phase", "complex"])
def test_forward_and_adjoint_agree(kind: Kind) -> None:
    of_kind, random = jacobian(kind), np.random.default_rng(2)
    numbers = random.standard_normal(of_kind.inside.shape)
    if kind == "complex":
        numbers = numbers + 1j * random.standard_normal(of_kind.inside.shape)
    changes = of_kind.forward(numbers)
    other = random.standard_normal(changes.shape)
    there, back = np.vdot(changes, other), np.vdot(numbers, of_kind.adjoint(other)).real
    assert there == pytest.approx(back, rel=1e-3)


def test_the_derivative_is_that_of_amplitudes_over_their_deviation() -> None:
    of_kind = jacobian("complex")
    model, linear = of_kind.linear.model, of_kind.linear
    numbers = 1e-3 * np.random.default_rng(3).standard_normal(of_kind.inside.shape).astype(complex)
    change = of_kind.deviation * of_kind.limited(numbers)
    lit_object = linear.lit.values / np.where(of_kind.inside, model.illumination.values, 1.0)
    before, after = (
        model.amplitudes((lit_object + sign * change).astype(np.complex64)) for sign in (-1.0, 1.0)
    )
    sigma = model.recorded[0].sigma
    assert sigma is not None
    differences = 0.5 * (after[0] - before[0]) / sigma
    expected = of_kind.forward(numbers)[0]
    # Dark pixels have a kink in their amplitude.
    bright = before[0] > 0.05 * before[0].max()
    assert np.linalg.norm((differences - expected)[bright]) < 0.03 * np.linalg.norm(expected[bright])


@pytest.mark.parametrize(("kind", "exposures"), [("amplitude", (1.0,)), ("complex", (1.0, 30.0))])
def test_bounds_hold_the_error_of_a_dense_matrix(kind: Kind, exposures: tuple[float, ...]) -> None:
    """The mean over random vectors is the trace of the posterior over that of the prior."""
    of_kind = jacobian(kind, exposures)
    size = of_kind.inside.size
    units = [1.0, 1j] if kind == "complex" else [1.0]
    numbers = [unit * one.reshape(of_kind.inside.shape) for unit in units for one in np.eye(size)]

    def real(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values.real.ravel(), values.imag.ravel()][: len(units)])

    chain = np.stack([of_kind.forward(one).ravel() for one in numbers], axis=1).astype(float)
    limit = np.stack([real(of_kind.limited(one)) for one in numbers], axis=1)
    posterior = np.linalg.inv(np.eye(len(numbers)) + chain.T @ chain)
    exact = np.trace(limit @ posterior @ limit.T) / np.trace(limit @ limit.T)
    found = [information_of(of_kind, steps=60, seed=seed) for seed in range(20)]
    lower, upper = (np.mean([getattr(one, name) for one in found]) for name in ("error", "error_bound"))
    assert all(one.error <= one.error_bound for one in found)
    assert lower * 0.85 <= exact <= upper * 1.15
    assert 0.0 < found[0].fraction < 1.0
    assert found[0].determined == pytest.approx(found[0].fraction * found[0].unknowns)
    # The singular values give the degrees of freedom for signal without the weight of the stop.
    values = singular_values(of_kind)[: len(numbers)]
    assert np.sum(values**2 / (1 + values**2)) == pytest.approx(len(numbers) - np.trace(posterior), rel=1e-3)


def test_saturated_pixels_tell_nothing() -> None:
    with np.errstate(invalid="raise"):
        found = jacobian("complex", (1e6,))
    unknown = np.isinf(np.stack([plane.sigma for plane in found.linear.model.recorded]))
    changes = found.forward(np.ones(found.inside.shape, complex))
    assert unknown.any()
    assert not changes[unknown].any()
    assert np.isfinite(changes).all()


def test_more_light_determines_more() -> None:
    dim, bright = (information_of(jacobian("complex", one)) for one in ((1.0,), (1.0, 30.0, 1000.0)))
    assert bright.determined > dim.determined
    assert bright.correlation > dim.correlation


def test_shrinkage_counts_as_larger_noise() -> None:
    """A threshold of one deviation acts like noise of twice the variance."""
    plain, other = jacobian("amplitude"), jacobian("amplitude")
    other._whitening = other._whitening / np.float32(np.sqrt(2.0))
    found = information_of(plain, shrinkage=1.0)
    assert found.error == pytest.approx(information_of(other).error, rel=1e-4)
    assert found.error > information_of(plain).error


def test_quadratures_bound_the_form_of_a_matrix() -> None:
    values = np.geomspace(1e-2, 1e4, 200)
    weights = np.full(200, 1.0 / 200)
    exact = float(np.sum(weights / (1.0 + values)))
    # Lanczos on a diagonal matrix, in exact terms of its moments.
    vector, previous, beta = np.sqrt(weights), np.zeros(200), 0.0
    diagonal, off_diagonal = [], []
    for _ in range(12):
        image_ = values * vector - beta * previous
        alpha = float(vector @ image_)
        image_ -= alpha * vector
        beta = float(np.linalg.norm(image_))
        previous, vector = vector, image_ / beta
        diagonal.append(alpha)
        off_diagonal.append(beta)
    lower, upper = _quadratures(np.array(diagonal), np.array(off_diagonal))
    assert lower < exact < upper
