"""Reconstructions whose verdict is not what is tested: it is found sooner."""

from __future__ import annotations

import pytest

from wavesim.reconstruction import assessment
from wavesim.reconstruction.diagnostics.cause_trials import CauseTrials


def judge_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reconstructions of this process try no causes of a misfit, and no score test of the bench.

    Both have tests of their own.
    """
    monkeypatch.setattr(CauseTrials, "trials", lambda _: [])
    monkeypatch.setattr(assessment, "_score_test", lambda *_: None)
