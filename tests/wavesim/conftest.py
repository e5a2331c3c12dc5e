"""The command `wavesim`, run in this process."""

from __future__ import annotations

from functools import partial

import pytest
from programs import Command
from wavesim_command import run_wavesim


@pytest.fixture
def wavesim(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs a command of `wavesim`: exit status, standard output and standard error."""
    return partial(run_wavesim, monkeypatch, capsys)
