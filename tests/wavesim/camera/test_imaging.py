"""An object through a lens in one call, on a bench that is not as designed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose, SurfacePerturbation
from wavesim.camera.exposures import estimate_intensity
from wavesim.camera.imaging import Imaged, image
from wavesim.scene.placement import Placement

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
SETTINGS: dict[str, Any] = {
    "patch_mm": 0.03,
    "engine": "eikonal",
    "error": 0.3,
    "noise": False,
    "pixels": 140,
}


def seen(placement: Placement | Pose | None = None, **changes: Any) -> Imaged:
    return image(LENS, "star", placement=placement, **SETTINGS | changes)


def pictures(imaged: Imaged) -> list[np.ndarray]:
    return [estimate_intensity(frame)[0] for frame in imaged.frames]


@pytest.fixture(scope="module")
def nominal() -> Imaged:
    return seen()


def test_a_pose_is_that_of_the_settings(nominal: Imaged) -> None:
    one, other = seen(Pose(decenter_x_mm=0.004)), seen(decenter_x_mm=0.004)
    for a, b, c in zip(one.frames, other.frames, nominal.frames, strict=True):
        assert np.array_equal(a.counts, b.counts)
        assert not np.array_equal(a.counts, c.counts)
    with pytest.raises(InputError, match="placement says how the lens is mounted"):
        seen(Pose(), decenter_x_mm=0.004)


def test_a_sensor_beside_its_place_sees_the_light_beside_its_middle(nominal: Imaged) -> None:
    pixel_mm = 1e-3 * LENS.sensor.pixel_pitch_um
    moved = seen(Placement(sensor_shift_mm=(3 * pixel_mm, 0.0, 0.0)))
    for shown, expected in zip(pictures(moved), pictures(nominal), strict=True):
        here, there = shown[:, :-3], expected[:, 3:]
        assert np.linalg.norm(here - there) < 0.03 * np.linalg.norm(there)


def test_planes_are_where_the_placement_says_and_frames_say_what_the_stage_does() -> None:
    one = seen(Placement(plane_distances_mm=(0.0, 0.004)))
    other = seen(stage_error_mm=(0.0, 0.004))
    for a, b in zip(one.frames, other.frames, strict=True):
        assert a.settings == b.settings
        assert np.array_equal(a.counts, b.counts)


def test_object_surface_light_and_tilt_change_the_frames(nominal: Imaged) -> None:
    for changed in (
        Placement(object_shift_mm=(0.002, 0.0, 0.0)),
        Placement(surface_perturbations={1: SurfacePerturbation(radius_mm=0.01)}),
        Placement(wavelength_um=0.56),
        Placement(sensor_tilt_deg=(0.0, 5.0)),
    ):
        for one, other in zip(pictures(seen(changed)), pictures(nominal), strict=True):
            assert one.shape == other.shape
            assert np.linalg.norm(one - other) > 1e-3 * np.linalg.norm(other)


def test_tiles_of_a_whole_field_record_on_upright_planes_alone() -> None:
    with pytest.raises(InputError, match="sensor_tilt_deg: engine two-level"):
        seen(Placement(sensor_tilt_deg=(1.0, 0.0)), engine="two-level")
