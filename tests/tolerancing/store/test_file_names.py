"""Names of a store's files: whoever made it could have written anything, so that each is checked first."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests_studies import DESIGN, RAY_STUDY

from lensdesign import InputError
from tolerancing.cli.commands import main
from tolerancing.run.run import run_study
from tolerancing.store.store import open_store
from tolerancing.study.files import load_study


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    (folder / "design.toml").write_text(DESIGN)
    (folder / "study.toml").write_text(RAY_STUDY)
    run_study(load_study(folder / "study.toml"), folder / "store.db", workers=1, trials=8)
    return folder / "store.db"


NAMES: dict[str, Any] = {
    "empty": "",
    "dot": ".",
    "slash": "/",
    "absolute": "/etc/hostname",
    "dots": "..",
    "step back": "a/../design.toml",
    "out": "../design.toml",
    "long": "x" * 300,
    "long and deep": "/".join(["y" * 200] * 40),
    "NUL": "design\0.toml",
    "line": "design\n.toml",
    "escape": "\x1b[2Jdesign.toml",
    "inner dot": "./design.toml",
    "double": "a//design.toml",
    "folder": "parts/",
    "of a file": "study.toml/design.toml",
    "backslash NUL": "a\\b\0",
}
CHANGES: dict[str, tuple[str, tuple[Any, ...]]] = {
    **{
        f"design named {name}": ("UPDATE file SET name = ? WHERE name = 'design.toml'", (value,))
        for name, value in NAMES.items()
    },
    **{f"study named {name}": ("UPDATE study SET name = ?", (value,)) for name, value in NAMES.items()},
    **{f"another {name}": ("INSERT INTO file VALUES (?, x'00')", (value,)) for name, value in NAMES.items()},
    "name of bytes": ("UPDATE file SET name = ? WHERE name = 'design.toml'", (b"design.toml",)),
    "no name": ("INSERT INTO file VALUES (?, x'00')", (None,)),
    "content of text": ("UPDATE file SET content = ?", ("text",)),
    "content of a number": ("UPDATE file SET content = ?", (7,)),
    "no files": ("DELETE FROM file", ()),
    "lone surrogate": ("UPDATE file SET name = CAST(x'eda080' AS TEXT) WHERE name = 'design.toml'", ()),
}


def changed(whole: Path, folder: Path, change: tuple[str, tuple[Any, ...]]) -> Path:
    store = folder / "store.db"
    shutil.copy(whole, store)
    connection = sqlite3.connect(store)
    connection.execute(*change)
    connection.commit()
    connection.close()
    return store


@pytest.mark.parametrize("name", CHANGES)
def test_a_store_with_such_a_file_is_refused_in_a_sentence(whole: Path, tmp_path: Path, name: str) -> None:
    store = changed(whole, tmp_path, CHANGES[name])
    with pytest.raises(InputError, match=r"store\.db") as refused, open_store(store) as opened:
        assert opened.study
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 600
    assert sorted(path.name for path in tmp_path.iterdir()) == ["store.db"]


COMMANDS: dict[str, Callable[[str], list[str]]] = {
    "show": lambda store: ["show", store],
    "show --trial": lambda store: ["show", store, "--trial", "1"],
    "report": lambda store: ["report", store, "-o", f"{store}.report"],
    "sensitivity": lambda store: ["sensitivity", store],
    "export": lambda store: ["export", store, f"{store}.csv"],
    "rare": lambda store: ["rare", store],
    "budget": lambda store: ["budget", store, "--yield", "0.5", "-o", f"{store}.toml"],
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", ["", ".", "x" * 300])
def test_commands_end_with_one_sentence(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    command: str, name: str,
) -> None:  # fmt: skip
    store = changed(whole, tmp_path, ("UPDATE file SET name = ? WHERE name = 'design.toml'", (name,)))
    monkeypatch.setattr("sys.argv", ["tolerancing", *COMMANDS[command](str(store))])
    with pytest.raises(SystemExit) as ended:
        main()
    captured = capsys.readouterr()
    assert ended.value.code == 2
    assert captured.err.startswith("error: the store ")
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""


def test_files_larger_than_any_that_is_read_are_refused_unread(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tolerancing.store.checks.TABLE_BYTES", 1000)
    store = changed(whole, tmp_path, ("INSERT INTO file VALUES ('large.csv', zeroblob(1001))", ()))
    with pytest.raises(InputError, match=r"large\.csv.*1001 bytes.*1000"), open_store(store) as held:
        assert held.study
