"""A stranger's store: all of it can be read, and nothing of it is run."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path

import pytest
from tests_studies import DECENTER, DESIGN, HEAD, SPREAD
from typer.testing import CliRunner

from lensdesign import InputError
from tolerancing.cli.commands import app
from tolerancing.run.run import run_study
from tolerancing.study.files import load_study

MERIT = """
[[merit]]
kind = "python"
function = "mine.py:score"
at_least = 0.0
"""
TRACE = "TRANSFERLENS_TEST_TRACE"
SOURCE = f"""
import os, pathlib

with pathlib.Path(os.environ["{TRACE}"]).open("a") as file:
    file.write("run")
print("a merit may print")
os.system("echo anything it likes")


def score(trial):
    print("while it scores, too")
    return 1.0
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study with a merit in Python, and its store."""
    folder = tmp_path_factory.mktemp("stranger")
    (folder / "design.toml").write_text(DESIGN)
    (folder / "mine.py").write_text(SOURCE)
    (folder / "study.toml").write_text(HEAD + DECENTER + SPREAD + MERIT)
    os.environ[TRACE] = str(folder / "trace")
    run_study(load_study(folder / "study.toml", trust=True), folder / "a.db", workers=1, trials=30)
    assert (folder / "trace").exists()
    del os.environ[TRACE]
    return folder


@pytest.fixture
def store(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The store alone, and where a trace would be left if its Python were run."""
    monkeypatch.setenv(TRACE, str(tmp_path / "trace"))
    return Path(shutil.copy(made / "a.db", tmp_path))


def run_one(*words: object) -> tuple[int, str, str]:
    # What is imported once is kept by its text.
    from tolerancing.merits.python import function_of

    function_of.cache_clear()
    result = CliRunner().invoke(app, [str(word) for word in words])
    error = result.exception
    text = str(error) if isinstance(error, InputError) else ""
    if error is not None and not text:
        raise error
    return (2 if text else result.exit_code), result.stdout, text


@pytest.mark.parametrize(
    "words",
    [["show"], ["show", "--json"], ["sensitivity"]],
    ids=" ".join,
)
def test_reading_a_store_runs_nothing(store: Path, words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(store.parent)
    code, _, text = run_one(words[0], store, *words[1:])
    assert (code, text) == (0, "")
    assert not (store.parent / "trace").exists()


@pytest.mark.parametrize(
    "words", [["show", "--trial", "1"], ["budget", "--yield", "0.5", "-o", "b.toml"]], ids=" ".join
)
def test_what_scores_again_asks_for_trust(
    store: Path, made: Path, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(store.parent)
    code, _, text = run_one(words[0], store, *words[1:])
    assert code == 2
    assert text.startswith("mine.py: ")
    assert hashlib.sha256(SOURCE.encode()).hexdigest() in text
    assert "--trust" in text
    assert not (store.parent / "trace").exists()
    shutil.copy(made / "mine.py", store.parent)  # as when a stranger's archive is unpacked
    assert run_one(words[0], store, *words[1:])[0] == 2
    assert not (store.parent / "trace").exists()


def test_what_a_merit_prints_is_not_in_the_results(store: Path, capfd: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_one("show", store, "--trial", "2", "--trust", "--json")
    assert code == 0
    assert json.loads(out)["same_as_stored"] is True
    printed, captured = capfd.readouterr()
    assert "anything" not in printed
    assert "anything it likes" in captured
