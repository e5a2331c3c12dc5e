"""The statement of a reconstruction from frames: object patch, light, planes, engine, memory and checkpoint.

Everything is read, checked and predicted before the reconstruction runs. The light behind an unknown object
is estimated from its frames: the pixels next to the border of the footprint show how much of it reaches the
rim of the aperture (:func:`light_of_frames`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FrozenModel
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import Lens, Sensor
from lensdesign.lens.poses import Pose
from wavesim.engines.choosing import affordable_engines, engine_for
from wavesim.engines.eikonal.on_cluster import validate_tiled
from wavesim.engines.registry import AUTO
from wavesim.engines.surfaces.grids import LONGEST_SECONDS
from wavesim.fields.field import Field, Grid
from wavesim.rays.maps import RIM_ARMS, inside_border, moved
from wavesim.rays.ray_bundles import open_pupil, trace_bundle
from wavesim.reconstruction.calibrated_bench import CalibratedBench, bench_of
from wavesim.reconstruction.diagnostics.held_out import HeldOut, hold_out, is_given
from wavesim.reconstruction.memory import run_bytes
from wavesim.reconstruction.source_search import BROADEST, coherent_nm, modes_on, sought_widths, stated_source
from wavesim.runtime.checkpoint import CHECKPOINT, Checkpoint, digest_of, key_of
from wavesim.runtime.memory import BASE_BYTES, Memory, MemoryLimitError, memory_limit
from wavesim.runtime.scratch import Scratch, scratch_in
from wavesim.scene.engine import Engine
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.settings import FramedSettings, PatchSettings, ReconstructionSettings, SettingError
from wavesim.scene.source import POINT, Source, SourceMode
from wavesim.scene.state_files import state_table
from wavesim.scene.system_state import AS_DESIGNED, SystemState
from wavesim.sensor.duplicate_frames import validate_distinct_frames
from wavesim.sensor.frame_sets import (
    PlaneFrames,
    frames_by_plane,
    planes_of_frames,
    recorded_planes,
    validate_one_wavelength,
    validate_same_pitch,
)
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Measurement, placed_planes
from wavesim.sensor.merged_exposures import electrons_of, rounding_fraction
from wavesim.sensor.surface_scatter import scatter_of_patch, with_stated_scatter
from wavesim.sensor.windows import (
    LEAST_DIVERSITY,
    check_diversity,
    check_footprint,
    exit_scene,
    imaging_engine,
)
from wavesim.targets.patch import Patch, lit, lit_patch, read_object, usaf_charts_of
from wavesim.targets.region import cut_field, region_grid, widened
from wavesim.targets.usaf import UsafElement

KEY_SETTINGS = (
    "hold_out_plane",
    "method",
    "kind",
    "iterations",
    "tv_weight",
    "start",
    "scale",
    "fill_factor",
    "source_deg",
)
"""Settings that affect the iterations, besides those of the engine."""


class ReconstructionProblem(NamedTuple):
    """Inputs of a reconstruction.

    Attributes
    ----------
    patch : Patch
        Samples of the object and its field stop.
    light : Field
        Illumination of the object.
    source : Source
        Light source, with its angular width and its bandwidth.
    source_deviations : mapping
        Standard deviations of the widths of the source that were found, by name.
    planes : tuple of PlaneFrames
        Distance, exposures and saturation of each plane.
    recorded : tuple of Measurement
        Measured amplitudes, without the pixels that are held out.
    held_out : tuple of HeldOut
        Pixels of each plane that are held out.
    engine : Engine
        Engine from the object to the nearest plane.
    truth : Field or None
        The true object, if it was given.
    charts : tuple
        Elements of the USAF charts.
    diversity : float
        Diversity of the planes.
    checkpoint : Checkpoint or None
        File of the last iteration.
    shown_grid, inside : Grid, ndarray of bool
        Part of the object that is judged and written, and its samples within the field stop.
    refocus_grid : Grid
        Part of the object that is refocused.
    depth_mm : float
        Depth of focus in mm.
    engine_on : callable
        Returns an engine from another part of the object to the same plane.
    scratch : Scratch
        Storage of large arrays.
    memory : Memory
        Estimate of the memory.
    bench_test_gb : float
        Limit of memory in GB with which other benches would be tested, where this is left out for want of it;
        else 0.
    predicted_error : float
        Upper bound of the engine's relative error.
    engine_of_error : callable
        Returns an engine of another accuracy, and its predicted error.
    calibrated : bool
        Whether a calibrated bench was given.
    sought : frozenset of str
        Names of the parameters that its calibration has sought with the same evidence.
    key : str
        Digest of all inputs that decide the result.
    rounding : float
        Largest fraction of a dark pixel's variance that comes from rounding.
    light_behind : callable
        Returns the light behind the field stop of another patch.
    """

    patch: Patch
    light: Field
    source: Source
    planes: tuple[PlaneFrames, ...]
    recorded: tuple[Measurement, ...]
    held_out: tuple[HeldOut, ...]
    engine: Engine
    truth: Field | None
    charts: tuple[tuple[UsafElement, ...], ...]
    diversity: float
    checkpoint: Checkpoint | None
    shown_grid: Grid
    inside: NDArray[np.bool_]
    refocus_grid: Grid
    depth_mm: float
    engine_on: Callable[[Grid], Engine]
    scratch: Scratch
    memory: Memory
    bench_test_gb: float
    predicted_error: float
    engine_of_error: Callable[[float], tuple[Engine, float]]
    calibrated: bool
    sought: frozenset[str]
    key: str
    rounding: float
    light_behind: Callable[[Patch], Field]
    source_deviations: Mapping[str, float] = MappingProxyType({})

    @property
    def modes(self) -> tuple[SourceMode, ...]:
        """Modes of the light of the source: one if it is coherent."""
        return tuple(modes_on(self.light, self.source))

    @property
    def given(self) -> list[Measurement]:
        """Planes that the iterations use: all but a plane that is held out as a whole."""
        return [plane for plane in self.recorded if is_given(plane)]


def reconstruction_problem(
    lens: Lens,
    frames: Sequence[Frame],
    settings: ReconstructionSettings,
    truth: Field | Path | None,
    calibration: CalibratedBench | SystemState | None,
    folder: Path | None,
) -> ReconstructionProblem:
    """Read and check all inputs of a reconstruction; the arguments are those of `reconstruct_frames`.

    Raises
    ------
    InputError, MemoryLimitError
        If an input is invalid or inputs contradict each other, or the arrays do not fit in memory.
    """
    limit = memory_limit(settings.memory_gb)
    bench = bench_of(calibration)
    state = None if bench is None else bench.state
    if state is not None and settings.pose != Pose():
        raise SettingError("{calibration} says how the lens is mounted: give no decenter, tilt or despace")
    pose = settings.pose if state is None else state.pose
    framed = patch_of_frames(lens, frames, settings, pose)
    patch, light = framed.patch, framed.light
    if settings.method == "paper" and len(framed.planes_mm) < 2:
        raise SettingError(
            "{method} paper: needs frames of at least two planes; with one plane use {method} object"
        )
    if settings.method == "paper":
        validate_coherent(settings, state, "{method} paper")
    shown, inside = _shown_part(patch, settings.region_mm)
    true = None if truth is None else _true_object(truth, patch)
    charts = usaf_charts_of(patch, settings.chart_at_mm) if settings.usaf else ()
    scene = exit_scene(lens, patch, framed.sensor, framed.planes_mm[0], pose)
    recorded = recorded_planes(frames, with_fractions=state is not None and state.nonlinearity != 0.0)
    if state is not None:
        scene, light = placed_scene(scene, state), placed_light(light, state)
        recorded = placed_planes(recorded, state)
    if settings.method == "object":
        recorded = _with_scatter(lens, recorded, framed, AS_DESIGNED if state is None else state)
    recorded, held_out = hold_out(recorded, settings.hold_out_plane)
    frame_light = light_of_frames(scene, framed.frames, light)
    known = stated_source(settings, AS_DESIGNED.source if state is None else state.source)
    source = _planned_source(settings, light, known)
    modes = modes_on(light, source)
    runs = 2 * settings.most_iterations * len(modes) if settings.method == "object" else 2
    engine = _engine(scene, settings, runs, limit, frame_light)
    if settings.cluster is not None:
        validate_tiled(engine)
        if source.bandwidth_nm:
            raise SettingError(
                "{bandwidth_nm}: cannot be used with {cluster}, whose tiles are of one wavelength"
            )
    shown = shown.at(light.grid.z_mm)
    refocus_grid = _refocus_grid(scene, settings, shown)

    def memory_of(tests_bench: bool) -> Memory:
        need = run_bytes(
            engine,
            recorded,
            settings,
            modes=modes,
            frames_bytes=sum(frame.counts.nbytes for frame in frames),
            shown=shown.size,
            refocused=0 if settings.focus_mm is None else refocus_grid.size,
            has_truth=true is not None,
            tests_bench=tests_bench,
        )
        return Memory(need, limit)

    memory, memory_with_test = memory_of(False), memory_of(settings.verdict == "full")
    bench_test_gb = 0.0
    if memory_with_test.is_sufficient or not memory.is_sufficient:
        memory = memory_with_test
    else:
        bench_test_gb = memory_with_test.sufficient_gb
    scratch = scratch_in(folder, _scratch_limit(memory, settings))
    key = _key(lens, framed.frames, settings, light, recorded, engine, known)
    sought = frozenset[str]()
    if bench is not None and bench.sought and bench.evidence_key == evidence_key(lens, framed, settings):
        sought = bench.sought
    predicted_error, even = engine.predicted_error(frame_light), frame_light.even
    stored_light = light.with_values(scratch.held(light.values, "the illumination"))

    def engine_of_error(error: float) -> tuple[Engine, float]:
        behind = Light(stored_light, even)
        if keeps_engine(settings):
            made = _engine(scene, settings.replaced(error=error), runs, limit, behind)
            return made, made.predicted_error(behind)
        return _more_accurate_engine(engine, error, predicted_error, runs, limit, behind)

    return ReconstructionProblem(
        patch=patch,
        light=stored_light,
        source=source,
        planes=planes_of_frames(frames),
        recorded=tuple(_stored_plane(scratch, plane) for plane in recorded),
        held_out=held_out,
        engine=engine,
        truth=true and true.with_values(scratch.held(true.values, "the true object")),
        charts=charts,
        diversity=framed.diversity,
        checkpoint=None if folder is None else Checkpoint(folder / CHECKPOINT, key),
        shown_grid=shown,
        inside=inside,
        refocus_grid=refocus_grid,
        depth_mm=1e-3 * patch.wavelength_um / lens.object.numerical_aperture**2,
        engine_on=lambda grid: _engine(
            replace(scene, object_grid=grid), settings, 6, limit, Light(cut_field(stored_light, grid), even)
        ),
        scratch=scratch,
        memory=memory,
        bench_test_gb=bench_test_gb,
        predicted_error=predicted_error,
        engine_of_error=engine_of_error,
        calibrated=state is not None,
        sought=sought,
        key=_key_of_result(key, settings, state, sought, bench_test_gb),
        rounding=max(rounding_fraction(frame) for frame in framed.frames),
        light_behind=lambda other: _light_behind(other, settings, state),
    )


def validate_coherent(settings: ReconstructionSettings, state: SystemState | None, user: str) -> None:
    """Check that light is coherent where a reconstruction assumes this.

    Parameters
    ----------
    settings
        Settings of the reconstruction.
    state
        Calibrated bench, if there is one.
    user
        Name of the method that assumes coherent light, for the message.

    Raises
    ------
    SettingError
        If the calibrated light is not coherent, and the settings do not state another source.
    """
    source = stated_source(settings, AS_DESIGNED.source if state is None else state.source)
    if source != POINT:
        widths = ", ".join(source.lines({}))
        raise SettingError(
            f"{{calibration}}: its light is not coherent ({widths}): cannot be used with {user}, which "
            "assumes coherent light; to neglect this, state {source_deg} 0 and {bandwidth_nm} 0"
        )


def _planned_source(settings: ReconstructionSettings, light: Field, known: Source) -> Source:
    """Return the known source, where a width that is to be found is as large as it may be."""
    largest = {"width_deg": 1.0, "bandwidth_nm": BROADEST * coherent_nm(light)}
    return replace(known, **{name: largest[name] for name in sought_widths(settings)})


def _with_scatter(
    lens: Lens, recorded: Sequence[Measurement], framed: FramePatch, state: SystemState
) -> list[Measurement]:
    """Return the measurements with the light that rough surfaces of the design scatter as background."""
    patch = framed.patch
    scatter = scatter_of_patch(lens, patch.grid, patch.wavelength_um, framed.planes_mm, state)
    return with_stated_scatter(recorded, framed.sensor.pixel_pitch_um, scatter)


def _light_behind(patch: Patch, settings: ReconstructionSettings, state: SystemState | None) -> Field:
    """Return the light on the object behind a patch's field stop, on the bench as calibrated."""
    light = lit(patch, settings)
    return light if state is None else placed_light(light, state)


