"""`wavesim reconstruct` replaces an engine whose own error is what the frames leave unexplained."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from programs import Command

from lensdesign import load_design, save_design, scaled
from wavesim import image
from wavesim.reconstruction import assessment, object_search
from wavesim.reconstruction.diagnostics.cause_trials import CauseTrials
from wavesim.scene.engine import Engine
from wavesim.sensor.frames import write_frame

PATCH_MM = 0.045

Bench = Callable[..., Path]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Folders with bright frames of a chart through a small twin, made once for each mounting."""
    lens, made = scaled(load_design("designs/paper_singlet.toml"), 1 / 48), dict[float, Path]()

    def folder(decenter_x_mm: float = 0.0) -> Path:
        if decenter_x_mm not in made:
            made[decenter_x_mm] = tmp_path_factory.mktemp("bench")
            save_design(lens, made[decenter_x_mm] / "twin.toml")
            imaged = image(
                lens,
                "usaf",
                patch_mm=PATCH_MM,
                decenter_x_mm=decenter_x_mm,
                exposures=(1.0, 30.0, 1000.0),
                full_well_electrons=1e6,
                bits=16,
                read_noise_electrons=1.0,
                seed=1,
                engine="eikonal",
                error=0.002,
            )
            for number, frame in enumerate(imaged.frames, start=1):
                write_frame(frame, made[decenter_x_mm] / f"frame_{number}.tif")
        return made[decenter_x_mm]

    return folder


@pytest.fixture(autouse=True)
def no_other_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Local minima and causes of a misfit are not sought: that takes long, and has tests of its own."""
    monkeypatch.setattr(object_search, "may_be_stagnated", lambda *_: False)
    monkeypatch.setattr(CauseTrials, "trials", lambda _: [])


@pytest.fixture
def no_score_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """The score test, which runs only for an explained misfit, is left out."""
    monkeypatch.setattr(assessment, "_score_test", lambda *_: None)


def reconstructed(wavesim: Command, bench: Path, out: Path, *stated: object) -> tuple[object, str, Any]:
    """Status, output and figures of a reconstruction."""
    frames, design = sorted(bench.glob("frame_*.tif")), ("--design", bench / "twin.toml")
    patch = "--patch-mm", PATCH_MM
    status, printed, _ = wavesim(
        "reconstruct", *frames, *design, *patch, "--kind", "amplitude", *stated, "-o", out
    )
    return status, printed, json.loads((out / "reconstruction.json").read_text())


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_engine_that_limits_the_misfit_is_replaced(
    wavesim: Command, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tested: list[Engine] = []
    monkeypatch.setattr(assessment, "_score_test", lambda case, settings, engine, *_: tested.append(engine))
    status, printed, found = reconstructed(wavesim, bench(), tmp_path)
    assert status == 0
    replaced = found["engine_replaced"]
    before, after = replaced["before"]["predicted_error"], replaced["after"]["predicted_error"]
    assert after == found["engine"]["predicted_error"] < before / 1.3
    assert f"predicted error {before:.2g} (eikonal) before, {after:.2g} (eikonal) now" in printed
    # Without the other engine residuals are only explained by an allowance of half the predicted error.
    assert found["verdict"]["model_error"] == 0.005
    # The score test runs once, with the engine that replaced the first one.
    assert [one.settings() for one in tested] == [found["engine"]["settings"]]


@pytest.mark.usefixtures("no_score_test")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_wrong_bench_is_not_explained_by_another_engine(
    wavesim: Command, bench: Bench, tmp_path: Path
) -> None:
    """The decenter leaves less than the first engine's predicted error, and so the engine is replaced."""
    status, printed, found = reconstructed(wavesim, bench(0.0002), tmp_path)
    assert "the engine was replaced" in printed
    assert found["verdict"]["model_error"] == 0.005
    assert found["verdict"]["over_noise"] > 1.3
    assert status == 1


@pytest.mark.usefixtures("no_score_test")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_stated_error_keeps_the_engine(wavesim: Command, bench: Bench, tmp_path: Path) -> None:
    *_, found = reconstructed(wavesim, bench(), tmp_path, "--error", 0.05, "--iterations", 20)
    assert "engine_replaced" not in found
    assert found["engine"]["predicted_error"] > 0.03
