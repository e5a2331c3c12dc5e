"""The command `wavesim image`: frames of an object, as the design's sensor records them."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from lensdesign.common.console import print_json, progress_bar
from lensdesign.common.text import visible
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from wavesim.cli.engine_options import (
    Compensation,
    Interface,
    PitchUm,
    Slices,
    StepUm,
    TileWidthMm,
    numbers,
    print_warnings,
    settings_text,
)
from wavesim.cli.imaging_options import (
    ActiveWidth,
    AsJson,
    ChartAtMm,
    Cluster,
    DecenterXMm,
    DecenterYMm,
    Design,
    DespaceMm,
    Device,
    EngineName,
    Error,
    FieldStopMm,
    Illumination,
    LightPitchUm,
    LightTiltDeg,
    MemoryGb,
    ObjectPitchUm,
    Options,
    Output,
    PatchMm,
    PivotZMm,
    TiltXDeg,
    TiltYDeg,
    WaistMm,
    WavelengthUm,
    chart_points,
    engine_options,
    engine_summary,
    patch_and_light,
    pose_of,
    tiles_in,
    versions,
)


def image(
    design: Design,
    output: Output,
    object_: Annotated[str, typer.Option("--object", help="usaf, star, phase, tissue, or FILE.")] = "usaf",
    picture_pixel_um: Annotated[float | None, typer.Option(help="FILE: side of its pixels.")] = None,
    ground: Annotated[str, typer.Option(help="usaf, star: bright or dark.")] = "bright",
    chart_at_mm: ChartAtMm = None,
    patch_mm: PatchMm = None,
    field_stop_mm: FieldStopMm = None,
    object_pitch_um: ObjectPitchUm = None,
    wavelength_um: WavelengthUm = None,
    illumination: Illumination = "plane",
    light_tilt_deg: LightTiltDeg = "0,0",
    waist_mm: WaistMm = None,
    light_pitch_um: LightPitchUm = None,
    planes_mm: Annotated[
        str | None, typer.Option(help="From the exit vertex; left out: the design's.")
    ] = None,
    pixels: Annotated[
        str | None, typer.Option(help="Of a side, or 9344x7000, or all; left out, what holds the light.")
    ] = None,
    engine: EngineName = "auto",
    error: Error = None,
    tile_width_mm: TileWidthMm = None,
    slices: Slices = None,
    compensation: Compensation = None,
    interface: Interface = None,
    step_um: StepUm = None,
    pitch_um: PitchUm = None,
    device: Device = None,
    cluster: Cluster = None,
    memory_gb: MemoryGb = None,
    decenter_x_mm: DecenterXMm = 0.0,
    decenter_y_mm: DecenterYMm = 0.0,
    despace_mm: DespaceMm = 0.0,
    tilt_x_deg: TiltXDeg = 0.0,
    tilt_y_deg: TiltYDeg = 0.0,
    pivot_z_mm: PivotZMm = 0.0,
    noise: Annotated[bool, typer.Option(help="Shot noise and read noise.")] = True,
    seed: Annotated[int, typer.Option(help="Of noise, and of tissue.")] = 0,
    full_well: Annotated[float, typer.Option(help="Electrons.")] = 10_000.0,
    read_noise: Annotated[float, typer.Option(help="Electrons.")] = 2.0,
    bits: Annotated[int, typer.Option(help="Of a count.")] = 12,
    brightest_share: Annotated[float, typer.Option(help="Of full well, in the brightest pixel.")] = 0.8,
    exposures: Annotated[
        str, typer.Option(help="Of each plane, as multiples of what gives --brightest-share.")
    ] = "1",
    active_width: ActiveWidth = 1.0,
    stage_error_mm: Annotated[str, typer.Option(help="Of all planes, or of each.")] = "0",
    shift_um: Annotated[str, typer.Option(help="x,y of the sensor from plane to plane.")] = "0,0",
    as_json: AsJson = False,
) -> None:
    """Record an object through the lens: frames, the true object, a preview, and what was used.

    Frames are 16-bit TIFF that hold their settings. The sensor's window is its middle, as much of it as the
    light falls on. Of several exposures, the long ones show faint light and are clipped where it is bright.

    Of a whole field (engine two-level) finished parts are kept: the same command goes on with a run that was
    interrupted.
    """
    from wavesim.camera.recording import drop_parts
    from wavesim.pictures.field_files import refuse_no_folder

    options = Options(**locals())
    refuse_no_folder(output)
    lens = load_design(design)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = _make(lens, options)
        summary = _summary(lens, options, made)
        summary["warnings"] = list(dict.fromkeys(str(warning.message) for warning in caught))
    print_warnings(summary["warnings"])
    summary["files"] = [str(output / name) for name in _write(made, summary, output)]
    drop_parts(output)
    if as_json:
        print_json(summary)
    else:
        _print(summary, output)


class Made(NamedTuple):
    """What the command computed."""

    patch: Any
    target: Any
    sensor: Any
    recording: Any
    imaged: Any
    memory: dict[str, float]


def _make(lens: Any, options: Any) -> Made:
    from wavesim.camera.windows import check_footprint, light_window, sensor_window

    recording, pose = _recording(lens, options), pose_of(options)
    planes = recording.plane_distances_mm
    patch, light = patch_and_light(lens, options)
    target = _target(lens, patch, options)
    sensor = sensor_window(lens, patch, planes, _pixels(options.pixels, lens), pose)
    check_footprint(lens, patch, sensor, planes, pose)
    windows = [light_window(lens, patch, sensor, plane, pose) for plane in planes]
    behind = light.with_values(light.values * target.transmission.values)
    del light
    return _imaged(lens, options, Made(patch, target, sensor, recording, None, {}), windows, behind)


def _target(lens: Any, patch: Any, options: Any) -> Any:
    from wavesim.objects.patch import make_target

    return make_target(
        patch,
        options.object_,
        options.ground,
        numerical_aperture=lens.object.numerical_aperture,
        seed=options.seed,
        picture_pixel_um=options.picture_pixel_um,
        chart_at_mm=chart_points(options),
    )


def _imaged(lens: Any, options: Any, made: Made, windows: Any, behind: Any) -> Made:
    """Through the lens and onto the sensor, within the memory allowed."""
    from wavesim.camera.recording import PARTS, image_patch, imaging_need
    from wavesim.camera.windows import OVERSAMPLING, exit_scene, imaging_error
    from wavesim.engines.choosing import engine_for
    from wavesim.runtime.memory import Memory, memory_limit, room_for_arrays
    from wavesim.runtime.scratch import scratch_in

    output, recording, limit = options.output, made.recording, memory_limit(options.memory_gb)
    settings = engine_options(options)
    planes, pose = recording.plane_distances_mm, pose_of(options)
    scene = exit_scene(lens, made.patch, windows[0], planes[0], pose, OVERSAMPLING)
    with tiles_in(options.cluster) as take:

        def make(scene: Any) -> Any:
            error = imaging_error(options.engine, options.error)
            return take(
                engine_for(scene, options.engine, error=error, memory_gb=1e-9 * limit, runs=1, **settings)
            )

        engine = make(scene)
        memory = Memory(imaging_need(engine, made.sensor, windows, recording), limit)
        scratch = scratch_in(output, room_for_arrays(memory.need, limit, "this picture"))
        if not options.as_json:
            print(memory.line(output), file=sys.stderr)
        try:
            with progress_bar() as bar:
                task = bar.add_task(f"engine {engine.name}", total=None)
                imaged = image_patch(
                    engine,
                    behind,
                    made.sensor,
                    windows,
                    recording,
                    make,
                    lambda what, done, count: bar.update(task, completed=done, total=count, description=what),
                    folder=output,
                    scratch=scratch,
                )
        except KeyboardInterrupt:
            kept = (output / PARTS).exists()
            where = (
                f"the same command goes on from what is kept in {output / PARTS}"
                if kept
                else "nothing is kept"
            )
            raise KeyboardInterrupt(f"interrupted; {where}") from None
    return made._replace(imaged=imaged, memory=memory.as_dict())


def _pixels(text: str | None, lens: Any) -> int | tuple[int, int] | None:
    """The sensor's window as :func:`wavesim.sensor_window` takes it."""
    if text is None:
        return None
    if text == "all":
        across, down = lens.sensor.pixels
        return across, down
    parts = text.split("x")
    if not all(part.strip().isdecimal() for part in parts) or len(parts) > 2:
        raise InputError(f"--pixels = {text!r}: must be a whole number, two such as 9344x7000, or all")
    sides = [int(part) for part in parts]
    return sides[0] if len(sides) == 1 else (sides[0], sides[1])


