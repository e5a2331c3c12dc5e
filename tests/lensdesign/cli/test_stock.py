"""The command that finds stock lenses: files, exit status, and what it refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from places import DESIGNS
from programs import Command, run_program
from vendor_folder import write_vendors

SPEC = DESIGNS / "stock_pair_spec.toml"


@pytest.fixture(scope="module")
def vendors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stock") / "vendors"
    write_vendors(folder)
    return folder


def test_every_design_that_is_written_passes_the_check(
    vendors: Path, tmp_path: Path, command: Command
) -> None:
    out = tmp_path / "found"
    status, printed, _ = command(
        "stock", vendors, "--spec", SPEC, "-o", out, "--keep", 2, "--workers", 1, "--json"
    )
    assert status == 0
    values = json.loads(printed)
    assert (values["files"], len(values["refused"]), len(values["matches"])) == (9, 5, 2)
    rows = list(csv.DictReader((out / "stock.csv").open()))
    for row in rows:
        assert command("check", out / row["design"], "--against", SPEC)[0] == 0
    status, printed, _ = command("stock", vendors, "--spec", SPEC, "-o", out, "--keep", 2, "--workers", 1)
    assert status == 0
    assert "0 of them read now" in printed
    assert rows[0]["lenses"].split(" + ")[0].split()[0] in printed


def test_the_yield_of_a_stock_lens_is_that_of_a_study_of_its_design(
    vendors: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, study = tmp_path / "found", tmp_path / "study.toml"

    def run(name: str, *arguments: object) -> str:
        ended = run_program(monkeypatch, capsys, name, *arguments)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    options = ("--keep", 1, "--workers", 1, "--tolerances", "commercial", "--json")
    (match,) = json.loads(run("lensdesign", "stock", vendors, "--spec", SPEC, "-o", out, *options))["matches"]
    run("tolerancing", "start", match["design"], "--grade", "commercial", "-o", study)
    predicted = json.loads(run("tolerancing", "predict", study, "--json"))["yield"]
    assert 0.05 < predicted < 0.95
    assert match["predicted_yield"] == pytest.approx(predicted, abs=1e-3)
    assert match["yield"] is None  # no trials were asked for


def test_an_unmet_specification_writes_the_nearest_lens(
    vendors: Path, tmp_path: Path, command: Command
) -> None:
    spec = tmp_path / "spec.toml"
    text = SPEC.read_text().replace("[optimize]", "[constraints]\nmax_spread_deg = 4.0\n\n[optimize]")
    spec.write_text(text)
    out = tmp_path / "found"
    status, printed, _ = command("stock", vendors, "--spec", spec, "-o", out, "--workers", 1)
    assert status == 1
    assert "not met" in printed
    assert sorted(path.name for path in out.glob("*.toml")) == ["nearest.toml", "settings.toml"]
    assert command("check", out / "nearest.toml", "--against", spec)[0] == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["missing", "--spec", SPEC], "missing"),
        ([".", "--spec", SPEC], "no .zmx"),
        (["vendors", "--spec", "none.toml"], "none.toml"),
        (["vendors", "--spec", DESIGNS / "paper_singlet.toml"], "specification"),
        (["vendors", "--spec", DESIGNS / "as_built_spec.toml", "--yield-trials", 5], "tolerances"),
        (["vendors", "--spec", SPEC, "--clear-fraction", 0], "clear_fraction"),
    ],
)
def test_bad_input_is_one_message(
    tmp_path: Path,
    vendors: Path,
    command: Command,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[object],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [vendors if one == "vendors" else one for one in arguments]
    status, _, err = command("stock", *given, "-o", tmp_path / "found")
    assert status == 2
    assert said in " ".join(err.split())
    assert not (tmp_path / "found").exists()