def _shown_part(patch: Patch, region_mm: Sequence[float] | None) -> tuple[Grid, Any]:
    """Return the grid of the part that is judged and written, and its samples within the field stop."""
    if region_mm is None:
        return patch.grid, patch.inside
    try:
        shown = region_grid(patch.grid, region_mm, "{region_mm}")
    except InputError as error:
        raise SettingError(str(error)) from None
    inside = replace(patch, grid=shown).inside
    if not inside.any():
        text = ",".join(f"{n:g}" for n in region_mm)
        raise SettingError(
            f"{{region_mm}} = {text}: lies outside the field stop of {patch.field_stop_mm:g} mm, where there "
            "is no light"
        )
    return shown, inside


def _true_object(truth: Field | Path, patch: Patch) -> Field:
    if not isinstance(truth, Field):
        truth = read_object(truth, patch)
    elif truth.grid != patch.grid:
        raise InputError(f"truth: its grid {truth.grid} is not the patch's {patch.grid}")
    return truth.with_values(truth.values.astype(np.complex64, copy=False))


def _engine(scene: Scene, settings: ReconstructionSettings, runs: int, limit: float, light: Light) -> Engine:
    return imaging_engine(scene, settings, runs=runs, memory_gb=_free_gb(scene, limit), light=light)