def _recording(lens: Any, options: Any) -> Any:
    """Planes, electronics, noise and errors of the stage."""
    from lensdesign.common.toml_files import validate
    from wavesim.camera.exposures import Electronics
    from wavesim.camera.recording import Recording

    planes = list(lens.sensor.plane_distances_mm)
    if options.planes_mm is not None:
        planes = sorted(numbers(options.planes_mm, "--planes-mm"))
    if min(planes) <= 0.0 or len(set(planes)) < len(planes):
        raise InputError(f"--planes-mm = {options.planes_mm!r}: must be greater than 0, and differ")
    errors = numbers(options.stage_error_mm, "--stage-error-mm")
    if len(errors) not in (1, len(planes)):
        raise InputError(f"--stage-error-mm = {options.stage_error_mm!r}: must be 1 or {len(planes)} numbers")
    if options.seed < 0:
        raise InputError(f"--seed = {options.seed}: must be a whole number from 0")
    exposures = sorted(numbers(options.exposures, "--exposures"))
    if exposures[0] <= 0.0:
        raise InputError(f"--exposures = {options.exposures!r}: must be greater than 0")
    shift_x, shift_y = numbers(options.shift_um, "--shift-um", 2)
    electronics = {
        "full_well_electrons": options.full_well,
        "read_noise_electrons": options.read_noise,
        "bits": options.bits,
        "active_width": options.active_width,
        # Keeps the noise of dark pixels, and leaves counts for light where there are few.
        "offset_counts": min(64.0, 2.0**options.bits / 16.0),
    }
    return Recording(
        tuple(planes),
        validate(Electronics, electronics, "sensor"),
        options.seed if options.noise else None,
        options.brightest_share,
        tuple(errors * len(planes) if len(errors) == 1 else errors),
        (shift_x, shift_y),
        tuple(exposures),
    )


