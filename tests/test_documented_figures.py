"""Figures that a page states of the reconstruction of `make demo`, compared with those of the same frames.

The frames are frozen, so that a change of the reconstruction is told from one of the recording. The score
test of the bench, which takes most of a verdict, is not run here: `make demo` runs it. The tutorial's figures
are those that its commands print (tests/test_documented_commands.py).
"""

from __future__ import annotations

import lzma
import re
from pathlib import Path

import pytest
from places import GOLDEN, ROOT
from quick_verdicts import judge_quickly

from lensdesign import load_design
from wavesim import read_frames, reconstruct_frames

FIGURES = re.compile(r"correlation (0\.\d+), PSNR ([\d.]+) dB, SSIM (0\.\d+)")
RESIDUALS = re.compile(
    r"explained within the noise: residuals ([\d.]+) times the noise, ([\d.]+) times on pixels that were held"
)


def test_a_reconstruction_is_as_good_as_its_page_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, golden = (ROOT / "docs/measured.md").read_text(encoding="utf-8"), GOLDEN / "documented/demo"
    ((correlation, psnr_db, ssim),) = FIGURES.findall(text)
    ((over_noise, held_out),) = RESIDUALS.findall(text)
    for path in golden.glob("frame_*.tif.xz"):
        (tmp_path / path.stem).write_bytes(lzma.decompress(path.read_bytes()))
    lens = load_design(golden / "twin.toml")
    frames = read_frames(sorted(tmp_path.glob("frame_*.tif")), lens=lens)
    judge_quickly(monkeypatch)
    found = reconstruct_frames(lens, frames, kind="amplitude", patch_mm=0.19, truth=golden)
    assert found.truth["object_correlation"] == pytest.approx(float(correlation), abs=0.001)
    assert found.truth["psnr_db"] == pytest.approx(float(psnr_db), abs=0.1)
    assert found.truth["ssim"] == pytest.approx(float(ssim), abs=0.003)
    assert found.verdict.explained
    assert found.verdict.over_noise == pytest.approx(float(over_noise), abs=0.003)
    assert found.verdict.held_out_over_noise == pytest.approx(float(held_out), abs=0.003)
