"""`lensdesign studio` without what it needs: one message, exit 2."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import socket
from pathlib import Path

import pytest

from lensdesign.cli.workbench import studio
from lensdesign.errors import InputError


def test_without_the_extra_one_message_says_what_to_install(
    paper_design: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"transferlens\[studio\]"):
        studio(paper_design, 0, "precision", False)


def test_without_the_package_above_too(paper_design: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: ())
    with pytest.raises(InputError, match="needs an extra"):
        studio(paper_design, 0, "precision", False)


def test_a_port_that_is_taken_is_refused(
    paper_design: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match="taken by another program"):
            studio(paper_design, taken.getsockname()[1], "", False)