def _summary(lens: Any, options: Any, made: Made) -> dict[str, Any]:
    from wavesim.camera.windows import diversity

    planes = made.recording.plane_distances_mm
    limit = 500.0 / lens.sensor.pixel_pitch_um
    across, down = made.sensor.pixels
    return {
        "design": lens.title or Path(options.design).stem,
        "object": {
            "name": made.target.name,
            "ground": made.target.ground,
            "elements": len(made.target.elements),
            "patch_mm": made.patch.grid.shape[0] * made.patch.grid.pitch_mm,
            "field_stop_mm": made.patch.field_stop_mm,
            "pitch_um": 1e3 * made.patch.grid.pitch_mm,
            "samples": made.patch.grid.shape[0],
        },
        "illumination": options.illumination,
        "wavelength_um": made.patch.wavelength_um,
        "engine": engine_summary(made.imaged.engine),
        "pose": vars(pose_of(options)),
        "sensor": {
            "pixel_pitch_um": made.sensor.pixel_pitch_um,
            "pixels": [across, down],
            **made.recording.electronics.model_dump(mode="json", exclude_none=True),
            "seed": made.recording.seed,
            "stage_errors_mm": list(made.recording.stage_errors_mm),
            "shift_um": list(made.recording.shift_um),
        },
        "frames": [
            {
                "file": name,
                "plane_distance_mm": frame.settings.plane_distance_mm,
                "exposure": frame.settings.exposure,
                "times": times,
                "brightest_counts": int(frame.counts.max()),
                "saturated_pixels": int(frame.saturated.sum()),
            }
            for (name, times), frame in zip(_names(made.recording), made.imaged.frames, strict=True)
        ],
        "diversity": diversity(lens, made.patch, planes),
        "energy_share_beyond_pixel_limit": made.imaged.share_beyond_pixels,
        "pixel_limit_per_mm": limit,
        "memory": made.memory,
        "versions": versions(),
    }


