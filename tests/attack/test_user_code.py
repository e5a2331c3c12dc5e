"""A stranger's study names Python code: no command of any program executes it without --trust."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import typer
from PIL import Image
from places import DESIGNS
from tests_studies import DECENTER, DESIGN, HEAD, RADIUS, SPREAD, STREHL
from typer.testing import CliRunner

from lensdesign import InputError, load_design, load_specification, trust_user_code, write_zmx
from lensdesign.cli.commands import app as lensdesign_app
from lensdesign.optimization import check_against
from tolerancing import load_study, run_study
from tolerancing.cli.commands import app as tolerancing_app
from wavesim.cli.commands import app as wavesim_app

APPS = {"lensdesign": lensdesign_app, "tolerancing": tolerancing_app, "wavesim": wavesim_app}
SOURCE = """
import pathlib

with pathlib.Path("TRACE").open("a") as file:
    file.write("executed")


def score(trial):
    return 1.0
"""
MERIT = """
[[merit]]
kind = "python"
function = "mine.py:score"
at_least = 0.0
"""
SPECIFICATION = """
[tolerances]
study = "study.toml"
trials = 100

[constraints]
min_yield = 0.1
min_edge_thickness_mm = 0.5

[optimize]
goal = "thinnest lens"
starts = 1
max_evaluations = 10

