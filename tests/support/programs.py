"""Console scripts that run in this process."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import NamedTuple

import pytest


class Ended(NamedTuple):
    """How a command ended, in the words of `subprocess.CompletedProcess`."""

    returncode: int
    stdout: str
    stderr: str


Command = Callable[..., Ended]


def run_program(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, *arguments: object
) -> Ended:
    """Run `lensdesign`, `wavesim` or `tolerancing` with these arguments."""
    monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        import_module(f"{name}.cli.commands").main()
    return Ended(int(ended.value.code or 0), *capsys.readouterr())
