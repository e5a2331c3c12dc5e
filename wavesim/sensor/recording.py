"""From light behind the object to frames: through the lens, onto the pixels, plane by plane.

Where an engine carries light to any plane alike, it does so for each, true to where the stage and the sensor
stand, and the plane is made in bands of rows: the light of a whole field on a plane need not fit into memory,
and what a run that was cut off has done is not done again. Other engines carry light to the first plane, and
free space from there.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, Sensor
from wavesim.engines.whole_field.tile_store import TileStore
from wavesim.fields.field import Field, Grid
from wavesim.fields.propagator import propagate
from wavesim.fields.spectrum import BlockSpectrum, spectrum_support
from wavesim.runtime.checkpoint import digest_of, key_of
from wavesim.runtime.scratch import Scratch
from wavesim.scene.bench import AS_DESIGNED, Bench
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.scene import Scene, placed_scene
from wavesim.scene.source import SourceMode
from wavesim.sensor.exposures import Electronics, Seed, plane_seeds
from wavesim.sensor.frames import Frame
from wavesim.sensor.incoherent import added_modes, of_mode
from wavesim.sensor.pixel_integration import PixelLight
from wavesim.sensor.pixels.errors import ALIKE, PixelErrors
from wavesim.sensor.sensor import (
    frames_of_light,
    light_on_pixels,
    on_sensor,
    sensor_grid,
    warn_of_footprint,
)
from wavesim.sensor.windows import OVERSAMPLING
from wavesim.targets.patch import Patch

BAND_ROWS = 1024
"""Of a plane's samples, made at one time."""

PARTS = ".parts"
"""Folder within the results' in which finished parts of an unfinished run lie."""

Progress = Callable[[str, int, int], None]
"""Told what is done, how many parts of it are, and of how many."""


@dataclass(frozen=True)
class Recording:
    """How the sensor records.

    Attributes
    ----------
    plane_distances_mm : tuple of float
        From the exit vertex, as the stage states them, increasing.
    electronics : Electronics
        Full well, noise and quantisation.
    seed : int, numpy.random.SeedSequence or None
        Of the noise; None for none.
    peak_fill
        Of full well, in the brightest pixel of a frame with an exposure of 1.
    stage_errors_mm : tuple of float
        How much farther from the lens each plane is than stated.
    shift_um : (x, y)
        By how much the sensor moves from one plane to the next.
    exposures : tuple of float
        Of the frames of each plane, in units of the one that puts `peak_fill` into the brightest pixel.
    bench : Bench
        How far the planes and the sensor's middle are from where they should be, beside all this, the
        sensor's tilt, the light's source, and the backgrounds.
    pixel_errors : PixelErrors
        How unlike the pixels are.
    exposure_errors : tuple of float
        How much longer each exposure is than frames say, as a share; none if left out.
    """

    plane_distances_mm: tuple[float, ...]
    electronics: Electronics
    seed: Seed | None = 0
    peak_fill: float = 0.8
    stage_errors_mm: tuple[float, ...] = ()
    shift_um: tuple[float, float] = (0.0, 0.0)
    exposures: tuple[float, ...] = (1.0,)
    bench: Bench = AS_DESIGNED
    pixel_errors: PixelErrors = ALIKE
    exposure_errors: tuple[float, ...] = ()

    def error_mm(self, number: int) -> float:
        """How much farther from the lens a plane is than stated."""
        of_stage = self.stage_errors_mm[number] if self.stage_errors_mm else 0.0
        return of_stage + self.bench.placement.plane_distance_mm(number)

    def place_um(self, number: int) -> tuple[float, float]:
        """Where the sensor's middle is on a plane (x, y)."""
        x_mm, y_mm = self.bench.shift_mm(number)
        return number * self.shift_um[0] + 1e3 * x_mm, number * self.shift_um[1] + 1e3 * y_mm


