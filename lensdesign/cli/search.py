"""Commands that search for lenses."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.cli.tables import print_tables, table
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.console import print_json, say
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Json, SpecificationFile, Trust, output_option
from lensdesign.common.progress import progress_text
from lensdesign.common.text import number_with_unit, relation_symbol, visible
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from lensdesign.analysis.report import Constraint
    from lensdesign.exploration.front import ExploredPoint
    from lensdesign.optimization.as_built import AsBuiltReport
    from lensdesign.optimization.limits.search import Limit
    from lensdesign.optimization.result import OptimizationResult
    from lensdesign.optimization.specification.specification import Specification


def optimize(
    specification: SpecificationFile,
    output: Annotated[Path, output_option("Design file to write.", "DESIGN")],
    trust: Trust = False,
    as_json: Json = False,
    seed: Annotated[
        int,
        typer.Option(
            min=0, max=2**31 - 1, help="Seed of the random starts.", rich_help_panel=OptionGroup.SOLVER
        ),
    ] = 0,
    algorithm: Annotated[
        str | None,
        typer.Option(
            metavar="[slsqp|mma|ccsaq|cobyla|isres|auglag-lbfgs|auglag-bobyqa|auglag-crs2|auglag-direct]",
            help="Algorithm; default: as specified.",
            show_default=False,
            rich_help_panel=OptionGroup.SOLVER,
        ),
    ] = None,
    starts: Annotated[
        int | None,
        typer.Option(
            help="Largest number of starts for each choice of glasses; default: as specified.",
            show_default=False,
            rich_help_panel=OptionGroup.SOLVER,
        ),
    ] = None,
    max_evaluations: Annotated[
        int | None,
        typer.Option(
            help="Largest number of evaluations for each choice of glasses; default: as specified.",
            show_default=False,
            rich_help_panel=OptionGroup.SOLVER,
        ),
    ] = None,
    max_seconds: Annotated[
        float | None,
        typer.Option(
            help="Time limit of the whole search (the result depends on the machine); default: as specified.",
            show_default=False,
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
) -> None:
    """Optimize a lens for a specification.

    The search is started repeatedly until several starts agree. The result is checked against the
    specification; requirements on lenses as built are checked by independent Monte Carlo trials.

    An interrupt (Ctrl-C, SIGTERM) or a time limit ends the search: the best lens so far is written.

    Example: lensdesign optimize spec.toml -o best.toml

    Exit status: 0 if the lens meets every constraint, 1 if not, or if a limit ended the search (the lens is
    written nevertheless), 2 for bad input, 130 or 143 after an interrupt.
    """
    from lensdesign.files.design import design_text
    from lensdesign.optimization.search import SearchInterrupted
    from lensdesign.optimization.search import optimize as search
    from lensdesign.optimization.specification.specification import load_specification

    asked = _with_settings(
        load_specification(specification),
        algorithm=algorithm,
        starts=starts,
        max_evaluations=max_evaluations,
        max_seconds=max_seconds,
    )
    if os.path.exists(output) and output.samefile(specification):
        raise InputError(f"cannot write {output}: it is the specification itself; give another file name")
    # The file is opened before the search, so that an unwritable path is reported at once.
    interrupted = False
    with atomic_path(output) as temporary:
        try:
            with progress_text("searching") as status:
                result = search(asked, report=status.update, seed=seed)
        except SearchInterrupted as stop:
            result, interrupted = stop.result, True
        text = design_text(result.lens, output.parent)
        try:
            temporary.write_text(text, encoding="utf-8")
        except KeyboardInterrupt:
            interrupted = True
            temporary.write_text(text, encoding="utf-8")
    if as_json:
        print_json(result.as_dict() | {"design": str(output)})
    else:
        _print_optimization(result)
        typer.echo(f"wrote {output}")
    if interrupted:
        met = "meets" if result.feasible else "does not meet"
        raise KeyboardInterrupt(
            f"interrupted; {output} holds the best lens so far, which {met} the specification"
        )
    raise typer.Exit(0 if result.feasible and not result.unfinished else 1)


def explore(
    specification: SpecificationFile,
    over: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help=(
                "Two to four of thickness, track, semi_diameter, spread, as_built_rms, yield, field, na, "
                "cost; optionally with bounds: field=2:4,thickness. The last is the goal of each search."
            ),
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ],
    output: Annotated[Path, output_option("Folder for the results.", "DIR", is_folder=True)],
    lenses: Annotated[
        int,
        typer.Option(
            min=2, max=10000, help="Lenses for each choice of glasses.", rich_help_panel=OptionGroup.SOLVER
        ),
    ] = 50,
    glasses: Annotated[
        str | None,
        typer.Option(
            help="Glasses of the first element, names or catalogue:SCHOTT; default: as specified.",
            show_default=False,
            rich_help_panel=OptionGroup.LENS,
        ),
    ] = None,
    fresh: Annotated[
        bool,
        typer.Option(
            "--fresh",
            help="Start over: replace the contents of the folder.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = False,
    max_seconds: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            help="Time limit; the same command continues later.",
            show_default=False,
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Compute a Pareto front of lenses: a table, charts, and a design file for each lens.

    An interrupt or a time limit leaves the table of the lenses found so far; the same command continues.

    Exit status: 0 if lenses were found, 1 if none meets the specification or the time limit ended the
    exploration, 2 for bad input, 130 or 143 after an interrupt.
    """
    from lensdesign.common.console import messages_only
    from lensdesign.common.deadlines import DeadlineExceeded, deadline, now
    from lensdesign.common.progress import progress_count
    from lensdesign.exploration.chart import write_charts
    from lensdesign.exploration.folder import folder_for
    from lensdesign.exploration.front import Exploration, front_of
    from lensdesign.exploration.glasses import with_glasses
    from lensdesign.exploration.objectives import axes_of
    from lensdesign.optimization.specification.specification import load_specification

    asked = load_specification(specification)
    if glasses is not None:
        asked = with_glasses(asked, glasses)
    axes = axes_of(over, asked)
    folder = folder_for(output, asked, axes, lenses)
    known = folder.begin(fresh)
    end = math.inf if max_seconds is None else now() + max_seconds
    try:
        with messages_only(), progress_count("searches") as count, deadline(end):
            explored = Exploration(asked, axes, lenses, known, folder.keep, count.update).run()
    except (KeyboardInterrupt, DeadlineExceeded) as stop:
        found = list(folder.begin().values())
        folder.write_front(found, axes)
        hint = f"{len(found)} searches are stored in {output}; repeat the command to continue"
        if isinstance(stop, KeyboardInterrupt):
            raise KeyboardInterrupt(f"interrupted; {hint}") from None
        typer.echo(f"max_seconds = {max_seconds:g} ended the exploration; {hint}", err=True)
        raise typer.Exit(1) from None
    files = [folder.write_front(explored, axes), *write_charts(output, explored, axes)]
    front = front_of(explored, axes)
    none = [one.key for one in explored if one.lens is None]
    if as_json:
        rows = [{"key": one.key, "glasses": one.glasses, **one.values} for one in front]
        print_json({"front": rows, "searches": len(explored), "no_lens": none, "files": [*map(str, files)]})
        return
    _print_front(front, [axis.objective.column for axis in axes], len(explored))
    if none:
        typer.echo(f"no lens for {len(none)} of the searches: {'; '.join(map(visible, none[:3]))}")
    for file in files:
        typer.echo(f"wrote {file}")


