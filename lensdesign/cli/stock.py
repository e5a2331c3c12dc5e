"""Command that finds stock lenses in a folder of vendors' files."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.cli.tables import print_tables, table
from lensdesign.common.console import print_json, say
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import GRADES, Json, Trust, output_option
from lensdesign.common.outputs import output_file
from lensdesign.common.progress import progress_count
from lensdesign.common.text import counted_reasons, visible
from lensdesign.files.formats import LENS_FORMATS

if TYPE_CHECKING:
    from lensdesign.stock.index import StockIndex
    from lensdesign.stock.results import StockFiles
    from lensdesign.stock.search import StockMatch, StockResult


def stock(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help=f"Folder with lens files of vendors: {', '.join(LENS_FORMATS)}, at any depth.",
        ),
    ],
    spec: Annotated[
        Path,
        typer.Option(
            metavar="SPEC",
            help="Specification (TOML) that lenses must meet.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ],
    output: Annotated[Path, output_option("Folder for designs and tables.", "DIR", is_folder=True)],
    keep: Annotated[
        int,
        typer.Option(min=1, help="Largest number of lenses to write.", rich_help_panel=OptionGroup.OUTPUT),
    ] = 10,
    traced: Annotated[
        int,
        typer.Option(
            min=1,
            help="Largest number of single lenses, and of pairs, through which rays are traced.",
            rich_help_panel=OptionGroup.SOLVER,
        ),
    ] = 300,
    clear_fraction: Annotated[
        float,
        typer.Option(
            help="Fraction of the semi-diameters in the files that is clear, such as 0.9.",
            rich_help_panel=OptionGroup.LENS,
        ),
    ] = 1.0,
    index: Annotated[
        Path | None,
        typer.Option(
            callback=output_file,
            metavar="FILE",
            help="File that stores the index; default: in your cache folder.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
    glass_catalog: Annotated[
        list[Path] | None, typer.Option(help="AGF file; may be repeated.", rich_help_panel=OptionGroup.INPUT)
    ] = None,
    tolerances: Annotated[
        str | None,
        typer.Option(
            metavar=f"{GRADES}|STUDY",
            help="Also find the yield as built of the three best lenses, with this grade or study.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = None,
    yield_trials: Annotated[
        int,
        typer.Option(
            min=0,
            help="Trials of each of these lenses, which take some seconds each; 0: predict the yield only.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = 0,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of processes; default: the number of processors.",
            show_default=False,
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Find stock lenses in a folder of vendors' files, one or two in a row, that meet a specification.

    The first run reads every file and keeps an index in your cache folder; later runs interpret new and
    changed files only. Single lenses and air-spaced pairs are tried in both orientations. The working
    distance is found within the bounds of its variable in the specification. The best lenses are written as
    designs, ordered by spread angle and length; each meets the specification as `lensdesign check --against`
    checks it. Files that cannot be used are listed with the reasons in left_out.csv.

    An interrupt (Ctrl-C, SIGTERM) keeps the index; the same command continues.

    Example: lensdesign stock vendors --spec spec.toml -o found

    Exit status: 0 if a lens meets every constraint, 1 if not (the nearest one is written nevertheless), 2 for
    bad input, 130 or 143 after an interrupt.
    """
    from lensdesign.optimization.specification.specification import load_specification
    from lensdesign.stock.index import index_stock
    from lensdesign.stock.results import write_stock_files
    from lensdesign.stock.search import StockSettings, find_stock_lenses

    specification = load_specification(spec)
    settings = StockSettings(keep, traced, clear_fraction, tolerances, yield_trials)
    with progress_count("reading lens files") as count:
        indexed = index_stock(folder, index, glass_catalog or (), workers, count.update)
    with progress_count("estimating lenses") as count:
        result = find_stock_lenses(indexed, specification, settings, workers, count.update)
    files = write_stock_files(result, output)
    if as_json:
        print_json(_as_dict(indexed, result, files))
    else:
        _print_result(indexed, result, files)
    raise typer.Exit(0 if result.matches else 1)


def _as_dict(index: StockIndex, result: StockResult, files: StockFiles) -> dict[str, object]:
    from lensdesign.stock.results import stock_row

    nearest = result.nearest
    return {
        "files": len(index.files),
        "read": index.read_count,
        "refused": {file.name: file.reason for file in index.refused},
        "left_out": result.left_out,
        "skipped": result.skipped,
        "matches": [
            stock_row(match, str(path)) for match, path in zip(result.matches, files.designs, strict=False)
        ],
        "nearest": None
        if nearest is None
        else stock_row(nearest, str(files.designs[0])) | {"not_met": list(nearest.report.violations)},
        "written": [str(path) for path in (*files.designs, files.table, files.left_out) if path is not None],
    }


def _print_result(index: StockIndex, result: StockResult, files: StockFiles) -> None:
    typer.echo(
        f"{len(index.files)} files, {index.read_count} of them read now: {len(index.lenses)} with a lens, "
        f"{result.lenses} different ones; {result.traced} single lenses and pairs traced"
    )
    if result.left_out:
        typer.echo(f"{len(result.left_out)} files not used; the most frequent reasons:")
        for reason, number in [*counted_reasons(Counter(result.left_out.values())).items()][:3]:
            typer.echo(f"  {number}: {visible(reason)}")
    for reason, number in result.skipped.items():
        typer.echo(f"skipped, {visible(reason)}: {number}")
    if result.matches:
        print_tables(_table(result.matches, files))
    elif result.nearest is None:
        typer.echo("no lens meets the specification, and the light passes none of them")
    else:
        typer.echo(f"no lens meets the specification; nearest: {visible(result.nearest.lens.title)}")
        for sentence in result.nearest.report.violations:
            say("not met:", sentence)
    first, last = files.designs[:1], files.designs[1:][-1:]
    designs = " to ".join(path.name for path in (*first, *last))
    written = [designs, *(path.name for path in (files.table, files.left_out) if path is not None)]
    typer.echo(f"wrote to {files.table.parent}: {', '.join(name for name in written if name)}")


def _table(matches: tuple[StockMatch, ...], files: StockFiles) -> object:
    built = any(match.predicted_yield is not None for match in matches)
    heads = ["design", "lenses", "spread", "track, mm", "object, mm", "spacing, mm"]
    shown = table("Stock lenses that meet the specification", *heads, *(["yield as built"] if built else []))
    for match, path in zip(matches, files.designs, strict=True):
        spacing = "" if match.spacing_mm is None else f"{match.spacing_mm:.3f}"
        cells = [
            path.name,
            visible(match.arrangement.name),
            f"{match.report.max_spread_deg:.3f}°",
            f"{match.lens.track_mm:.2f}",
            f"{match.lens.object.working_distance_mm:.3f}",
            spacing,
        ]
        if built:
            cells.append(_yield_text(match))
        shown.add_row(*cells)
    return shown


def _yield_text(match: StockMatch) -> str:
    """Return the yield by trials with its interval, or else the predicted one."""
    if (built := match.built) is not None:
        return f"{100.0 * built.good:.1f} % ({100.0 * built.low:.1f} to {100.0 * built.high:.1f})"
    if match.predicted_yield is None:
        return ""
    if not math.isfinite(match.predicted_yield):
        return "not predicted"
    return f"{100.0 * match.predicted_yield:.1f} %, predicted"
