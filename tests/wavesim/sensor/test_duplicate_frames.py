"""Pictures of different planes that are one picture are refused; others are not."""

from __future__ import annotations

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


@pytest.mark.parametrize("brightness", [1.0, 0.4])
def test_one_picture_with_other_noise_is_refused_on_planes_far_apart(brightness: float) -> None:
    planes = [[frame(1.0, PICTURE, 1)], [frame(2.0, brightness * PICTURE, 2)]]
    validate_distinct_frames(planes, diverse=False)
    with pytest.raises(InputError, match="within the noise"):
        validate_distinct_frames(planes, diverse=True)


def test_other_pictures_and_pictures_of_noise_are_not_refused() -> None:
    validate_distinct_frames([[frame(1.0, PICTURE, 1)], [frame(2.0, PICTURE[::-1], 2)]], diverse=True)
    dark = np.full(PICTURE.shape, 3.0)
    validate_distinct_frames([[frame(1.0, dark, 1)], [frame(2.0, dark, 2)]], diverse=True)


def test_a_picture_that_changes_by_two_percent_is_another_one() -> None:
    other = PICTURE * (1.0 + 0.03 * np.sin(np.arange(60)))
    planes = [[frame(1.0, 20.0 * PICTURE, 1)], [frame(2.0, 20.0 * other, 2)]]
    validate_distinct_frames(planes, diverse=True)