def _free_gb(scene: Scene, limit: float) -> float:
    """Return the memory (GB) that is left for an engine. A second one tests the bench."""
    fields = 8 * (scene.object_grid.size + scene.exit_grid.size)
    return 0.5e-9 * (limit - BASE_BYTES - fields)


def keeps_engine(settings: ReconstructionSettings) -> bool:
    """Return whether the engine or its error is stated, so that no other engine may replace it."""
    return settings.error is not None or settings.engine != AUTO


def _more_accurate_engine(
    present: Engine, error: float, predicted_error: float, runs: int, limit: float, light: Light
) -> tuple[Engine, float]:
    """Return an engine in place of the present one, with its predicted error.

    It is the cheapest affordable engine that meets the error limit, or else the most accurate one.
    """
    scene, cost = present.scene, present.cost()
    # Largest time of all iterations with an engine that replaces the first one, relative to the first one's.
    most_slowdown = 10.0
    affordable = affordable_engines(
        scene,
        (error, min(2.0 * error, predicted_error)),
        memory_gb=_free_gb(scene, limit),
        seconds=min(LONGEST_SECONDS, most_slowdown * (cost.setup_seconds + runs * cost.seconds)),
        runs=runs,
        light=light,
    )
    if not affordable:
        raise SamplingError("no other engine is affordable")
    meeting = [one for one in affordable if one.relative_error <= error]
    best = min(meeting, key=lambda one: one.total_seconds(runs)) if meeting else affordable[0]
    return engine_for(scene, best.engine, **best.settings), best.relative_error


