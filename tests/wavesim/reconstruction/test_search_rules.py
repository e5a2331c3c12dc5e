"""When searches end, and how strong their automatic total variation is."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavesim.reconstruction.object_solver import USUAL_STEPS
from wavesim.reconstruction.search_rules import (
    COARSE_STEPS,
    SINGLE_EXPOSURE_FACTOR,
    coarse_step_rule,
    ends_at_noise,
    tv_factor,
)
from wavesim.scene.engine import Engine
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import Measurement, recorded_intensity

SMALL = cast(Engine, object())
"""An engine that is not that of a whole field."""


def plane(exposures: tuple[float, ...]) -> Measurement:
    """Return a bright and a faint half; each is known from the longest exposure that does not clip it."""
    electrons = np.repeat([[9000.0, 20.0]], 4, axis=0)
    longest = np.array([[max(e for e in exposures if e * n <= 10000.0) for n in electrons[0]]])
    return recorded_intensity(0.0, electrons, electrons / longest + 4.0 / longest**2)


def test_single_exposures_need_more_total_variation() -> None:
    assert tv_factor("amplitude", SMALL, [plane((1.0,))]) == SINGLE_EXPOSURE_FACTOR


def test_faint_light_that_a_long_exposure_measures_needs_no_more() -> None:
    assert tv_factor("phase", SMALL, [plane((1.0, 30.0, 1000.0))]) == pytest.approx(1.0)


@given(st.integers(0, 16))
def test_the_factor_falls_with_the_fraction_that_is_known_precisely(precise: int) -> None:
    sigma = np.ones(16)
    sigma[:precise] = 0.1
    amplitude = np.full((4, 4), 5.0)
    amplitude.flat[-1] = 9.0  # the brightest pixel is known with a deviation of 1, unless all are
    found = tv_factor("amplitude", SMALL, [Measurement(0.0, amplitude, sigma.reshape(4, 4))])
    fraction = 0.0 if precise == 16 else min(precise / 8.0, 1.0)
    assert found == pytest.approx(SINGLE_EXPOSURE_FACTOR - 0.4 * fraction)


@pytest.mark.parametrize("kind", ["amplitude", "phase", "complex"])
def test_only_complex_objects_end_at_the_noise(kind: Kind) -> None:
    assert ends_at_noise(kind, SMALL) == (kind == "complex")
    if kind == "complex":
        assert tv_factor(kind, SMALL, [plane((1.0,))]) == 1.0


def test_first_steps_of_amplitude_objects_are_longer() -> None:
    assert coarse_step_rule("amplitude") == COARSE_STEPS != USUAL_STEPS
    assert coarse_step_rule("phase") == coarse_step_rule("complex") == USUAL_STEPS
