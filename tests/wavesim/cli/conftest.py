"""Frames of a small twin, and the command that reconstructs from them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from wavesim_command import frames_and_design, run_wavesim, write_frames

Run = Callable[..., tuple[object, str, str]]


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small twin, two frames of a chart through it, and the chart."""
    folder = tmp_path_factory.mktemp("data")
    write_frames(folder)
    return folder


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], data: Path) -> Run:
    """`wavesim reconstruct` on the twin's frames."""

    def command(*arguments: object) -> tuple[object, str, str]:
        return run_wavesim(monkeypatch, capsys, "reconstruct", *frames_and_design(data), *arguments)

    return command
