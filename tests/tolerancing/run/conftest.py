"""Workers that are copies of a server, as those of a command are."""

from __future__ import annotations

import sys

import pytest

from lensdesign.common import processes


@pytest.fixture(scope="session")
def worker_server() -> None:
    """Start the server once; workers of other tests stay new processes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(processes, "_server_started", False)
        processes.start_ahead("tolerancing.run.forkserver_preload")


@pytest.fixture
def copied_workers(worker_server: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let runs of this process have copies of the server as workers: they import nothing again."""
    monkeypatch.setattr(processes, "_server_started", sys.platform == "linux")
