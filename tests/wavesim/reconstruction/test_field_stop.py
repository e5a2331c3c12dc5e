"""The field stop as a stated and as an estimated quantity: position, diameter, results and verdict."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.calibration import calibrate_frames
from wavesim.calibration.calibration_result import Calibrated
from wavesim.fields.field import Field
from wavesim.reconstruction.field_stop import FieldStop, StopSearch
from wavesim.reconstruction.found_object import FoundObject
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.system_state import SystemState
from wavesim.sensor.imaging import Imaged, image
from wavesim.targets.illumination import field_stop
from wavesim.targets.patch import object_patch

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
STOP_MM, AT_MM = 0.014, (0.006, -0.004)
TILES = {"engine": "eikonal", "error": 0.3}
PATCH_MM = 0.03
SAMPLE_MM = 4.256e-4


def grains() -> Field:
    """Opaque grains of random shape on a clear ground."""
    patch = object_patch(LENS, PATCH_MM)
    values = gaussian_filter(np.random.default_rng(3).standard_normal(patch.grid.shape), 2.5)
    clear = np.where(values > 0.7 * values.std(), 0.05, 1.0)
    return Field(patch.grid, clear.astype(np.complex64), patch.wavelength_um)


@cache
def aside() -> Imaged:
    stop = {"field_stop_mm": STOP_MM, "field_stop_at_mm": AT_MM}
    return image(LENS, grains(), exposures=(1.0, 30.0), pixels=84, **TILES, **stop)


def found_with(**changes: object) -> FoundObject:
    settings = {"kind": "amplitude", "iterations": 25, "patch_mm": PATCH_MM, **TILES}
    return reconstruct_frames(LENS, aside().frames, truth=grains(), **{**settings, **changes})


def test_a_stop_beside_the_axis_covers_its_disc() -> None:
    grid = object_patch(LENS, PATCH_MM).grid
    values = field_stop(grid, "disc", STOP_MM, at_mm=AT_MM)
    assert values.sum() * grid.cell == pytest.approx(math.pi * (0.5 * STOP_MM) ** 2, rel=1e-9)
    assert (values.sum(axis=0) @ grid.x_mm) / values.sum() == pytest.approx(AT_MM[0], abs=1e-6)
    assert (values.sum(axis=1) @ grid.y_mm) / values.sum() == pytest.approx(AT_MM[1], abs=1e-6)


def test_a_stop_that_the_patch_does_not_hold_is_refused() -> None:
    with pytest.raises(InputError, match=r"field_stop_at_mm = 0\.009,0: .*patch"):
        object_patch(LENS, PATCH_MM, STOP_MM, field_stop_at_mm=(0.009, 0.0))
    with pytest.raises(InputError, match="must be finite"):
        object_patch(LENS, PATCH_MM, STOP_MM, field_stop_at_mm=(math.nan, 0.0))


@pytest.mark.usefixtures("quick_verdicts")
def test_a_stated_stop_beside_the_axis_is_reconstructed() -> None:
    found = found_with(field_stop_mm=STOP_MM, field_stop_at_mm=AT_MM)
    assert found.truth["object_correlation"] > 0.98
    figures = found.as_dict()
    assert figures["field_stop_mm"] == STOP_MM
    assert figures["field_stop_at_mm"] == list(AT_MM)
    assert figures["field_stop_from"] == "stated"


@pytest.mark.usefixtures("quick_verdicts")
def test_the_stop_is_found_from_the_frames() -> None:
    found = found_with(field_stop="find")
    assert found.truth["object_correlation"] > 0.98
    assert found.patch.field_stop_mm == pytest.approx(STOP_MM, abs=2 * SAMPLE_MM)
    assert math.dist(found.patch.field_stop_at_mm, AT_MM) < 2 * SAMPLE_MM
    assert found.as_dict()["field_stop_from"] == "frames"


@pytest.mark.usefixtures("quick_verdicts")
def test_a_calibration_finds_the_stop_together_with_the_bench() -> None:
    """Nothing is stated about the stop, and a camera that moved displaces its first estimate."""
    bench = SystemState(plane_shifts_um=((0.0, 0.0), (2.0, -1.5)))
    stop = {"field_stop_mm": STOP_MM, "field_stop_at_mm": AT_MM}
    frames = image(LENS, grains(), state=bench, exposures=(1.0, 30.0), pixels=84, **TILES, **stop).frames
    found = calibrate_frames(
        LENS,
        frames,
        patch_mm=PATCH_MM,
        kind="amplitude",
        parameters="plane_2_shift_x_um,plane_2_shift_y_um",
        iterations=6,
        **TILES,
    )
    assert found.field_stop_from == "frames"
    assert found.field_stop_mm == pytest.approx(STOP_MM, abs=2 * SAMPLE_MM)
    assert math.dist(found.field_stop_at_mm, AT_MM) < 0.5 * SAMPLE_MM
    assert found.state.plane_shifts_um[1] == pytest.approx((2.0, -1.5), abs=0.05)
    assert found.state.object_shift_mm == (0.0, 0.0, 0.0)
    assert found.explained
    assert not found.stop_warning


def grey(width: float) -> Field:
    """A grey object that is darker towards one corner, as photographs are."""
    patch = object_patch(LENS, PATCH_MM)
    x, y = (at / PATCH_MM for at in (patch.grid.x_mm[None, :], patch.grid.y_mm[:, None]))
    texture = gaussian_filter(np.random.default_rng(5).standard_normal(patch.grid.shape), 1.5)
    values = np.clip(0.45 + 0.7 * (x + 0.6 * y) + width * texture / texture.std(), 0.02, 1.0)
    return Field(patch.grid, values.astype(np.complex64), patch.wavelength_um)


def calibration_of(frames: Any, **changes: Any) -> Calibrated:
    sought = {"parameters": "decenter_x_mm", "kind": "amplitude", "iterations": 3, "most_mountings": 2}
    sought |= {"patch_mm": PATCH_MM, "verdict": "none", **TILES, **changes}
    return calibrate_frames(LENS, frames, **sought)


def test_a_grey_object_whose_light_lies_aside_starts_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = SystemState(plane_shifts_um=((0.0, 0.0), (0.6, -0.8)))
    frames = image(LENS, grey(0.1), state=bench, exposures=(1.0, 30.0), **TILES).frames
    trials: list[int] = []

    def counted(self: StopSearch, stop: FieldStop, iterations: int) -> float:
        trials.append(iterations)
        return misfit(self, stop, iterations)

    misfit = StopSearch.misfit
    monkeypatch.setattr(StopSearch, "misfit", counted)
    assert calibration_of(frames).field_stop_from == "patch"
    assert 0 < len(trials) < 10


def reconstruction_of(frames: Any, folder: Path | None = None, progress: Any = None, **changes: Any) -> Any:
    """The stop of a reconstruction of one iteration, which is not judged."""
    patches: list[Any] = []

    def ended(found: FoundObject) -> None:
        patches.append(found.patch)
        raise KeyboardInterrupt

    settings = {"kind": "amplitude", "patch_mm": PATCH_MM, **TILES, **changes}
    with pytest.raises(KeyboardInterrupt) as stop:
        reconstruct_frames(LENS, frames, folder=folder, progress=progress, on_found=ended, **settings)
    if not patches:
        raise stop.value
    return patches[0].field_stop_mm, patches[0].field_stop_at_mm


def stop_of_calibration(frames: Any, **changes: Any) -> Any:
    return calibration_of(frames, most_mountings=1, **changes).field_stop


@pytest.mark.parametrize("stop_of", [stop_of_calibration, reconstruction_of])
def test_an_interrupted_search_for_the_stop_goes_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, stop_of: Any
) -> None:
    """No trial is made twice, and the result is that of a search without an interrupt."""
    tried: list[tuple[FieldStop, int]] = []
    most = [4]

    def counted(self: StopSearch, stop: FieldStop, iterations: int) -> float:
        known = (stop, iterations) in self._misfits
        if not known:
            if len(tried) == most[0]:
                raise KeyboardInterrupt
            tried.append((stop, iterations))
        return misfit(self, stop, iterations)

    misfit = StopSearch.misfit
    monkeypatch.setattr(StopSearch, "misfit", counted)
    frames = image(LENS, grains(), exposures=(1.0,), pixels=84, **TILES, field_stop_mm=STOP_MM).frames
    stop = {"field_stop": "find", "field_stop_at_mm": (0.0, 0.0), "iterations": 1}
    stages: list[str] = []
    with pytest.raises(KeyboardInterrupt, match="run the same command again"):
        stop_of(frames, folder=tmp_path, progress=lambda stage, done, total: stages.append(stage), **stop)
    assert len(tried) == 4
    assert stages[-1].startswith("field stop, ")
    most[0] = -1
    again = stop_of(frames, folder=tmp_path, **stop)
    assert len(tried) == len(set(tried)) > 4
    tried.clear()
    assert stop_of(frames, **stop) == again


def test_nothing_is_found_where_all_is_stated() -> None:
    with pytest.raises(InputError, match="field_stop_at_mm"):
        found_with(field_stop="find", field_stop_mm=STOP_MM, field_stop_at_mm=AT_MM)


def test_without_options_the_verdict_names_the_stop() -> None:
    judged = found_with(iterations=8).verdict
    assert not judged.explained
    assert judged.cause == "field stop", judged.words
    assert "--field-stop-at-mm" in judged.next_step
