"""Frames of several wavelengths at once are the sums of the frames of each wavelength alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.common.arrays import Array
from wavesim.scene.settings import ImageSettings, SettingError
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import common_pixels, image

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
PAIR = (0.635, 0.45)
HOW: dict[str, Any] = {
    "engine": "eikonal",
    "error": 0.1,
    "patch_mm": 0.02,
    "planes_mm": (0.05, 0.2),
    "noise": False,
    "bits": 16,
    "full_well_electrons": 1e6,
    "object_pitch_um": 0.3,
}


def light_of(frames: tuple[Frame, ...]) -> list[Array]:
    """Electrons of the planes over their sum on the first one."""
    electrons = [frame.counts.astype(float) - frame.settings.offset_counts for frame in frames]
    return [one / electrons[0].sum() for one in electrons]


@pytest.mark.parametrize(
    "changes",
    [
        {"illumination": "tilted", "light_tilt_deg": (5.0, 0.0)},
        {"illumination": "point", "source_distance_mm": 0.05},
        {"working_distance_error_mm": 0.002},
    ],
    ids=["tilted light", "point source", "object displaced"],
)
def test_each_wavelength_has_its_own_light(changes: dict[str, Any]) -> None:
    """The light at once is a sum of the light of each wavelength alone, with factors for their power."""
    pixels = common_pixels(LENS, ImageSettings(**HOW, **changes), PAIR)
    at_once = light_of(image(LENS, "star", wavelengths_um=PAIR, pixels=pixels, **HOW, **changes).frames)
    alone = [
        light_of(image(LENS, "star", wavelength_um=one, pixels=pixels, **HOW, **changes).frames)
        for one in PAIR
    ]
    for plane, one, other in zip(at_once, *alone, strict=True):
        columns = np.stack([one.ravel(), other.ravel()], axis=1)
        powers, *_ = np.linalg.lstsq(columns, plane.ravel(), rcond=None)
        error = np.linalg.norm(columns @ powers - plane.ravel()) / np.linalg.norm(plane)
        assert error < 2e-3
        assert powers.min() > 0.3


def test_a_state_with_a_wavelength_is_refused() -> None:
    with pytest.raises(SettingError, match=r"state: has a wavelength of 0\.64 um"):
        image(LENS, "star", wavelengths_um=PAIR, state=SystemState(wavelength_um=0.64), **HOW)
