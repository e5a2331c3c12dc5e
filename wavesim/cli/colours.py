"""The command `wavesim colours`: find an object at several wavelengths, or its height, from frames."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Design, Json
from lensdesign.common.text import visible
from lensdesign.files.design import load_design
from wavesim.cli.bench_files import frame_files
from wavesim.cli.options import Output, print_warnings, warning_messages
from wavesim.cli.runs import print_table, progress, versions
from wavesim.scene.settings import ColourSettings, FrameSetSettings

if TYPE_CHECKING:
    from wavesim.reconstruction.colours import FoundColours


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
    they are not. A run has no checkpoint: after an interrupt, the same command starts from the beginning.

    Example: wavesim colours lens.toml frames --patch-mm 0.1 -o object
    """
    from wavesim.reconstruction.colours import reconstruct_colours
    from wavesim.runtime.result_files import remove_unfinished
    from wavesim.sensor.frame_sets import read_colour_frames

    remove_unfinished(output)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lens = load_design(design)
        pictures = read_colour_frames(frame_files(frames, "FRAMES"), of_frames, lens=lens)
        with progress(resumes=False) as on_progress:
            found = reconstruct_colours(lens, pictures, settings, truth=truth, progress=on_progress)
    messages = warning_messages(caught)
    print_warnings(messages)
    summary = {"design": lens.title or design.stem} | found.as_dict()
    summary |= {"warnings": messages, "versions": versions()}
    summary["files"] = [str(output / name) for name in _write(found, summary, output)]
    if as_json:
        print_json(summary)
    else:
        _print(summary, output)
    raise typer.Exit(0 if found.explained else 1)


def _write(found: FoundColours, summary: dict[str, Any], output: Path) -> list[str]:
    """Write all files together, and return their names."""
    from wavesim.fields.files import write_arrays, write_field
    from wavesim.plots.colours import colours_figure, heights_figure
    from wavesim.plots.frames import save
    from wavesim.runtime.result_files import new_results, write_csv, write_json

    inside = found.patch.inside
    title = f"{summary['design']}\n{summary['kind']} object, {found.patch.stop_words}"
    with new_results(output) as folder:
        for one in found.transmissions:
            write_field(one, folder / f"reconstruction_{one.wavelength_um:g}_um.npz")
        save(colours_figure(found.transmissions, inside, title), folder / "reconstruction.png")
        if found.heights is not None:
            write_arrays(
                folder / "heights.npz",
                height_um=found.heights.height_um,
                deviation_um=found.heights.deviation_um,
                ambiguous=found.heights.ambiguous,
                inside=inside,
                pitch_um=1e3 * found.patch.grid.pitch_mm,
            )
            drawn = heights_figure(found.heights, found.transmissions[0], inside, title)
            save(drawn, folder / "heights.png")
        rows = [{"iteration": n, "misfit": value} for n, value in enumerate(found.misfit, start=1)]
        write_csv(rows, folder / "convergence.csv")
        names = sorted([*(path.name for path in folder.iterdir()), "colours.json"])
        write_json(summary | {"files": names}, folder / "colours.json")
    return names


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
