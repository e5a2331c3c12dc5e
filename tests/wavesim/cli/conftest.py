"""Frames of a small twin, and the command that reconstructs from them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from plain_searches import search_plainly
from programs import Command
from wavesim_command import frames_and_design, write_frames


@pytest.fixture
def whole_search() -> None:
    """Reconstructions improve the limit, edges and position of the first object."""


@pytest.fixture(autouse=True)
def first_objects(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other commands are tested with the solver's first object, which is found sooner."""
    if "whole_search" not in request.fixturenames:
        search_plainly(monkeypatch)


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
