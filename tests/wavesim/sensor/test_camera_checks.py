"""Checks of the black level and of the largest count against the counts of frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies

from wavesim.sensor.camera_checks import clipping_counts, contradicts_black_level, dark_part
from wavesim.sensor.frames import Frame, FrameSettings

OFFSET = 64.0


def light(brightest: float, ground: float = 0.0) -> np.ndarray:
    """Electrons of a bright spot with fringes in the middle of a picture of 128 x 96 pixels."""
    y, x = np.indices((96, 128)) - np.array([48.0, 64.0])[:, None, None]
    radius = np.hypot(x, y)
    spot = np.exp(-((radius / 16.0) ** 2)) * (1.0 + 0.5 * np.cos(radius))
    return np.asarray(ground + brightest / spot.max() * spot)


def frame(
    electrons: np.ndarray,
    *,
    stated: float = OFFSET,
    bits: int = 12,
    gain: float = 2.5,
    read_noise: float = 2.0,
    clipped: int | None = None,
    multiple: int = 1,
    seed: int = 1,
    **more: Any,
) -> Frame:
    """Frame whose camera has the black level `OFFSET`, with the noise of its settings."""
    random = np.random.default_rng(seed)
    signal = random.poisson(electrons) + read_noise * random.standard_normal(electrons.shape)
    top = 2**bits // multiple - 1 if clipped is None else clipped
    counts = multiple * np.clip(np.rint(OFFSET / multiple + signal / gain), 0, top)
    own = FrameSettings(
        pixel_pitch_um=3.2,
        plane_distance_mm=1.0,
        wavelength_um=0.5,
        exposure=1.0,
        bits=bits,
        offset_counts=stated,
        gain_electrons_per_count=gain / multiple,
        read_noise_electrons=read_noise,
        **more,
    )
    return Frame(counts.astype(np.uint16), own)


def contradicts(one: Frame) -> bool:
    dark = dark_part(one)
    assert dark is not None
    return contradicts_black_level(one, dark)


@settings(max_examples=40)
@given(
    brightest=strategies.sampled_from([30.0, 1000.0, 9000.0]),
    ground=strategies.sampled_from([0.0, 0.5, 3.0, 40.0, 2000.0]),
    gain=strategies.sampled_from([0.2, 1.0, 2.5, 15.0]),
    read_noise=strategies.sampled_from([0.0, 1.5, 2.0, 6.0]),
    seed=strategies.integers(0, 999),
)
def test_a_right_black_level_is_never_contradicted(
    brightest: float, ground: float, gain: float, read_noise: float, seed: int
) -> None:
    """Whatever light falls everywhere: its noise tells it from a black level."""
    one = frame(light(brightest, ground), gain=gain, read_noise=read_noise, bits=16, seed=seed)
    assert not contradicts(one)


@pytest.mark.parametrize("gain", [0.5, 2.5])
@pytest.mark.parametrize("error", [-12.0, -4.0, 4.0, 16.0])
def test_a_wrong_black_level_is_found_and_measured(error: float, gain: float) -> None:
    one = frame(light(3000.0), stated=OFFSET + error * 2.5 / gain, gain=gain, bits=14)
    dark = dark_part(one)
    assert dark is not None
    assert contradicts_black_level(one, dark)
    assert dark.counts == pytest.approx(OFFSET, abs=0.3 * 2.5 / gain)


def test_hot_and_dead_pixels_do_not_move_the_level() -> None:
    one = frame(light(3000.0))
    counts = one.counts.copy()
    random = np.random.default_rng(3)
    counts.ravel()[random.choice(counts.size, 60, replace=False)] = 0
    counts.ravel()[random.choice(counts.size, 60, replace=False)] = 4000
    dark = dark_part(Frame(counts, one.settings))
    assert dark is not None
    assert dark.counts == pytest.approx(OFFSET, abs=0.5)


def test_noise_free_light_is_no_black_level() -> None:
    """Even light without noise, as simulations give it, with a stated read noise and without."""
    for read_noise in (0.0, 2.0):
        one = frame(np.full((64, 64), 500.0))
        even = Frame(
            np.full((64, 64), 264, np.uint16), one.settings.replaced(read_noise_electrons=read_noise)
        )
        assert not contradicts(even)


def test_a_frame_that_is_too_small_is_not_examined() -> None:
    one = frame(np.zeros((12, 20)))
    assert dark_part(one) is None


@pytest.mark.parametrize(("clipped", "multiple", "bits"), [(3000, 1, 12), (250, 1, 12), (4095, 16, 16)])
def test_a_camera_that_clips_early_is_found(clipped: int, multiple: int, bits: int) -> None:
    """Also 12 bits that are stored as multiples of 16."""
    brightest = 1.3 * 2.5 * (clipped - OFFSET / multiple)
    one = frame(light(brightest), clipped=clipped, multiple=multiple, bits=bits)
    assert clipping_counts(one) == multiple * clipped
    stated = Frame(one.counts, one.settings.replaced(saturation_counts=one.settings.top_counts))
    assert clipping_counts(stated) is None


@settings(max_examples=40)
@given(
    brightest=strategies.sampled_from([100.0, 3000.0, 9000.0, 30000.0]),
    flat=strategies.booleans(),
    gain=strategies.sampled_from([0.3, 2.5, 40.0]),
    seed=strategies.integers(0, 999),
)
def test_a_camera_that_does_not_clip_is_not_doubted(
    brightest: float, flat: bool, gain: float, seed: int
) -> None:
    """Nor one that clips at its largest count, and no even bright part."""
    electrons = np.minimum(light(2.0 * brightest), brightest) if flat else light(brightest)
    assert clipping_counts(frame(electrons, gain=gain, seed=seed, bits=14)) is None
    assert clipping_counts(frame(20.0 * electrons, gain=gain, seed=seed, bits=8)) is None


def test_even_frames_are_not_clipped() -> None:
    one = frame(np.zeros((64, 64)))
    assert clipping_counts(Frame(np.full((64, 64), 900, np.uint16), one.settings)) is None
