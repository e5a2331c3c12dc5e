"""Spectra from bands against those of the whole."""

from __future__ import annotations

import math

import numpy as np
import pytest

from wavesim.evaluation.metrics import spectrum_support
from wavesim.fields.spectrum import BlockSpectrum


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
        whole = spectrum_support(field, pitch, limit).share_beyond
        assert blocks.share_beyond(limit) == pytest.approx(whole, rel=0.05)


def test_what_keeps_below_the_limit_does_not_leak_beyond() -> None:
    x = np.arange(2000) * 1.6e-3
    wave = np.exp(2j * np.pi * 140.3 * x)[None, :] * np.ones((600, 1))
    blocks = BlockSpectrum(1.6e-3)
    blocks.add(wave.astype(np.complex64))
    assert blocks.share_beyond(156.0) < 1e-6
    assert blocks.share_beyond(135.0) > 0.999


def test_darkness_has_no_spectrum() -> None:
    blocks = BlockSpectrum(1e-3)
    blocks.add(np.zeros((100, 90), np.complex64))
    assert math.isnan(blocks.share_beyond(10.0))
