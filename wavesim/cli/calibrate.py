"""The command `wavesim calibrate`: how the lens is mounted, from frames."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.console import print_json, progress_bar
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from wavesim.cli.engine_options import (
    Compensation,
    Interface,
    PitchUm,
    Slices,
    StepUm,
    TileWidthMm,
    print_warnings,
)
from wavesim.cli.imaging_options import (
    KINDS,
    ActiveWidth,
    AsJson,
    Bits,
    DesignOption,
    EngineName,
    Error,
    Exposure,
    FieldStopMm,
    Frames,
    GainElectronsPerCount,
    Illumination,
    LightPitchUm,
    LightTiltDeg,
    ObjectPitchUm,
    OffsetCounts,
    Options,
    Output,
    PatchMm,
    PivotZMm,
    PixelPitchUm,
    PlaneDistanceMm,
    ReadNoiseElectrons,
    WaistMm,
    WavelengthUm,
    engine_options,
    framed_patch,
    key_of_frames,
    refuse_other,
    versions,
)

FILE = "calibration.json"


def calibrate(
    frames: Frames,
    design: DesignOption,
    output: Output,
    parameters: Annotated[
        str, typer.Option(help="What is unknown: rigid, all, or names separated by commas.")
    ] = "rigid",
    known: Annotated[
        Path | None, typer.Option(help="The object, where it is known: a file (.npz), or its folder.")
    ] = None,
    kind: Annotated[str, typer.Option(help="Of an unknown object: complex or amplitude.")] = "amplitude",
    iterations: Annotated[int, typer.Option(help="Of each reconstruction on the way.")] = 8,
    most_mountings: Annotated[int, typer.Option(help="That are tried.")] = 80,
    scale: Annotated[float | None, typer.Option(help="Recorded amplitude of 1; left out: fitted.")] = None,
    pivot_z_mm: PivotZMm = 0.0,
    patch_mm: PatchMm = None,
    field_stop_mm: FieldStopMm = None,
    object_pitch_um: ObjectPitchUm = None,
    illumination: Illumination = "plane",
    light_tilt_deg: LightTiltDeg = "0,0",
    waist_mm: WaistMm = None,
    light_pitch_um: LightPitchUm = None,
    engine: EngineName = "eikonal",
    error: Error = None,
    tile_width_mm: TileWidthMm = None,
    slices: Slices = None,
    compensation: Compensation = None,
    interface: Interface = None,
    step_um: StepUm = None,
    pitch_um: PitchUm = None,
    active_width: ActiveWidth = 1.0,
    plane_distance_mm: PlaneDistanceMm = None,
    pixel_pitch_um: PixelPitchUm = None,
    wavelength_um: WavelengthUm = None,
    exposure: Exposure = None,
    bits: Bits = None,
    offset_counts: OffsetCounts = None,
    gain_electrons_per_count: GainElectronsPerCount = None,
    read_noise_electrons: ReadNoiseElectrons = None,
    as_json: AsJson = False,
) -> None:
    """Find how the lens is mounted: decenter, tilt, working distance, distances of the planes.

    The mounting is the one with which frames and reconstruction agree best. The file that is written serves
    `wavesim reconstruct --calibration`. An interrupted run goes on with the same command.
    """
    from wavesim.pictures.field_files import refuse_no_folder

    options = Options(**locals())
    refuse_other("--kind", kind, KINDS)
    refuse_no_folder(output)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = _calibrated(options)
    messages = list(dict.fromkeys(str(warning.message) for warning in caught))
    print_warnings(messages)
    summary = _summary(found, options) | {"warnings": messages, "versions": versions()}
    _write(found, summary, output)
    if as_json:
        print_json(summary)
    else:
        _print(found, summary, output)


def _calibrated(options: Any) -> Any:
    """Read, search with a bar, and keep what was tried where it is cut off."""
    from wavesim.calibration.estimation import calibrate as search
    from wavesim.calibration.estimation import noise_misfit
    from wavesim.calibration.mounting import Mounting, parameter_names
    from wavesim.camera.frame_sets import recorded_planes
    from wavesim.camera.windows import exit_scene, imaging_error
    from wavesim.cli.reconstruct_results import read_truth
    from wavesim.engines.choosing import engine_for
    from wavesim.runtime.checkpoint import Checkpoint

    lens = load_design(options.design)
    frames, planes, sensor, patch, light, _ = framed_patch(lens, options)
    recorded = recorded_planes(frames)
    options.noise = noise_misfit(recorded)
    options.planes_mm = planes
    settings, error = engine_options(options), imaging_error(options.engine, options.error)
    start = Mounting(pivot_z_mm=options.pivot_z_mm)
    names = _named(options.parameters, parameter_names(len(planes)))
    known = None if options.known is None else read_truth(options.known, patch)
    checkpoint = Checkpoint(options.output / "checkpoint.npz", _key(lens, frames, options, light, known))
    tried = _kept(checkpoint, start, names)
    trail: list[tuple[Any, float]] = []
    try:
        with progress_bar() as bar:
            task = bar.add_task("the light without an object", total=options.most_mountings)

            def show(search: str, number: int, mounting: Any, misfit: float) -> None:
                bar.update(task, completed=number, description=f"{search} search: misfit {misfit:.4f}")
                if search == "fine":
                    trail.append((mounting, misfit))
                    values = [m.values_of(names) for m, _ in trail]
                    if len(trail) > len(tried):
                        checkpoint.keep(values=values, misfits=[size for _, size in trail])

            found = search(
                exit_scene(lens, patch, sensor, planes[0]),
                light,
                recorded,
                parameters=names,
                known=known,
                kind=options.kind,
                iterations=options.iterations,
                scale=options.scale,
                active_width=options.active_width,
                start=start,
                make=lambda scene: engine_for(
                    scene, options.engine, error=error, runs=2 * options.iterations, **settings
                ),
                most_mountings=options.most_mountings,
                tried=tried,
                progress=show,
            )
    except KeyboardInterrupt:
        told = "the same command goes on from there" if trail else "nothing was written"
        raise KeyboardInterrupt(f"interrupted after {len(trail)} mountings; {told}") from None
    checkpoint.drop()
    return found


def _named(text: str, allowed: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters asked for."""
    from wavesim.calibration.estimation import RIGID
    from wavesim.calibration.mounting import refuse_parameters

    groups = {"rigid": RIGID, "all": allowed}
    names = groups.get(text) or tuple(part.strip() for part in text.split(",") if part.strip())
    try:
        refuse_parameters(names, len(allowed) - len(RIGID) - 1)
    except InputError as error:
        raise InputError(f"--parameters = {text!r}: {error}; or: rigid, all") from None
    return names


