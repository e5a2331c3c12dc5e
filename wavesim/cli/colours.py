"""The command `wavesim colours`: find an object at several wavelengths, or its height, from frames."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Design, Json
from lensdesign.common.text import visible
from lensdesign.files.design import load_design
from wavesim.cli.bench_files import frame_files
from wavesim.cli.options import Output
from wavesim.cli.runs import Run, print_table
from wavesim.scene.settings import ColourSettings, FrameSetSettings


@most_used(
    "output",
    "patch_mm",
    "kind",
    "film_index",
    "heights_um",
    "ground_mm",
    "iterations",
    "scale",
    "truth",
    "engine",
    "error",
    "as_json",
)
def colours(
    design: Design,
    frames: Annotated[
        list[Path],
        typer.Argument(metavar="FRAMES...", help="Frames (TIFF), or folders of `wavesim image`."),
    ],
    output: Output,
    settings: ColourSettings,
    of_frames: FrameSetSettings,
    truth: Annotated[
        Path | None,
        typer.Option(
            help="Folder of `wavesim image` with the true object at each wavelength.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Find an object at several wavelengths, or the height of a film, from frames.

    Frames may be recorded one wavelength after the other, or at once on a monochrome sensor or behind colour
    filters; they state which. The exit status is 0 if the frames are explained within their noise, and 1 if
    they are not. After an interrupt, the same command continues where it was, and finds the same object.

    Example: wavesim colours lens.toml frames --patch-mm 0.1 -o object
    """
    from wavesim.reconstruction.colours import reconstruct_colours
    from wavesim.runtime.checkpoint import drop_series
    from wavesim.runtime.result_files import remove_unfinished
    from wavesim.sensor.frame_sets import read_colour_frames

    remove_unfinished(output)
    run = Run(as_json, folder=output)
    with run.computing() as on_progress:
        lens = load_design(design)
        pictures = read_colour_frames(frame_files(frames, "FRAMES"), of_frames, lens=lens)
        found = reconstruct_colours(
            lens, pictures, settings, truth=truth, folder=output, progress=on_progress
        )
    summary = found.write(output, {"design": lens.title or design.stem, "warnings": run.messages})
    drop_series(output)
    run.report(summary, partial(_print, output=output), found.explained)


def _print(summary: dict[str, Any], output: Path) -> None:
    from wavesim.reconstruction.stop_rule import STOPPED

    why = STOPPED[summary["stopped_because"]]
    print(visible(summary["design"]))
    print(f"{summary['kind']} object: {summary['iterations']} iterations{why}")
    rows = [
        (
            f"{plane['plane_distance_mm']:g}",
            ", ".join(f"{one:g}" for one in plane["wavelengths_um"]),
            "mosaic" if plane["mosaic"] else "monochrome",
            f"{plane['residual']:.4f}",
            f"{plane['noise']:.4f}",
        )
        for plane in summary["planes"]
    ]
    print()
    print_table((), ("plane (mm)", "wavelengths (um)", "pixels", "residual", "noise alone"), rows)
    print()
    print(f"{summary['oversampling_ratio']:.3g} measurements for each unknown")
    for wavelength, truth in zip(summary["wavelengths_um"], summary["truth"], strict=bool(summary["truth"])):
        correlation = truth["object_correlation"]
        shown = "none" if correlation is None else f"{correlation:.4f}"
        print(f"{wavelength:g} um: correlation with the true object {shown}")
    heights = summary["heights"]
    if heights is not None:
        print(
            f"heights: median {heights['median_um']:.4g} um, median standard deviation "
            f"{1e3 * heights['median_deviation_um']:.3g} nm of a sample, "
            f"{100.0 * heights['ambiguous_fraction']:.2g} % of the samples ambiguous"
        )
    print(f"wrote {len(summary['files'])} files to {output}")
    ratio = summary["over_noise"]
    verdict = "explained by noise" if summary["explained"] else "not explained by noise"
    print(f"residuals are {ratio:.3g} times those of noise alone: {verdict}")
    print(
        f"on pixels that were held out, they are at most {summary['held_out_over_noise']:.3g} times the noise"
    )
    if summary["explained"] and not summary["predicts_held_out"]:
        print("this is more than a reliable object leaves: record more planes or longer exposures")
