"""What frames say of the object behind them: its patch and light, and under what a run on them is kept."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from lensdesign.common.section import Section
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, Sensor
from lensdesign.lens.poses import Pose
from wavesim.fields.field import Field
from wavesim.runtime.checkpoint import digest_of, key_of
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import PatchSettings
from wavesim.sensor.frame_sets import frames_by_plane, validate_same_pitch
from wavesim.sensor.frames import Frame
from wavesim.sensor.same_pictures import validate_distinct_pictures
from wavesim.sensor.windows import LEAST_DIVERSITY, check_diversity, check_footprint
from wavesim.targets.patch import Patch, lit_patch


class FramePatch(NamedTuple):
    """What frames and settings say of the object: its patch and light, the planes, each once, and sensor."""

    frames: tuple[Frame, ...]
    planes_mm: tuple[float, ...]
    sensor: Sensor
    patch: Patch
    light: Field
    diversity: float


def patch_of_frames(
    lens: Lens, frames: Sequence[Frame], settings: PatchSettings, pose: Pose = Pose()
) -> FramePatch:
    """The patch and light of frames, which are checked for what they can tell.

    Raises
    ------
    InputError
        If frames do not belong to the design, a value is not usable, or two planes hold the same picture.

    Warns
    -----
    FootprintWarning, DiversityWarning
        Where frames tell less than they might.
    """
    if not frames:
        raise InputError("frames: must be one at least")
    validate_same_pitch(frames, lens)
    by_plane = frames_by_plane(frames)
    patch, light = lit_patch(lens, settings, frames[0].settings.wavelength_um)
    rows, columns = frames[0].counts.shape
    planes = tuple(plane[0].settings.plane_distance_mm for plane in by_plane)
    sensor = lens.sensor.replaced(pixels=(columns, rows))
    check_footprint(lens, patch, sensor, planes, pose)
    figure = check_diversity(lens, patch, planes) if len(planes) > 1 else 0.0
    validate_distinct_pictures(by_plane, diverse=figure >= LEAST_DIVERSITY)
    return FramePatch(
        tuple(frame for plane in by_plane for frame in plane), planes, sensor, patch, light, figure
    )


def validate_frames(lens: Lens, frames: Sequence[Frame], settings: Section) -> None:
    """Refuse lengths of frames and settings that another unit would explain.

    Raises
    ------
    SettingError
        As of :func:`wavesim.scene.lengths.validate_lengths`.
    """
    light = frames[0].settings.wavelength_um if frames else None
    validate_lengths(lens, {"wavelength_um": light})
    planes = [frame.settings.plane_distance_mm for frame in frames]
    validate_lengths(lens, {"plane_distance_mm": planes}, light)
    validate_lengths(lens, settings, light)


def key_of_frames(lens: Lens, frames: Sequence[Frame], light: Field, *told: str | bytes) -> str:
    """Digest of all that a result depends on, under which parts of a run are kept."""
    pictures = [
        part for frame in frames for part in (digest_of(frame.counts), frame.settings.model_dump_json())
    ]
    maps = [
        digest_of(own)
        for frame in frames
        if frame.maps is not None
        for own in (frame.maps.gain, frame.maps.dark_electrons, frame.maps.bad)
        if own is not None
    ]
    return key_of(lens.model_dump_json(), digest_of(light.values), *told, *pictures, *maps)