def _refocus_grid(scene: Scene, settings: ReconstructionSettings, shown: Grid) -> Grid:
    """Return the grid of the part that is refocused, with a margin for the spread of light."""
    if settings.focus_mm is None:
        return shown
    aperture = min(scene.lens.object.numerical_aperture, 0.99)
    spread_mm = max(map(abs, settings.focus_mm)) * math.tan(math.asin(aperture))
    # Margin over the spread of light during refocusing, so that the region's rim does not show.
    spread_factor = 2.0
    return widened(shown, scene.object_grid, spread_factor * spread_mm)


def _scratch_limit(memory: Memory, settings: ReconstructionSettings) -> float:
    try:
        return memory.room_for_arrays("the reconstruction")
    except MemoryLimitError as error:
        if settings.focus_mm is None or settings.region_mm is not None:
            raise
        raise MemoryLimitError(f"{error}; or refocus a part of the object alone (--region-mm)") from None


def _stored_plane(scratch: Scratch, plane: Measurement) -> Measurement:
    amplitude = scratch.held(plane.amplitude, "the recorded amplitudes")
    sigma = plane.sigma if plane.sigma is None else scratch.held(plane.sigma, "the standard deviations")
    background = plane.background
    if background is not None:
        background = scratch.held(background, "the backgrounds")
    return replace(plane, amplitude=amplitude, sigma=sigma, background=background)