def limits(
    specification: SpecificationFile,
    seed: Annotated[
        int,
        typer.Option(
            min=0, max=2**31 - 1, help="Seed of the random starts.", rich_help_panel=OptionGroup.SOLVER
        ),
    ] = 0,
    max_seconds: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            help="Time limit; limits found by then are printed.",
            show_default=False,
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        output_option("Folder for the design of the lens at each limit.", "DIR", is_folder=True),
    ] = None,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Find the largest field, aperture, pixel and tolerances for which a lens meets the specification.

    Each quantity is enlarged alone while the others stay as specified; the constraints that prevent more are
    named. --output writes the lens with the largest field and those at the other limits. A limit is confirmed
    by independent starts just above it, which is no proof. After an interrupt or a time limit, the limits
    found so far are printed.

    Example: lensdesign limits spec.toml -o limits

    Exit status: 0 if the specification can be met, 1 if not or if the time limit ended the search, 2 for bad
    input, 130 or 143 after an interrupt.
    """
    from lensdesign.common.deadlines import deadline, now
    from lensdesign.optimization.limits.search import LimitsInterrupted, find_limits
    from lensdesign.optimization.specification.specification import load_specification

    asked, interrupted = load_specification(specification), False
    end = math.inf if max_seconds is None else now() + max_seconds
    try:
        with progress_text("searching") as status, deadline(end):
            found = find_limits(asked, status.update, seed)
    except LimitsInterrupted as stop:
        found, interrupted = stop.limits, True
    written = {} if output is None else _write_lenses(found, output)
    if as_json:
        print_json({"limits": [one.as_dict() | {"design": written.get(one.name)} for one in found]})
    else:
        _print_limits(found)
        for path in written.values():
            typer.echo(f"wrote {path}")
    if interrupted:
        raise KeyboardInterrupt(f"interrupted during limit {len(found)}; this last limit is not confirmed")
    met = all(one.reached is not None and one.reached >= one.asked and not one.cut for one in found)
    raise typer.Exit(0 if met else 1)


def _write_lenses(found: Sequence[Limit], folder: Path) -> dict[str, str]:
    """Write the lens at each limit to a folder, and return the files by the names of the limits."""
    from lensdesign.files.design import save_design

    folder.mkdir(parents=True, exist_ok=True)
    files = {}
    for one in found:
        if one.lens is not None:
            path = folder / f"largest_{one.name.replace(' ', '_')}.toml"
            save_design(one.lens, path)
            files[one.name] = str(path)
    return files


def _print_limits(found: Sequence[Limit]) -> None:
    shown = table("", "what", "required", "can be met", "ratio", "binding constraints")
    for one in found:
        reached = "none found" if one.reached is None else number_with_unit(f"{one.reached:.4g}", one.unit)
        ratio = "" if one.reached is None else f"{one.reached / one.asked:.3f}"
        more = "" if one.ended else ", and more"
        binding = visible(", ".join(one.binding))
        shown.add_row(
            one.name, number_with_unit(f"{one.asked:.4g}", one.unit), reached + more, ratio, binding
        )
    print_tables(shown)
    for one in found:
        typer.echo(f"{one.name}: {one.confidence}")
    typer.echo("each limit holds alone, with all other values as specified")


def _print_front(front: Sequence[ExploredPoint], columns: Sequence[str], searches: int) -> None:
    shown = table(f"{len(front)} lenses on the Pareto front", "glasses", *columns)
    for one in front:
        shown.add_row(visible(one.glasses), *(f"{one.values[column]:.5g}" for column in columns))
    print_tables(shown)
    if len(front) == 1:
        typer.echo("one lens is best in every objective: there is no trade-off")
    typer.echo(f"{searches} searches")


def _with_settings(specification: Specification, **changes: object) -> Specification:
    """Return the specification with the settings of the command line."""
    from lensdesign.common.toml_files import validate
    from lensdesign.optimization.specification.sections import Settings

    given = {key: value for key, value in changes.items() if value is not None}
    settings = validate(Settings, specification.optimize.model_dump() | given, "command line")
    return specification.model_copy(update={"optimize": settings})


def _print_optimization(result: OptimizationResult) -> None:
    from rich.markup import escape

    from lensdesign.optimization.specification.sections import AS_BUILT_GOALS

    for sentence in result.unfinished:
        typer.echo(f"not finished: {visible(sentence)}")
    variables = table(result.lens.title, "variable", "value")
    for name, value in result.variables.items():
        shown = "plane" if value is None else f"{value:.8g}" if isinstance(value, float) else str(value)
        variables.add_row(name, escape(visible(shown)))
    variables.add_section()
    of_limit = result.goal_unit == "%" and result.goal != "yield"
    goal = f"{result.goal}, fraction of its limit" if of_limit else result.goal
    if result.goal in AS_BUILT_GOALS:
        rows = () if result.as_built is None else result.as_built.rows
        by_trials = result.goal == "yield" and any(row.predicted_good is None for row in rows)
        goal = f"{result.goal}, {'by trials' if by_trials else 'predicted'}"
    variables.add_row(goal, number_with_unit(f"{result.goal_value:.6g}", result.goal_unit))
    if len(result.spreads) > 1:
        for s in result.spreads:
            shown = f"{s.spread_deg:.4f}°, {100.0 * s.share:.2f} % of {s.limit_deg:.4f}°"
            variables.add_row(f"spread at {s.wavelength_um:g} µm", shown)
    tables = [variables]
    if any(one.temperature_c is not None for one in result.check.constraints):
        tables.append(_at_temperatures(result.check.constraints))
    if result.as_built is not None:
        tables += _as_built(result.as_built)
    print_tables(*tables)
    for line in [] if result.as_built is None else _limits_of(result.as_built, result.goal):
        typer.echo(visible(line))
    for name in result.binding:
        typer.echo(f"binding: {name}")
    for sentence in result.violations:
        say("not met:", sentence)
    if result.reach is not None:
        typer.echo(result.reach.in_words(result.lens.object))
    if result.feasible:
        typer.echo("checked: every constraint of the specification is met")
    typer.echo(
        f"{result.algorithm}: {result.evaluations} evaluations in {result.seconds:.2f} s, stopped because of "
        f"{result.stopped_because}; {result.starts_at_best} of {result.starts} starts reached this lens"
    )
    if not result.agreed:
        typer.echo("hint: no other start reached this lens; allow more starts, or narrow the bounds")


def _at_temperatures(constraints: Sequence[Constraint]) -> Any:
    """Return a table of each constraint at each temperature; lengths are those of the design."""
    from lensdesign.lens.catalogues.thermal import REFERENCE_C
    from lensdesign.lens.temperature import named_at

    temperatures = list(dict.fromkeys(one.temperature_c for one in constraints))
    heads = [f"{REFERENCE_C if t is None else t:g} C" for t in temperatures]
    shown = table("Constraints at each temperature", "constraint", "limit", *heads)
    values = {one.name: f"{one.value:.5g}" for one in constraints}
    for one in constraints:
        if one.temperature_c is None:
            limit = number_with_unit(f"{relation_symbol(one.relation)} {one.limit:.5g}", one.unit)
            shown.add_row(one.name, limit, *(values.get(named_at(one.name, t), "") for t in temperatures))
    return shown


def _as_built(report: AsBuiltReport) -> list[Any]:
    """Return tables that compare yields and wavefronts of start and result, by trials and as predicted."""
    first = report.rows[0]
    heads = [head for row in report.rows for head in (row.name, "predicted")]
    title = f"Yield of {first.trials} trials each (seed {report.seed}), and predicted yield"
    found = table(title, "limit", *map(visible, heads))
    if len(first.merits) > 1:
        cells = [_yield_cells(row.good, row.low, row.high, row.predicted_good) for row in report.rows]
        found.add_row("all limits", *(cell for pair in cells for cell in pair))
    for k, merit in enumerate(first.merits):
        merits = [row.merits[k] for row in report.rows]
        cells = [_yield_cells(one.good, one.low, one.high, one.predicted) for one in merits]
        found.add_row(visible(merit.merit), *(cell for pair in cells for cell in pair))
    tables = [found, *_losses(report)]
    if not report.points_mm:
        return tables
    points = [f"rms at {place}" for place in report.places]
    waves = table("Wavefronts of the same trials (predicted value in parentheses), in waves", "lens", *points)
    for row in report.rows:
        values = zip(row.rms_waves, row.rms_errors_waves, row.predicted_rms_waves, strict=True)
        texts = (f"{rms:.4f} +- {2.0 * error:.4f} ({predicted:.4f})" for rms, error, predicted in values)
        waves.add_row(visible(row.name), *texts)
    return [*tables, waves]


def _losses(report: AsBuiltReport) -> list[Any]:
    """Return a table of mean reconstruction losses; empty if the study has no such merit."""
    merits = report.rows[0].losses
    if not merits:
        return []
    heads = [f"{one.merit}, {'calibrated' if one.calibrated else 'nominal'} model" for one in merits]
    found = table(
        "Mean reconstruction loss of the same trials (predicted value in parentheses)",
        "lens",
        *map(visible, heads),
    )
    for row in report.rows:
        cells = (f"{one.mean:.4g} +- {2.0 * one.error:.2g} ({one.predicted:.4g})" for one in row.losses)
        found.add_row(visible(row.name), *cells)
    return [found]


def _yield_cells(good: float, low: float, high: float, predicted: float | None) -> tuple[str, str]:
    """Return a yield with its confidence interval by trials, and the predicted yield."""
    own = f"{100.0 * good:.1f} % ({100.0 * low:.1f} to {100.0 * high:.1f})"
    return own, "not predicted" if predicted is None else f"{100.0 * predicted:.1f} %"


def _limits_of(report: AsBuiltReport, goal: str) -> list[str]:
    """Return lines on the limits of a good lens, and on merits that only trials can evaluate."""
    from lensdesign.optimization.specification.sections import LOSS_GOAL

    merits = report.rows[-1].merits
    lines = ["a good lens keeps all limits of the study:" if len(merits) > 1 else "a good lens keeps:"]
    lines += [f"  {one.merit} {one.limit}: {one.conditions}" for one in merits]
    searched = {one.merit for one in report.rows[-1].losses} if goal == LOSS_GOAL else set()
    if remaining := [name for name in report.trials_only if name not in searched]:
        lines.append(f"not included in the search, but in the trials: {', '.join(remaining)}")
    return lines
