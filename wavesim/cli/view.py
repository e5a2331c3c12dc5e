"""The command `wavesim view`: show a whole field or frame as a zoomable page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import output_option
from lensdesign.common.outputs import check_output_file
from lensdesign.errors import InputError

CAMERA: dict[str, Any] = {
    "plane_distance_mm": 0.0,
    "wavelength_um": 1.0,
    "exposure": 1.0,
    "bits": 16,
    "offset_counts": 0.0,
    "gain_electrons_per_count": 1.0,
}
"""Settings with which a frame's electrons equal its counts."""


def view(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT",
            help="Folder of `wavesim reconstruct` or `image`, a field (.npz), or a frame (.tif).",
        ),
    ],
    region_mm: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,WIDTH,HEIGHT",
            help="x,y,width,height of the region: its centre and sides; default: all.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="True object (.npz), or its folder.", rich_help_panel=OptionGroup.INPUT),
    ] = None,
    pixel_pitch_um: Annotated[
        float | None,
        typer.Option(
            help="Pixel pitch of a frame (.tif) that does not state it; its counts are shown.",
            rich_help_panel=OptionGroup.CAMERA,
        ),
    ] = None,
    output: Annotated[
        Path | None, output_option("Page to write (.html); default: next to RESULT.", "FILE")
    ] = None,
    open_: Annotated[
        bool, typer.Option("--open", help="Open the page in a browser.", rich_help_panel=OptionGroup.OUTPUT)
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON.", rich_help_panel=OptionGroup.OUTPUT)
    ] = False,
) -> None:
    """Show a whole field or frame in a browser, as one self-contained page that zooms.

    The layers of a folder are amplitude and phase of the reconstruction, the true object, and the frames. A
    region is one of the object (frames of a folder are omitted then), or of the frame that RESULT names.
    """
    from wavesim.cli.options import numbers
    from wavesim.plots.page import write_zoom_page

    region = None if region_mm is None else numbers(region_mm, "--region-mm", 4)
    folder = result.is_dir()
    path = output or (result / "view.html" if folder else result.with_suffix(".html"))
    if path.suffix.lower() != ".html":
        raise InputError(f"--output = {str(path)!r}: the file name must end in .html")
    if output is None:
        check_output_file(path)
    layers = _layers(result, truth, region, pixel_pitch_um)
    title, facts = _title_and_facts(result)
    made = write_zoom_page(layers, path, title, facts)
    if as_json:
        print_json({"file": str(path)} | made.as_dict())
    else:
        typer.echo(f"wrote {path}: {', '.join(made.layers)}, {made.tiles} tiles, {1e-6 * made.bytes:.2g} MB")
    _print_reduced_layers(made, layers, region)
    if open_:
        import webbrowser

        if not webbrowser.open(path.resolve().as_uri()):
            typer.echo(f"no browser was found; open {path} yourself", err=True)


def _layers(
    result: Path, truth: Path | None, region: list[float] | None, pixel_pitch_um: float | None
) -> list[Any]:
    """Return the layers of a file or folder, with those of fields before those of frames."""
    if not result.is_dir() and result.suffix.lower() in (".tif", ".tiff"):
        if truth is not None:
            raise InputError(f"--truth: cannot be used with the frame {result}")
        return [_frame(result, region, pixel_pitch_um)]
    if pixel_pitch_um is not None:
        raise InputError(f"--pixel-pitch-um: cannot be used with {result}, which is not a frame (.tif)")
    if not result.is_dir():
        found, frames = {result: ""}, []
        if result.suffix.lower() != ".npz":
            raise InputError(f"{result}: must be a folder, a field (.npz) or a frame (.tif)")
    else:
        # Fields in a folder, and the names of their layers.
        labels = {"reconstruction.npz": "", "object.npz": "true"}
        found = {result / name: label for name, label in labels.items() if (result / name).exists()}
        frames = sorted(result.glob("frame_*.tif"), key=lambda path: (len(path.name), path.name))
        if not found and not frames:
            raise InputError(f"{result}: contains none of {', '.join(labels)}, frame_*.tif")
        if len(found) == 1:
            found = dict.fromkeys(found, "")
    layers = [layer for path, name in found.items() for layer in _field(path, name, region)]
    if truth is not None:
        file = truth / "object.npz" if truth.is_dir() else truth
        layers += [] if file in found else _field(file, "true", region)
    if region is None or not layers:
        layers += [_frame(path, region, None) for path in frames]
    return layers