def _key(
    lens: Lens,
    frames: Sequence[Frame],
    settings: ReconstructionSettings,
    light: Field,
    recorded: Sequence[Measurement],
    engine: Engine,
    known: Source,
) -> str:
    names = set(KEY_SETTINGS)
    if settings.source_deg is None:  # as earlier versions wrote it, so that their checkpoints stay usable
        settings = settings.replaced(source_deg=0.0)
    if settings.bandwidth_nm:  # left out otherwise, so that earlier checkpoints stay usable
        names.add("bandwidth_nm")
    settings_json = settings.model_dump_json(include=names)
    planes = [
        (p.distance_mm, p.shift_mm, p.tilt_deg, None if p.background is None else float(p.background.mean()))
        for p in recorded
    ]
    is_calibrated = known != stated_source(settings)
    bench = (light.grid.z_mm, planes, known) if is_calibrated else (light.grid.z_mm, planes)
    return key_of_frames(lens, frames, light, settings_json, engine.key(), str(bench))


def _key_of_result(
    key: str,
    settings: ReconstructionSettings,
    state: SystemState | None,
    sought: frozenset[str],
    bench_test_gb: float,
) -> str:
    """Return the digest of all inputs of a result: those of its iterations, and those that follow them.

    A result without the test of other benches, which needs `bench_test_gb`, is no result with it.
    """
    names = {"starts", "region_mm", "refocus_mm", "engine", "error", "verdict"}
    bench = "" if state is None else json.dumps(state_table(state), sort_keys=True)
    return key_of(
        key,
        settings.model_dump_json(include=names),
        bench,
        str(sorted(sought)),
        str(bench_test_gb > 0.0),
        version("transferlens"),
    )


def evidence_key(lens: Lens, framed: FramePatch, settings: FramedSettings) -> str:
    """Return a digest of what determines a bench: frames, nominal light, and what the object may be."""
    assumed = settings.model_dump_json(include={"kind", "scale", "fill_factor"})
    return key_of_frames(lens, framed.frames, framed.light, assumed)


