"""The command `wavesim reconstruct`: reconstruct the object from recorded frames."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Json
from lensdesign.common.text import visible
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from wavesim.cli.bench_files import read_empty, read_priors, with_calibrated_stop
from wavesim.cli.free_space import in_free_space
from wavesim.cli.layers import in_layers
from wavesim.cli.options import Empty, Frames, Output, Priors, print_warnings
from wavesim.cli.runs import Run, print_table, progress
from wavesim.scene.settings import (
    STOP_ORIGINS,
    CalibrationSettings,
    FramedSettings,
    FrameSetSettings,
    FreeSpaceSettings,
    LayerReconstructionSettings,
    PoseSettings,
    ReconstructionSettings,
)
from wavesim.scene.system_state import SystemState

SHOWN_DISPLACEMENT = 0.2
"""Smallest displacement that is printed (samples). JSON also contains smaller ones."""

SUMMARY = "reconstruction.json"

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens
    from wavesim.calibration.calibration_result import Calibrated
    from wavesim.reconstruction.calibrated_bench import CalibratedBench
    from wavesim.reconstruction.found_object import FoundObject
    from wavesim.runtime.memory import Memory
    from wavesim.sensor.frames import Frame


@most_used(
    "design",
    "output",
    "patch_mm",
    "kind",
    "illumination",
    "plane_distance_mm",
    "iterations",
    "calibration",
    "calibrate",
    "truth",
    "engine",
    "error",
    "as_json",
)
def reconstruct(
    frames: Frames,
    output: Output,
    settings: ReconstructionSettings,
    of_frames: FrameSetSettings,
    free: FreeSpaceSettings,
    of_layers: LayerReconstructionSettings,
    design: Annotated[
        Path | None,
        typer.Option(
            metavar="DESIGN",
            help="Design file (TOML); required without --free-space.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Result of `wavesim calibrate` (calibration.json).", rich_help_panel=OptionGroup.INPUT
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="True object (.npz), or its folder.", rich_help_panel=OptionGroup.INPUT),
    ] = None,
    empty: Empty = None,
    priors: Priors = None,
    as_json: Json = False,
) -> None:
    """Reconstruct the object from frames: amplitude, phase, residuals, focus, and goodness of fit.

    The exit status is 0 if the frames are explained within their noise, and 1 if they are not, or if they
    were not judged (--verdict none). Where they are not explained, the most likely causes are tested and
    named. A quick verdict rests on the residuals alone. After an interrupt, repeat the command to continue
    from the last checkpoint; with --layers-um or --free-space it starts from the beginning. An interrupt
    during these tests keeps the object, which is then not judged: the exit status is 1.

    Example: wavesim reconstruct frames/*.tif --design lens.toml -o object
    """
    from wavesim.calibration.calibration_result import read_bench
    from wavesim.metrics.goodness_of_fit import Finding, with_finding
    from wavesim.metrics.next_steps import STOP_CAUSE
    from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
    from wavesim.runtime.checkpoint import CHECKPOINT, SEARCH_CHECKPOINTS, STOP_TRIALS
    from wavesim.runtime.result_files import remove_unfinished
    from wavesim.sensor.frame_sets import read_frames

    remove_unfinished(output)
    if free.free_space:
        of_lenses: dict[str, object] = {"design": design, "calibration": calibration, "truth": truth}
        of_lenses |= {"empty": empty, "priors": priors, "layers_um": of_layers.layers_um}
        in_free_space(frames, output, settings, of_frames, free, of_lenses, as_json)
        return
    if design is None:
        raise InputError(
            "--design: missing; give the design of the lens, or --free-space for frames without a lens"
        )
    if free.calibrate and calibration is not None:
        raise InputError("--calibrate, --calibration: give only one of them")
    if priors is not None and not free.calibrate:
        raise InputError("--priors: requires --calibrate")
    if of_layers.layers_um is not None:
        if free.calibrate or empty:
            option = "--calibrate" if free.calibrate else "--empty"
            raise InputError(
                f"{option}: cannot be used with --layers-um; calibrate with another object first"
            )
        in_layers(
            frames,
            design,
            output,
            settings,
            of_frames,
            of_layers,
            calibration=calibration,
            truth=truth,
            as_json=as_json,
        )
        return
    run = Run(as_json)
    tell_memory = run.tells_memory(output)

    def on_estimate(memory: Memory) -> None:
        print_warnings(run.messages)
        if tell_memory is not None:
            tell_memory(memory)

    # Subfolder of the results for the calibration by --calibrate.
    subfolder = "calibration"
    with _no_empty_folder(output), run.warnings():
        lens = load_design(design)
        bench = None if calibration is None else read_bench(calibration, lens)
        stop_from, stop_doubt, settings = with_calibrated_stop(calibration, settings)
        pictures = [read_frames(frames, of_frames, lens=lens)]
        if free.calibrate or empty:
            without, folder = read_empty(empty, of_frames, lens), output / subfolder
            expected = read_priors(priors, lens)
            calibrated = _calibrated(
                lens, pictures[0], without, expected, settings, folder, free.calibrate, bench
            )
            if free.calibrate and calibrated.field_stop_from == "frames":
                settings = settings.with_stop(*calibrated.field_stop)
                stop_from, stop_doubt = "frames", calibrated.stop_warning
            seen, kind = (frames, settings.kind) if free.calibrate else (empty or [], "empty")
            _write_and_print(calibrated, seen, pictures[0], kind, folder, as_json)
            earlier, bench = bench, calibrated.bench
            if not free.calibrate:  # the calibration has the mounting, too
                bench = replace(bench, uncertainty=None if earlier is None else earlier.uncertainty)
                settings = settings.replaced(**dict.fromkeys(PoseSettings.model_fields, 0.0))
        summaries = list[dict[str, Any]]()

        def write(found: FoundObject) -> None:
            """Write an object that is not judged yet."""
            with warnings.catch_warnings():  # those of plots are no warnings about the result
                warnings.simplefilter("ignore")
                summaries.append(with_doubt(found).write(output, more(found)))

        def with_doubt(found: FoundObject) -> FoundObject:
            if not stop_doubt:
                return found
            return replace(found, verdict=with_finding(found.verdict, Finding(STOP_CAUSE, stop_doubt)))

        def more(found: FoundObject) -> dict[str, Any]:
            return {
                "design": lens.title or design.stem,
                "field_stop_from": stop_from or found.settings.field_stop_from,
                "warnings": run.messages,
            }

        try:
            with progress() as on_progress:
                found = reconstruct_frames(
                    lens,
                    # Given away: nothing here may hold them to the end.
                    pictures.pop(),
                    settings,
                    truth=truth,
                    calibration=bench,
                    folder=output,
                    progress=on_progress,
                    on_estimate=on_estimate,
                    on_found=write,
                )
        except KeyboardInterrupt:
            if not summaries:
                raise
            summary = summaries[0]
        else:
            summary = summaries[0] | with_doubt(found).as_dict() | more(found)
            _write_summary(summary, output)
    if summary["verdict"]["judged"]:
        searches = (output / subfolder / name for name in SEARCH_CHECKPOINTS)
        for path in (output / CHECKPOINT, output / STOP_TRIALS, *searches):
            with suppress(OSError):  # the results are written
                path.unlink(missing_ok=True)
    run.report(summary, partial(_print, output=output), summary["verdict"]["explained"])


def _calibrated(
    lens: Lens,
    frames: Sequence[Frame],
    empty: Sequence[Frame] | None,
    priors: dict[str, float] | None,
    settings: ReconstructionSettings,
    output: Path,
    calibrates: bool,
    bench: CalibratedBench | None,
) -> Calibrated:
    """Calibrate the bench from frames, or the light alone from empty frames; an interrupted run continues.

    On a bench that is calibrated already, the light alone is sought anew.
    """
    from wavesim.calibration.frame_calibration import calibrate_empty, calibrate_frames, validate_same_frames

    given = settings.model_dump(include=set(FramedSettings.model_fields), exclude_unset=True)
    # The reconstruction that follows is judged.
    sought = CalibrationSettings(**given | {"kind": settings.kind, "verdict": "none"})
    with progress() as on_progress:
        if calibrates or empty is None:
            return calibrate_frames(
                lens,
                frames,
                sought,
                empty=empty,
                priors=priors,
                folder=output,
                progress=on_progress,
            )
        validate_same_frames(empty, frames)
        start = SystemState(settings.pose) if bench is None else bench.state
        return calibrate_empty(
            lens, empty, sought, start=start, folder=output, progress=on_progress, parameters="light"
        )


def _write_and_print(
    found: Calibrated,
    paths: Sequence[Path],
    frames: Sequence[Frame],
    kind: str,
    output: Path,
    as_json: bool,
) -> None:
    """Write and print a calibration."""
    from wavesim.cli.calibrate import print_calibration, write_calibration

    summary = write_calibration(found, paths, frames, {"object": kind, "warnings": []}, output)
    if not as_json:
        print_calibration(found, summary, output)
        print()


@contextmanager
def _no_empty_folder(folder: Path) -> Iterator[None]:
    """Remove a folder that was created for files of large arrays, if it is empty in the end."""
    made = not folder.exists()
    try:
        yield
    finally:
        if made:
            with suppress(OSError):  # It does not exist, holds results, or cannot be changed.
                folder.rmdir()


def _write_summary(summary: dict[str, Any], output: Path) -> None:
    """Write the summary again, with the verdict."""
    from wavesim.runtime.result_files import new_results, write_json

    names = [Path(path).name for path in summary["files"]]
    with new_results(output) as folder:
        write_json(summary | {"files": names}, folder / SUMMARY)


def _print(summary: dict[str, Any], output: Path) -> None:
    from wavesim.reconstruction.stop_rule import STOPPED

    engine = summary["engine"]
    why = STOPPED[summary["stopped_because"]] if "stopped_because" in summary else ""
    print(visible(summary["design"]))
    print(
        f"method {summary['method']}, {summary['kind']} object, engine {engine['name']}: "
        f"{summary['iterations']} iterations{why}"
    )
    rows = [
        (
            f"{plane['plane_distance_mm']:g}",
            *(
                "unknown" if plane[name] is None else f"{plane[name]:.{digits}f}"
                for name, digits in (("residual", 4), ("noise", 4), ("correlation", 5))
            ),
        )
        for plane in summary["planes"]
    ]
    print()
    print_table((), ("plane (mm)", "residual", "noise alone", "correlation of amplitudes"), rows)
    print()
    for line in _summary_lines(summary):
        print(line)
    print(f"wrote {len(summary['files'])} files to {output}")
    print(f"verdict: {summary['verdict']['words']}")


def _summary_lines(summary: dict[str, Any]) -> list[str]:
    from wavesim.scene.source import Source
    from wavesim.targets.patch import stop_words

    words = stop_words(summary["field_stop_mm"], summary["field_stop_at_mm"])
    lines = [f"{words}, {STOP_ORIGINS[summary['field_stop_from']]}"]
    if "found_by" in summary:
        lines.append("object and verdict are those of the calibration, of the same frames and settings")
    if summary["oversampling"] is not None:
        lines.append(
            f"oversampling {summary['oversampling']['ratio']:.3g}: pixels with more light than noise for "
            f"each unknown of the {summary['kind']} object"
        )
    if not summary["scale_is_determined"]:
        known = "give --scale, the recorded amplitude where it is 1"
        if summary["kind"] == "amplitude":
            known = f"its brightest parts count as 1 at the scale {summary.get('scale', 1.0):.4g}; {known}"
        lines.append(
            f"the frames do not determine the scale: the transmission is known up to a factor; {known}"
        )
    if "engine_replaced" in summary:
        lines.append(summary["engine_replaced"]["words"])
    source = Source(summary.get("source_deg", 0.0), summary.get("bandwidth_nm", 0.0))
    deviations = {"width_deg": "source_deg_deviation", "bandwidth_nm": "bandwidth_nm_deviation"}
    lines += source.lines({name: summary[key] for name, key in deviations.items() if key in summary})
    if summary["region_mm"] is not None:
        x, y, width, height = summary["region_mm"]
        lines.append(
            f"region of the object: {width:.4g} mm x {height:.4g} mm, centred at {x:.4g}, {y:.4g} mm"
        )
    if summary["refocus_um"] is not None:
        lines.append(f"best focus {summary['refocus_um']:.2f} µm behind the object plane")
    if summary["truth"]:
        shown = {n: "none" if value is None else f"{value:.4g}" for n, value in summary["truth"].items()}
        lines.append(
            f"compared with the true object, band-limited by the lens: correlation "
            f"{shown['object_correlation']}, PSNR {shown['psnr_db']} dB, SSIM {shown['ssim']}"
        )
        if "correlation_without_low_orders" in shown:
            lines.append(
                "times the polynomial of second order that fits best (ramp and curvature of its phase): "
                f"correlation {shown['correlation_without_low_orders']}"
            )
        lines += _displacement(summary["truth"], summary["object_pitch_um"])
    if summary["usaf"]:
        lines += _resolved(summary["usaf"])
        for chart in summary["usaf"]["beside"]:
            x, y = chart["at_mm"]
            first, *others = _resolved(chart)
            lines += [f"chart at {x:g}, {y:g} mm: {first}", *others]
    return lines


def _displacement(truth: dict[str, float | None], pitch_um: float) -> list[str]:
    """Describe the displacement of the result from the true object, if it is noticeable."""
    x, y = truth["displacement_x_um"], truth["displacement_y_um"]
    if x is None or y is None or max(abs(x), abs(y)) < SHOWN_DISPLACEMENT * pitch_um:
        return []
    return [
        f"displaced by {x:.3g}, {y:.3g} µm from the true object (x, y); without this displacement the "
        f"correlation is {truth['correlation_registered']:.4g}"
    ]


def _resolved(chart: dict[str, Any]) -> list[str]:
    """Describe the finest resolved element in both directions, its limit, and the chart's position."""
    if not chart["elements"] and "region" in chart["limited_by"]:
        return ["no element of the chart lies within the region"]
    finest = chart["smallest_resolved"]
    if finest is None:
        return ["no element of the chart is resolved", f"  limit: {chart['limit']}", *_place_of(chart)]
    beyond = (
        f", finer than the diffraction limit of {chart['aperture_passes_um']:.3g} µm (wavelength / 2 NA), "
        "due to the method's assumptions about the object"
    )
    x, y = (chart[f"smallest_resolved_{way}"]["line_width_um"] for way in "xy")
    return [
        f"resolved down to group {finest['group']}, element {finest['element']}: lines of "
        f"{finest['line_width_um']:.3g} µm{beyond if finest['beyond_aperture'] else ''}",
        f"  bars repeated along x: {x:.3g} µm; along y: {y:.3g} µm",
        f"  limit: {chart['limit']}",
        *_place_of(chart),
    ]


def _place_of(chart: dict[str, Any]) -> list[str]:
    """Describe the position of the chart in the result, if it is displaced or unknown."""
    found = chart["displacement"]
    if found is None:
        return ["  the position of the chart is undetermined: contrast is measured at its nominal position"]
    lines = []
    if max(abs(found["x_samples"]), abs(found["y_samples"])) >= SHOWN_DISPLACEMENT:
        lines.append(
            f"  chart displaced by {found['x_um']:.3g}, {found['y_um']:.3g} µm (x, y), which does not reduce "
            "the resolution"
        )
    if found["scale"] != 1.0 or found["rotation_deg"] != 0.0:
        lines.append(f"  chart scaled by {found['scale']:.4f} and rotated by {found['rotation_deg']:.3f}°")
    return lines
