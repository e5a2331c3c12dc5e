"""The command `wavesim`, run in this process."""

from __future__ import annotations

from functools import partial

import pytest
from plain_searches import search_plainly
from programs import Command
from quick_verdicts import judge_quickly
from wavesim_command import run_wavesim


@pytest.fixture
def wavesim(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs a command of `wavesim`: exit status, standard output and standard error."""
    return partial(run_wavesim, monkeypatch, capsys)


@pytest.fixture
def quick_verdicts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reconstructions try no causes of a misfit, and no score test of the bench."""
    judge_quickly(monkeypatch)


@pytest.fixture
def plain_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reconstructions keep the solver's first object."""
    search_plainly(monkeypatch)
