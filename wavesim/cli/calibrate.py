"""The command `wavesim calibrate`: calibrate a bench from frames."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Json
from lensdesign.files.design import load_design
from wavesim.cli.bench_files import read_empty, read_priors
from wavesim.cli.options import DesignOption, Empty, Frames, Output, Priors
from wavesim.cli.runs import Run, print_table
from wavesim.scene.settings import STOP_ORIGINS, CalibrationSettings, FrameSetSettings

if TYPE_CHECKING:
    from wavesim.calibration.calibration_result import Calibrated
    from wavesim.sensor.frames import Frame


@most_used(
    "design",
    "output",
    "patch_mm",
    "kind",
    "illumination",
    "plane_distance_mm",
    "parameters",
    "iterations",
    "known",
    "empty",
    "priors",
    "engine",
    "as_json",
)
def calibrate(
    frames: Frames,
    design: DesignOption,
    output: Output,
    settings: CalibrationSettings,
    of_frames: FrameSetSettings,
    known: Annotated[
        Path | None,
        typer.Option(
            "--truth",
            "--known",
            help="True object, if it is known: a file (.npz), or its folder.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    empty: Empty = None,
    priors: Priors = None,
    as_json: Json = False,
) -> None:
    """Calibrate the bench from frames of a known or unknown object: light, lens, mounting and camera.

    The result is the bench with which frames and reconstruction agree best. Parameters that the frames do not
    need keep their nominal values. The output folder has them in calibration.json, which a reconstruction
    reads (`wavesim reconstruct --calibration FILE`).
    The verdict is that of a reconstruction on this bench, whose object is written, too. A reconstruction of
    the same frames with the same settings uses it. The exit status is 0 if the frames are explained within
    their noise, and 1 if they are not, or if they were not judged: with --verdict none, or where an
    interrupt has ended the run before the verdict. After an interrupt, repeat the command to continue.

    Verdict and standard deviations take half of the time, and can be left out (--verdict, --no-deviations).

    Example: wavesim calibrate frames/*.tif --design lens.toml -o bench
    """
    from wavesim.calibration.frame_calibration import calibrate_frames
    from wavesim.metrics.next_steps import ADVICE
    from wavesim.runtime.checkpoint import SEARCH_CHECKPOINTS
    from wavesim.runtime.result_files import remove_unfinished
    from wavesim.sensor.frame_sets import read_frames

    remove_unfinished(output)
    searched: list[Calibrated] = []
    extra: dict[str, Any] = {"object": "known" if known else settings.kind}
    if empty:
        extra["empty"] = [str(path) for path in empty]
    run = Run(as_json)
    with run.computing() as on_progress:
        lens = load_design(design)
        pictures = read_frames(frames, of_frames, lens=lens)

        def write(found: Calibrated) -> None:
            """Write a bench that is not judged yet."""
            searched.append(found)  # an interrupt from here on keeps it
            with warnings.catch_warnings():  # those of plots are no warnings about the result
                warnings.simplefilter("ignore")
                write_calibration(found, frames, pictures, extra | {"warnings": run.messages}, output)

        try:
            found = calibrate_frames(
                lens,
                pictures,
                settings,
                known=known,
                empty=read_empty(empty, of_frames, lens),
                priors=read_priors(priors, lens),
                folder=output,
                progress=on_progress,
                on_found=write,
            )
        except KeyboardInterrupt:
            if not searched:
                raise
            found = searched[0]
    is_complete = found.verdict is not None or not searched
    is_without_verdict = found.verdict is None and settings.verdict == "none"
    summary = write_calibration(found, frames, pictures, extra | {"warnings": run.messages}, output)
    # A search whose verdict or deviations were left out can be continued to them.
    if is_complete and not is_without_verdict and settings.deviations:
        for name in SEARCH_CHECKPOINTS:
            with suppress(OSError):  # A left-over checkpoint does no harm.
                (output / name).unlink(missing_ok=True)

    def show(summary: dict[str, Any]) -> None:
        print_calibration(found, summary, output)
        if not is_complete:
            print(f"verdict: not judged: interrupted after the search; {ADVICE['not judged']}")
        elif is_without_verdict:
            print("verdict: not judged: --verdict none; the same command without it judges the bench")
            if found.stop_warning:
                print(found.stop_warning)

    run.report(summary, show, is_complete and not is_without_verdict and found.explained is not False)


def write_calibration(
    found: Calibrated, paths: Sequence[Path], frames: Sequence[Frame], extra: dict[str, Any], output: Path
) -> dict[str, Any]:
    """Write a calibration with the frames that it is from; return the table."""
    from wavesim.sensor.frame_sets import planes_of_frames

    of_frames = {
        "frames": [str(path) for path in paths],
        "planes_mm": [plane.distance_mm for plane in planes_of_frames(frames)],
    }
    return found.write(output, of_frames | extra)


def print_calibration(found: Calibrated, summary: dict[str, Any], output: Path) -> None:
    """Print the estimates with their standard deviations, and the verdict."""
    from wavesim.reconstruction.calibrated_bench import JUDGED_OBJECT
    from wavesim.targets.patch import stop_words

    rows = []
    deviations = found.deviations or (None,) * len(found.parameters)
    for name, value, deviation in zip(found.parameters, found.values, deviations, strict=True):
        notes = ["poorly determined"] * (name in found.poorly_determined)
        notes += ["not needed, kept nominal"] * (name in found.nominal)
        notes += [f"correlated with {', '.join(found.correlated_with.get(name, ()))}"] * (
            name in found.correlated_with
        )
        rows.append((name, f"{value:.5f}", "" if deviation is None else f"{deviation:.2g}", "; ".join(notes)))
    heads = "estimate", "standard deviation"
    print_table(("deviation from the design",), heads, rows, notes="")
    if found.deviations is None and found.typical is not None:
        print("standard deviations: not computed (--no-deviations); each parameter has its estimate")
    if found.undetermined:
        print(
            "not sought, kept nominal: " + ", ".join(found.undetermined) + ": a complex object can have the "
            "same effect as these errors of the light; for an object without phase, use --kind amplitude"
        )
    noise = summary["misfit_of_noise"]
    if found.field_stop_mm is not None:
        stop_text = stop_words(found.field_stop_mm, found.field_stop_at_mm)
        print(f"{stop_text}, {STOP_ORIGINS[found.field_stop_from]}")
    for line in found.state.source.lines(found.source_deviations):
        print(line)
    print(
        f"misfit {summary['misfit_before']:.4f} before calibration, {summary['misfit']:.4f} after"
        + ("" if noise is None else f" (expected from noise alone: {noise:.4f})")
    )
    print(
        f"{summary['mountings_tried']} benches tried; {summary['stopped_because']}; wrote {found.file}, "
        f"calibration.png{f' and {JUDGED_OBJECT}' if found.judged is not None else ''} to {output}"
    )
    if found.verdict is not None:
        print(f"verdict: {found.verdict.words}")
