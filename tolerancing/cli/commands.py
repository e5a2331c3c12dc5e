"""The command ``tolerancing``: run a study, and show or report the results in its store."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import make_app, messages_only, print_json, run_app
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Json, StudyFile, Trust, output_option
from lensdesign.common.outputs import check_output_file, output_file
from lensdesign.common.text import number_with_unit, visible
from lensdesign.errors import InputError, TransferLensError
from tolerancing.cli import predict as cli_predict
from tolerancing.cli import statistics as cli_statistics
from tolerancing.cli import tolerances as cli_tolerances
from tolerancing.cli.tables import print_table
from tolerancing.cli.tolerances import StorePath

if TYPE_CHECKING:
    from tolerancing.merits.base import Merit
    from tolerancing.prediction.study_prediction import StudyPrediction
    from tolerancing.statistics.summary import Summary
    from tolerancing.statistics.trial import SingleTrial
    from tolerancing.statistics.yields import Yield
    from tolerancing.store.store import Store

app = make_app(
    "Monte Carlo tolerancing of transfer lenses: studies, sensitivities, budgets, reports.",
    {
        "Studies": {
            "start": "Write a study of a lens with usual tolerances.",
            "run": "Run the trials of a study, and store them.",
            "show": "Show the yield of a store, or one of its trials.",
            "report": "Write the report of a store.",
            "export": "Write the trials of a store as a table.",
        },
        "Tolerances": {
            "predict": "Predict yields from rays, without trials.",
            "sensitivity": "Show the effect of each perturbation alone.",
            "inverse": "Find the largest deviation that each merit allows.",
            "budget": "Find the cheapest tolerances for a yield.",
            "cost": "Show the relative cost of each tolerance.",
        },
        "Statistics": {
            "rare-failures": "Estimate the yield of a lens that seldom fails.",
            "variance": "Find how much of a merit's variance each error causes.",
        },
    },
    {"rare": "rare-failures", "indices": "variance"},
)

app.command()(cli_tolerances.start)


@app.command()
def run(
    study: StudyFile,
    store: Annotated[
        Path, typer.Option(help="Store to create, or to continue.", rich_help_panel=OptionGroup.OUTPUT)
    ],
    workers: Annotated[
        int | None,
        typer.Option(
            help="Number of processes; default: the number of processors.", rich_help_panel=OptionGroup.OUTPUT
        ),
    ] = None,
    trials: Annotated[
        int | None,
        typer.Option(
            help="Total number of trials, stored ones included; default: that of the study.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = None,
    fresh: Annotated[
        bool,
        typer.Option("--fresh", help="Start over: replace the store.", rich_help_panel=OptionGroup.OUTPUT),
    ] = False,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Dask scheduler whose workers run the trials.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Run a study's trials, sweeps and sensitivities into a store.

    The same command continues an interrupted run. Python code of the study is executed only with --trust.

    Example: tolerancing run study.toml --trials 1000 --store trials.db
    """
    if fresh or not os.path.exists(store):
        check_output_file(store)
    several = cluster is None and (workers or len(os.sched_getaffinity(0))) > 1
    if several and (fresh or not store.exists()):
        from lensdesign.common.processes import start_ahead

        with messages_only():
            start_ahead("tolerancing.run.forkserver_preload")
    # The summary needs it, too. Its import now overlaps with the start of the workers.
    import scipy.special  # noqa: F401

    from lensdesign.common.progress import progress_count
    from tolerancing.run.run import run_study
    from tolerancing.statistics.summary import summarize
    from tolerancing.store.store import open_store
    from tolerancing.study.files import load_study

    loaded = load_study(study, trust=trust)
    try:
        with messages_only(), progress_count("trials and steps") as count:
            outcome = run_study(
                loaded,
                store,
                workers=workers,
                trials=trials,
                fresh=fresh,
                cluster=cluster,
                progress=lambda done, total: count.update(done, total, "trials and steps"),
                on_estimate=lambda expected: print(expected.sentence, file=sys.stderr),
            )
    except KeyboardInterrupt:
        kept = f"the finished results are stored in {store}; repeat the command to continue"
        message = f"interrupted; {kept if os.path.exists(store) else 'nothing is stored yet'}"
        raise KeyboardInterrupt(message) from None
    with open_store(store) as opened:
        summary, predicted = summarize(opened), _predicted(opened)
    if as_json:
        found = _summary_dict(summary, predicted)
        counts = {
            "trials_run": outcome.trials_run,
            "steps_run": outcome.steps_run,
            "high_fidelity_run": outcome.high_fidelity_run,
            "workers": outcome.workers,
            "seconds": outcome.seconds,
        }
        print_json({"store": str(store), "run": counts, **found})
        return
    _print_summary(summary, predicted)
    done = {
        "trials": outcome.trials_run,
        "steps": outcome.steps_run,
        "trials by high-fidelity merits": outcome.high_fidelity_run,
    }
    if not any(done.values()):
        print(f"the store is already complete: {store}")
        return
    work = ", ".join(f"{count} {name}" for name, count in done.items() if count)
    workers_text = cluster or f"{outcome.workers} {'worker' if outcome.workers == 1 else 'workers'}"
    print(f"{work} in {outcome.seconds:.1f} s by {workers_text}: {store}")


