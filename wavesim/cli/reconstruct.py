"""The command `wavesim reconstruct`: the object behind recorded frames."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.text import visible
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from lensdesign.lens.poses import Pose
from wavesim.cli.engine_options import (
    Compensation,
    Interface,
    PitchUm,
    Slices,
    StepUm,
    TileWidthMm,
    numbers,
    print_warnings,
)
from wavesim.cli.imaging_options import (
    KINDS,
    ActiveWidth,
    AsJson,
    Bits,
    ChartAtMm,
    Cluster,
    DecenterXMm,
    DecenterYMm,
    DesignOption,
    DespaceMm,
    Device,
    EngineName,
    Error,
    Exposure,
    FieldStopMm,
    Frames,
    GainElectronsPerCount,
    Illumination,
    LightPitchUm,
    LightTiltDeg,
    MemoryGb,
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
    engine_summary,
    pose_of,
    refuse_other,
    versions,
)

METHODS = {"paper": ("model", "uniform", "random"), "object": ("even", "amplitude")}
"""Ways of reconstruction, and their starts; the first is the one that is taken."""

ITERATIONS = {"paper": 500, "object": 30}
PAPER_REFOCUS_MM = "-0.01,0.01"


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
    memory_gb: MemoryGb = None,
    cluster: Cluster = None,
    device: Device = None,
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
    region_mm: Annotated[
        str | None,
        typer.Option(help="x,y,width,height: the part of the object that is judged and written."),
    ] = None,
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
    from wavesim.cli.reconstruct_results import summary_of, write_results
    from wavesim.cli.reconstruct_run import case_of, run
    from wavesim.pictures.field_files import refuse_no_folder

    options = Options(**locals())
    _refuse(options)
    refuse_no_folder(output)
    with _no_empty_folder(output), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        case = case_of(load_design(design), options)
        print_warnings(dict.fromkeys(str(warning.message) for warning in caught))
        if not as_json:
            print(case.memory.line(output), file=sys.stderr)
        outcome = run(case, options)
        summary = summary_of(case, outcome, options) | {
            "warnings": list(dict.fromkeys(str(warning.message) for warning in caught)),
            "engine": engine_summary(case.engine),
            "memory": case.memory.as_dict(),
            "versions": versions(),
        }
    summary["files"] = [str(output / name) for name in write_results(case, outcome, summary, output)]
    case.checkpoint.drop()
    if as_json:
        print_json(summary)
    else:
        _print(summary, output)


@contextmanager
def _no_empty_folder(folder: Path) -> Iterator[None]:
    """Remove a folder that was made for files of large arrays, if nothing else came into it."""
    made = not folder.exists()
    try:
        yield
    finally:
        if made and folder.exists() and not any(folder.iterdir()):
            folder.rmdir()


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
    if options.region_mm is not None:
        options.region_mm = numbers(options.region_mm, "--region-mm", 4)
    if options.tv_weight != "auto":
        options.tv_weight = numbers(options.tv_weight, "--tv-weight", 1)[0]
    if options.calibration is not None and pose_of(options) != Pose():
        raise InputError("--calibration says how the lens is mounted: give no decenter, tilt or despace")
    if options.iterations is None:
        options.iterations = ITERATIONS[options.method]
    if options.iterations < 1:
        raise InputError(f"--iterations = {options.iterations}: must be at least 1")
    if options.method == "paper" and len(options.frames) < 2:
        from wavesim.cli.reconstruct_run import ONE_PLANE

        raise InputError(ONE_PLANE)
    if options.refocus_mm is None and options.method == "paper":
        options.refocus_mm = PAPER_REFOCUS_MM
    if options.refocus_mm is not None:
        options.refocus_mm = tuple(numbers(options.refocus_mm, "--refocus-mm", 2))


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
    if summary["region_mm"] is not None:
        x, y, width, height = summary["region_mm"]
        lines.append(f"of the object {width:.4g} mm x {height:.4g} mm about {x:.4g}, {y:.4g} mm")
    if summary["refocus_um"] is not None:
        lines.append(f"sharpest {summary['refocus_um']:.2f} um behind the object plane")
    if summary["truth"]:
        shown = {n: "none" if value is None else f"{value:.4g}" for n, value in summary["truth"].items()}
        lines.append(
            f"against the true object as the lens passes it: correlation {shown['object_correlation']}, "
            f"PSNR {shown['psnr_db']} dB, SSIM {shown['ssim']}"
        )
    if summary["usaf"]:
        lines.append(_resolved(summary["usaf"]))
        for chart in summary["usaf"]["beside"]:
            x, y = chart["at_mm"]
            lines.append(f"at {x:g}, {y:g} mm {_resolved(chart)}")
    return lines


def _resolved(chart: dict[str, Any]) -> str:
    if not chart["elements"]:
        return "no element of the chart lies within the region"
    finest = chart["smallest_resolved"]
    if finest is None:
        return "no element of the chart is resolved"
    return (
        f"resolved down to group {finest['group']}, element {finest['element']}: lines of "
        f"{finest['line_width_um']:.3g} um"
    )
