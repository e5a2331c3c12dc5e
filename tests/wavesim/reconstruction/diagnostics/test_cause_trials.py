"""Frames of benches that are not as they are said to be: never explained, and mostly named.

One case of each kind; `python -m benchmarks.verdicts` has all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import pytest

from lensdesign import load_design, scaled
from lensdesign.lens.lens import Lens
from wavesim.reconstruction.diagnostics import cause_trials
from wavesim.reconstruction.found_object import FoundObject
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import image

pytestmark = pytest.mark.usefixtures("plain_searches")

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
PLANES_MM = LENS.sensor.plane_distances_mm
TILES = {"patch_mm": 0.024, "engine": "eikonal", "error": 0.3}


def frames_of(thing: str = "star", **errors: Any) -> tuple[Frame, ...]:
    return image(LENS, thing, exposures=(1.0, 30.0), pixels=108, **TILES, **errors).frames


@cache
def healthy() -> tuple[Frame, ...]:
    return frames_of()


def at_planes(frames: Sequence[Frame], *planes_mm: float) -> list[Frame]:
    """The same frames, which state other planes."""
    said = dict(zip(PLANES_MM, planes_mm, strict=True))
    return [
        Frame(f.counts, f.settings.replaced(plane_distance_mm=said[f.settings.plane_distance_mm]))
        for f in frames
    ]


def found_in(frames: Sequence[Frame], lens: Lens = LENS, **changes: Any) -> FoundObject:
    return reconstruct_frames(lens, frames, **{"kind": "amplitude", "iterations": 12, **TILES, **changes})


def test_frames_of_a_bench_as_designed_are_explained() -> None:
    found = found_in(healthy()).verdict
    assert found.explained, found.words
    assert not found.trials


def test_another_object_and_other_noise_are_explained() -> None:
    found = found_in(frames_of("phase", seed=1), kind="complex", iterations=25).verdict
    assert found.explained, found.words


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize(
    ("errors", "cause"),
    [
        ({"light_error_deg": (-0.2, 0.3)}, "light"),
        ({"plane_shift_um": ((0.0, 0.0), (1.3, -2.2))}, "shift"),
        ({"plane_background": (0.0, 0.05)}, "background"),
    ],
)
def test_a_bench_that_differs_is_not_explained_and_named(errors: dict[str, Any], cause: str) -> None:
    found = found_in(frames_of(**errors)).verdict
    assert not found.explained
    assert found.cause == cause, found.words
    assert found.next_step


def test_swapped_planes_are_not_explained_and_named() -> None:
    found = found_in(at_planes(healthy(), *PLANES_MM[::-1])).verdict
    assert (found.explained, found.cause) == (False, "planes swapped"), found.words


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps are not refined, which takes most of the time."""
    monkeypatch.setattr(cause_trials, "REFINED", 0)
    monkeypatch.setattr(cause_trials, "LONGEST", 0.06)


@pytest.mark.usefixtures("coarse")
def test_pixels_that_are_larger_than_stated_are_not_explained_and_named() -> None:
    pitch_um = LENS.sensor.pixel_pitch_um
    larger = LENS.replaced(sensor=LENS.sensor.replaced(pixel_pitch_um=1.05 * pitch_um))
    frames = image(larger, "star", exposures=(1.0, 30.0), pixels=108, **TILES).frames
    said = [Frame(f.counts, f.settings.replaced(pixel_pitch_um=pitch_um)) for f in frames]
    found = found_in(said).verdict
    assert (found.explained, found.cause) == (False, "pixel pitch"), found.words


@pytest.mark.usefixtures("coarse")
def test_another_design_is_not_explained_and_named() -> None:
    front, back = LENS.surfaces
    other = LENS.replaced(surfaces=(front.replaced(radius_mm=1.2 * front.radius_mm), back))
    found = found_in(healthy(), other).verdict
    assert (found.explained, found.cause) == (False, "lens"), found.words


def test_a_plane_that_was_held_out_is_predicted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cause_trials.CauseTrials, "trials", lambda self: [])
    found = found_in(healthy(), hold_out_plane=1).verdict
    used, held = found.planes[1], found.planes[0]
    assert used.over_noise is not None
    assert held.over_noise is None
    assert held.held_out_over_noise is not None
    wrong = found_in(at_planes(healthy(), *PLANES_MM[::-1]), hold_out_plane=1).verdict
    assert (wrong.planes[0].held_out_over_noise or 0.0) > 2.0 * held.held_out_over_noise


def test_several_starts_end_at_one_object() -> None:
    found = found_in(healthy(), starts=2).verdict
    assert found.agreement is not None
    assert found.agreement > 0.9


@pytest.mark.usefixtures("coarse")
def test_a_wide_source_is_tried_and_named() -> None:
    found = found_in(frames_of(source_deg=1.0)).verdict
    assert not found.explained
    assert any(trial.cause == "source" and trial.gain > 0.2 for trial in found.trials)
    assert found.cause in ("source", "vibration"), found.words
    assert "source" in found.words


@pytest.mark.usefixtures("coarse")
def test_a_broad_band_is_tried_named_and_found() -> None:
    frames = image(
        LENS, "star", exposures=(1.0, 30.0), pixels=108, bandwidth_nm=50.0, **TILES | {"error": 0.05}
    ).frames
    found = found_in(frames, error=0.05).verdict
    assert (found.explained, found.cause) == (False, "bandwidth"), found.words
    stated = found_in(frames, error=0.05, bandwidth_nm="find", iterations=25)
    assert stated.verdict.explained, stated.verdict.words
    assert stated.of_method["bandwidth_nm"] == pytest.approx(50.0, rel=0.05)
