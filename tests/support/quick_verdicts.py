"""Reconstructions whose verdict is not what is tested: it is found sooner."""

from __future__ import annotations

from typing import Any, NoReturn

import pytest

from lensdesign.errors import TransferLensError
from wavesim.reconstruction import assessment
from wavesim.reconstruction.diagnostics.cause_trials import CauseTrials


def judge_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reconstructions of this process try no causes of a misfit, and no score test of the bench.

    Both have tests of their own.
    """
    monkeypatch.setattr(CauseTrials, "trials", lambda _: [])
    monkeypatch.setattr(assessment, "score_test", _impossible)


def _impossible(*_: Any, **__: Any) -> NoReturn:
    """Refuse a score test, as one does that rays or samples do not allow."""
    raise TransferLensError("not tested here")
