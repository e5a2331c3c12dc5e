"""The command `wavesim compare-engines`: error against cost of all engines, and where each fails."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.console import message_console, print_json
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Design, Json, output_option
from lensdesign.common.text import finite_or_none, visible
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from wavesim.cli.runs import print_table
from wavesim.scene.lengths import validate_lengths

PICTURE_DPI = 110

MAP_SEMI_DIAMETER_MM, MAP_PATCH_MM = 1.0, 0.02
"""Size of the scaled design for failure maps, on which a run takes a fraction of a second."""

PLANE_SEMI_DIAMETER_MM, PLANE_PATCH_MM, PLANE_DISTANCE = 0.13, 0.016, 0.25
"""Size of the scaled design for whole planes, on which a run takes seconds, and the distance of its exit
plane in semi-diameters."""


def compare(
    design: Design,
    output: Annotated[Path, output_option("Folder to write to.", is_folder=True)],
    radius_mm: Annotated[
        float, typer.Option(help="Radius of the exact cylinder.", rich_help_panel=OptionGroup.EVALUATION)
    ] = 0.2,
    planes: Annotated[
        bool, typer.Option(help="Also compare on whole planes.", rich_help_panel=OptionGroup.EVALUATION)
    ] = True,
    patch_mm: Annotated[
        float, typer.Option(help="Side of the object patch.", rich_help_panel=OptionGroup.OBJECT)
    ] = 0.05,
    field_mm: Annotated[
        float, typer.Option(help="Height of the patch's centre along y.", rich_help_panel=OptionGroup.OBJECT)
    ] = 0.0,
    scale: Annotated[
        float, typer.Option(help="Scale factor of the lens.", rich_help_panel=OptionGroup.LENS)
    ] = 1.0,
    most_seconds: Annotated[
        float,
        typer.Option(
            "--max-seconds",
            "--most-seconds",
            help="Skip runs that are predicted to take longer.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = 10.0,
    maps: Annotated[
        bool, typer.Option(help="Also draw failure maps.", rich_help_panel=OptionGroup.EVALUATION)
    ] = True,
    as_json: Json = False,
) -> None:
    """Chart error against seconds and memory of every engine, and map where each fails.

    On lines, the cases are an exact cylinder and a meridional patch of the lens, with the wave propagation
    method at fine steps as reference. On whole planes, they are an exact sphere and a patch about the axis of
    a scaled lens, with the sum over all plane waves as reference.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from lensdesign.lens.scaling import scaled
    from wavesim.analytic.registry import analytic_case
    from wavesim.metrics.comparison import compare as measure
    from wavesim.metrics.comparison import lens_case, variants
    from wavesim.plots.comparisons import comparison_figure
    from wavesim.plots.frames import save
    from wavesim.runtime.result_files import write_csv

    lens = scaled(load_design(design), scale)
    validate_lengths(lens, {"patch_mm": patch_mm, "field_mm": field_mm})
    if output.exists() and not output.is_dir():
        raise InputError(f"--output = {str(output)!r}: must be a folder, but is a file")
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {output}: {error.strerror}") from None
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=message_console(), transient=True) as bar:
        task = bar.add_task("reference fields", total=None)
        size = "" if scale == 1.0 else f", scaled by {scale:g}"
        name = lens.title or design.stem
        cases = {
            f"line: exact cylinder, radius {radius_mm:g} mm": analytic_case("cylinder", radius_mm=radius_mm),
            f"line: {name}{size}, patch of {patch_mm:g} mm at {field_mm:g} mm": lens_case(
                lens, patch_mm, field_mm
            ),
        }
        if planes:
            cases |= _on_planes(lens, name)

        def show(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total, description=what[:72])

        rows = measure(cases, variants, show, most_seconds)
        write_csv([row.as_dict() for row in rows], output / "comparison.csv")
        save(comparison_figure(rows, "Error against cost"), output / "comparison.png", PICTURE_DPI)
        written = [output / "comparison.png", output / "comparison.csv"]
        if maps:
            written += _maps(lens, output, bar, task)
    if as_json:
        measured = [{name: finite_or_none(v) for name, v in row.as_dict().items()} for row in rows]
        print_json({"measured": measured, "written": [str(path) for path in written]})
        return
    _print_front(rows)
    for path in written:
        typer.echo(f"wrote {path}")


def _on_planes(lens: Any, name: str) -> dict[str, Any]:
    from lensdesign.lens.scaling import scaled
    from wavesim.analytic.registry import analytic_case
    from wavesim.metrics.axisymmetric_reference import axial_case

    sphere_radius_mm = 0.15
    cases = {
        f"plane: exact sphere, radius {sphere_radius_mm:g} mm": analytic_case(
            "sphere", radius_mm=sphere_radius_mm
        )
    }
    distance_mm = PLANE_DISTANCE * PLANE_SEMI_DIAMETER_MM
    try:
        twin = scaled(lens, PLANE_SEMI_DIAMETER_MM / lens.stop_semi_diameter_mm)
        case = axial_case(twin, PLANE_PATCH_MM, plane_distance_mm=distance_mm)
    except InputError as problem:
        message_console().print(
            f"the comparison on a plane of the lens is skipped: {problem}",
            soft_wrap=True,
            markup=False,
            highlight=False,
        )
        return cases
    title = (
        f"plane: twin of {name} with a stop of {PLANE_SEMI_DIAMETER_MM:g} mm, patch of {PLANE_PATCH_MM:g} mm"
    )
    return cases | {title: case}


def _maps(lens: Any, output: Path, bar: Any, task: Any) -> list[Path]:
    from lensdesign.lens.scaling import scaled
    from wavesim.metrics.failures import failure_maps, map_rows
    from wavesim.plots.comparisons import failure_figure
    from wavesim.plots.frames import save
    from wavesim.runtime.result_files import write_csv

    twin = scaled(lens, MAP_SEMI_DIAMETER_MM / lens.stop_semi_diameter_mm)
    bar.update(task, total=None, description="failure maps")
    found, written = [], []
    for one in failure_maps(twin, MAP_PATCH_MM):
        bar.update(task, description=f"failure maps: {one.method}")
        found.append(one)
        path = output / f"failure_{one.name}.csv"
        write_csv(map_rows(one), path)
        written.append(path)
    picture = output / "failure_maps.png"
    save(
        failure_figure(found, "Relative error of each method, with its limits of warning and refusal"),
        picture,
        PICTURE_DPI,
    )
    return [picture, *written]


def _print_front(rows: list[Any]) -> None:
    numbers = ("relative error", "seconds", "set-up (s)", "memory (MB)")
    for scene in dict.fromkeys(row.scene for row in rows):
        front = [row for row in rows if row.scene == scene and row.fastest]
        cells = [
            (
                row.family,
                row.setting,
                f"{row.relative_error:.2g}",
                f"{row.seconds:.2g}",
                f"{row.setup_seconds:.2g}",
                f"{row.peak_mb:.3g}",
            )
            for row in sorted(front, key=lambda r: r.seconds)
        ]
        print_table(
            ("engine", "setting"), numbers, cells, visible(f"{scene}: fastest setting for each error")
        )
        print()
