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
from wavesim.sensor.camera_noise import Seed, plane_seeds
from wavesim.sensor.colour_filters import ColourFilters
from wavesim.sensor.frames import Frame
from wavesim.sensor.incoherent import added_modes, of_mode
from wavesim.sensor.pixel_integration import PixelLight
from wavesim.sensor.sensor import (
    Camera,
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
    """Recording planes, camera and true state of the setup.

    Attributes
    ----------
    camera : Camera
        Sensor, electronics and exposures.
    plane_distances_mm : tuple of float
        Distances from the exit vertex as the stage states them, increasing.
    seed : int, numpy.random.SeedSequence or None
        Seed of the noise; None for frames without noise.
    state : SystemState
        True position of the sensor on each plane relative to the stated one, light source, and backgrounds.
    windows : tuple of Sensor
        A window for each plane that covers all of its light (:func:`wavesim.sensor.windows.light_window`).
        Default: the camera's sensor.
    """

    camera: Camera
    plane_distances_mm: tuple[float, ...]
    seed: Seed | None = 0
    state: SystemState = AS_DESIGNED
    windows: tuple[Sensor, ...] = ()

    @property
    def sensor(self) -> Sensor:
        """Sensor window that records."""
        return self.camera.sensor

    def grids(self, exit_vertex_z_mm: float) -> list[Grid]:
        """Return the grid of each plane at the true position of stage and sensor, without its tilt."""
        windows = self.windows or (self.sensor,) * len(self.plane_distances_mm)
        poses = [self.state.sensor_pose(index) for index in range(len(windows))]
        planes = zip(windows, self.plane_distances_mm, poses, strict=True)
        return [
            replace(
                sensor_grid(window, exit_vertex_z_mm + distance_mm + pose.distance_mm, OVERSAMPLING),
                centre_mm=pose.shift_mm,
            )
            for window, distance_mm, pose in planes
        ]

    def scene(self, lens: Lens, patch: Patch, **changes: Any) -> Scene:
        """Return the scene between a patch and the first plane, at their true positions.

        Parameters
        ----------
        lens, patch
            Lens and patch of the object.
        **changes
            Further fields of the scene, such as its coating.
        """
        nominal = Scene(
            lens, patch.grid, self.grids(lens.exit_vertex_z_mm)[0], patch.wavelength_um, **changes
        )
        return placed_scene(nominal, self.state)


@dataclass(frozen=True, eq=False)
class Recorder:
    """Engines that propagate the light behind an object to the sensor, which records it on every plane.

    Rough surfaces of the lens scatter a part of the light (:mod:`wavesim.sensor.surface_scatter`).

    Attributes
    ----------
    recording : Recording
        Camera, planes and errors.
    engine : Engine
        Engine from the patch to the window of the first plane (:meth:`Recording.scene`).
    make : callable or None
        Function that returns the engine for another plane or wavelength; required with a tiled engine.
    progress : callable
        Callback `progress(stage, completed, total)`; the total is 0 where it is unknown.
    folder : Path or None
        Folder whose subfolder `PARTS` holds intermediate results of a tiled engine until :func:`drop_parts`.
        The same recording continues an interrupted one. Default: the results stay in memory.
    scratch : Scratch or None
        Storage of large arrays; default: memory.

    Raises
    ------
    InputError
        If a tiled engine has no function for further ones, or the sensor is tilted.
    """

    recording: Recording
    engine: Engine
    make: Callable[[Scene], Engine] | None = None
    progress: Progress = lambda stage, completed, total: None
    folder: Path | None = None
    scratch: Scratch | None = None

    def __post_init__(self) -> None:
        if isinstance(self.engine, Tiled) and self.make is None:
            raise InputError(
                f"make: missing; engine {self.engine.name} needs a function that makes an engine for each "
                "plane"
            )
        if isinstance(self.engine, Tiled) and any(self.recording.state.sensor_tilt_deg):
            raise InputError(
                f"sensor_tilt_deg: must be 0 with engine {self.engine.name}; for a tilted sensor use another "
                "engine, such as eikonal with hierarchical = False"
            )

    def frames(
        self, behind_object: Field, others: Sequence[Field] = (), ghosts: Sequence[Array] = ()
    ) -> tuple[tuple[Frame, ...], float]:
        """Return the frames of an object.

        Parameters
        ----------
        behind_object
            Field behind the object: illumination times transmission.
        others
            Fields behind the object at the further wavelengths of the camera's colours, in their order.
        ghosts
            Smooth light of ghosts on the pixels of each plane, as fractions of the direct light
            (:func:`wavesim.sensor.ghost_light.ghost_light`); default: none.

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
        recording, camera = self.recording, self.recording.camera
        light = self._light(behind_object, self.engine, "", ghosts)
        if camera.colours is not None:
            lights = [light, *(self._light_of_colour(lit, ghosts) for lit in others)]
            light = _sums_of_colours(lights, camera.colours, camera.sensor.pixels[::-1])
        frames, fraction_beyond = list[Frame](), 0.0
        planes_mm, state = recording.plane_distances_mm, recording.state
        seeds = plane_seeds(recording.seed, len(planes_mm))
        for index, (distance_mm, seed, (intensity, beyond)) in enumerate(
            zip(planes_mm, seeds, light, strict=True)
        ):
            fraction_beyond = beyond if index == 0 else fraction_beyond
            frames += camera.frames(
                _with_background(intensity, state.background_on(index, intensity.shape)),
                distance_mm,
                behind_object.wavelength_um,
                seed,
                state.exposure_error(index),
            )
        return tuple(frames), fraction_beyond

    def modes(self, engine: Engine, object_grid: Grid) -> list[SourceMode]:
        """Return the modes of the light: directions, wavelengths, and components of the field."""
        source = self.recording.state.source
        modes = source.modes(engine.scene.wavelength_um, samples=max(object_grid.shape))
        return with_components(modes, engine.components)

    def memory(self) -> MemoryNeed:
        """Return the memory of :meth:`frames` and of the writing of its results, with the process itself.

        The bytes per sample are measured; the estimate is within 30 % of the peak of a process.
        """
        recording, engine = self.recording, self.engine
        (across, down), planes = recording.sensor.pixels, len(recording.plane_distances_mm)
        windows, object_grid = recording.windows or (recording.sensor,), engine.scene.object_grid
        modes = len(self.modes(engine, object_grid))
        # Counts of all frames, and for an extended source the intensities of modes and their sums.
        frame_bytes = 2 * len(recording.camera.exposures) + (16 if modes > 1 else 0)
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

    def fields(self, behind_object: Field) -> Iterator[Field]:
        """Propagate the light behind an object to each plane, through free space from the exit grid.

        Yields
        ------
        Field
            Field on the window of each plane, in the coordinates of the sensor.

        Raises
        ------
        InputError, SamplingError
            If the sampling is too coarse for the propagation.
        """
        return self._fields(self.engine, behind_object)

    def _fields(self, engine: Engine, behind_object: Field) -> Iterator[Field]:
        grids = self._grids(engine)
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
            tilt_deg = self.recording.state.sensor_tilt_deg
            yield on_sensor(first if grid == first.grid else propagate(first, grid), tilt_deg)

    def _grids(self, engine: Engine) -> list[Grid]:
        return self.recording.grids(engine.scene.lens.exit_vertex_z_mm)

    def _light_of_colour(self, lit: Field, ghosts: Sequence[Array]) -> Iterator[tuple[Array, float]]:
        """Yield the light of a further wavelength, by an engine of its own that is made when it is due."""
        if self.make is None:
            raise InputError(
                "make: missing; light of several wavelengths needs a function that makes an engine for each"
            )
        engine = self.make(replace(self.engine.scene, wavelength_um=lit.wavelength_um))
        yield from self._light(lit, engine, f"{lit.wavelength_um:g}_um", ghosts)

    def _light(
        self, lit: Field, engine: Engine, prefix: str, ghosts: Sequence[Array]
    ) -> Iterator[tuple[Array, float]]:
        """Yield one wavelength's light on the pixels of each plane, and its fraction beyond the limit."""

        def light_of_mode(mode: SourceMode, of_mode_prefix: str) -> Iterator[tuple[Array, float]]:
            mode_engine, lit_by_mode = of_mode(engine, lit, mode, self.make)
            if not isinstance(mode_engine, Tiled):
                return self._light_through_free_space(mode_engine, lit_by_mode)
            folder = None if self.folder is None else self.folder / PARTS / prefix / of_mode_prefix
            return self._light_of_tiles(mode_engine, lit_by_mode, folder)

        modes, recording = self.modes(engine, lit.grid), self.recording
        direct = light_of_mode(modes[0], "") if len(modes) == 1 else added_modes(modes, light_of_mode)
        scatter = scatter_of_patch(
            self.engine.scene.lens, lit.grid, lit.wavelength_um, recording.plane_distances_mm, recording.state
        )
        for index, (light, beyond) in enumerate(direct):
            total = with_scattered_light(
                light, recording.sensor.pixel_pitch_um, halos_on_plane(scatter, index)
            )
            if ghosts:
                total = total + (float(light.sum()) * ghosts[index]).astype(light.dtype)
            yield total, beyond

    def _light_through_free_space(
        self, engine: Engine, behind_object: Field
    ) -> Iterator[tuple[Array, float]]:
        """Yield light on the pixels of each plane, and the first plane's fraction beyond the limit."""
        recording, sensor = self.recording, self.recording.sensor
        planes, fraction_beyond = len(recording.plane_distances_mm), 0.0
        self.progress("through the lens", 0, planes)
        for index, field in enumerate(self._fields(engine, behind_object)):
            self.progress(f"plane {index + 1}", index, planes)
            if index == 0:
                limit = 500.0 / sensor.pixel_pitch_um
                fraction_beyond = spectrum_support(field.values, field.grid.pitch_mm, limit).fraction_beyond
            intensity = light_on_pixels(
                field,
                sensor,
                fill_factor=recording.camera.electronics.fill_factor,
                oversampling=OVERSAMPLING,
                blur_um=recording.state.vibration_um,
            )
            del field  # frees memory for the field of the next plane
            yield intensity, fraction_beyond

    def _light_of_tiles(
        self, engine: Tiled, behind_object: Field, folder: Path | None
    ) -> Iterator[tuple[Array, float]]:
        """Yield light and fraction beyond the limit for each plane, with one tiled engine per plane."""
        assert self.make is not None
        scene, sensor = engine.scene, self.recording.sensor
        fill_factor = self.recording.camera.electronics.fill_factor
        blur_pixels = self.recording.state.vibration_um / sensor.pixel_pitch_um
        for index, grid in enumerate(self._grids(engine)):
            plane_engine = engine if grid == scene.exit_grid else self.make(replace(scene, exit_grid=grid))
            assert isinstance(plane_engine, Tiled)
            yield _light_in_bands(
                plane_engine,
                behind_object,
                sensor,
                PixelLight(sensor, np.complex64, OVERSAMPLING, fill_factor, self.scratch, blur_pixels),
                _tile_results(folder, index, plane_engine, behind_object),
                partial(self.progress, f"plane {index + 1}"),
            )


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


def _with_background(intensity: Array, fractions: Array | None) -> Array:
    """Add a background that makes up fractions of the mean of the total light."""
    if fractions is None:
        return intensity
    total = float(intensity.mean()) / (1.0 - float(fractions.mean()))
    return np.asarray(intensity + (total * fractions).astype(intensity.dtype))


def drop_parts(folder: Path) -> None:
    """Remove the intermediate results of a run from its output folder."""
    shutil.rmtree(folder / PARTS, ignore_errors=True)


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
