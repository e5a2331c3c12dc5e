"""Frames in broad light that a benchmark makes without the model of the reconstruction."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import broad_light
from benchmarks.broad_light import Case, broad_frames, imaged, spectrum
from lensdesign import load_design, scaled
from wavesim import image


@pytest.mark.parametrize("shape", ["rectangular", "gaussian"])
def test_spectra_have_the_variance_of_their_rectangle(shape: str) -> None:
    case = Case(64, 0.03, "star", "amplitude", shape, 20.0)
    weights, wavelengths_um = np.array(spectrum(shape, 20.0, 0.532)).T
    assert weights.sum() == pytest.approx(1.0)
    variance_nm2 = float(weights @ (1e3 * (wavelengths_um - 0.532)) ** 2)
    assert np.sqrt(12.0 * variance_nm2) == pytest.approx(case.rectangle_nm, rel=0.01)


def test_frames_agree_with_simulated_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of few wavelengths, with the noise of both."""
    monkeypatch.setattr(broad_light, "WAVELENGTHS", 5)
    monkeypatch.setattr(broad_light, "EXPOSURES", (1.0,))
    case = Case(64, 0.03, "star", "amplitude", "rectangular", 40.0)
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    own = broad_frames(lens, imaged(case, lens), spectrum("rectangular", 40.0, 0.532))
    planes = {"planes_mm": (0.03, 0.3), "patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    for frame, simulated in zip(
        own, image(lens, "star", bandwidth_nm=40.0, seed=1, **planes).frames, strict=True
    ):
        counts, others = (f.counts.astype(float) - 64.0 for f in (frame, simulated))
        assert np.linalg.norm(counts - others) < 0.05 * np.linalg.norm(others)
