"""The command `wavesim image`: frames of an object, as the design's sensor records them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from lensdesign.console import print_json, progress_bar
from lensdesign.errors import InputError
from lensdesign.files import load_design
from lensdesign.plain_text import visible
from wavesim.cli_engine import (
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
from wavesim.cli_imaging import (
    ActiveWidth,
    AsJson,
    DecenterXMm,
    DecenterYMm,
    Design,
    DespaceMm,
    EngineName,
    Error,
    FieldStopMm,
    Illumination,
    LightPitchUm,
    LightTiltDeg,
    ObjectPitchUm,
    Options,
    Output,
    PatchMm,
    PivotZMm,
    TiltXDeg,
    TiltYDeg,
    WaistMm,
    WavelengthUm,
    engine_options,
    engine_summary,
    patch_and_light,
    pose_of,
    versions,
)


def image(
    design: Design,
    output: Output,
    object_: Annotated[str, typer.Option("--object", help="usaf, star, phase, tissue, or FILE.")] = "usaf",
    picture_pixel_um: Annotated[float | None, typer.Option(help="FILE: side of its pixels.")] = None,
    ground: Annotated[str, typer.Option(help="usaf, star: bright or dark.")] = "bright",
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
    pixels: Annotated[int | None, typer.Option(help="Of a side; left out, what holds the light.")] = None,
    engine: EngineName = "auto",
    error: Error = None,
    tile_width_mm: TileWidthMm = None,
    slices: Slices = None,
    compensation: Compensation = None,
    interface: Interface = None,
    step_um: StepUm = None,
    pitch_um: PitchUm = None,
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
    active_width: ActiveWidth = 1.0,
    stage_error_mm: Annotated[str, typer.Option(help="Of all planes, or of each.")] = "0",
    shift_um: Annotated[str, typer.Option(help="x,y of the sensor from plane to plane.")] = "0,0",
    as_json: AsJson = False,
) -> None:
    """Record an object through the lens: frames, the true object, a preview, and what was used.

    Frames are 16-bit TIFF that hold their settings. The sensor's window is its middle, as much of it as the
    light falls on.
    """
    from wavesim.field_files import refuse_no_folder

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
    if as_json:
        print_json(summary)
    else:
        _print(summary, output)


class Made(NamedTuple):
    """What the command computed."""

    patch: Any
    light: Any
    target: Any
    sensor: Any
    recording: Any
    imaged: Any


def _make(lens: Any, options: Any) -> Made:
    from wavesim.imaging import make_target
    from wavesim.imaging_planes import (
        OVERSAMPLING,
        check_footprint,
        exit_scene,
        image_patch,
        imaging_engine,
        light_window,
        sensor_window,
    )

    recording, pose, settings = _recording(lens, options), pose_of(options), engine_options(options)
    planes = recording.plane_distances_mm
    patch, light = patch_and_light(lens, options)
    target = make_target(
        patch,
        options.object_,
        options.ground,
        numerical_aperture=lens.object.numerical_aperture,
        seed=options.seed,
        picture_pixel_um=options.picture_pixel_um,
    )
    sensor = sensor_window(lens, patch, planes, options.pixels, pose)
    check_footprint(lens, patch, sensor, planes, pose)
    windows = [light_window(lens, patch, sensor, plane, pose) for plane in planes]
    scene = exit_scene(lens, patch, windows[0], planes[0], pose, OVERSAMPLING)
    behind = light.with_values(light.values * target.transmission.values)
    with progress_bar() as bar:
        task = bar.add_task("", total=2 + len(planes))
        imaged = image_patch(
            scene,
            behind,
            sensor,
            windows,
            recording,
            lambda scene: imaging_engine(scene, options.engine, 1, options.error, **settings),
            lambda what: bar.update(task, advance=1, description=what),
        )
    return Made(patch, light, target, sensor, recording, imaged)


def _recording(lens: Any, options: Any) -> Any:
    """Planes, electronics, noise and errors of the stage."""
    from lensdesign.files import validate
    from wavesim.imaging_planes import Recording
    from wavesim.sensor import Electronics

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
    )


def _summary(lens: Any, options: Any, made: Made) -> dict[str, Any]:
    from wavesim.imaging_planes import diversity
    from wavesim.metrics import spectrum_support

    planes = made.recording.plane_distances_mm
    limit = 500.0 / lens.sensor.pixel_pitch_um
    field = made.imaged.fields[0]
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
                "file": f"frame_{number}.tif",
                "plane_distance_mm": plane,
                "exposure": frame.settings.exposure,
                "brightest_counts": int(frame.counts.max()),
                "saturated_pixels": int(frame.saturated.sum()),
            }
            for number, (plane, frame) in enumerate(zip(planes, made.imaged.frames, strict=True), start=1)
        ],
        "diversity": diversity(lens, made.patch, planes),
        "energy_share_beyond_pixel_limit": spectrum_support(
            field.values, field.grid.pitch_mm, limit
        ).share_beyond,
        "pixel_limit_per_mm": limit,
        "versions": versions(),
    }


def _write(made: Made, summary: dict[str, Any], output: Path) -> list[str]:
    """Names of the files written."""
    import numpy as np

    from wavesim.field_files import new_results, write_field, write_json, write_tiff
    from wavesim.frames import write_frame
    from wavesim.imaging_plots import frames_figure, object_figure, save

    transmission = made.target.transmission
    pitch_um = 1e3 * made.patch.grid.pitch_mm
    with new_results(output) as folder:
        for entry, frame in zip(summary["frames"], made.imaged.frames, strict=True):
            write_frame(frame, folder / entry["file"])
        write_field(folder / "object.npz", transmission, field_stop_mm=made.patch.field_stop_mm)
        write_tiff(
            folder / "object_amplitude.tif", np.abs(transmission.values), pitch_um, quantity="amplitude"
        )
        write_tiff(folder / "object_phase.tif", np.angle(transmission.values), pitch_um, quantity="phase_rad")
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
    for column in ("frame", "plane (mm)", "brightest count", "saturated pixels"):
        table.add_column(column, justify="left" if column == "frame" else "right")
    for frame in summary["frames"]:
        table.add_row(
            frame["file"],
            f"{frame['plane_distance_mm']:g}",
            str(frame["brightest_counts"]),
            str(frame["saturated_pixels"]),
        )
    console.print()
    console.print(table)
    console.print(f"\nwrote {len(summary['files'])} files to {output}", soft_wrap=True)
