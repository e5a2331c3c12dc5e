"""Small siblings of `benchmarks.single_exposure_lenses`, on twins of its lenses."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import single_exposure_lenses as single
from lensdesign import load_design, scaled
from wavesim import image


@pytest.mark.filterwarnings("ignore:plane at")
def test_frames_of_the_benchmark_differ_from_those_of_the_package_by_their_noise() -> None:
    """Finer tiles and means over sub-pixels against the package's engine and pixels, on one bench."""
    case = single.LENSES["complex"]
    lens = scaled(load_design(single.DESIGNS / f"{case.design}.toml"), 0.25)
    true = single.dense_object(lens, case, 1)
    frame = single.recorded_frame(lens, true, {}, 1)
    pixels = frame.counts.shape[0]
    taken = image(
        lens,
        true,
        field_stop_mm=lens.object.field_diameter_mm,
        pixels=pixels,
        noise=False,
        bits=16,
        engine="eikonal",
        error=single.ENGINE_ERROR,
        **single.MOUNTING,
    ).frames[0]
    gain = frame.settings.gain_electrons_per_count
    electrons = (frame.counts - frame.settings.offset_counts) * gain
    model = taken.counts - taken.settings.offset_counts
    model = model * electrons.sum() / model.sum()
    deviation = np.sqrt(np.maximum(model, 0.0) + frame.settings.read_noise_electrons**2 + gain**2 / 12.0)
    bright = model > 20.0
    normalized = (electrons - model)[bright] / deviation[bright]
    assert bright.sum() > 1000
    assert np.sqrt(np.mean(normalized**2)) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("name", single.LENSES)
def test_objects_of_the_benchmark_are_dense_and_resolved(name: str) -> None:
    case = single.LENSES[name]
    lens = scaled(load_design(single.DESIGNS / f"{case.design}.toml"), 0.25)
    values = single.dense_object(lens, case, 2).values
    assert np.abs(values).max() <= 1.0 + 1e-12
    assert np.angle(values).std() == pytest.approx(case.phase_rms_rad, rel=0.05)
    assert (np.abs(values).std() > 0.15) == (case.amplitude_rms > 0.0)
