"""The command that makes a page of a result: what it shows of what, and what it refuses."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from programs import Command

from wavesim import Field, Frame, FrameSettings, Grid, write_frame
from wavesim.fields.files import write_field
from wavesim.plots import page as zoom_page
from wavesim.plots.pyramid import write_pyramid

PITCH_UM, SIDE = 0.4, 300


@pytest.fixture
def command(wavesim: Command) -> Command:
    """The command `wavesim view`."""
    return partial(wavesim, "view")


def put_field(path: Path, phase: float = 0.0, side: int = SIDE) -> None:
    rng = np.random.default_rng(side)
    values = rng.uniform(0.5, 1.0, (side, side)) * np.exp(1j * phase * rng.standard_normal((side, side)))
    path.parent.mkdir(exist_ok=True)
    write_field(Field(Grid((side, side), 1e-3 * PITCH_UM, 0.0), values, 0.532), path)


def put_frame(path: Path, plane_mm: float = 2.0) -> None:
    counts = np.random.default_rng(0).integers(64, 4000, (200, 250)).astype(np.uint16)
    settings: dict[str, Any] = {"pixel_pitch_um": 3.2, "plane_distance_mm": plane_mm, "wavelength_um": 0.532}
    settings |= {"exposure": 1e4, "bits": 12, "offset_counts": 64.0, "gain_electrons_per_count": 2.0}
    write_frame(Frame(counts, FrameSettings(**settings)), path)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """What `wavesim image` leaves behind."""
    folder = tmp_path / "frames"
    put_field(folder / "object.npz")
    for number in (1, 2, 10):
        put_frame(folder / f"frame_{number}.tif", number)
    (folder / "image.json").write_text(json.dumps({"design": "A <b>lens</b>"}))
    return folder


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """What `wavesim reconstruct` leaves behind."""
    folder = tmp_path / "result"
    put_field(folder / "reconstruction.npz", phase=0.5)
    summary = {"design": "A lens", "method": "object", "kind": "complex", "iterations": 12}
    (folder / "reconstruction.json").write_text(json.dumps(summary))
    return folder


def layers_of(path: Path) -> list[dict[str, Any]]:
    (embedded,) = re.findall(r'id="page">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)
    return list(json.loads(embedded)["layers"])


def test_a_reconstruction(command: Command, result: Path) -> None:
    code, out, err = command(result)
    assert (code, err) == (0, "")
    page = result / "view.html"
    assert re.fullmatch(rf"wrote {re.escape(str(page))}: amplitude, phase, 2 tiles, 0\.\d+ MB\n", out)
    text = page.read_text(encoding="utf-8")
    for said in ("<title>result: A lens</title>", "<dd>object</dd>", "<dd>complex</dd>", "<dd>12</dd>"):
        assert said in text
    amplitude, phase = layers_of(page)
    assert (amplitude["size"], amplitude["pitch"]) == ([SIDE, SIDE], pytest.approx(PITCH_UM))
    assert (phase["unit"], phase["plane"]) == ("rad", "object")


def test_a_reconstruction_beside_the_truth(command: Command, result: Path, frames: Path) -> None:
    page = result.parent / "new" / "page.html"
    for truth in (frames, frames / "object.npz"):
        code, out, err = command(result, "--truth", truth, "-o", page, "--json")
        assert (code, err) == (0, "")
        made = json.loads(out)
        assert made["file"] == str(page)
        assert made["bytes"] == page.stat().st_size
        assert made["layers"] == ["amplitude", "phase", "true amplitude"]
    put_field(result / "object.npz")
    for more in ((), ("--truth", result)):
        made = json.loads(command(result, "--json", *more)[1])
        assert made["layers"] == ["amplitude", "phase", "true amplitude"]


def test_frames_and_their_object(command: Command, frames: Path) -> None:
    made = json.loads(command(frames, "--json")[1])
    assert made["layers"] == ["amplitude", *(f"frame_{n}.tif, {n} mm" for n in (1, 2, 10))]
    layers = layers_of(frames / "view.html")
    assert [layer["plane"] for layer in layers] == ["object", "sensor", "sensor", "sensor"]
    assert "A &lt;b&gt;lens&lt;/b&gt;" in (frames / "view.html").read_text(encoding="utf-8")
    (frames / "object.npz").unlink()
    made = json.loads(command(frames, "--json", "--region-mm", "0.1,-0.1,0.2,0.1")[1])
    assert made["layers"] == [f"frame_{n}.tif, {n} mm" for n in (1, 2, 10)]


def test_single_files(command: Command, frames: Path) -> None:
    assert json.loads(command(frames / "object.npz", "--json")[1])["file"] == str(frames / "object.html")
    made = json.loads(command(frames / "frame_2.tif", "--json")[1])
    assert (made["file"], made["layers"]) == (str(frames / "frame_2.html"), ["frame_2.tif, 2 mm"])


def test_a_region_of_the_object(command: Command, frames: Path) -> None:
    made = json.loads(command(frames, "--region-mm", "0.02,-0.01,0.04,0.02", "--json")[1])
    assert made["layers"] == ["amplitude"]
    (layer,) = layers_of(frames / "view.html")
    assert layer["size"] == [100, 50]
    assert (layer["left"], layer["top"]) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_camera_s_own_frame(command: Command, tmp_path: Path) -> None:
    path = tmp_path / "camera.tif"
    Image.fromarray(np.arange(2000, dtype=np.uint16).reshape(40, 50)).save(path)
    code, out, err = command(path)
    assert (code, out) == (2, "")
    assert "camera.tif: does not state how it was recorded; give --pixel-pitch-um" in err
    code, _, err = command(path, "--pixel-pitch-um", 3.2)
    assert (code, err) == (0, "")
    (layer,) = layers_of(tmp_path / "camera.html")
    assert (layer["unit"], layer["high"], layer["pitch"]) == ("counts", 1999.0, 3.2)


def test_what_has_no_room_is_told(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put_field(tmp_path / "field.npz", phase=0.5, side=1100)
    scant = partial(zoom_page.write_zoom_page, most_bytes=1_200_000)
    monkeypatch.setattr(zoom_page, "write_zoom_page", scant)
    code, _, err = command(tmp_path / "field.npz")
    assert code == 0
    asked = re.search(r"--region-mm (\S+) or less", err)
    assert asked is not None
    assert "amplitude (means of 2 x 2 samples)" in err
    code, _, err = command(tmp_path / "field.npz", "--region-mm", asked[1])
    assert (code, err) == (0, "")


def test_a_browser_is_asked(command: Command, result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url: bool(asked.append(url)))
    code, _, err = command(result, "--open")
    assert (code, asked) == (0, [(result / "view.html").as_uri()])
    assert "no browser was found" in err


def test_what_cannot_be_shown_is_refused(command: Command, frames: Path, result: Path) -> None:
    field, frame = frames / "object.npz", frames / "frame_1.tif"
    empty, text, picture = frames / "empty", frames / "a.txt", frames / "amplitude.tif"
    empty.mkdir()
    text.write_text("no field")
    write_pyramid(np.ones((4, 4)), picture, 0.4, ["amplitude"])
    (frames / "cut.npz").write_bytes(field.read_bytes()[:-100])
    (frames / "cut.tif").write_bytes(frame.read_bytes()[:2000])
    before = sorted(frames.iterdir())
    for arguments, words in (
        ((frames / "none",), "none: must be a folder, a field"),
        ((frames / "none.npz",), "cannot read the field .*none.npz: No such file"),
        ((frames / "none.tif",), "cannot read .*none.tif: No such file"),
        ((text,), "must be a folder, a field"),
        ((picture,), "amplitude.tif: a TIFF, grey, floating-point numbers"),
        ((empty,), "contains none of reconstruction.npz, object.npz, frame_"),
        ((frames / "cut.npz",), "cannot read the field .*cut.npz"),
        ((frames / "cut.tif",), "cut.tif"),
        ((field, "-o", frames / "page.png"), r"--output = '.*page.png': the file name must end in \.html"),
        ((field, "-o", frame / "page.html"), "cannot write"),
        ((field, "--region-mm", "0,0,1"), "--region-mm"),
        ((field, "--region-mm", "0,0,x,1"), "--region-mm"),
        ((field, "--region-mm", "0,0,0.1,0"), r"--region-mm = 0,0,0\.1,0: must be finite, and the sides"),
        ((field, "--region-mm", "0.05,0,0.1,0.1"), r"along x from -0\.06 to 0\.06 mm"),
        ((frame, "--region-mm", "0,0,0.1,0.7"), r"along y from -0\.32 to 0\.32 mm"),
        ((frame, "--truth", field), "--truth: cannot be used with the frame"),
        ((field, "--pixel-pitch-um", 3.2), "--pixel-pitch-um: cannot be used with"),
        ((frame, "--pixel-pitch-um", -1.0), "pixel_pitch_um"),
        ((result, "--truth", empty), "cannot read the field .*object.npz"),
    ):
        code, out, err = command(*arguments)
        assert (code, out) == (2, ""), arguments
        assert re.search(words, err), err
        assert len(err.splitlines()) == 1
    assert sorted(frames.iterdir()) == before
    (result / "reconstruction.json").write_text("{")
    code, _, err = command(result)
    assert code == 2
    assert "reconstruction.json: it is not a JSON file" in err