class FramePatch(NamedTuple):
    """Properties of the object that follow from frames and settings.

    Attributes
    ----------
    frames : tuple of Frame
        Frames sorted by plane.
    planes_mm : tuple of float
        Distance of each plane in mm.
    sensor : Sensor
        Sensor with the size of the frames.
    patch, light : Patch, Field
        Samples of the object, and its illumination.
    diversity : float
        Diversity of the planes; 0 for a single plane.
    """

    frames: tuple[Frame, ...]
    planes_mm: tuple[float, ...]
    sensor: Sensor
    patch: Patch
    light: Field
    diversity: float


def patch_of_frames(
    lens: Lens, frames: Sequence[Frame], settings: PatchSettings, pose: Pose = Pose()
) -> FramePatch:
    """Return the object's patch and illumination for frames, after checks of the frames.

    Raises
    ------
    InputError
        If frames do not belong to the design, a value is invalid, or two planes have the same picture.

    Warns
    -----
    FootprintWarning, DiversityWarning
        If the frames contain less information than they could.
    """
    if not frames:
        raise InputError("frames: needs at least one frame")
    validate_one_wavelength(frames)
    validate_same_pitch(frames, lens)
    by_plane = frames_by_plane(frames)
    patch, light = lit_patch(lens, settings, frames[0].settings.wavelength_um)
    rows, columns = frames[0].counts.shape
    planes = tuple(plane[0].settings.plane_distance_mm for plane in by_plane)
    sensor = lens.sensor.replaced(pixels=(columns, rows))
    check_footprint(lens, patch, sensor, planes, pose)
    diversity = check_diversity(lens, patch, planes) if len(planes) > 1 else 0.0
    validate_distinct_frames(by_plane, diverse=diversity >= LEAST_DIVERSITY)
    return FramePatch(
        tuple(frame for plane in by_plane for frame in plane), planes, sensor, patch, light, diversity
    )


def validate_frames(lens: Lens, frames: Sequence[Frame], settings: FrozenModel) -> None:
    """Check that lengths of frames and settings are not in another unit.

    Raises
    ------
    SettingError
        If a length is implausible; see :func:`wavesim.scene.lengths.validate_lengths`.
    """
    light = frames[0].settings.wavelength_um if frames else None
    validate_lengths(lens, {"wavelength_um": light})
    planes = [frame.settings.plane_distance_mm for frame in frames]
    validate_lengths(lens, {"plane_distance_mm": planes}, light)
    validate_lengths(lens, settings, light)


def key_of_frames(lens: Lens, frames: Sequence[Frame], light: Field, *settings_json: str | bytes) -> str:
    """Return a digest of all inputs of a result, under which parts of a run are saved."""
    pictures = [part for frame in frames for part in (digest_of(frame.counts), frame.settings.key_text())]
    maps = [
        digest_of(pattern)
        for frame in frames
        if frame.maps is not None
        for pattern in (frame.maps.gain, frame.maps.dark_electrons, frame.maps.bad)
        if pattern is not None
    ]
    texts = [_with_former_names(text) if isinstance(text, str) else text for text in settings_json]
    return key_of(lens.model_dump_json(), digest_of(light.values), *texts, *pictures, *maps)


def _with_former_names(settings_json: str) -> str:
    # Former names of settings, which keys of stored results keep: earlier checkpoints stay usable.
    former_names = {'"fill_factor":': '"active_width":'}
    for name, former in former_names.items():
        settings_json = settings_json.replace(name, former)
    return settings_json


MOST_FAULTY_PIXELS, FAULTY_FRACTION = 4, 0.002
"""Number of pixels on the ring that may be faulty, and the fraction that may be faulty besides these."""


