"""Spectra of known waves, and from bands against those of the whole."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.fields.spectrum import BlockSpectrum, spectrum_support


@pytest.mark.parametrize("rows", [256, 700, 5000])
def test_share_beyond_is_that_of_the_whole(rows: int) -> None:
    rng = np.random.default_rng(3)
    count, pitch = 1500, 1.6e-3
    y = (np.arange(count) - 0.5 * count)[:, None] / count
    x = (np.arange(count) - 0.5 * count) / count
    # Light whose spectrum falls off slowly, within a soft footprint.
    spectrum = rng.normal(size=(count, count)) + 1j * rng.normal(size=(count, count))
    spectrum *= np.exp(-np.hypot(np.fft.fftfreq(count)[:, None], np.fft.fftfreq(count)) / 0.08)
    field = np.fft.ifft2(spectrum) * np.exp(-((np.hypot(y, x) / 0.3) ** 4))
    blocks = BlockSpectrum(pitch)
    for start in range(0, count, rows):
        blocks.add(field[start : start + rows].astype(np.complex64))
    for limit in (50.0, 100.0, 156.0):
        whole = spectrum_support(field, pitch, limit).fraction_beyond
        assert blocks.fraction_beyond(limit) == pytest.approx(whole, rel=0.05)


def test_what_keeps_below_the_limit_does_not_leak_beyond() -> None:
    x = np.arange(2000) * 1.6e-3
    wave = np.exp(2j * np.pi * 140.3 * x)[None, :] * np.ones((600, 1))
    blocks = BlockSpectrum(1.6e-3)
    blocks.add(wave.astype(np.complex64))
    assert blocks.fraction_beyond(156.0) < 1e-6
    assert blocks.fraction_beyond(135.0) > 0.999


def test_darkness_has_no_spectrum() -> None:
    blocks = BlockSpectrum(1e-3)
    blocks.add(np.zeros((100, 90), np.complex64))
    assert math.isnan(blocks.fraction_beyond(10.0))


def test_spectrum_of_known_waves() -> None:
    """Two cosines of 40 and 170 cycles per mm with energies 9 and 1."""
    count, pitch = 500, 2e-3
    x = pitch * np.arange(count)
    values = 7.0 + 3.0 * np.cos(2 * np.pi * 40.0 * x) + np.cos(2 * np.pi * 170.0 * x)
    found = spectrum_support(np.tile(values, (300, 1)), pitch, 156.25)
    assert found.fraction_beyond == pytest.approx(0.1)
    assert found.frequency_within_per_mm == pytest.approx(170.0)
    assert spectrum_support(values, pitch, 156.25, fraction=0.89).frequency_within_per_mm == pytest.approx(
        40.0
    )
    assert spectrum_support(values, pitch, 171.0).fraction_beyond == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: spectrum_support(np.ones((9, 9)), 1e-3, 100.0), "mean"),
        (lambda: spectrum_support(np.ones((9, 9)), 0.0, 100.0), "pitch_mm"),
        (lambda: spectrum_support(np.eye(9), 1e-3, 100.0, fraction=1.0), "fraction"),
    ],
)
def test_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()
