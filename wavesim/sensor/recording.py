"""Recording of frames: the light behind the object propagates through the lens to the pixels of each plane.

A tiled engine propagates to every plane directly, at the true position of stage and sensor. It computes a
plane in bands of rows, so that the field of a plane need not fit in memory, and an interrupted run can
continue. Other engines propagate to the first plane; free-space propagation leads from there to the others.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import Lens, Sensor
from wavesim.engines.eikonal.tile_store import TileStore
from wavesim.fields.field import Field, Grid
from wavesim.fields.propagator import FreeSpacePropagator, propagate
from wavesim.fields.spectrum import BlockSpectrum, spectrum_support
from wavesim.runtime.checkpoint import digest_of, key_of
from wavesim.runtime.memory import MemoryNeed, in_memory, movable
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.scene import Scene, placed_scene
from wavesim.scene.source import SourceMode, with_components
from wavesim.scene.system_state import AS_DESIGNED, SystemState
from wavesim.sensor.camera_noise import Electronics, Seed, plane_seeds
from wavesim.sensor.colour_filters import ColourFilters
from wavesim.sensor.frames import Frame
from wavesim.sensor.incoherent import added_modes, of_mode
from wavesim.sensor.pixel_integration import PixelLight
from wavesim.sensor.pixels.non_uniformity import ALIKE, PixelErrors
from wavesim.sensor.sensor import (
    frames_of_light,
    light_on_pixels,
    on_sensor,
    sensor_grid,
    warn_of_footprint,
)
from wavesim.sensor.surface_scatter import (
    HALO_BYTES,
    halos_on_plane,
    scatter_of_patch,
    with_scattered_light,
)
from wavesim.sensor.windows import OVERSAMPLING
from wavesim.targets.patch import LIGHT_BYTES, Patch

BAND_ROWS = 1024
"""Rows of samples of a plane that are computed at a time."""

PARTS = ".parts"
"""Name of the subfolder for the intermediate results of an unfinished run."""

Progress = Callable[[str, int, int], None]
"""Progress callback `progress(stage, completed, total)`; the total is 0 where it is unknown."""


@dataclass(frozen=True)
class Recording:
    """Recording planes, sensor model and true state of the setup.

    Attributes
    ----------
    plane_distances_mm : tuple of float
        Distances from the exit vertex as the stage states them, increasing.
    electronics : Electronics
        Full well, noise and quantisation.
    seed : int, numpy.random.SeedSequence or None
        Seed of the noise; None for frames without noise.
    peak_fill : float
        Expected electrons in the brightest pixel at an exposure of 1, as a fraction of full well.
    exposures : tuple of float
        Exposures of the frames of each plane, relative to the exposure that reaches `peak_fill`.
    state : SystemState
        True position of the sensor on each plane relative to the stated one, light source, and backgrounds.
    pixel_errors : PixelErrors
        Non-uniformity of the pixels.
    exposure_errors : tuple of float
        Relative errors (true over stated exposure, minus 1) of each exposure; default: no errors.
    colours : ColourFilters or None
        Wavelengths that are recorded at once, and the responses of the pixels; None for one wavelength.
    """

    plane_distances_mm: tuple[float, ...]
    electronics: Electronics
    seed: Seed | None = 0
    peak_fill: float = 0.8
    exposures: tuple[float, ...] = (1.0,)
    state: SystemState = AS_DESIGNED
    pixel_errors: PixelErrors = ALIKE
    exposure_errors: tuple[float, ...] = ()
    colours: ColourFilters | None = None


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
    ghosts: Sequence[Array] = (),
    others: Sequence[Field] = (),
) -> tuple[tuple[Frame, ...], float]:
    """Propagate the light behind the object to the sensor, and record frames on every plane.

    Rough surfaces of the lens scatter a part of the light (:mod:`wavesim.sensor.surface_scatter`).

    Parameters
    ----------
    engine
        Engine from the patch to the window of the first plane (:func:`recorded_scene`).
    behind_object
        Field behind the object: illumination times transmission.
    sensor
        Sensor window that records.
    windows
        One window for each plane that covers all of its light (:func:`wavesim.sensor.windows.light_window`).
    recording
        Planes, noise and errors.
    make
        Function that returns the engine for another plane or wavelength; required with a tiled engine.
    progress
        Callback `progress(stage, completed, total)`; the total is 0 where it is unknown.
    folder
        Folder whose subfolder `PARTS` holds intermediate results of a tiled engine until :func:`drop_parts`.
        The same call continues an interrupted run. Default: the results stay in memory.
    scratch
        Storage of large arrays; default: memory.
    ghosts
        Smooth light of ghosts on the pixels of each plane, as fractions of the direct light
        (:func:`wavesim.sensor.ghost_light.ghost_light`); default: none.
    others
        Fields behind the object at the further wavelengths of `recording.colours`, in their order.

    Returns
    -------
    frames : tuple of Frame
        Frames ordered by plane, then by exposure.
    fraction_beyond_pixels : float
        Fraction of the energy on the first plane at frequencies beyond the Nyquist limit of the pixels.

    Raises
    ------
    InputError, SamplingError
        If a setting is invalid, the sampling is too coarse for the propagation, or the disk is full.
    """
    if isinstance(engine, Tiled) and make is None:
        raise InputError(
            f"make: missing; engine {engine.name} needs a function that makes an engine for each plane"
        )
    if isinstance(engine, Tiled) and any(recording.state.sensor_tilt_deg):
        raise InputError(
            f"sensor_tilt_deg: must be 0 with engine {engine.name}; for a tilted sensor use another engine, "
            "such as eikonal with hierarchical = False"
        )
    report_progress = progress or (lambda stage, completed, total: None)

    def light_of(lit: Field, prefix: str) -> Iterator[tuple[Array, float]]:
        """Yield one wavelength's light on the pixels of each plane, and its fraction beyond the limit."""
        own = engine
        if lit.wavelength_um != behind_object.wavelength_um:
            if make is None:
                raise InputError(
                    "make: missing; light of several wavelengths needs a function that makes an engine for "
                    "each"
                )
            own = make(replace(engine.scene, wavelength_um=lit.wavelength_um))

        def light_of_mode(mode: SourceMode, of_mode_prefix: str) -> Iterator[tuple[Array, float]]:
            mode_engine, lit_by_mode = of_mode(own, lit, mode, make)
            if not isinstance(mode_engine, Tiled):
                return _light_through_free_space(
                    mode_engine, lit_by_mode, sensor, windows, recording, report_progress
                )
            assert make is not None
            mode_folder = None if folder is None else folder / PARTS / prefix / of_mode_prefix
            return _light_of_tiles(
                mode_engine,
                lit_by_mode,
                sensor,
                windows,
                recording,
                make,
                report_progress,
                folder=mode_folder,
                scratch=scratch,
            )

        modes = modes_of(own, recording, lit.grid)
        direct = light_of_mode(modes[0], "") if len(modes) == 1 else added_modes(modes, light_of_mode)
        scatter = scatter_of_patch(
            engine.scene.lens, lit.grid, lit.wavelength_um, recording.plane_distances_mm, recording.state
        )
        for index, (light, beyond) in enumerate(direct):
            total = with_scattered_light(light, sensor.pixel_pitch_um, halos_on_plane(scatter, index))
            if ghosts:
                total = total + (float(light.sum()) * ghosts[index]).astype(light.dtype)
            yield total, beyond

    light: Iterator[tuple[Array, float]] = light_of(behind_object, "")
    if recording.colours is not None:
        lights = [light, *(light_of(lit, f"{lit.wavelength_um:g}_um") for lit in others)]
        light = _sums_of_colours(lights, recording.colours, sensor.pixels[::-1])
    frames, fraction_beyond = list[Frame](), 0.0
    seeds = plane_seeds(recording.seed, len(windows))
    pattern = recording.pixel_errors.pattern(sensor.pixels[::-1], recording.electronics.full_well_electrons)
    for index, (seed, (intensity, beyond)) in enumerate(zip(seeds, light, strict=True)):
        fraction_beyond = beyond if index == 0 else fraction_beyond
        frames += frames_of_light(
            _with_background(intensity, recording.state.background_on(index, intensity.shape)),
            sensor,
            recording.plane_distances_mm[index],
            behind_object.wavelength_um,
            recording.electronics,
            seed,
            recording.exposures,
            recording.peak_fill,
            pattern=pattern,
            exposure_errors=_exposure_errors(recording, index),
            colours=recording.colours,
        )
    return tuple(frames), fraction_beyond


