"""Flats, hot pixels and dead pixels behind colour filters."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign import load_design, scaled
from wavesim.sensor.frame_sets import BadPixelWarning, read_colour_frames
from wavesim.sensor.frames import Frame, write_frame
from wavesim.sensor.imaging import image

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
HOW: dict[str, Any] = {"engine": "eikonal", "error": 0.1, "patch_mm": 0.02, "planes_mm": (0.05, 0.2)}


@pytest.fixture(scope="module")
def frames() -> tuple[Frame, ...]:
    return image(LENS, "star", wavelengths_um=(0.45, 0.635), colour_filters="bayer", **HOW).frames


def written(frames: tuple[Frame, ...], folder: Path) -> list[Path]:
    paths = [folder / f"frame_{index}.tif" for index in range(len(frames))]
    for frame, path in zip(frames, paths, strict=True):
        write_frame(frame, path)
    return paths


def test_a_flat_behind_filters_keeps_their_colours(frames: tuple[Frame, ...], tmp_path: Path) -> None:
    """Light is uneven behind filters; only what differs between pixels of one filter is their gain."""
    own, shape = frames[0].settings, frames[0].counts.shape
    assert own.colours is not None
    gain = 1.0 + 0.1 * np.random.default_rng(0).standard_normal(shape).clip(-2.0, 2.0)
    letters = own.colours.letters_on_pixels(shape)
    for letter in own.colours.responses:
        gain[letters == letter] /= gain[letters == letter].mean()
    white = sum(own.colours.on_pixels(shape))
    np.save(tmp_path / "flat.npy", own.offset_counts + 1000.0 * white * gain)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = read_colour_frames(written(frames, tmp_path), flat=tmp_path / "flat.npy")
    assert read[0].maps is not None
    assert read[0].maps.gain == pytest.approx(gain, rel=1e-9)


def test_hot_and_dead_pixels_are_found_behind_filters(frames: tuple[Frame, ...], tmp_path: Path) -> None:
    brightest = np.unravel_index(np.argmax(frames[0].counts), frames[0].counts.shape)
    hot, dead = (3, 4), (int(brightest[0]), int(brightest[1]))
    broken = []
    for frame in frames:
        counts = frame.counts.copy()
        counts[hot], counts[dead] = 4000, frame.settings.offset_counts
        broken.append(Frame(counts, frame.settings))
    (tmp_path / "whole").mkdir()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_colour_frames(written(frames, tmp_path / "whole"))
    with pytest.warns(BadPixelWarning, match="2 pixels are hot or dead"):
        read = read_colour_frames(written(tuple(broken), tmp_path))
    for frame in read:
        assert frame.maps is not None
        assert frame.maps.bad is not None
        assert sorted(map(tuple, np.argwhere(frame.maps.bad).tolist())) == sorted([hot, dead])