def image_patch(
    engine: Engine,
    behind_object: Field,
    sensor: Sensor,
    windows: Sequence[Sensor],
    recording: Recording,
    make: Callable[[Scene], Engine] | None = None,
    progress: Progress | None = None,
    *,
    folder: Path | None = None,
    scratch: Scratch | None = None,
) -> tuple[tuple[Frame, ...], float]:
    """Carry light from behind the object to the sensor, and record it on every plane.

    Parameters
    ----------
    engine
        From the patch to the first plane's window (:func:`recorded_scene`).
    behind_object
        Illumination times transmission.
    sensor
        Whose pixels record.
    windows
        For each plane, a window that holds all light (:func:`light_window`).
    recording
        Planes, noise and errors.
    make
        Makes engines for other planes, where that is better than free space; needed with such an engine.
    progress
        Told what is done.
    folder
        Where finished parts of a whole field are kept (in a folder `PARTS`) until :func:`drop_parts`, so that
        a run which was cut off goes on; left out, they stay in memory.
    scratch
        Where large arrays lie.

    Returns
    -------
    frames : tuple of Frame
        As recorded: plane by plane, and of each plane its exposures.
    share_beyond_pixels : float
        Share of the light's energy on the first plane at frequencies beyond those that pixels resolve.

    Raises
    ------
    InputError, SamplingError
        If a setting is not usable, samples cannot hold the light on its way, or the folder's disk is full.
    """
    if isinstance(engine, Tiled) and make is None:
        raise InputError(f"make: engine {engine.name} needs one for each plane")
    if isinstance(engine, Tiled) and any(recording.bench.placement.sensor_tilt_deg):
        raise InputError(f"sensor_tilt_deg: engine {engine.name} records on upright planes alone")
    tell = progress or (lambda what, done, count: None)

    def through(mode: SourceMode, prefix: str) -> Iterator[tuple[Array, float]]:
        own, lit = of_mode(engine, behind_object, mode, make)
        if not isinstance(own, Tiled):
            return _light_through_free_space(own, lit, sensor, windows, recording, tell)
        assert make is not None
        kept = None if folder is None else folder / PARTS / prefix
        return _light_of_tiles(own, lit, sensor, windows, recording, make, tell, folder=kept, scratch=scratch)

    modes = recording.bench.source.modes(behind_object.wavelength_um)
    light = through(modes[0], "") if len(modes) == 1 else added_modes(modes, through)
    frames, share = list[Frame](), 0.0
    seeds = plane_seeds(recording.seed, len(windows))
    pattern = recording.pixel_errors.pattern(sensor.pixels[::-1], recording.electronics.full_well_electrons)
    for number, (seed, (intensity, beyond)) in enumerate(zip(seeds, light, strict=True)):
        share = beyond if number == 0 else share
        frames += frames_of_light(
            _with_background(intensity, recording.bench.background(number)),
            sensor,
            recording.plane_distances_mm[number],
            behind_object.wavelength_um,
            recording.electronics,
            seed,
            recording.exposures,
            recording.peak_fill,
            pattern=pattern,
            exposure_errors=recording.exposure_errors,
        )
    return tuple(frames), share


def _with_background(intensity: Array, share: float) -> Array:
    """Intensity with even light that is a share of the whole."""
    if not share:
        return intensity
    return np.asarray(intensity + float(intensity.mean()) * share / (1.0 - share))


def _light_through_free_space(
    engine: Engine,
    behind_object: Field,
    sensor: Sensor,
    windows: Sequence[Sensor],
    recording: Recording,
    tell: Progress,
) -> Iterator[tuple[Array, float]]:
    """Light on the pixels of each plane, and of the first its share beyond what they resolve."""
    tell("through the lens", 0, len(windows))
    width, share = recording.electronics.fill_factor, 0.0
    for number, field in enumerate(fields_on_sensor(engine, behind_object, windows, recording)):
        tell(f"plane {number + 1}", number, len(windows))
        if number == 0:
            limit = 500.0 / sensor.pixel_pitch_um
            share = spectrum_support(field.values, field.grid.pitch_mm, limit).fraction_beyond
        intensity = light_on_pixels(field, sensor, fill_factor=width, oversampling=OVERSAMPLING)
        del field  # the next plane's takes as much
        yield intensity, share


def _light_of_tiles(
    engine: Tiled,
    behind_object: Field,
    sensor: Sensor,
    windows: Sequence[Sensor],
    recording: Recording,
    make: Callable[[Scene], Engine],
    tell: Progress,
    *,
    folder: Path | None,
    scratch: Scratch | None,
) -> Iterator[tuple[Array, float]]:
    """Light on the pixels of each plane, and its share beyond what they resolve, by an engine for each."""
    scene, width = engine.scene, recording.electronics.fill_factor
    for number, window in enumerate(windows):
        here = replace(scene, exit_grid=_plane_grid(scene.lens, window, number, recording))
        own = engine if here.exit_grid == scene.exit_grid else make(here)
        assert isinstance(own, Tiled)
        yield _light_in_bands(
            own,
            behind_object,
            sensor,
            PixelLight(sensor, np.complex64, OVERSAMPLING, width, scratch),
            _parts(folder, number, own, behind_object),
            lambda *told, n=number: tell(f"plane {n + 1}", *told),
        )