def _sums_of_colours(
    lights: Sequence[Iterator[tuple[Array, float]]], colours: ColourFilters, shape: tuple[int, int]
) -> Iterator[tuple[Array, float]]:
    """Yield, for each plane, the light of all wavelengths that pixels measure behind their filters."""
    responses = colours.on_pixels(shape)
    for of_wavelengths in zip(*lights, strict=True):
        pairs = list(zip(of_wavelengths, responses, strict=True))
        measured = [(response * light).astype(light.dtype) for (light, _), response in pairs]
        energies = [float(light.sum()) for light in measured]
        beyond = sum(energy * one for energy, ((_, one), _) in zip(energies, pairs, strict=True))
        yield sum(measured[1:], start=measured[0]), beyond / sum(energies)


def modes_of(engine: Engine, recording: Recording, object_grid: Grid) -> list[SourceMode]:
    """Return the modes of the light: directions, wavelengths, and components of the field."""
    source = recording.state.source
    modes = source.modes(engine.scene.wavelength_um, samples=max(object_grid.shape))
    return with_components(modes, engine.components)


def _exposure_errors(recording: Recording, index: int) -> tuple[float, ...]:
    """Return the relative error of each exposure on a plane, with that of the plane."""
    of_plane = 1.0 + recording.state.exposure_error(index)
    errors = recording.exposure_errors or (0.0,) * len(recording.exposures)
    return tuple((1.0 + error) * of_plane - 1.0 for error in errors)


