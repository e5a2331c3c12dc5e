"""Heights from phases: their order, their precision, and where they are ambiguous."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.reconstruction.heights import (
    common_phases,
    heights_from_phases,
    unambiguous_um,
    wave_numbers,
    wrapped,
)

PAIR, THREE = (0.532, 0.635), (0.45, 0.532, 0.635)


def phases_of(height_um: np.ndarray, wavelengths: tuple[float, ...]) -> np.ndarray:
    return wrapped(wave_numbers(wavelengths, 1.5).reshape(-1, 1) * height_um)


def test_the_range_is_that_of_the_synthetic_wavelength() -> None:
    assert unambiguous_um(PAIR, 1.5) == pytest.approx(0.532 * 0.635 / 0.103 / 0.5)
    assert unambiguous_um((0.532,), 1.5) == pytest.approx(2.0 * 0.532)


@pytest.mark.parametrize("wavelengths", [PAIR, THREE])
def test_heights_over_the_whole_range_have_the_precision_of_all_wavelengths(
    wavelengths: tuple[float, ...],
) -> None:
    """Against the scatter of heights from phases with noise."""
    rng = np.random.default_rng(0)
    true = rng.uniform(-3.0, 3.0, 20000)
    noise = np.array([0.03, 0.05, 0.04])[: len(wavelengths), None] * np.ones((1, len(true)))
    phases = phases_of(true, wavelengths) + noise * rng.standard_normal(noise.shape)
    found = heights_from_phases(phases, noise, wavelengths, 1.5)
    error = found.height_um - true
    assert not found.ambiguous.any()
    numbers = wave_numbers(wavelengths, 1.5)
    expected = 1.0 / np.sqrt(np.sum(numbers[:, None] ** 2 / noise**2, axis=0))
    assert found.deviation_um == pytest.approx(expected)
    assert float(np.std(error / found.deviation_um)) == pytest.approx(1.0, abs=0.03)


def test_noise_that_hides_the_order_is_flagged() -> None:
    """Nearly all samples of a wrong order are among the flagged ones."""
    rng = np.random.default_rng(1)
    true = rng.uniform(-2.5, 2.5, 5000)
    noise = np.full((2, len(true)), 0.2)
    phases = phases_of(true, PAIR) + noise * rng.standard_normal(noise.shape)
    found = heights_from_phases(phases, noise, PAIR, 1.5)
    wrong = np.abs(found.height_um - true) > 0.5
    assert wrong.mean() > 0.03
    assert found.ambiguous[wrong].mean() > 0.95
    assert found.ambiguous.mean() < 0.8


def test_a_known_range_resolves_the_order() -> None:
    """Of phases that are too noisy for the whole range."""
    rng = np.random.default_rng(2)
    true = rng.uniform(0.0, 0.5, 1000)
    noise = np.full((2, len(true)), 0.2)
    phases = phases_of(true, PAIR) + noise * rng.standard_normal(noise.shape)
    found = heights_from_phases(phases, noise, PAIR, 1.5, (0.0, 0.5))
    assert np.abs(found.height_um - true).max() < 0.3
    assert found.ambiguous.mean() < 0.1


def test_the_ground_is_the_same_part_at_all_wavelengths() -> None:
    """Half of the object is ground; the rest has steps."""
    rng = np.random.default_rng(3)
    height = np.where(rng.random((60, 60)) < 0.5, 0.0, rng.choice([0.3, 0.7, 1.1], (60, 60)))
    numbers = wave_numbers(THREE, 1.5)[:, None, None]
    offsets = np.array([0.4, -2.9, 3.1])[:, None, None]
    noise = 0.03 * rng.standard_normal((3, 60, 60))
    found = common_phases(np.exp(1j * (numbers * height + offsets + noise)), np.ones((60, 60), bool))
    assert wrapped(found - offsets.ravel()) == pytest.approx(np.zeros(3), abs=0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"deviations": np.zeros((2, 3))}, "must be above 0"),
        ({"deviations": np.ones((2, 2))}, "must be equal"),
        ({"wavelengths_um": THREE}, "3 wavelengths first"),
        ({"index": 1.0}, "above 1"),
        ({"heights_um": (0.0, 1e5)}, "orders"),
        ({"wavelengths_um": (0.532, 0.532)}, "differ from each other"),
    ],
)
def test_wrong_input_is_named(change: dict, message: str) -> None:
    given = {
        "phases": np.zeros((2, 3)),
        "deviations": np.ones((2, 3)),
        "wavelengths_um": PAIR,
        "index": 1.5,
    } | change
    with pytest.raises(InputError, match=message):
        heights_from_phases(**given)
