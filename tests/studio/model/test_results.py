"""Folders of results: what they say, and refusals of what is none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lensdesign import InputError
from studio.model.results import read_folder


def test_a_folder_says_what_it_holds(tmp_path: Path) -> None:
    summary = {"kind": "amplitude", "misfit": 0.123456789, "verdict": {"explained": False, "words": "no <b>"}}
    (tmp_path / "reconstruction.json").write_text(json.dumps(summary | {"bench": {"tilt_x_deg": 0.1}}))
    (tmp_path / "residuals.png").write_bytes(b"png")
    seen = read_folder(tmp_path, lambda _: None)
    assert (seen.verdict, seen.explained) == ("no <b>", False)
    assert dict(seen.facts) == {"kind": "amplitude", "misfit": "0.123457", "bench, tilt x deg": "0.1"}
    assert seen.pictures == (("residuals.png", b"png"),)
    assert seen.page == ""  # nothing to zoom into


@pytest.mark.parametrize("text", ["{", "[]"])
def test_what_is_none_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="holds none of"):
        read_folder(tmp_path, lambda _: None)
    (tmp_path / "image.json").write_text(text)
    with pytest.raises(InputError, match="cannot read"):
        read_folder(tmp_path, lambda _: None)
