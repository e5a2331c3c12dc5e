"""Frozen frames of perfect benches: the object that comes back, and the verdict.

The frames were made by `wavesim image` on a twin of 1/32 with the default settings: of a bright letter, of
the grey picture `camera` of scikit-image, and of a small F, which iterations alone put one sample too low. A
change of a value here says why in its commit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lensdesign import load_design
from wavesim import read_frames, reconstruct_frames

FOLDER = Path(__file__).parent / "golden" / "perfect_benches"

FIGURES = {
    "letter": {"object_correlation": 0.972, "psnr_db": 20.2, "ssim": 0.723},
    "camera": {"object_correlation": 0.975, "psnr_db": 24.3, "ssim": 0.761},
    "F": {"object_correlation": 0.998, "psnr_db": 37.5, "ssim": 0.983},
}
"""Correlation, PSNR and SSIM of the object. With the scale of an object that is bright everywhere, a quarter
of the samples of the grey picture would be clipped.
"""


@pytest.mark.filterwarnings("ignore:little diversity")
@pytest.mark.parametrize("name", FIGURES)
def test_a_perfect_bench_is_explained_and_its_object_found(name: str) -> None:
    folder, lens = FOLDER / name, load_design(FOLDER / "twin32.toml")
    frames = read_frames(sorted(folder.glob("frame_*.tif")), lens=lens)
    found = reconstruct_frames(lens, frames, kind="amplitude", patch_mm=0.05, truth=folder)
    assert found.verdict.explained
    assert found.truth["object_correlation"] == pytest.approx(FIGURES[name]["object_correlation"], abs=0.01)
    assert found.truth["psnr_db"] == pytest.approx(FIGURES[name]["psnr_db"], abs=0.5)
    assert found.truth["ssim"] == pytest.approx(FIGURES[name]["ssim"], abs=0.03)
    assert found.true is not None
    true = np.abs(found.true.values[found.inside])
    clipped = np.mean(found.transmission.values.real[found.inside] > 0.9999)
    assert clipped < np.mean(true > 0.95 * true.max()) + 0.05
    assert not found.scale_is_determined
    # The frames of `wavesim image` have the scale 1, and the brightest parts have this fraction of it.
    brightest = {"letter": 0.95, "camera": 0.87, "F": 1.0}[name]
    assert found.of_method["scale"] == pytest.approx(brightest, rel=0.06)