[[variable]]
surface = 1
parameter = "radius_mm"
smallest_radius_mm = 20.0
"""
COMMANDS: dict[str, list[str]] = {
    "lensdesign check": ["design.toml", "--against", "asked.toml"],
    "lensdesign compare": [
        "design.toml",
        "design.toml",
        "--against",
        "asked.toml",
        "--tolerances",
        "study.toml",
    ],
    "lensdesign drawing": ["design.toml", "-o", "sheet.svg", "--tolerances", "study.toml"],
    "lensdesign explore": ["asked.toml", "--over", "thickness,yield", "-o", "front"],
    "lensdesign limits": ["asked.toml"],
    "lensdesign optimize": ["asked.toml", "-o", "best.toml"],
    "lensdesign scale": ["design.toml", "0.5", "-o", "twin.toml", "--study", "study.toml"],
    "lensdesign stock": [
        *["vendors", "--spec", "stock.toml", "-o", "found", "--workers", "1"],
        *["--tolerances", "study.toml", "--yield-trials", "4"],
    ],
    "lensdesign testplates": ["asked.toml", "--plates", "plates.csv", "-o", "best.toml"],
    "tolerancing budget": ["study.db", "--yield", "0.5", "-o", "budget.toml", "--verify", "20"],
    "tolerancing cost": ["study.toml"],
    "tolerancing export": ["study.db", "trials.csv"],
    "tolerancing inverse": ["study.toml"],
    "tolerancing predict": ["study.toml"],
    "tolerancing rare-failures": ["study.db", "--trials", "50"],
    "tolerancing report": ["study.db", "-o", "report"],
    "tolerancing run": ["study.toml", "--store", "new.db", "--trials", "4", "--workers", "1"],
    "tolerancing sensitivity": ["study.db"],
    "tolerancing show": ["study.db", "--trial", "1"],
    "tolerancing variance": ["study.toml", "--base", "16"],
    "wavesim calibrate": ["frame.png", "--design", "design.toml", "--priors", "study.toml", "-o", "bench"],
    "wavesim reconstruct": [
        *["frame.png", "--design", "design.toml", "--calibrate", "--priors", "study.toml", "-o", "object"]
    ],
}
NOT_HERE = {
    "lensdesign studio": "a server; it loads studies with `study_by_name`, as `lensdesign compare` does",
}
SCORES_NOTHING = {
    "lensdesign drawing",
    "lensdesign scale",
    "tolerancing cost",
    "tolerancing export",
    "tolerancing predict",
    "tolerancing report",
    "tolerancing sensitivity",
    "wavesim calibrate",
    "wavesim reconstruct",
}
"""Commands that read a study or store, but execute no merit."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a study whose merit is Python code, and with everything that may name the study."""
    folder = tmp_path_factory.mktemp("stranger")
    (folder / "design.toml").write_text(DESIGN)
    (folder / "mine.py").write_text(SOURCE.replace("TRACE", str(folder / "trace")))
    (folder / "study.toml").write_text(HEAD + DECENTER + RADIUS + SPREAD + STREHL + MERIT)
    (folder / "asked.toml").write_text(DESIGN + SPECIFICATION)
    (folder / "plates.csv").write_text("radius_mm\n42.0\n12.0\n")
    shutil.copy(DESIGNS / "feasible_singlet_spec.toml", folder / "stock.toml")
    write_zmx(load_design(DESIGNS / "feasible_singlet.toml"), folder / "vendors" / "a.zmx")
    Image.new("L", (64, 64), 20).save(folder / "frame.png")
    run_study(load_study(folder / "study.toml", trust=True), folder / "study.db", workers=1, trials=30)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the folder, which is the working folder."""
    from tolerancing.merits.python import function_of

    shutil.copytree(made, tmp_path / "own")
    monkeypatch.chdir(tmp_path / "own")
    function_of.cache_clear()  # the code of a file is executed once in a process
    return tmp_path / "own"


@pytest.fixture
def trace(made: Path) -> Path:
    """The file that the code writes when it is executed; it does not exist yet."""
    (made / "trace").unlink(missing_ok=True)
    return made / "trace"


def run(command: str, words: list[str]) -> tuple[int, str]:
    program, name = command.split()
    result = CliRunner().invoke(APPS[program], [name, *words])
    if result.exception is not None and not isinstance(result.exception, SystemExit | InputError):
        raise result.exception
    is_bad = isinstance(result.exception, InputError)
    return (2 if is_bad else result.exit_code), str(result.exception) if is_bad else result.output


def reads_studies(parameter: Any) -> bool:
    words = str(parameter.metavar).split("|")[-1]
    return any(word in words for word in ("STUDY", "SPEC", "STORE"))


def test_every_command_that_reads_a_study_is_tried() -> None:
    found = {
        f"{program} {name}"
        for program, app in APPS.items()
        for name, command in typer.main.get_command(app).commands.items()  # type: ignore[attr-defined]
        if any(reads_studies(parameter) for parameter in command.params)
    }
    assert found == {*COMMANDS, *NOT_HERE}


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_executes_code_without_consent(folder: Path, trace: Path, command: str) -> None:
    code, text = run(command, COMMANDS[command])
    assert not trace.exists()
    if command not in SCORES_NOTHING:
        assert (code, "mine.py" in text, "--trust" in text) == (2, True, True), text


def test_settings_files_cannot_consent(folder: Path, trace: Path) -> None:
    """Neither do they lead to a study of their own without consent."""
    hidden = folder / "settings.toml"
    hidden.write_text('spec = "stock.toml"\ntolerances = "study.toml"\nyield-trials = 4\n')
    words = ["vendors", "-o", "found", "--workers", "1", "--settings", "settings.toml"]
    code, text = run("lensdesign stock", words)
    assert (code, "--trust" in text) == (2, True), text
    hidden.write_text('against = "asked.toml"\n')
    assert run("lensdesign check", ["design.toml", "--settings", "settings.toml"])[0] == 2
    hidden.write_text('against = "asked.toml"\ntrust = true\n')
    assert run("lensdesign check", ["design.toml", "--settings", "settings.toml"])[0] == 2
    assert not trace.exists()


@pytest.mark.parametrize("command", ["lensdesign check", "tolerancing run", "tolerancing show"])
def test_with_consent_it_is_executed(folder: Path, trace: Path, command: str) -> None:
    code, text = run(command, [*COMMANDS[command], "--trust"])
    assert code in (0, 1), text
    assert trace.exists()


def test_consent_in_python_ends_with_its_context(folder: Path, trace: Path) -> None:
    lens = load_design("design.toml")
    with pytest.raises(InputError, match="trust_user_code"):
        load_specification("asked.toml")
    with trust_user_code():
        specification = load_specification("asked.toml")
        assert check_against(lens, specification).constraints[-1].name == "yield"
    assert trace.exists()
    with pytest.raises(InputError, match="trust_user_code"):
        check_against(lens, specification)
