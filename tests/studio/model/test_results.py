"""Folders of results: what they say, and refusals of what is none."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lensdesign import InputError
from studio.model.results import dark_picture, read_folder


def test_a_folder_says_what_it_holds(tmp_path: Path) -> None:
    summary = {"kind": "amplitude", "misfit": 0.123456789, "verdict": {"explained": False, "words": "no <b>"}}
    (tmp_path / "reconstruction.json").write_text(json.dumps(summary | {"bench": {"tilt_x_deg": 0.1}}))
    (tmp_path / "residuals.png").write_bytes(b"png")
    seen = read_folder(tmp_path, lambda _: None)
    assert (seen.verdict, seen.explained) == ("no <b>", False)
    assert dict(seen.facts) == {"kind": "amplitude", "misfit": "0.123457", "bench, tilt x (°)": "0.1"}
    assert seen.pictures == (("residuals.png", b"png", b"png"),)
    assert seen.page == ""  # nothing to zoom into


def test_pictures_with_too_many_pixels_are_not_decoded(tmp_path: Path) -> None:
    (tmp_path / "image.json").write_text("{}")
    Image.new("1", (8192, 4097)).save(tmp_path / "frames.png")
    Image.new("1", (16, 16)).save(tmp_path / "object.png")
    assert [name for name, *_ in read_folder(tmp_path, lambda _: None).pictures] == ["object.png"]


@pytest.mark.parametrize("is_chart", [False, True])
def test_pictures_for_dark_pages_keep_their_images(is_chart: bool) -> None:
    values = np.full((200, 200, 3), 255, np.uint8)
    values[20:24, 20:24] = 0  # text
    values[60:160, 60:160] = np.linspace(0, 240, 100).astype(np.uint8)[None, :, None]
    stream = BytesIO()
    Image.fromarray(values).save(stream, "png")
    with Image.open(BytesIO(dark_picture(stream.getvalue(), is_chart))) as picture:
        dark = np.asarray(picture)
    assert dark[5, 5].max() < 40
    assert dark[22, 22].min() > 200
    assert np.array_equal(dark[60:160, 60:160], values[60:160, 60:160]) is not is_chart


@pytest.mark.parametrize("text", ["{", "[]"])
def test_what_is_none_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="holds none of"):
        read_folder(tmp_path, lambda _: None)
    (tmp_path / "image.json").write_text(text)
    with pytest.raises(InputError, match="cannot read"):
        read_folder(tmp_path, lambda _: None)
