"""Frames of a small twin, and the command that reconstructs from them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from programs import Command
from wavesim_command import frames_and_design, write_frames


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small twin, two frames of a chart through it, and the chart."""
    folder = tmp_path_factory.mktemp("data")
    write_frames(folder)
    return folder


@pytest.fixture
def run(wavesim: Command, data: Path) -> Command:
    """`wavesim reconstruct` on the twin's frames."""
    return partial(wavesim, "reconstruct", *frames_and_design(data))