def drop_parts(folder: Path) -> None:
    """Remove what was kept of a run whose results are written."""
    shutil.rmtree(folder / PARTS, ignore_errors=True)


def _plane_grid(lens: Lens, window: Sensor, number: int, recording: Recording) -> Grid:
    """Samples of a window on a plane where the stage and the sensor truly stand, the sensor's tilt aside."""
    z_mm = lens.exit_vertex_z_mm + recording.plane_distances_mm[number] + recording.error_mm(number)
    x_um, y_um = recording.place_um(number)
    return replace(sensor_grid(window, z_mm, OVERSAMPLING), centre_mm=(1e-3 * x_um, 1e-3 * y_um))


def recorded_scene(lens: Lens, patch: Patch, window: Sensor, recording: Recording) -> Scene:
    """The scene between a patch and a window on the first plane, all where they truly are."""
    nominal = Scene(lens, patch.grid, _plane_grid(lens, window, 0, recording), patch.wavelength_um)
    return placed_scene(nominal, recording.bench.placement)


def fields_on_sensor(
    engine: Engine, behind_object: Field, windows: Sequence[Sensor], recording: Recording
) -> Iterator[Field]:
    """Carry light from behind the object to each plane, through free space from the engine's exit grid.

    Parameters
    ----------
    engine
        To the first plane's window (:func:`recorded_scene`).
    behind_object, windows, recording
        As of :func:`image_patch`.

    Yields
    ------
    Field
        On the window, in the frame of the sensor.

    Raises
    ------
    InputError, SamplingError
        If samples cannot hold the light on its way.
    """
    first = engine.forward(behind_object)
    for number, window in enumerate(windows):
        grid = _plane_grid(engine.scene.lens, window, number, recording)
        tilt_deg = recording.bench.placement.sensor_tilt_deg
        yield on_sensor(first if grid == first.grid else propagate(first, grid), tilt_deg)


def _light_in_bands(
    engine: Tiled,
    behind_object: Field,
    sensor: Sensor,
    light: PixelLight,
    sums: MutableMapping[int, NDArray],
    tell: Callable[[int, int], None],
) -> tuple[Array, float]:
    """A whole field's light on the pixels of one plane, and its share beyond what they resolve."""
    grid = engine.scene.exit_grid
    own = replace(sensor_grid(sensor, grid.z_mm, OVERSAMPLING), centre_mm=grid.centre_mm)
    part = own.samples_among(grid)
    assert part is not None  # windows are as wide as the sensor at least
    rows, columns = part
    spectrum, total = BlockSpectrum(grid.pitch_mm), 0.0
    steps = engine.parts + math.ceil(grid.shape[0] / BAND_ROWS)
    engine.progress = lambda done, _: tell(done, steps)
    try:
        bands = engine.forward_in_bands(behind_object, BAND_ROWS, sums)
        for step, (band, values) in enumerate(bands, start=engine.parts + 1):
            tell(step, steps)
            total += float(np.vdot(values, values).real)
            spectrum.add(values)
            start, stop = max(band.start, rows.start), min(band.stop, rows.stop)
            if start < stop:
                inside = values[start - band.start : stop - band.start, columns]
                light.add(slice(start - rows.start, stop - rows.start), inside)
    finally:
        engine.progress = None
    warn_of_footprint(light.caught, total, sensor)
    return light.means(), spectrum.fraction_beyond(500.0 / sensor.pixel_pitch_um)


def _parts(
    folder: Path | None, number: int, engine: Tiled, field: Field
) -> MutableMapping[int, NDArray[Any]]:
    """Where super-tiles' fields of one plane are kept."""
    if folder is None:
        return {}
    lit = digest_of(field.values)
    kept = TileStore(folder / f"plane_{number + 1}", key_of(engine.key(), lit))
    try:
        kept.check_free_space(engine.sums_bytes)
    except InputError:
        if not kept:
            kept.drop()
        raise
    return kept