@app.command()
def show(
    store: StorePath,
    trial: Annotated[
        int | None,
        typer.Option(help="Draw, trace and score this trial again.", rich_help_panel=OptionGroup.EVALUATION),
    ] = None,
    output: Annotated[
        Path | None, output_option("With --trial: picture of the trial to write (png, svg or pdf).")
    ] = None,
    state: Annotated[
        Path | None,
        typer.Option(
            callback=output_file,
            help="With --trial: file to write the perturbed system to, for `wavesim image --state` (json).",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
    high_fidelity: Annotated[
        bool,
        typer.Option(
            "--high-fidelity",
            "--dear",
            help="With --trial: also score it by the high-fidelity merits.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = False,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Show the yield of a store's trials by merit, or one of its trials.

    A trial is scored again from the files of its study in the store. Python code among them is executed only
    with --trust.

    Example: tolerancing show trials.db
    """
    from tolerancing.statistics.summary import summarize
    from tolerancing.store.store import open_store

    if trial is None and (output is not None or state is not None or high_fidelity):
        raise InputError("--output, --state and --high-fidelity need --trial")
    with open_store(store, trust=trust) as opened:
        if trial is not None:
            _show_trial(opened, trial, output, state, high_fidelity, as_json)
            return
        summary, predicted = summarize(opened), _predicted(opened)
    if as_json:
        print_json({"store": str(store), **_summary_dict(summary, predicted)})
    else:
        _print_summary(summary, predicted)


def _show_trial(
    store: Store, number: int, output: Path | None, state: Path | None, high_fidelity: bool, as_json: bool
) -> None:
    from tolerancing.report.figures.one_trial import write_trial_figure
    from tolerancing.statistics.trial import single_trial
    from wavesim import write_state

    with messages_only():
        trial = single_trial(store, number, high_fidelity=high_fidelity)
        if output is not None:
            write_trial_figure(trial, output)
        if state is not None:
            write_state(trial.state, state)
    if as_json:
        print_json({"store": str(store.path), **trial.as_dict()})
        return
    _print_trial(trial)
    for path in (output, state):
        if path is not None:
            print(f"wrote {path}")


@app.command()
def report(
    store: StorePath,
    output: Annotated[Path, output_option("Folder for the report.", is_folder=True)],
    beside: Annotated[
        Path | None,
        typer.Option(
            metavar="STORE",
            help="Store of the original lens, to compare this lens with.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    front: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Output folder of lensdesign explore, to compare this lens with.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a store's report.

    report.html is a single self-contained page, and report.pdf has the same content for printing. trials.csv
    and steps.csv are for other programs.
    """
    from tolerancing.report.report import write_report
    from tolerancing.store.store import open_store

    with ExitStack() as stack:
        opened = stack.enter_context(open_store(store))
        other = None if beside is None else stack.enter_context(open_store(beside))
        files = write_report(opened, output, beside=other, front=front)
    if as_json:
        print_json({name: str(path) for name, path in vars(files).items()})
    else:
        print(f"wrote {', '.join(str(path) for path in vars(files).values())}")


@app.command()
def export(
    store: StorePath,
    output: Annotated[
        Path, typer.Argument(callback=output_file, metavar="FILE", help="File to write, .csv or .parquet.")
    ],
    steps: Annotated[
        bool,
        typer.Option(
            "--steps",
            help="Steps of sweeps, grids and sensitivities instead of trials.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = False,
) -> None:
    """Write a store's trials as one table."""
    from tolerancing.store.export import write_steps, write_trials
    from tolerancing.store.store import open_store

    with open_store(store) as opened:
        (write_steps if steps else write_trials)(opened, output)
    print(f"wrote {output}")


app.command()(cli_predict.predict)
app.command()(cli_tolerances.sensitivity)
app.command()(cli_tolerances.inverse)
app.command()(cli_tolerances.budget)
app.command()(cli_tolerances.cost)
app.command("rare-failures")(cli_statistics.rare)
app.command("variance")(cli_statistics.indices)


def _print_trial(trial: SingleTrial) -> None:
    study, again = trial.study, trial.again
    deviations = []
    for perturbation, value in zip(study.perturbations, again.values[0], strict=True):
        distribution = perturbation.distribution
        standardized = (value - distribution.centre) / distribution.standard_deviation
        deviation = number_with_unit(f"{value:+.5g}", perturbation.unit)
        deviations.append((perturbation.column, deviation, f"{standardized:+.2f}"))
    title = f"trial {trial.number} of {study.title or study.design}"
    print_table(title, ["perturbation"], ["deviation", "in std. dev."], deviations)
    scores = []
    for k, merit in enumerate(study.merits):
        stored = "-" if trial.stored is None else f"{trial.stored.scores[0, k]:.6g}"
        verdict = "good" if merit.passed(again.scores[0, k]) else "bad"
        scores.append((merit.column, _limit(merit), stored, f"{again.scores[0, k]:.6g}", verdict))
    others = [*zip(study.extra_columns, again.extras[0], strict=True), *trial.high_fidelity.items()]
    scores += [(name, "", "", f"{value:.6g}", "") for name, value in others]
    print_table("", ["merit", "limit"], ["stored", "again", ""], scores)
    if again.messages[0]:
        print(visible(again.messages[0]))
    if trial.same is None:
        print("not in the store yet")
    else:
        print(
            "the same as stored"
            if trial.same
            else "NOT the same as stored: the store was made by another version or on another machine"
        )


def _predicted(store: Store) -> StudyPrediction | str:
    """Return the prediction of `tolerancing predict` if it takes a second or two, or why there is none."""
    from tolerancing.prediction.study_prediction import is_scored_at_once, predict_study

    if not all(is_scored_at_once(merit) for merit in store.study.merits):
        return "not all limits are predicted within seconds; see tolerancing predict and the report"
    try:
        return predict_study(store.loaded.lens, store.study)
    except TransferLensError as error:
        return str(error)


def _summary_dict(summary: Summary, predicted: StudyPrediction | str) -> dict[str, Any]:
    names = ("yield", "yield_low", "yield_high", "reason")
    found: dict[str, Any] = dict.fromkeys(names)
    if isinstance(predicted, str):
        found["reason"] = predicted
    else:
        found = cli_predict.yield_dict(predicted)
    return summary.as_dict() | {f"predicted_{name}": found[name] for name in names}


def _print_summary(summary: Summary, predicted: StudyPrediction | str) -> None:
    planned = summary.record.planned_trials
    rows = [
        (
            row.merit.column,
            _limit(row.merit),
            _number(row.nominal),
            _number(row.percentiles.get(50)),
            *_yield_cells(row.good),
        )
        for row in summary.merits
    ]
    print_table(
        f"{summary.study.title or summary.study.design}: {summary.trials} of {planned} trials",
        ["merit", "limit"],
        ["nominal", "median", "yield", "95 % interval"],
        rows,
        ("all limits", "", "", "", *_yield_cells(summary.good)),
    )
    for row in summary.merits:
        if row.merit.location:
            print(f"{row.merit.label}: {row.merit.location}")
    text = predicted if isinstance(predicted, str) else cli_predict.yield_text(predicted)
    print(f"yield without trials: {text}")
    if summary.failed:
        print(f"{summary.failed} trials could not be scored and count as bad")
    if not summary.complete:
        print(
            f"not finished: {summary.trials} of {planned} trials, "
            f"{summary.steps} of {summary.planned_steps} steps of sweeps and other series"
        )


def _limit(merit: Merit) -> str:
    return number_with_unit(f"{'≥' if merit.at_least is not None else '≤'} {merit.limit:g}", merit.unit)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _yield_cells(good: Yield | None) -> tuple[str, str]:
    if good is None:
        return "-", "-"
    return f"{100.0 * good.fraction:.1f} %", f"{100.0 * good.low:.1f} - {100.0 * good.high:.1f} %"


def main() -> None:
    """Run the command line."""
    from lensdesign.common.processes import one_blas_thread

    one_blas_thread()
    run_app(app)


if __name__ == "__main__":
    main()