def imaging_bytes(
    engine: Engine, sensor: Sensor, windows: Sequence[Sensor], recording: Recording
) -> MemoryNeed:
    """Return the memory of :func:`image_patch` and of the writing of its results, with the process itself.

    The bytes per sample are measured; the estimate is within 30 % of the peak of a process.

    Parameters
    ----------
    engine
        Engine for the first plane.
    sensor, windows, recording
        See :func:`image_patch`.
    """
    (across, down), planes = sensor.pixels, len(windows)
    object_grid = engine.scene.object_grid
    modes = len(modes_of(engine, recording, object_grid))
    # Counts of all frames, and for an extended source the intensities of modes and their sums.
    frame_bytes = 2 * len(recording.exposures) + (16 if modes > 1 else 0)
    held = 300_000_000 + engine.cost().peak_bytes_in_single + frame_bytes * planes * across * down
    held += LIGHT_BYTES * object_grid.size
    if any(surface.roughness is not None for surface in engine.scene.lens.surfaces):
        held += HALO_BYTES * across * down
    if not isinstance(engine, Tiled):
        # With several planes: two fields and the work arrays of the free-space propagation between them.
        fields = 1 if planes == 1 else 4
        window = max(math.prod(window.pixels) for window in windows) * OVERSAMPLING**2
        return in_memory(held + 16 * fields * window)
    row = max(window.pixels[0] for window in windows) * OVERSAMPLING
    bands = 4 * 8 * row * min(BAND_ROWS, down * OVERSAMPLING)
    light_on_rows, light_on_pixels = 4 * OVERSAMPLING * across * down, 8 * across * down
    files = MemoryNeed(0, 0, engine.sums_bytes * planes * modes)
    return in_memory(held + bands + light_on_pixels) + movable(light_on_rows) + files


def _with_background(intensity: Array, fractions: Array | None) -> Array:
    """Add a background that makes up fractions of the mean of the total light."""
    if fractions is None:
        return intensity
    total = float(intensity.mean()) / (1.0 - float(fractions.mean()))
    return np.asarray(intensity + (total * fractions).astype(intensity.dtype))


def _light_through_free_space(
    engine: Engine,
    behind_object: Field,
    sensor: Sensor,
    windows: Sequence[Sensor],
    recording: Recording,
    report_progress: Progress,
) -> Iterator[tuple[Array, float]]:
    """Yield light on the pixels of each plane, and the first plane's fraction beyond the Nyquist limit."""
    report_progress("through the lens", 0, len(windows))
    fill_factor, fraction_beyond = recording.electronics.fill_factor, 0.0
    for index, field in enumerate(fields_on_sensor(engine, behind_object, windows, recording)):
        report_progress(f"plane {index + 1}", index, len(windows))
        if index == 0:
            limit = 500.0 / sensor.pixel_pitch_um
            fraction_beyond = spectrum_support(field.values, field.grid.pitch_mm, limit).fraction_beyond
        intensity = light_on_pixels(
            field,
            sensor,
            fill_factor=fill_factor,
            oversampling=OVERSAMPLING,
            blur_um=recording.state.vibration_um,
        )
        del field  # frees memory for the field of the next plane
        yield intensity, fraction_beyond


