"""The statement of a calibration: the key of its checkpoint, and its memory."""

from __future__ import annotations

import json
from typing import Any

import pytest

from lensdesign import load_design, scaled
from wavesim import image
from wavesim.calibration import calibrate_frames, calibration_problem
from wavesim.calibration.calibration_problem import IGNORED_SETTINGS, CalibrationProblem
from wavesim.runtime.memory import MemoryLimitError
from wavesim.scene.settings import CalibrationSettings, PatchSettings


def test_a_key_has_no_settings_that_act_only_through_the_light() -> None:
    """But for those that keys of earlier checkpoints have."""
    stated = set(json.loads(CalibrationSettings().model_dump_json(exclude=IGNORED_SETTINGS)))
    assert stated & set(PatchSettings.model_fields) == {"light_tilt_deg", "waist_mm", "light_pitch_um"}


def test_the_memory_of_all_modes_of_the_light_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    frames = image(lens, "star", patch_mm=0.03, planes_mm=(0.03,), engine="eikonal", error=0.1).frames
    settings = CalibrationSettings(
        patch_mm=0.03,
        error=0.1,
        source_deg=0.5,
        parameters="decenter_x_mm",
        kind="amplitude",
        iterations=1,
        most_mountings=1,
    )
    problem = CalibrationProblem(lens, frames, settings)
    (plane,), samples = problem.pixels.recorded, problem.framed.patch.grid.size
    limit = 4 * (plane.amplitude.size * (7 + 12 * 6) + 4 * samples)
    calls: dict[str, Any] = {"settings": settings, "verdict": "none"}
    monkeypatch.setattr(calibration_problem, "memory_limit", lambda stated: limit)
    calibrate_frames(lens, frames, **calls)
    monkeypatch.setattr(calibration_problem, "memory_limit", lambda stated: limit - 1)
    with pytest.raises(MemoryLimitError, match=r"1 parameters in .* pixels in light of 7 modes needs"):
        calibrate_frames(lens, frames, **calls)
