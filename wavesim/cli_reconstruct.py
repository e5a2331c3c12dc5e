"""The command `wavesim reconstruct`: the object behind recorded frames."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from lensdesign.console import print_json, progress_bar
from lensdesign.errors import InputError
from lensdesign.files import load_design
from lensdesign.plain_text import visible
from lensdesign.poses import Pose
from wavesim.cli_engine import (
    Compensation,
    Interface,
    PitchUm,
    Slices,
    StepUm,
    TileWidthMm,
    numbers,
    print_warnings,
)
from wavesim.cli_imaging import (
    KINDS,
    ActiveWidth,
    AsJson,
    Bits,
    ChartAtMm,
    DecenterXMm,
    DecenterYMm,
    DesignOption,
    DespaceMm,
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
    TiltXDeg,
    TiltYDeg,
    WaistMm,
    WavelengthUm,
    chart_points,
    engine_options,
    engine_summary,
    framed_patch,
    key_of_frames,
    pose_of,
    refuse_other,
    versions,
)

METHODS = {"paper": ("model", "uniform", "random"), "object": ("even", "amplitude")}
"""Ways of reconstruction, and their starts; the first is the one that is taken."""

ITERATIONS = {"paper": 500, "object": 30}
PAPER_REFOCUS_MM = "-0.01,0.01"
ONE_PLANE = "--method paper: needs frames of two planes or more; --method object can do with one"


def reconstruct(
    frames: Frames,
    design: DesignOption,
    output: Output,
    method: Annotated[str, typer.Option(help="paper (Appendix A) or object.")] = "object",
    kind: Annotated[str, typer.Option(help="object: complex or amplitude.")] = "complex",
    iterations: Annotated[int | None, typer.Option(help="Left out: object 30, paper 500.")] = None,
    tv_weight: Annotated[str, typer.Option(help="object: total variation, or auto: by the noise.")] = "auto",
    start: Annotated[
        str | None, typer.Option(help="paper: model, uniform, random; object: even, amplitude.")
    ] = None,
    scale: Annotated[
        float | None, typer.Option(help="object: recorded amplitude of 1; left out: fitted.")
    ] = None,
    patch_mm: PatchMm = None,
    field_stop_mm: FieldStopMm = None,
    object_pitch_um: ObjectPitchUm = None,
    illumination: Illumination = "plane",
    light_tilt_deg: LightTiltDeg = "0,0",
    waist_mm: WaistMm = None,
    light_pitch_um: LightPitchUm = None,
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
    active_width: ActiveWidth = 1.0,
    calibration: Annotated[
        Path | None, typer.Option(help="Of `wavesim calibrate`: the lens as mounted.")
    ] = None,
    refocus_mm: Annotated[str | None, typer.Option(help="low,high: where to look for the focus.")] = None,
    truth: Annotated[
        Path | None, typer.Option(help="True object (.npz), or the folder that holds it.")
    ] = None,
    usaf: Annotated[str | None, typer.Option(help="The object is a USAF chart: bright or dark.")] = None,
    chart_at_mm: ChartAtMm = None,
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
    """Find the object behind frames: amplitude and phase, residuals, refocusing, and how good it is.

    An interrupted run goes on with the same command from the last iterations that it kept.
    """
    from wavesim.field_files import refuse_no_folder
    from wavesim.reconstruction_results import summary_of, write_results

    options = Options(**locals())
    _refuse(options)
    refuse_no_folder(output)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        case = _case(load_design(design), options)
        print_warnings(dict.fromkeys(str(warning.message) for warning in caught))
        outcome = _run(case, options)
    summary = summary_of(case, outcome, options) | {
        "warnings": list(dict.fromkeys(str(warning.message) for warning in caught)),
        "engine": engine_summary(case.engine),
        "versions": versions(),
    }
    summary["files"] = [str(output / name) for name in write_results(case, outcome, summary, output)]
    case.checkpoint.drop()
    if as_json:
        print_json(summary)
    else:
        _print(summary, output)


class Case(NamedTuple):
    """What is reconstructed from what."""

    lens: Any
    patch: Any
    light: Any
    sensor: Any
    planes: Any
    recorded: Any
    engine: Any
    truth: Any
    charts: Any
    diversity: float
    checkpoint: Any


class Outcome(NamedTuple):
    """What came out.

    `behind` is the field behind the object, `curve` the misfit (object) or the correlation A6 (paper) for
    every iteration; `said` holds figures of one method alone.
    """

    transmission: Any
    behind: Any
    residual_maps: Any
    curve: Any
    refocusing: Any
    said: dict[str, Any]


def _refuse(options: Any) -> None:
    """Refuse what can be told before any file is read, and fill in what depends on the method."""
    refuse_other("--method", options.method, tuple(METHODS))
    refuse_other("--kind", options.kind, KINDS)
    starts = METHODS[options.method]
    options.start = options.start or starts[0]
    if options.start not in starts:
        raise InputError(f"--start = {options.start!r}: allowed for {options.method}: {', '.join(starts)}")
    if options.usaf not in (None, "bright", "dark"):
        raise InputError(f"--usaf = {options.usaf!r}: allowed: bright, dark")
    options.chart_at_mm = chart_points(options)
    if options.chart_at_mm and options.usaf is None:
        raise InputError("--chart-at-mm: means nothing without --usaf")
    if options.tv_weight != "auto":
        options.tv_weight = numbers(options.tv_weight, "--tv-weight", 1)[0]
    if options.calibration is not None and pose_of(options) != Pose():
        raise InputError("--calibration says how the lens is mounted: give no decenter, tilt or despace")
    if options.iterations is None:
        options.iterations = ITERATIONS[options.method]
    if options.iterations < 1:
        raise InputError(f"--iterations = {options.iterations}: must be at least 1")
    if options.method == "paper" and len(options.frames) < 2:
        raise InputError(ONE_PLANE)
    if options.refocus_mm is None and options.method == "paper":
        options.refocus_mm = PAPER_REFOCUS_MM
    if options.refocus_mm is not None:
        options.refocus_mm = tuple(numbers(options.refocus_mm, "--refocus-mm", 2))


def _case(lens: Any, options: Any) -> Case:
    from wavesim.frame_sets import planes_of_frames, recorded_planes
    from wavesim.imaging import usaf_charts_of
    from wavesim.imaging_planes import exit_scene, imaging_engine
    from wavesim.mounting import read_mounting
    from wavesim.reconstruction_results import read_truth
    from wavesim.resumable import Checkpoint

    mounting = None if options.calibration is None else read_mounting(options.calibration)
    pose = pose_of(options) if mounting is None else mounting.pose
    frames, planes, sensor, patch, light, diversity = framed_patch(lens, options, pose)
    if options.method == "paper" and len(planes) < 2:
        raise InputError(ONE_PLANE)
    truth = None if options.truth is None else read_truth(options.truth, patch)
    charts = usaf_charts_of(patch, options.chart_at_mm) if options.usaf else ()
    settings = engine_options(options)
    scene = exit_scene(lens, patch, sensor, planes[0], pose)
    recorded = recorded_planes(frames)
    if mounting is not None:
        scene, light, recorded = (
            mounting.scene(scene),
            mounting.illumination(light),
            mounting.recorded(recorded),
        )
    runs = 2 * options.iterations if options.method == "object" else 2
    engine = imaging_engine(scene, options.engine, runs, options.error, **settings)
    checkpoint = Checkpoint(
        options.output / "checkpoint.npz", _key(lens, frames, options, light, recorded, engine)
    )
    seen = planes_of_frames(frames)
    return Case(lens, patch, light, sensor, seen, recorded, engine, truth, charts, diversity, checkpoint)


def _key(lens: Any, frames: Any, options: Any, light: Any, recorded: Any, engine: Any) -> str:
    told = {
        name: str(getattr(options, name))
        for name in ("method", "kind", "iterations", "tv_weight", "start", "scale")
    }
    told |= {"active_width": str(options.active_width), "pose": str(engine.scene.pose)}
    told |= {"engine": engine.name, "settings": str(engine.settings())}
    told |= {"object_z": str(light.grid.z_mm), "planes": str([p.distance_mm for p in recorded])}
    return key_of_frames(lens, frames, light, str(sorted(told.items())))


def _run(case: Case, options: Any) -> Outcome:
    """Reconstruct and refocus, with a bar; an interrupt says what is kept."""
    done = 0
    try:
        with progress_bar() as bar:
            task = bar.add_task(f"{options.method}: engine {case.engine.name}", total=options.iterations)

            def show(k: int, figure: float) -> None:
                nonlocal done
                done = k + 1
                name = "CC" if options.method == "paper" else "misfit"
                bar.update(task, completed=done, description=f"{options.method}: {name} {figure:.5f}")

            outcome = (_paper if options.method == "paper" else _object)(case, options, show)
            if options.refocus_mm is None:
                return outcome
            bar.update(task, description="refocusing", completed=0, total=None)
            return _refocused(
                case, options, outcome, lambda k, total: bar.update(task, completed=k, total=total)
            )
    except KeyboardInterrupt:
        kept = case.checkpoint.load() is not None
        where = "the same command goes on from where it was last kept" if kept else "nothing was written"
        raise KeyboardInterrupt(
            f"interrupted after {done} of {options.iterations} iterations; {where}"
        ) from None


def _object(case: Case, options: Any, show: Any) -> Outcome:
    from wavesim.resumable import reconstruct_resumably

    found = reconstruct_resumably(
        case.engine,
        case.light,
        case.recorded,
        case.checkpoint,
        kind=options.kind,
        tv_weight=options.tv_weight,
        iterations=options.iterations,
        scale=options.scale,
        start="amplitude" if options.start == "amplitude" else None,
        active_width=options.active_width,
        progress=show,
    )
    said = {"scale": found.scale, "misfit": found.misfit[-1], "stopped_early": found.stopped_early}
    behind = case.light.with_values(case.light.values * found.transmission.values)
    return Outcome(found.transmission, behind, found.residual_maps, found.misfit, None, said)


def _paper(case: Case, options: Any, show: Any) -> Outcome:
    from wavesim.imaging import transmission_of
    from wavesim.resumable import retrieve_resumably

    retrieved, maps = retrieve_resumably(
        case.engine,
        case.light,
        case.recorded,
        case.checkpoint,
        iterations=options.iterations,
        start=options.start,
        progress=show,
    )
    back = case.engine.adjoint(retrieved.field)
    said = {"correlation_a6": retrieved.correlation[-1], "stagnated_at": retrieved.stagnated_at}
    return Outcome(transmission_of(back, case.light), back, maps, retrieved.correlation, None, said)


def _refocused(case: Case, options: Any, outcome: Outcome, show: Any) -> Outcome:
    """The sharpest of all distances; a field is carried, not a transmission."""
    from dataclasses import replace

    from wavesim.imaging import transmission_of
    from wavesim.refocusing import refocus_field

    depth_mm = 1e-3 * case.patch.wavelength_um / case.lens.object.numerical_aperture**2
    found = refocus_field(outcome.behind, options.refocus_mm, depth_mm, show)
    # The light is taken where the object was thought to be: over a few depths of focus it hardly changes.
    there = transmission_of(replace(found.field, grid=case.light.grid), case.light)
    return outcome._replace(transmission=there, refocusing=found)


def _print(summary: dict[str, Any], output: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, markup=False)
    engine = summary["engine"]
    early = ", where the misfit fell no more" if summary.get("stopped_early") else ""
    console.print(visible(summary["design"]), soft_wrap=True)
    console.print(
        f"method {summary['method']}, {summary['kind']} object, engine {engine['name']}: "
        f"{summary['iterations']} iterations{early}",
        soft_wrap=True,
    )
    table = Table(box=None, pad_edge=False)
    for column in ("plane (mm)", "residual", "of it noise", "correlation of amplitudes"):
        table.add_column(column, justify="right")
    for plane in summary["planes"]:
        noise = "not known" if plane["noise"] is None else f"{plane['noise']:.4f}"
        table.add_row(
            f"{plane['plane_distance_mm']:g}",
            f"{plane['residual']:.4f}",
            noise,
            f"{plane['correlation']:.5f}",
        )
    console.print()
    console.print(table)
    console.print()
    for line in _figures(summary):
        console.print(line, soft_wrap=True)
    console.print(f"wrote {len(summary['files'])} files to {output}", soft_wrap=True)


def _figures(summary: dict[str, Any]) -> list[str]:
    lines = []
    if summary["refocus_um"] is not None:
        lines.append(f"sharpest {summary['refocus_um']:.2f} um behind the object plane")
    if summary["truth"]:
        shown = {n: "none" if value is None else f"{value:.4g}" for n, value in summary["truth"].items()}
        lines.append(
            f"against the true object as the lens passes it: correlation {shown['object_correlation']}, "
            f"PSNR {shown['psnr_db']} dB, SSIM {shown['ssim']}"
        )
    if summary["usaf"]:
        lines.append(_resolved(summary["usaf"]["smallest_resolved"]))
        for chart in summary["usaf"]["beside"]:
            x, y = chart["at_mm"]
            lines.append(f"at {x:g}, {y:g} mm {_resolved(chart['smallest_resolved'])}")
    return lines


def _resolved(finest: dict[str, Any] | None) -> str:
    if finest is None:
        return "no element of the chart is resolved"
    return (
        f"resolved down to group {finest['group']}, element {finest['element']}: lines of "
        f"{finest['line_width_um']:.3g} um"
    )
