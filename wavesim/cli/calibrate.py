"""The command `wavesim calibrate`: how the lens is mounted, from frames."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.files.design import load_design
from wavesim.camera.mounting import mounting_table, values_of
from wavesim.cli.options import AsJson, DesignOption, Frames, Output, print_warnings
from wavesim.cli.runs import print_table, progress, versions
from wavesim.scene.settings import CalibrationSettings, FrameSetSettings

if TYPE_CHECKING:
    from wavesim.calibration.estimation import Calibrated

FILE = "calibration.json"


def calibrate(
    frames: Frames,
    design: DesignOption,
    output: Output,
    settings: CalibrationSettings,
    of_frames: FrameSetSettings,
    known: Annotated[
        Path | None, typer.Option(help="The object, where it is known: a file (.npz), or its folder.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find how the lens is mounted: decenter, tilt, working distance, distances of the planes.

    The mounting is the one with which frames and reconstruction agree best. The file that is written serves
    `wavesim reconstruct --calibration`. An interrupted run goes on with the same command.
    """
    from wavesim.calibration.from_frames import CHECKPOINT, calibrate_frames
    from wavesim.camera.frame_sets import planes_of_frames, read_frames
    from wavesim.pictures.result_files import refuse_no_folder

    refuse_no_folder(output)
    with progress() as tell, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lens = load_design(design)
        pictures = read_frames(frames, of_frames, lens=lens)
        found = calibrate_frames(lens, pictures, settings, known=known, folder=output, progress=tell)
    (output / CHECKPOINT).unlink(missing_ok=True)
    messages = list(dict.fromkeys(str(warning.message) for warning in caught))
    print_warnings(messages)
    summary = {
        "frames": [str(path) for path in frames],
        "planes_mm": [plane.distance_mm for plane in planes_of_frames(pictures)],
        "mounting": mounting_table(found.mounting),
        "parameters": list(found.parameters),
        "misfit_before": found.misfit_before,
        "misfit": found.misfit,
        "misfit_of_noise": found.misfit_of_noise,
        "mountings_tried": len(found.trail),
        "at_reach": list(found.at_reach),
        "stopped_because": found.stopped_because,
        "object": "known" if known else settings.kind,
        "warnings": messages,
        "versions": versions(),
    }
    _write(found, summary, output)
    if as_json:
        print_json(summary)
    else:
        _print(found, summary, output)


def _write(found: Calibrated, summary: dict[str, Any], output: Path) -> None:
    from wavesim.pictures.calibrations import calibration_figure
    from wavesim.pictures.frames import save
    from wavesim.pictures.result_files import new_results, write_json

    with new_results(output) as folder:
        save(calibration_figure(found, found.misfit_of_noise), folder / "calibration.png")
        write_json(summary, folder / FILE)


def _print(found: Calibrated, summary: dict[str, Any], output: Path) -> None:
    rows = []
    for name, value in zip(found.parameters, values_of(found.mounting, found.parameters), strict=True):
        border = "  (at the border of the search)" if name in found.at_reach else ""
        rows.append((name, f"{value:.5f}{border}"))
    print_table(("lens as mounted, from the design",), ("found",), rows)
    noise = summary["misfit_of_noise"]
    print(
        f"misfit {summary['misfit_before']:.4f} as designed, {summary['misfit']:.4f} as mounted"
        + ("" if noise is None else f"; {noise:.4f} would be noise alone")
    )
    print(
        f"{summary['mountings_tried']} mountings tried; {summary['stopped_because']}; wrote {FILE} and "
        f"calibration.png to {output}"
    )
