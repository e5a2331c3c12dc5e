"""An object through the lens: from a design and what is to be set, in one call, to recorded frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lensdesign.common.notebook import html_table
from lensdesign.common.toml_files import validate
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, Sensor
from lensdesign.lens.poses import Pose
from wavesim.engines.whole_field.on_cluster import tiles_in
from wavesim.engines.with_ghost import WithGhost
from wavesim.fields.field import Field
from wavesim.runtime.inventory import need_of
from wavesim.runtime.memory import Memory, memory_limit
from wavesim.runtime.scratch import scratch_in
from wavesim.scene.bench import Bench, bench_of
from wavesim.scene.engine import Engine
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.light import Light
from wavesim.scene.placement import Placement
from wavesim.scene.scene import Scene
from wavesim.scene.settings import ImageSettings, SettingError
from wavesim.sensor.exposures import Electronics
from wavesim.sensor.frames import Frame
from wavesim.sensor.memory import imaging_arrays
from wavesim.sensor.mounting import light_on
from wavesim.sensor.pixels.errors import PixelErrors
from wavesim.sensor.recording import PARTS, Progress, Recording, image_patch, recorded_scene
from wavesim.sensor.windows import (
    check_footprint,
    diversity,
    imaging_engine,
    light_window,
    sensor_window,
)
from wavesim.targets.patch import Patch, Target, lit, lit_patch, make_target


@dataclass(frozen=True, eq=False)
class Imaged:
    """Frames of an object, and how they came about.

    Attributes
    ----------
    settings : ImageSettings
        With which it was imaged.
    patch : Patch
        The object's samples and its field stop.
    target : Target
        The object.
    sensor : Sensor
        The window whose pixels recorded.
    recording : Recording
        Planes, electronics, noise and errors.
    engine : Engine
        That carried the light to the first plane.
    frames : tuple of Frame
        As recorded: plane by plane, and of each plane its exposures.
    share_beyond_pixels : float
        Share of the light's energy on the first plane at frequencies beyond those that pixels resolve.
    diversity : float
        What the planes tell of the phase (:func:`wavesim.sensor.windows.diversity`).
    memory : Memory
        What was said to be taken.
    predicted_error : float
        Upper bound of the field's relative L2 error on the first plane, of this object's light.
    """

    settings: ImageSettings
    patch: Patch
    target: Target
    sensor: Sensor
    recording: Recording
    engine: Engine
    frames: tuple[Frame, ...]
    share_beyond_pixels: float
    diversity: float
    memory: Memory
    predicted_error: float

    def __repr__(self) -> str:
        return f"Imaged({', '.join(f'{name} {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table("Frames of an object", self._rows())

    def _rows(self) -> list[tuple[str, str]]:
        across, down = self.sensor.pixels
        planes = ", ".join(f"{z:g}" for z in self.recording.plane_distances_mm)
        return [
            ("object", f"{self.target.name}, {self.patch.stop_words}"),
            ("engine", self.engine.name),
            ("frames", f"{len(self.frames)} of {across} x {down} pixels, planes at {planes} mm"),
            ("brightest", f"{max(int(frame.counts.max()) for frame in self.frames)} counts"),
        ]


def image(
    lens: Lens,
    thing: str | Field = "usaf",
    settings: ImageSettings | None = None,
    *,
    placement: Placement | Pose | Bench | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    before: Callable[[Memory], None] | None = None,
    **changes: Any,
) -> Imaged:
    """Record an object through a lens: frames, as the design's sensor would give them.

    Parameters
    ----------
    lens
        The nominal lens.
    thing
        "usaf", "star", "phase", "tissue", "empty", the file of a picture, or a transmission, whose samples
        then are those of the patch.
    settings
        All that may be set; defaults if left out.
    placement
        How lens, object, sensor and light are not as designed, in place of what settings say of it. Frames
        say of their planes what the stage says, and of the light its own wavelength.
    folder
        Where finished parts of a whole field are kept, so that a run which was cut off goes on
        (:func:`wavesim.sensor.recording.drop_parts` removes them), and arrays that memory does not hold.
    progress
        Told what is done, how many parts of it are, and of how many.
    before
        Told what the run will take, when nothing can be refused any more.
    **changes
        Settings by name, in place of those of `settings`.

    Raises
    ------
    InputError, SamplingError, MemoryLimitError
        If a setting is not usable, or samples or memory do not hold what is asked for.
    """
    settings = (settings or ImageSettings()).replaced(**changes)
    validate_lengths(lens, settings)
    recording = _recording(lens, settings, placement)
    place, planes = recording.bench.placement, recording.plane_distances_mm
    patch, light = _patch_and_light(lens, thing, settings)
    light = recording.bench.light.on(light)
    target = _target(lens, patch, thing, settings)
    pixels = lens.sensor.pixels if settings.pixels == "all" else settings.pixels
    sensor = sensor_window(lens, patch, planes, pixels, place)
    check_footprint(lens, patch, sensor, planes, place)
    windows = [
        light_window(lens, patch, sensor, plane, recording.bench.at_plane(number))
        for number, plane in enumerate(planes)
    ]
    behind = light_on(light.with_values(light.values * target.transmission.values), place)
    del light
    limit = memory_limit(settings.memory_gb)
    with tiles_in(settings.cluster) as take:

        def make(scene: Scene) -> Engine:
            engine = imaging_engine(
                scene, settings, runs=1, memory_gb=1e-9 * limit, light=Light(behind).on(scene)
            )
            return take(WithGhost(engine, settings.ghost) if settings.ghost else engine)

        engine = make(recorded_scene(lens, patch, windows[0], recording))
        memory = Memory(need_of(imaging_arrays(engine, sensor, windows, recording)), limit)
        predicted_error = engine.predicted_error(Light(behind))
        scratch = scratch_in(folder, memory.room_for_arrays("this picture"))
        if before is not None:
            before(memory)
        if progress is not None:
            progress(f"engine {engine.name}", 0, 0)
        try:
            frames, share = image_patch(
                engine, behind, sensor, windows, recording, make, progress, folder=folder, scratch=scratch
            )
        except KeyboardInterrupt:
            kept = folder is not None and (folder / PARTS).exists()
            where = f"the same command goes on from what is kept in {folder}/{PARTS}"
            raise KeyboardInterrupt(f"interrupted; {where if kept else 'nothing is kept'}") from None
    told = diversity(lens, patch, planes)
    return Imaged(
        settings, patch, target, sensor, recording, engine, frames, share, told, memory, predicted_error
    )


def _patch_and_light(lens: Lens, thing: str | Field, settings: ImageSettings) -> tuple[Patch, Field]:
    if isinstance(thing, str):
        return lit_patch(lens, settings, settings.wavelength_um)
    if settings.patch_mm is not None or settings.object_pitch_um is not None:
        raise InputError("patch_mm, object_pitch_um: are those of the transmission given: leave them out")
    side_mm = 2.0 * min(thing.grid.half_widths_mm)
    at_mm = settings.field_stop_at_mm or (0.0, 0.0)
    patch = Patch(thing.grid, settings.field_stop_mm or side_mm, thing.wavelength_um, at_mm)
    return patch, lit(patch, settings)


def _target(lens: Lens, patch: Patch, thing: str | Field, settings: ImageSettings) -> Target:
    if isinstance(thing, Field):
        return Target("transmission", thing, (), "bright")
    return make_target(
        patch,
        thing,
        settings.ground,
        numerical_aperture=lens.object.numerical_aperture,
        seed=settings.seed,
        picture_pixel_um=settings.picture_pixel_um,
        picture_width_mm=settings.picture_width_mm,
        chart_at_mm=settings.chart_at_mm,
    )


def _bench(
    lens: Lens, settings: ImageSettings, placement: Placement | Pose | Bench | None, planes: int
) -> Bench:
    if placement is None:
        return settings.bench(lens, settings.pose, planes)
    if settings.pose != Pose() or settings.differs:
        raise SettingError(
            "{placement} says how the lens is mounted, and how light and sensor are: give no decenter, tilt "
            "or despace, and no errors of light, lens or sensor"
        )
    return bench_of(placement)


def _recording(lens: Lens, settings: ImageSettings, placement: Placement | Pose | Bench | None) -> Recording:
    """Planes, electronics, noise and errors of bench and pixels."""
    planes, errors = settings.planes_mm or lens.sensor.plane_distances_mm, settings.stage_error_mm
    if len(errors) not in (1, len(planes)):
        said = ",".join(f"{error:g}" for error in errors)
        raise SettingError(f"{{stage_error_mm}} = {said!r}: must be 1 or {len(planes)} numbers")
    exposures, longer = settings.exposures, settings.exposure_error
    if len(longer) not in (1, len(exposures)):
        said = ",".join(f"{error:g}" for error in longer)
        raise SettingError(f"{{exposure_error}} = {said!r}: must be 1 or {len(exposures)} numbers")
    pixels = PixelErrors(
        settings.prnu, settings.dsnu_electrons, settings.hot_pixels, settings.dead_pixels, settings.seed
    )
    electronics = {
        "full_well_electrons": settings.full_well_electrons,
        "read_noise_electrons": settings.read_noise_electrons,
        "bits": settings.bits,
        "fill_factor": settings.fill_factor,
        # Keeps the noise of dark pixels, and leaves counts for light where there are few.
        "offset_counts": min(64.0, 2.0**settings.bits / 16.0),
    }
    return Recording(
        tuple(sorted(planes)),
        validate(Electronics, electronics, "sensor"),
        settings.seed if settings.noise else None,
        settings.peak_fill,
        errors * len(planes) if len(errors) == 1 else errors,
        settings.shift_um,
        exposures,
        _bench(lens, settings, placement, len(planes)),
        pixels,
        longer * len(exposures) if len(longer) == 1 else longer,
    )