def _field(path: Path, name: str, region: list[float] | None) -> list[Any]:
    from wavesim.fields.files import read_centre_um, read_field
    from wavesim.plots.layers import field_layers
    from wavesim.targets.region import cut_out

    values, pitch_um = read_field(path)
    centre_um = read_centre_um(path)
    if region is not None:
        values, centre_um = cut_out(values, pitch_um, region, f"{path}: --region-mm", centre_um)
    return field_layers(values, pitch_um, centre_um, name)


def _frame(path: Path, region: list[float] | None, pixel_pitch_um: float | None) -> Any:
    from dataclasses import replace

    from wavesim.plots.layers import frame_layer
    from wavesim.scene.settings import SettingError
    from wavesim.sensor.frames import read_frame
    from wavesim.targets.region import cut_out

    if pixel_pitch_um is not None:
        frame = read_frame(path, pixel_pitch_um=pixel_pitch_um, **CAMERA)
    else:
        try:
            frame = read_frame(path)
        except SettingError:
            raise InputError(
                f"{path}: does not state how it was recorded; give --pixel-pitch-um to see its counts"
            ) from None
    settings, centre_um = frame.settings, (0.0, 0.0)
    if region is not None:
        counts, centre_um = cut_out(frame.counts, settings.pixel_pitch_um, region, f"{path}: --region-mm")
        frame = replace(frame, counts=counts)
    if pixel_pitch_um is not None:
        return replace(frame_layer(frame, path.name, centre_um), unit="counts")
    return frame_layer(frame, f"{path.name}, {settings.plane_distance_mm:g} mm", centre_um)


def _title_and_facts(result: Path) -> tuple[str, list[tuple[str, str]]]:
    """Return title and facts of the page."""
    summary = _summary(result) if result.is_dir() else {}
    design, name = summary.get("design"), result.resolve().name
    title = f"{name}: {design}" if isinstance(design, str) else name
    facts = {name: summary.get(name) for name in ("method", "kind", "iterations")}
    return title, [(name, str(value)) for name, value in facts.items() if isinstance(value, str | int)]


def _summary(folder: Path) -> dict[str, Any]:
    import json

    from lensdesign.common.input_files import TOML_BYTES, read_input

    # Files that give the title of the page.
    summaries = ("reconstruction.json", "image.json")
    for name in summaries:
        path = folder / name
        if path.exists():
            try:
                summary = json.loads(read_input(path, TOML_BYTES))
            except (ValueError, RecursionError) as error:
                if isinstance(error, InputError):
                    raise
                raise InputError(f"cannot read {path}: it is not a JSON file, or is damaged") from error
            return summary if isinstance(summary, dict) else {}
    return {}


def _print_reduced_layers(made: Any, layers: list[Any], region: list[float] | None) -> None:
    """Print which layers do not show every sample, and how to see all samples."""
    coarse = [
        f"{name} (means of {2**halvings} x {2**halvings} samples)"
        for name, halvings in zip(made.layers, made.halvings, strict=True)
        if halvings
    ]
    if not coarse:
        return
    x_mm, y_mm = (0.0, 0.0) if region is None else region[:2]
    several = len({layer.plane for layer in layers}) > 1
    typer.echo(
        f"the page is too small for all samples of: {'; '.join(coarse)}. To see every sample of a region"
        f"{' of the object' if several else ''}, give --region-mm {x_mm:g},{y_mm:g},{made.region_mm:g},"
        f"{made.region_mm:g} or less{', or name a frame' if several else ''}",
        err=True,
    )
