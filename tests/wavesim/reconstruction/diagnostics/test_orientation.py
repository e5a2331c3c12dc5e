"""Pictures that fit better mirrored, turned or shifted."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavesim.reconstruction.diagnostics.orientation import orientation_findings
from wavesim.sensor.measurement import Measurement
from wavesim.sensor.orientations import ORIENTATIONS

SHAPE = (90, 120)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]]
MADE = 1.0 + 0.3 * np.sin(0.13 * X + 0.001 * X * Y) + 0.2 * np.cos(0.21 * Y - 0.0007 * X**2)
NOISE = 0.6


def taken(picture: np.ndarray, seed: int = 0) -> tuple[Measurement, np.ndarray]:
    """A noisy picture, and the amplitudes that a model of the right one has less it."""
    amplitude = picture + NOISE * np.random.default_rng(seed).standard_normal(SHAPE)
    return Measurement(1.0, amplitude, np.full(SHAPE, NOISE)), MADE - amplitude


@given(st.integers(0, 1000))
def test_a_picture_as_it_is_has_no_finding(seed: int) -> None:
    plane, error = taken(MADE, seed)
    assert orientation_findings([plane], [error]) == []


@pytest.mark.parametrize("name", ["mirrored left to right", "mirrored top to bottom", "turned by 180°"])
def test_a_noisy_picture_that_is_mirrored_or_turned_is_found(name: str) -> None:
    plane, error = taken(np.asarray(ORIENTATIONS[name](MADE)))
    found = max(orientation_findings([plane], [error]), key=lambda one: one.chi_square)
    assert found.cause == "orientation"
    assert name in found.explanation
    assert "plane 1" in found.explanation


def test_a_quarter_turn_is_found_in_the_middle_square() -> None:
    picture = MADE.copy()
    picture[:, 15:105] = np.asarray(ORIENTATIONS["turned by 90°"](MADE[:, 15:105]))
    plane, error = taken(picture)
    assert "turned by -90°" in orientation_findings([plane], [error])[0].explanation


def test_a_shifted_picture_is_found_with_its_shift() -> None:
    plane, error = taken(np.roll(MADE, (3, -5), (0, 1)))
    shift = next(one for one in orientation_findings([plane], [error]) if one.cause == "shift")
    x, y = map(float, re.findall(r"(-?[\d.]+), (-?[\d.]+) pixels", shift.explanation)[0])
    assert (x, y) == (pytest.approx(5.0, abs=0.3), pytest.approx(-3.0, abs=0.3))


def test_pixels_that_are_not_known_do_not_count() -> None:
    plane, error = taken(np.asarray(MADE[:, ::-1]))
    unknown = Measurement(1.0, plane.amplitude, np.full(SHAPE, np.inf))
    assert orientation_findings([unknown], [error]) == []