def _key(lens: Any, frames: Any, options: Any, light: Any, known: Any) -> str:
    names = (
        "parameters", "kind", "iterations", "scale", "pivot_z_mm", "active_width", "engine", "error",
        "tile_width_mm", "slices", "compensation", "interface", "step_um", "pitch_um",
    )  # fmt: skip
    told = str([(name, getattr(options, name)) for name in names])
    return key_of_frames(lens, frames, light, told, b"" if known is None else known.values.tobytes())


def _kept(checkpoint: Any, start: Any, names: tuple[str, ...]) -> list[tuple[Any, float]]:
    """Mountings that an earlier run has tried, and their misfits."""
    kept = checkpoint.load()
    if kept is None:
        return []
    rows = zip(kept["values"].tolist(), kept["misfits"].tolist(), strict=True)
    return [(start.with_values(names, values), misfit) for values, misfit in rows]


def _summary(found: Any, options: Any) -> dict[str, Any]:
    return {
        "frames": [str(path) for path in options.frames],
        "planes_mm": list(options.planes_mm),
        "mounting": found.mounting.model_dump(mode="json"),
        "parameters": list(found.parameters),
        "misfit_before": found.misfit_before,
        "misfit": found.misfit,
        "misfit_of_noise": options.noise,
        "mountings_tried": len(found.trail),
        "at_reach": list(found.at_reach),
        "stopped_because": found.stopped_because,
        "object": "known" if options.known else options.kind,
    }


def _write(found: Any, summary: dict[str, Any], output: Path) -> None:
    from wavesim.pictures.calibrations import calibration_figure
    from wavesim.pictures.field_files import new_results, write_json
    from wavesim.pictures.frames import save

    with new_results(output) as folder:
        save(calibration_figure(found, summary["misfit_of_noise"]), folder / "calibration.png")
        write_json(folder / FILE, summary)


def _print(found: Any, summary: dict[str, Any], output: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, markup=False)
    table = Table(box=None, pad_edge=False)
    table.add_column("lens as mounted, from the design")
    table.add_column("found", justify="right")
    for name, value in zip(found.parameters, found.mounting.values_of(found.parameters), strict=True):
        border = "  (at the border of the search)" if name in found.at_reach else ""
        table.add_row(name, f"{value:.5f}{border}")
    console.print(table)
    noise = summary["misfit_of_noise"]
    console.print(
        f"misfit {summary['misfit_before']:.4f} as designed, {summary['misfit']:.4f} as mounted"
        + ("" if noise is None else f"; {noise:.4f} would be noise alone"),
        soft_wrap=True,
    )
    console.print(
        f"{summary['mountings_tried']} mountings tried; {summary['stopped_because']}; wrote {FILE} and "
        f"calibration.png to {output}",
        soft_wrap=True,
    )
