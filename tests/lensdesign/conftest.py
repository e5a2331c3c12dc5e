"""The command `lensdesign`, run in this process."""

from __future__ import annotations

from functools import partial

import pytest
from programs import Command, run_program


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs `lensdesign`: exit status, standard output and standard error."""
    return partial(run_program, monkeypatch, capsys, "lensdesign")
