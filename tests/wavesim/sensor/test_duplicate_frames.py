"""Pictures of different planes that are one picture are refused; others are not."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.sensor.duplicate_frames import validate_distinct_frames
from wavesim.sensor.frames import Frame, FrameSettings

PICTURE = 2000.0 * np.hypot(*np.meshgrid(np.sin(np.arange(60)), np.cos(0.3 * np.arange(50))))


def frame(distance_mm: float, electrons: np.ndarray, seed: int) -> Frame:
    """A frame with shot noise, one electron a count."""
    counts = 64 + np.random.default_rng(seed).poisson(electrons) + 0
    settings = FrameSettings(
        pixel_pitch_um=3.2,
        plane_distance_mm=distance_mm,
        wavelength_um=0.532,
        exposure=1.0,
        bits=16,
        offset_counts=64.0,
        gain_electrons_per_count=1.0,
        read_noise_electrons=1.0,
    )
    return Frame(counts.astype(np.uint16), settings)


def test_identical_pictures_are_refused_wherever_the_planes_are() -> None:
    planes = [[frame(1.0, PICTURE, 1)], [frame(2.0, PICTURE, 1)]]
    with pytest.raises(InputError, match="1 mm and 2 mm"):
        validate_distinct_frames(planes, diverse=False)


DARK = np.full(PICTURE.shape, 3.0)
CHANGED_BY_TWO_PERCENT = 20.0 * PICTURE * (1.0 + 0.03 * np.sin(np.arange(60)))


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (PICTURE, PICTURE, True),
        (PICTURE, 0.4 * PICTURE, True),
        (PICTURE, PICTURE[::-1], False),
        (20.0 * PICTURE, CHANGED_BY_TWO_PERCENT, False),
        (DARK, DARK, False),  # nothing but noise says nothing
    ],
    ids=["other noise", "other brightness", "upside down", "changed by 2 %", "dark"],
)
def test_one_picture_with_other_noise_is_refused_on_planes_far_apart_alone(
    one: np.ndarray, other: np.ndarray, same: bool
) -> None:
    planes = [[frame(1.0, one, 1)], [frame(2.0, other, 2)]]
    validate_distinct_frames(planes, diverse=False)
    with pytest.raises(InputError, match="within the noise") if same else nullcontext():
        validate_distinct_frames(planes, diverse=True)
