"""The command draws no sheet that its study's yield does not survive, and says what it predicts."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from drawing_checks import assert_tidy
from places import GOLDEN
from typer.testing import CliRunner

from lensdesign.cli.commands import app
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from lensdesign.manufacture.drawing.assumed import load_tolerances
from lensdesign.manufacture.drawing.predicted_yield import drawing_with_yield, read_yield_predictor
from lensdesign.manufacture.drawing.sheets import DrawingOptions

LOOSE = """
[[tolerances]]
thickness_mm = 0.05
diameter_mm = 0.1
source = "agreed"

[tolerances.left]
centring_arcmin = 20.0

[tolerances.right]
centring_arcmin = 20.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("designer")
    for name in ("best.toml", "study_best.toml", "thin.toml", "study.toml"):
        shutil.copy(GOLDEN / "designer_b" / name, path / name)
    return path


def test_the_sheet_marks_its_values_and_states_its_yield(folder: Path) -> None:
    out, study = folder / "sheet.svg", folder / "as_drawn.toml"
    design = folder / "as_drawn_lens.toml"
    words = ["drawing", folder / "best.toml", "--tolerances", folder / "study_best.toml", "-o", out]
    words += ["--study-as-drawn", study, "--as-drawn", design, "--json"]
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["study_yield"] > 0.98
    assert found["study_yield"] - found["as_drawn_yield"] <= 0.02
    assert any(note.startswith("predicted yield with all tolerances") for note in found["notes"])
    text = out.read_text(encoding="utf-8")
    shown = f"predicted yield with all tolerances of this drawing {100.0 * found['as_drawn_yield']:.1f} %"
    assert shown in text
    assert "† derived from study_best.toml" in text
    assert "* general tolerances of ISO 10110-11" in text
    centring = re.findall(r">(4/ [^<]*)<", text)
    assert all("†" in words for words in centring)
    assert ">Ø 11 ±0.5*<" in text
    assert ">5.887 ±0.02<" in text  # the study's

    # The same number comes from the study that the sheet stands for.
    from tolerancing.prediction import predict_study
    from tolerancing.study.files import load_study

    loaded = load_study(study)
    assert predict_study(loaded.lens, loaded.study).yield_fraction == found["as_drawn_yield"]


def test_a_sheet_states_no_yield_that_leaves_a_limit_out(folder: Path) -> None:
    study = folder / "with_throughput.toml"
    text = (folder / "study_best.toml").read_text(encoding="utf-8")
    study.write_text(text + '\n[[merit]]\nkind = "throughput"\nat_least = 0.99\n', encoding="utf-8")
    out = folder / "partly.svg"
    words = ["drawing", folder / "best.toml", "--tolerances", study, "-o", out, "--json"]
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["study_yield"] is None
    assert found["as_drawn_yield"] is None
    sheet = out.read_text(encoding="utf-8")
    assert "throughput has no prediction" in sheet
    assert not re.search(r"yield[^<]*\d %", sheet)
    assert any("tolerancing run" in note for note in found["notes"])


def test_a_sheet_that_loses_yield_is_refused_and_nothing_is_written(folder: Path) -> None:
    sheet, out, lens = folder / "sheet.toml", folder / "loose.svg", folder / "loose.toml"
    sheet.write_text(LOOSE)
    words = ["drawing", folder / "best.toml", "--tolerances", folder / "study_best.toml"]
    words += ["--sheet", sheet, "-o", out, "--as-drawn", lens]
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert isinstance(done.exception, InputError)
    message = str(done.exception)
    assert re.match(
        r"the sheet allows more than study_best\.toml: it loses [\d.]+ percentage points", message
    )
    assert "centring of surface 1 (±20′): " in message
    assert "--accept-yield-loss" in message
    assert not out.exists()
    assert not lens.exists()
    done = CliRunner().invoke(app, [*(str(word) for word in words), "--accept-yield-loss"])
    assert done.exit_code == 0
    assert "accepted loss of yield" in done.stderr
    assert out.exists()


def test_scored_sheets_are_tidy(folder: Path) -> None:
    lens = load_design(folder / "best.toml")
    study = folder / "study_best.toml"
    done = drawing_with_yield(
        lens, DrawingOptions(), load_tolerances(study, lens), read_yield_predictor(study)
    )
    assert_tidy(done.drawing)
    assert done.predicted_yield is not None
    assert done.predicted_yield.is_trustworthy


def test_a_file_without_limits_is_drawn_unscored(folder: Path) -> None:
    text = (folder / "study_best.toml").read_text()
    (folder / "only.toml").write_text(text[: text.index("[[merit]]")])
    words = ["drawing", folder / "best.toml", "--tolerances", folder / "only.toml", "-o", folder / "o.svg"]
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0
    assert "the yield of the sheet is not predicted: " in done.stderr
    assert "has no [[merit]] tables" in done.stderr
    done = CliRunner().invoke(app, [*(str(w) for w in words), "--study-as-drawn", str(folder / "s.toml")])
    assert isinstance(done.exception, InputError)


def test_an_output_does_not_replace_an_input(folder: Path) -> None:
    words = ["drawing", "best.toml", "--tolerances", "study_best.toml", "-o", "x.svg"]
    words = [str(folder / word) if "." in word else word for word in words]
    done = CliRunner().invoke(app, [*words, "--study-as-drawn", str(folder / "study_best.toml")])
    assert isinstance(done.exception, InputError)
    assert "it is the study" in str(done.exception)
