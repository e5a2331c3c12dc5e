"""The command ``tolerancing``: run a study, show and report what its store holds."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.console import make_app, print_json, run_app

if TYPE_CHECKING:
    from tolerancing.merit import Merit
    from tolerancing.summary import Summary, Yield

app = make_app("Monte Carlo tolerancing of transfer lenses: studies, yields, reports.")

StorePath = Annotated[Path, typer.Argument(metavar="STORE", help="Store that a run made.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@app.command()
def run(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (TOML).")],
    store: Annotated[Path, typer.Option(help="Store to make, or to go on with.")],
    workers: Annotated[int | None, typer.Option(help="Processes; by default as many as processors.")] = None,
    trials: Annotated[int | None, typer.Option(help="Trials in the end; by default the study's.")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Start over: replace the store.")] = False,
    as_json: Json = False,
) -> None:
    """Run a study's trials and sweeps into a store.

    An interrupted run goes on where it stopped.
    """
    from lensdesign.console import progress_bar
    from tolerancing.run import run_study
    from tolerancing.store import open_store
    from tolerancing.study import load_study
    from tolerancing.summary import summarize

    loaded = load_study(study)
    try:
        with progress_bar() as bar:
            task = bar.add_task("trials and sweeps", total=None)
            outcome = run_study(
                loaded,
                store,
                workers=workers,
                trials=trials,
                fresh=fresh,
                report=lambda done, total: bar.update(task, completed=done, total=total),
            )
    except KeyboardInterrupt:
        kept = f"what was finished is in {store}, and the same command goes on from there"
        message = f"interrupted; {kept if os.path.exists(store) else 'nothing is stored yet'}"
        raise KeyboardInterrupt(message) from None
    with open_store(store) as opened:
        summary = summarize(opened)
    if as_json:
        print_json({"store": str(store), "run": vars(outcome), **summary.as_dict()})
        return
    _print_summary(summary)
    if outcome.trials_run + outcome.steps_run == 0:
        print(f"nothing was missing: {store}")
        return
    print(
        f"{outcome.trials_run} trials and {outcome.steps_run} sweep steps in {outcome.seconds:.1f} s by "
        f"{outcome.workers} {'worker' if outcome.workers == 1 else 'workers'}: {store}"
    )


@app.command()
def show(store: StorePath, as_json: Json = False) -> None:
    """Show the yield that a store holds, merit by merit."""
    from tolerancing.store import open_store
    from tolerancing.summary import summarize

    with open_store(store) as opened:
        summary = summarize(opened)
    if as_json:
        print_json({"store": str(store), **summary.as_dict()})
    else:
        _print_summary(summary)


@app.command()
def report(
    store: StorePath,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the report.")],
    as_json: Json = False,
) -> None:
    """Write a store's report.

    report.html needs nothing beside itself; trials.csv and sweeps.csv are for other programs.
    """
    from tolerancing.report import write_report
    from tolerancing.store import open_store

    with open_store(store) as opened:
        files = write_report(opened, output)
    if as_json:
        print_json({name: str(path) for name, path in vars(files).items()})
    else:
        print(f"wrote {files.html}, {files.trials_csv} and {files.sweeps_csv}")


def _print_summary(summary: Summary) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    planned = summary.record.planned_trials
    title = f"{summary.study.title or summary.study.design}: {summary.trials} of {planned} trials"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("merit")
    table.add_column("limit")
    for heading in ("nominal", "median", "yield", "95 % interval"):
        table.add_column(heading, justify="right")
    for merit in summary.merits:
        table.add_row(
            merit.merit.column,
            _limit(merit.merit),
            _number(merit.nominal),
            _number(merit.percentiles.get(50)),
            *_yield_cells(merit.good),
        )
    table.add_section()
    table.add_row("all limits", "", "", "", *_yield_cells(summary.good))
    Console().print(table)
    if summary.failed:
        print(f"{summary.failed} trials could not be scored and count as bad")
    if not summary.complete:
        print(
            f"not finished: {summary.trials} of {planned} trials, "
            f"{summary.steps} of {summary.planned_steps} sweep steps"
        )


def _limit(merit: Merit) -> str:
    return f"{'>=' if merit.at_least is not None else '<='} {merit.limit:g} {merit.unit}".strip()


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _yield_cells(good: Yield | None) -> tuple[str, str]:
    if good is None:
        return "-", "-"
    return f"{100.0 * good.share:.1f} %", f"{100.0 * good.low:.1f} - {100.0 * good.high:.1f} %"


def main() -> None:
    """Entry point of the command."""
    from tolerancing.threads import one_blas_thread

    one_blas_thread()
    run_app(app)


if __name__ == "__main__":
    main()
