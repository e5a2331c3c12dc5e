"""Simulated imaging of an object through a lens: from design and settings to recorded frames."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lensdesign.analysis.roughness import RoughnessReport, RoughnessWarning
from lensdesign.common.arrays import Array
from lensdesign.common.given import FilePath, object_of
from lensdesign.common.toml_files import validate
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens, Sensor
from lensdesign.lens.poses import Pose
from wavesim.engines.choosing import predicted_error_of
from wavesim.engines.eikonal.on_cluster import tiles_in
from wavesim.engines.with_ghost import WithGhost
from wavesim.fields.field import Field
from wavesim.runtime.memory import Memory, memory_limit
from wavesim.runtime.result import Result
from wavesim.runtime.scratch import scratch_in
from wavesim.scene.engine import Engine
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene, placed_light
from wavesim.scene.settings import ImageSettings, SettingError
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState, state_of
from wavesim.sensor.camera_noise import Electronics
from wavesim.sensor.colour_filters import colour_filters
from wavesim.sensor.frames import Frame
from wavesim.sensor.ghost_light import ghost_light
from wavesim.sensor.pixels.non_uniformity import PixelErrors
from wavesim.sensor.recording import (
    PARTS,
    Progress,
    Recorder,
    Recording,
)
from wavesim.sensor.sensor import Camera
from wavesim.sensor.surface_scatter import scatter_of_patch
from wavesim.sensor.windows import (
    central_window,
    check_width,
    diversity,
    imaging_engine,
    light_radius_mm,
    light_window,
    pixels_across,
    sensor_window,
)
from wavesim.targets.colours import FILM_INDEX, channel_of, film
from wavesim.targets.layers import layer_stack
from wavesim.targets.patch import MAKERS, Patch, Target, lit, lit_patch, make_target, transmission_of


@dataclass(frozen=True, eq=False, repr=False)
class Imaged(Result):
    """Simulated frames of an object, with the settings and models that produced them.

    :func:`wavesim.image` returns it.

    Attributes
    ----------
    settings : ImageSettings
        Settings of the simulation.
    patch : Patch
        Samples of the object plane and the field stop.
    target : Target
        Object with its transmission.
    recording : Recording
        Recording planes, camera, noise and errors of the setup.
    engine : Engine
        Engine that propagates the light to the first plane.
    frames : tuple of Frame
        Frames ordered by plane, then by exposure.
    share_beyond_pixels : float
        Fraction of the energy on the first plane at frequencies beyond the Nyquist limit of the pixels.
    diversity : float
        Phase diversity of the planes (:func:`wavesim.sensor.windows.diversity`).
    memory : Memory
        Estimated memory of the run.
    predicted_error : float
        Upper bound of the relative L2 error of this object's field on the first plane.
    scattered : RoughnessReport or None
        Light that rough surfaces of the lens scatter; None without a rough surface.
    layers : tuple of Target
        Layers of an object of several, in the order in which light passes them. The transmission of `target`
        is then the field behind all layers, in the object plane, over that of the illumination in front of
        them. Empty for other objects.
    coloured : tuple of Field
        Transmission of the object at each wavelength that is recorded at once; empty for one wavelength.

    Examples
    --------
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> taken = image(lens, "star", patch_mm=0.03, planes_mm=(0.03,), engine="eikonal", error=0.1)
    >>> taken.target.transmission.grid.shape == taken.patch.grid.shape
    True
    >>> taken.frames[0].counts.shape == taken.sensor.pixels[::-1]
    True
    """

    heading = "Frames of an object"

    settings: ImageSettings
    patch: Patch
    target: Target
    recording: Recording
    engine: Engine
    frames: tuple[Frame, ...]
    share_beyond_pixels: float
    diversity: float
    memory: Memory
    predicted_error: float
    scattered: RoughnessReport | None = None
    layers: tuple[Target, ...] = ()
    coloured: tuple[Field, ...] = ()

    @property
    def sensor(self) -> Sensor:
        """Sensor window that records."""
        return self.recording.sensor

    def table(self) -> list[tuple[str, str]]:
        across, down = self.sensor.pixels
        planes = ", ".join(f"{z:g}" for z in self.recording.plane_distances_mm)
        return [
            ("object", f"{self.target.name}, {self.patch.stop_words}"),
            ("engine", self.engine.name),
            ("frames", f"{len(self.frames)} of {across} x {down} pixels, planes at {planes} mm"),
            ("brightest", f"{max(int(frame.counts.max()) for frame in self.frames)} counts"),
        ]


def image(
    lens: Lens | FilePath,
    object_: str | Field | Sequence[str | Field] = "usaf",
    settings: ImageSettings | None = None,
    *,
    state: SystemState | Pose | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    on_estimate: Callable[[Memory], None] | None = None,
    **changes: Any,
) -> Imaged:
    """Simulate the frames that the sensor of a design records of an object.

    Parameters
    ----------
    lens
        The nominal lens, or the path of its design file.
    object_
        Name of a built-in object ("usaf", "star", "phase", "tissue", "empty"), path of a picture, or the
        complex transmission of an object on a plane. The grid of a transmission is used as the patch. With
        `layers_um`, one of these for each layer; a single one is used on all layers.
        With `wavelengths_um`, a sequence has the transmission at each of them.
    settings
        All settings; default: `ImageSettings()`.
    state
        Deviations of lens, object, sensor and light from the design, instead of those in `settings`. Frames
        state the plane distances of the stage and the true wavelength of the light.
    folder
        Folder of intermediate results of a whole field and of arrays that do not fit in memory. The same
        call continues an interrupted run. :func:`wavesim.sensor.recording.drop_parts` removes the results.
    progress
        Callback `progress(stage, completed, total)`; the total is 0 where it is unknown.
    on_estimate
        Callback `on_estimate(memory)` with the estimate of the memory, called after all checks.
    **changes
        Settings by name, which replace those of `settings`.

    Returns
    -------
    Imaged
        The frames, and the models that produced them.

    Raises
    ------
    InputError, SamplingError, MemoryLimitError
        If a setting is invalid, the sampling is too coarse, or the arrays do not fit in memory.
    KeyboardInterrupt
        If the run is interrupted; the message says what was saved.

    Warns
    -----
    RoughnessWarning
        If the model of scattered light does not hold for a rough surface of the lens.

    Examples
    --------
    A Siemens star on two planes, at 1/64 of the size of the lens, which takes a second:

    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> taken = image(lens, "star", patch_mm=0.03, planes_mm=(0.03, 0.3), engine="eikonal", error=0.1)
    >>> [frame.settings.plane_distance_mm for frame in taken.frames]
    [0.03, 0.3]
    >>> bool(3000 < taken.frames[0].counts.max() < 4095)
    True
    """
    lens = object_of(lens, Lens, load_design, "lens")
    settings = (settings or ImageSettings()).replaced(**changes)
    validate_lengths(lens, settings)
    plan = _plan(lens, object_, settings, state)
    limit = memory_limit(settings.memory_gb)
    with tiles_in(settings.cluster) as hand_over_tiles:

        def make(scene: Scene) -> Engine:
            light = Light(plan.behind_object).on(scene)
            engine = imaging_engine(scene, settings, runs=1, memory_gb=1e-9 * limit, light=light)
            return hand_over_tiles(_with_ghosts(engine, settings))

        recorder = Recorder(plan.recording, make(plan.scene), make, folder=folder)
        memory = Memory(recorder.memory(), limit)
        predicted_error = predicted_error_of(recorder.engine, Light(plan.behind_object))
        recorder = replace(recorder, scratch=scratch_in(folder, memory.room_for_arrays("this picture")))
        if on_estimate is not None:
            on_estimate(memory)
        if progress is not None:
            progress(f"engine {recorder.engine.name}", 0, 0)
            recorder = replace(recorder, progress=progress)
        try:
            ghosts = _smooth_ghosts(lens, plan.behind_object, plan.recording, settings)
            frames, fraction_beyond = recorder.frames(plan.behind_object, plan.others, ghosts)
        except KeyboardInterrupt:
            saved = folder is not None and (folder / PARTS).exists()
            hint = f"the finished parts are stored in {folder}/{PARTS}; repeat the command to continue"
            raise KeyboardInterrupt(f"interrupted; {hint if saved else 'nothing was written'}") from None
    return Imaged(
        settings=settings,
        patch=plan.patch,
        target=plan.target,
        recording=plan.recording,
        engine=recorder.engine,
        frames=frames,
        share_beyond_pixels=fraction_beyond,
        diversity=plan.diversity,
        memory=memory,
        predicted_error=predicted_error,
        scattered=plan.scattered,
        layers=plan.layers if settings.layers_um is not None else (),
        coloured=plan.coloured,
    )


@dataclass(frozen=True, eq=False)
class _Plan:
    """Checked inputs of a recording: the light behind the object, and what is recorded of it."""

    patch: Patch
    target: Target
    layers: tuple[Target, ...]
    coloured: tuple[Field, ...]
    behind_object: Field
    others: list[Field]
    """Fields behind the object at further wavelengths."""
    recording: Recording
    scene: Scene
    scattered: RoughnessReport | None
    diversity: float


def _plan(
    lens: Lens,
    object_: str | Field | Sequence[str | Field],
    settings: ImageSettings,
    state: SystemState | Pose | None,
) -> _Plan:
    """Check all inputs, and return what is recorded; the arguments are those of :func:`image`."""
    recording = _recording(lens, settings, state)
    if settings.layers_um is not None:
        _check_source_of_layers(recording.state.source)
    objects = _objects(object_, settings)
    patch, light = _patch_and_light(lens, objects[0], settings)
    wavelengths = settings.wavelengths_um or (patch.wavelength_um,) * len(objects)
    patches = [replace(patch, wavelength_um=one) for one in wavelengths]
    aperture, planes = lens.object.numerical_aperture, recording.plane_distances_mm
    targets = tuple(_target(own, aperture, one, settings) for own, one in zip(patches, objects, strict=True))
    recording = _with_windows(recording, lens, patches, settings)
    scattered = scatter_of_patch(lens, patch.grid, patch.wavelength_um, planes, recording.state)
    for note in scattered.notes if scattered is not None else ():
        warnings.warn(note, RoughnessWarning, stacklevel=3)
    light = placed_light(light, recording.state)
    layers = targets if settings.wavelengths_um is None else targets[:1]
    target, behind_object = _behind_object(patch, light, layers, settings)
    del light  # as large as the object field, which is kept
    others = []
    for own, one in zip(patches[len(layers) :], targets[len(layers) :], strict=True):
        own_light = placed_light(lit(own, settings), recording.state)
        others.append(own_light.with_values(own_light.values * one.transmission.values))
    return _Plan(
        patch=patch,
        target=target,
        layers=layers,
        coloured=tuple(one.transmission for one in targets) if others else (),
        behind_object=behind_object,
        others=others,
        recording=recording,
        scene=settings.applied_to(recording.scene(lens, patch)),
        scattered=scattered,
        diversity=diversity(lens, patch, planes),
    )


def _with_windows(
    recording: Recording, lens: Lens, patches: Sequence[Patch], settings: ImageSettings
) -> Recording:
    """Return the recording with the window of its sensor, and one around the light of each plane."""
    planes, state = recording.plane_distances_mm, recording.state
    of_wavelengths = {patch.wavelength_um: patch for patch in patches}.values()
    radii = max(([light_radius_mm(lens, one, z, state) for z in planes] for one in of_wavelengths), key=max)
    widths = [2.0 * (radius + math.hypot(*state.sensor_shift_mm[:2])) for radius in radii]
    whole = lens.sensor
    pixels = whole.pixels if settings.pixels == "all" else settings.pixels
    sensor = central_window(whole, planes, pixels_across(whole, max(widths)) if pixels is None else pixels)
    for width, plane in zip(widths, planes, strict=True):
        check_width(width, sensor, plane)
    shifts = (math.hypot(*state.sensor_pose(index).shift_mm) for index in range(len(planes)))
    windows = (light_window(sensor, 2.0 * (radius + s)) for radius, s in zip(radii, shifts, strict=True))
    return replace(recording, camera=replace(recording.camera, sensor=sensor), windows=tuple(windows))


def _objects(object_: str | Field | Sequence[str | Field], settings: ImageSettings) -> list[str | Field]:
    """Return the object of each layer, or at each wavelength."""
    if settings.wavelengths_um is not None:
        return _coloured_objects(object_, settings)
    objects = [object_] if isinstance(object_, str | Field) else list(object_)
    count = 1 if settings.layers_um is None else len(settings.layers_um)
    if len(objects) not in (1, count):
        raise SettingError(
            f"{{object_}}: {len(objects)} objects for {count} layer{'s' * (count > 1)}; give one for each "
            "distance in {layers_um}"
        )
    return objects * count if len(objects) == 1 else objects


def _check_source_of_layers(source: Source) -> None:
    """Check that the light on layers has one direction and wavelength.

    The modes of a source multiply the field behind the object. Light of another direction, however, arrives
    at another part of each further layer.
    """
    if source.width_deg or source.bandwidth_nm:
        raise SettingError(
            "{source_deg}, {bandwidth_nm}: must be 0 with {layers_um}, also in a given state; the source has "
            f"a width of {source.width_deg:g}° and a bandwidth of {source.bandwidth_nm:g} nm"
        )


def _behind_object(
    patch: Patch, light: Field, layers: Sequence[Target], settings: ImageSettings
) -> tuple[Target, Field]:
    """Return the object as seen from the object plane, and the field behind it."""
    if settings.layers_um is None:
        (target,) = layers
        return target, light.with_values(light.values * target.transmission.values)
    stack = layer_stack(patch, light, settings.layers_um)
    transmissions = [layer.transmission.values for layer in layers]
    stack.check_lost_light(transmissions)
    behind = light.with_values(stack.forward(transmissions).behind.astype(light.values.dtype))
    name = ", ".join(dict.fromkeys(layer.name for layer in layers))
    return Target(name, transmission_of(behind, light), (), layers[0].polarity), behind


def common_pixels(
    lens: Lens,
    settings: ImageSettings,
    wavelengths_um: Sequence[float],
    state: SystemState | Pose | None = None,
) -> tuple[int, int]:
    """Return the pixels (across, down) of a window for the light of each of several wavelengths.

    Parameters
    ----------
    lens
        The nominal lens.
    settings
        Settings of the patch, the planes and the mounting.
    wavelengths_um
        Wavelengths, whose footprints differ by the dispersion of the glass.
    state
        Deviations from the design; default: those in the settings.
    """
    recording = _recording(lens, settings, state)
    patch, _ = lit_patch(lens, settings, wavelengths_um[0])
    windows = [
        sensor_window(
            lens, replace(patch, wavelength_um=one), recording.plane_distances_mm, state=recording.state
        )
        for one in wavelengths_um
    ]
    return max(window.pixels for window in windows)


def _with_ghosts(engine: Engine, settings: ImageSettings) -> Engine:
    """Return the engine with the coherent ghosts that the settings ask for."""
    if settings.ghosts == "coherent":
        return WithGhost(engine)
    return WithGhost(engine, settings.ghost) if settings.ghost else engine


def _smooth_ghosts(
    lens: Lens, behind_object: Field, recording: Recording, settings: ImageSettings
) -> list[Array]:
    """Return the smooth light of ghosts on every plane; none unless the settings ask for ghosts.

    With coherent ghosts it is that of paths via the cover glass or the sensor.
    """
    if settings.ghosts == "none":
        return []
    coated = lens if settings.coating is None else lens.with_coating(settings.coating)
    is_coherent = settings.ghosts == "coherent"
    return [
        ghost_light(
            coated,
            behind_object,
            recording.sensor,
            plane,
            only_beyond_lens=is_coherent,
            state=recording.state,
            index=index,
        )
        for index, plane in enumerate(recording.plane_distances_mm)
    ]


def _coloured_objects(
    object_: str | Field | Sequence[str | Field], settings: ImageSettings
) -> list[str | Field]:
    """Return the object at each of several wavelengths."""
    assert settings.wavelengths_um is not None
    wavelengths = settings.wavelengths_um
    if settings.ghosts != "none" or settings.ghost:
        raise SettingError("{ghosts}, {ghost}: cannot be used with {wavelengths_um}")
    if settings.layers_um is not None:
        raise SettingError("{layers_um}: cannot be used with {wavelengths_um}")
    given = [object_] if isinstance(object_, str | Field) else list(object_)
    if len(given) == 1 and isinstance(given[0], str):
        return given * len(wavelengths)
    fields = [one for one in given if isinstance(one, Field)]
    stated = tuple(one.wavelength_um for one in fields)
    if len(fields) < len(given) or stated != wavelengths or len({one.grid for one in fields}) != 1:
        needed = ", ".join(f"{one:g}" for one in wavelengths)
        raise SettingError(
            f"{{object_}}: {len(given)} objects; must be one name, or a transmission for each wavelength "
            f"({needed} um), in this order and on one grid"
        )
    return given


def _patch_and_light(lens: Lens, object_: str | Field, settings: ImageSettings) -> tuple[Patch, Field]:
    if isinstance(object_, str) and settings.wavelengths_um is not None:
        # The samples of all wavelengths are those that the shortest one needs.
        patch, _ = lit_patch(lens, settings, min(settings.wavelengths_um))
        patch = replace(patch, wavelength_um=settings.wavelengths_um[0])
        return patch, lit(patch, settings)
    if isinstance(object_, str):
        return lit_patch(lens, settings, settings.wavelength_um)
    if settings.patch_mm is not None or settings.object_pitch_um is not None:
        raise InputError(
            "patch_mm, object_pitch_um: the grid of the given transmission defines them; omit both"
        )
    side_mm = 2.0 * min(object_.grid.half_widths_mm)
    at_mm = settings.field_stop_at_mm or (0.0, 0.0)
    patch = Patch(object_.grid, settings.field_stop_mm or side_mm, object_.wavelength_um, at_mm)
    return patch, lit(patch, settings)


def _target(patch: Patch, numerical_aperture: float, object_: str | Field, settings: ImageSettings) -> Target:
    _validate_coloured(object_, settings)
    if isinstance(object_, Field):
        return Target("transmission", object_, (), "bright")
    target = make_target(
        patch,
        object_,
        settings.ground,
        numerical_aperture=numerical_aperture,
        seed=settings.seed,
        picture_pixel_um=settings.picture_pixel_um,
        picture_width_mm=settings.picture_width_mm,
        chart_at_mm=settings.chart_at_mm,
        channel=channel_of(patch.wavelength_um) if settings.channels else None,
    )
    if settings.thickness_um is None:
        return target
    shape, thickness_um, index = target.transmission, settings.thickness_um, settings.film_index or FILM_INDEX
    return replace(target, transmission=film(shape, thickness_um, index, patch.wavelength_um))


def _validate_coloured(object_: str | Field, settings: ImageSettings) -> None:
    """Check that settings of objects that depend on the wavelength have an effect on an object."""
    given = "a transmission" if isinstance(object_, Field) else repr(object_)
    is_built_in = isinstance(object_, str) and object_ in ("usaf", *MAKERS)
    if settings.channels and (is_built_in or isinstance(object_, Field)):
        raise SettingError(
            f"{{channels}}: has no effect on the object {given}; must be used with a colour picture"
        )
    if settings.thickness_um is not None and (isinstance(object_, Field) or object_ in ("phase", "empty")):
        raise SettingError(
            f"{{thickness_um}}: cannot be used with the object {given}; must be used with an object whose "
            "amplitude varies (usaf, star, tissue, or a picture)"
        )


def _true_state(
    lens: Lens, settings: ImageSettings, state: SystemState | Pose | None, planes: int
) -> SystemState:
    """Return the given state or that of the settings, with the errors of the stage."""
    if state is None:
        true = settings.state(lens, settings.pose, planes)
    elif settings.pose != Pose() or settings.differs:
        raise SettingError(
            "{state}: defines the mounting of the lens, the light and the sensor; omit the settings of "
            "decenter, tilt and despace, and of errors of light, lens and sensor"
        )
    else:
        true = state_of(state)
    errors_mm, (x_um, y_um) = settings.stage_error_mm, settings.shift_um
    if len(errors_mm) not in (1, planes):
        given = ",".join(f"{error:g}" for error in errors_mm)
        raise SettingError(f"{{stage_error_mm}} = {given!r}: must be 1 or {planes} numbers")
    if any(errors_mm):
        errors_mm = errors_mm * planes if len(errors_mm) == 1 else errors_mm
        own_mm = [*true.plane_distance_errors_mm, *(0.0,) * planes][:planes]
        true = replace(true, plane_distance_errors_mm=tuple(map(sum, zip(errors_mm, own_mm, strict=True))))
    if x_um or y_um:  # the sensor moves by the same shift from each plane to the next
        own = [*true.plane_shifts_um, *((0.0, 0.0),) * planes][:planes]
        shifts = tuple((x + n * x_um, y + n * y_um) for n, (x, y) in enumerate(own))
        true = replace(true, plane_shifts_um=shifts)
    return true


def _recording(lens: Lens, settings: ImageSettings, state: SystemState | Pose | None) -> Recording:
    """Return the recording that the settings describe, with the whole sensor."""
    if settings.ghost and settings.ghosts != "none":
        raise SettingError("{ghost}, {ghosts}: both given; state a reflectance, or use the coatings")
    planes = settings.planes_mm or lens.sensor.plane_distances_mm
    exposures, exposure_errors = settings.exposures, settings.exposure_error
    if len(exposure_errors) not in (1, len(exposures)):
        given = ",".join(f"{error:g}" for error in exposure_errors)
        raise SettingError(f"{{exposure_error}} = {given!r}: must be 1 or {len(exposures)} numbers")
    true = _true_state(lens, settings, state, len(planes))
    colours = settings.wavelengths_um
    if colours is not None and true.wavelength_um is not None:
        raise SettingError(
            f"{{state}}: has a wavelength of {true.wavelength_um:g} um, which cannot be used with "
            "{wavelengths_um}"
        )
    pixels = PixelErrors(
        settings.prnu,
        settings.dsnu_electrons,
        settings.hot_pixels,
        settings.dead_pixels,
        settings.seed,
        true.nonlinearity,
    )
    electronics = {
        "full_well_electrons": settings.full_well_electrons,
        "read_noise_electrons": settings.read_noise_electrons,
        "bits": settings.bits,
        "fill_factor": settings.fill_factor,
        # Prevents clipping of dark noise at 0 and still leaves counts for light at few bits.
        "offset_counts": min(64.0, 2.0**settings.bits / 16.0),
    }
    camera = Camera(
        lens.sensor,
        validate(Electronics, electronics, "sensor"),
        exposures,
        settings.peak_fill,
        exposure_errors * len(exposures) if len(exposure_errors) == 1 else exposure_errors,
        pixels,
        None if colours is None else colour_filters(settings.colour_filters, colours),
    )
    return Recording(camera, tuple(sorted(planes)), settings.seed if settings.noise else None, true)