def _names(recording: Any) -> list[tuple[str, float]]:
    """Files of the frames, and their exposures as multiples of the one for the brightest pixel."""
    planes = range(1, len(recording.plane_distances_mm) + 1)
    if len(recording.exposures) == 1:
        return [(f"frame_{number}.tif", recording.exposures[0]) for number in planes]
    return [
        (f"frame_{number}_{place}.tif", times)
        for number in planes
        for place, times in enumerate(recording.exposures, start=1)
    ]


def _write(made: Made, summary: dict[str, Any], output: Path) -> list[str]:
    """Names of the files written."""
    from wavesim.camera.frames import write_frame
    from wavesim.pictures.field_files import new_results, write_field, write_json, write_tiff
    from wavesim.pictures.frames import frames_figure, object_figure, save

    transmission = made.target.transmission
    pitch_um = 1e3 * made.patch.grid.pitch_mm
    with new_results(output) as folder:
        for entry, frame in zip(summary["frames"], made.imaged.frames, strict=True):
            write_frame(frame, folder / entry["file"])
        write_field(folder / "object.npz", transmission, field_stop_mm=made.patch.field_stop_mm)
        for quantity, name in (("amplitude", "object_amplitude.tif"), ("phase_rad", "object_phase.tif")):
            write_tiff(folder / name, transmission.values, pitch_um, quantity=quantity)
        save(
            object_figure(transmission, made.patch.inside, f"Object: {made.target.name}"),
            folder / "object.png",
        )
        save(frames_figure(made.imaged.frames, summary["design"]), folder / "frames.png")
        names = sorted(path.name for path in folder.iterdir())
        write_json(folder / "image.json", summary | {"files": [*names, "image.json"]})
        return [*names, "image.json"]


def _print(summary: dict[str, Any], output: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, markup=False)
    engine, sensor, thing = summary["engine"], summary["sensor"], summary["object"]
    across, down = sensor["pixels"]
    error = engine["predicted_error"]
    said = "not known" if error is None else f"at most {error:.2g} for light of all directions"
    console.print(visible(str(summary["design"])), soft_wrap=True)
    console.print(
        f"object {thing['name']}, field stop {thing['field_stop_mm']:g} mm, "
        f"{thing['samples']} x {thing['samples']} samples of {thing['pitch_um']:.4g} um",
        soft_wrap=True,
    )
    console.print(f"engine {engine['name']}, error {said}", soft_wrap=True)
    console.print(f"  {settings_text(engine['settings'])}", soft_wrap=True)
    console.print(
        f"sensor: the middle {across} x {down} pixels of {sensor['pixel_pitch_um']:g} um, "
        f"{100.0 * summary['energy_share_beyond_pixel_limit']:.2g} % of the light beyond their "
        f"{summary['pixel_limit_per_mm']:.4g} per mm",
        soft_wrap=True,
    )
    table = Table(box=None, pad_edge=False)
    for column in ("frame", "plane (mm)", "brightest count", "saturated pixels", "exposure"):
        table.add_column(column, justify="left" if column == "frame" else "right")
    for frame in summary["frames"]:
        table.add_row(
            frame["file"],
            f"{frame['plane_distance_mm']:g}",
            str(frame["brightest_counts"]),
            str(frame["saturated_pixels"]),
            f"{frame['times']:g} x",
        )
    console.print()
    console.print(table)
    console.print(f"\nwrote {len(summary['files'])} files to {output}", soft_wrap=True)