def light_of_frames(scene: Scene, frames: Sequence[Frame], illumination: Field) -> Light:
    """Return the illumination, and the fraction of light that is scattered evenly over the aperture.

    On the nearest plane, light is ordered by its direction. The intensity of pixels next to the footprint's
    border counts as light that fills the aperture evenly. Where no pixels lie there, all light counts as
    scattered.

    Parameters
    ----------
    scene
        Scene from the object to the pixels of the nearest plane, one sample per pixel.
    frames
        Frames of one or more planes.
    illumination
        Field on the object grid of the scene.
    """
    middle = scene.object_grid.centre_mm
    pupil = open_pupil(scene, middle, scene.exit_grid.z_mm, RIM_ARMS)
    rim = trace_bundle(scene, np.asarray(middle), pupil.rim, scene.exit_grid.z_mm)
    plane = sorted(frames_by_plane(frames)[0], key=lambda frame: frame.settings.exposure)
    rings = [_footprint_light(frame, scene, rim.sensor_mm) for frame in plane]
    clear = [ring for _, ring in rings if ring.is_clear] or [rings[0][1]]
    total, ring = rings[0][0], clear[-1]
    if ring.pixels == 0 or total <= 0.0:
        return Light(illumination, 1.0)
    lit = np.isfinite(rim.amplitude)
    # For even light of one unit per direction, compare the light on the border's pixels with the total.
    border = float(np.mean(rim.amplitude[lit] ** 2)) * scene.exit_grid.cell
    return Light(
        illumination, min(max(ring.upper_mean / border * _polygon_area(rim.cosines) / total, 0.0), 1.0)
    )


@dataclass(frozen=True)
class _Ring:
    """Light of the pixels next to the border.

    Attributes
    ----------
    pixels : int
        Number of pixels.
    upper_mean : float
        Upper bound of the mean light of a pixel.
    is_clear : bool
        Whether no more pixels are clipped than may be faulty.
    """

    pixels: int
    upper_mean: float
    is_clear: bool


def _ring_of(light: Array, clipped: int) -> _Ring:
    """Return the winsorized mean over pixels, some of which may be faulty.

    Faulty pixels, cosmic rays or damaged bytes would otherwise count as light at the rim. The brightest
    pixels are replaced by the next brighter one. This hardly changes the mean of light on many pixels.
    """
    count = len(light)
    faulty = min(MOST_FAULTY_PIXELS + round(FAULTY_FRACTION * count), count // 2)
    if count == 0:
        return _Ring(0, 0.0, clipped == 0)
    winsorized = np.partition(light, count - 1 - faulty)
    winsorized = np.minimum(winsorized, winsorized[count - 1 - faulty])
    mean, deviation = float(winsorized.mean()), float(winsorized.std())
    # Standard deviations that are added to the mean over the ring as an upper bound.
    deviations = 2.0
    return _Ring(count, mean + deviations * deviation / math.sqrt(count), clipped <= faulty)


def _footprint_light(frame: Frame, scene: Scene, border_mm: Array) -> tuple[float, _Ring]:
    """Return the light of a frame per unit of exposure, within the footprint and on its inner border."""
    # Width over the radius of the footprint of the ring of pixels that shows the light at the rim.
    ring_width = 0.1
    width = ring_width * float(np.mean(np.linalg.norm(border_mm - border_mm.mean(axis=0), axis=1)))
    y, x = scene.exit_grid.y_mm, scene.exit_grid.x_mm
    total, clipped, lights = 0.0, 0, list[Array]()
    rows_at_once = 64
    for start in range(0, len(y), rows_at_once):
        rows = slice(start, start + rows_at_once)
        inside, within = (inside_border(moved(border_mm, by), (y[rows], x)) for by in (0.0, -width))
        # Values may be negative, because the mean of the noise of dark pixels must be 0.
        light, near = electrons_of(frame, rows) / frame.settings.exposure, inside & ~within
        total += float(light[inside].sum())
        lights.append(light[near])
        clipped += int(np.count_nonzero(frame.counts[rows][near] >= frame.settings.clipped_counts))
    return total, _ring_of(np.concatenate(lights), clipped)


def _polygon_area(border: Array) -> float:
    """Return the area inside a closed border of points (y, x)."""
    y, x = border.T
    following = np.roll(border, -1, axis=0)
    return 0.5 * abs(float(np.sum(y * following[:, 1] - x * following[:, 0])))