def _light_of_tiles(
    engine: Tiled,
    behind_object: Field,
    sensor: Sensor,
    windows: Sequence[Sensor],
    recording: Recording,
    make: Callable[[Scene], Engine],
    report_progress: Progress,
    *,
    folder: Path | None,
    scratch: Scratch | None,
) -> Iterator[tuple[Array, float]]:
    """Yield light and fraction beyond the Nyquist limit for each plane, with one tiled engine per plane."""
    scene, fill_factor = engine.scene, recording.electronics.fill_factor
    blur_pixels = recording.state.vibration_um / sensor.pixel_pitch_um
    for index, window in enumerate(windows):
        plane_scene = replace(scene, exit_grid=_plane_grid(scene.lens, window, index, recording))
        plane_engine = engine if plane_scene.exit_grid == scene.exit_grid else make(plane_scene)
        assert isinstance(plane_engine, Tiled)
        yield _light_in_bands(
            plane_engine,
            behind_object,
            sensor,
            PixelLight(sensor, np.complex64, OVERSAMPLING, fill_factor, scratch, blur_pixels),
            _tile_results(folder, index, plane_engine, behind_object),
            partial(report_progress, f"plane {index + 1}"),
        )


def drop_parts(folder: Path) -> None:
    """Remove the intermediate results of a run from its output folder."""
    shutil.rmtree(folder / PARTS, ignore_errors=True)


def _plane_grid(lens: Lens, window: Sensor, index: int, recording: Recording) -> Grid:
    """Return the grid of a window at the true position of stage and sensor, without the sensor's tilt."""
    pose = recording.state.sensor_pose(index)
    z_mm = lens.exit_vertex_z_mm + recording.plane_distances_mm[index] + pose.distance_mm
    return replace(sensor_grid(window, z_mm, OVERSAMPLING), centre_mm=pose.shift_mm)


def recorded_scene(lens: Lens, patch: Patch, window: Sensor, recording: Recording) -> Scene:
    """Return the scene between a patch and a window on the first plane, at their true positions."""
    nominal = Scene(lens, patch.grid, _plane_grid(lens, window, 0, recording), patch.wavelength_um)
    return placed_scene(nominal, recording.state)


def fields_on_sensor(
    engine: Engine, behind_object: Field, windows: Sequence[Sensor], recording: Recording
) -> Iterator[Field]:
    """Propagate the light behind the object to each plane, through free space from the engine's exit grid.

    Parameters
    ----------
    engine
        Engine to the window of the first plane (:func:`recorded_scene`).
    behind_object, windows, recording
        See :func:`image_patch`.

    Yields
    ------
    Field
        Field on the window of each plane, in the coordinates of the sensor.

    Raises
    ------
    InputError, SamplingError
        If the sampling is too coarse for the propagation.
    """
    grids = [_plane_grid(engine.scene.lens, window, index, recording) for index, window in enumerate(windows)]
    exit_grid = engine.scene.exit_grid
    for grid in grids:
        if grid != exit_grid:  # before the engine's work
            try:
                FreeSpacePropagator(exit_grid, grid, behind_object.wavelength_um).check_samples()
            except SamplingError as error:
                advice = "or engine hierarchical, for scalar waves and a sensor without tilt"
                raise SamplingError(f"{error}, {advice}") from None
    first = engine.forward(behind_object)
    for grid in grids:
        tilt_deg = recording.state.sensor_tilt_deg
        yield on_sensor(first if grid == first.grid else propagate(first, grid), tilt_deg)


def _light_in_bands(
    engine: Tiled,
    behind_object: Field,
    sensor: Sensor,
    light: PixelLight,
    sums: MutableMapping[int, NDArray],
    report_progress: Callable[[int, int], None],
) -> tuple[Array, float]:
    """Return the light on the pixels of one plane, and its fraction beyond the Nyquist limit."""
    grid = engine.scene.exit_grid
    sensor_samples = replace(sensor_grid(sensor, grid.z_mm, OVERSAMPLING), centre_mm=grid.centre_mm)
    window_slices = sensor_samples.samples_among(grid)
    assert window_slices is not None  # windows are at least as wide as the sensor
    rows, columns = window_slices
    spectrum, total = BlockSpectrum(grid.pitch_mm), 0.0
    steps = engine.parts + math.ceil(grid.shape[0] / BAND_ROWS)
    engine.progress = lambda done, _: report_progress(done, steps)
    try:
        bands = engine.forward_in_bands(behind_object, BAND_ROWS, sums)
        for step, (band, values) in enumerate(bands, start=engine.parts + 1):
            report_progress(step, steps)
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


def _tile_results(
    folder: Path | None, index: int, engine: Tiled, field: Field
) -> MutableMapping[int, NDArray[Any]]:
    """Return the store of the super-tiles' fields of one plane: a folder, or a dict in memory."""
    if folder is None:
        return {}
    lit = digest_of(field.values)
    store = TileStore(folder / f"plane_{index + 1}", key_of(engine.key(), lit))
    try:
        store.check_free_space(engine.sums_bytes)
    except InputError:
        if not store:
            store.drop()
        raise
    return store
