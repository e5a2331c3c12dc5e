"""`wavesim reconstruct` replaces an engine whose own error is what the frames leave unexplained."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from wavesim_command import run_wavesim

from lensdesign import load_design, save_design, scaled

PATCH_MM = 0.045
BRIGHT = ("--exposures", "1,30,1000", "--full-well", 1e6, "--bits", 16, "--read-noise", 1, "--seed", 1)


def reconstructed(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *mounting: object,
    stated: tuple[object, ...] = (),
) -> tuple[object, str, dict[str, Any]]:
    """Status, output and figures of a reconstruction from bright frames, whose engine is accurate."""
    twin = folder / "twin.toml"
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 48), twin)
    patch = "--patch-mm", PATCH_MM
    accurate = "--engine", "eikonal", "--error", 0.002
    command = "image", twin, "--object", "usaf", *patch, *BRIGHT, *accurate, *mounting, "-o", folder / "seen"
    assert run_wavesim(monkeypatch, capsys, *command)[0] == 0
    frames = sorted((folder / "seen").glob("frame_*.tif"))
    command = "reconstruct", *frames, "--design", twin, *patch, "--kind", "amplitude"
    status, printed, _ = run_wavesim(monkeypatch, capsys, *command, *stated, "-o", folder / "found")
    return status, printed, json.loads((folder / "found" / "reconstruction.json").read_text())


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_engine_that_limits_the_misfit_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, printed, found = reconstructed(tmp_path, monkeypatch, capsys)
    assert status == 0
    replaced = found["engine_replaced"]
    before, after = replaced["before"]["predicted_error"], replaced["after"]["predicted_error"]
    assert after == found["engine"]["predicted_error"] < before / 1.3
    assert f"predicted error {before:.2g} (eikonal) before, {after:.2g} (eikonal) now" in printed
    # Without the other engine residuals are only explained by an allowance of half the predicted error.
    assert found["verdict"]["model_error"] == 0.005


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_wrong_bench_is_not_explained_by_another_engine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The decenter leaves less than the first engine's predicted error, and so the engine is replaced."""
    status, printed, found = reconstructed(tmp_path, monkeypatch, capsys, "--decenter-x-mm", 0.0002)
    assert "the engine was replaced" in printed
    assert found["verdict"]["model_error"] == 0.005
    assert found["verdict"]["over_noise"] > 1.3
    assert status == 1


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_stated_error_keeps_the_engine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    *_, found = reconstructed(tmp_path, monkeypatch, capsys, stated=("--error", 0.05, "--iterations", 20))
    assert "engine_replaced" not in found
    assert found["engine"]["predicted_error"] > 0.03
