"""The report of a study: one self-contained HTML page, and tables for other programs."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.errors import InputError, atomic_path
from tolerancing.correlation import RankCorrelation, rank_correlation
from tolerancing.perturbations import Perturbation
from tolerancing.results import StepResults, TrialResults
from tolerancing.store import Store, toolkit_version
from tolerancing.study import Study
from tolerancing.summary import PERCENTILES, Summary, summarize

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

WORST_TRIALS = 12


@dataclass(frozen=True)
class ReportFiles:
    """What a report consists of."""

    html: Path
    trials_csv: Path
    sweeps_csv: Path


@dataclass(frozen=True)
class WorstTrial:
    """A trial far on the bad side, with what deviated most in it."""

    trial: int
    scores: tuple[tuple[float, bool], ...]
    causes: str
    message: str


def write_report(store: Store, folder: str | os.PathLike[str]) -> ReportFiles:
    """Write a store's report.

    Parameters
    ----------
    store
        An open store, finished or not.
    folder
        Where ``report.html``, ``trials.csv`` and ``sweeps.csv`` go; made if needed.

    Raises
    ------
    InputError
        If the store cannot be read or a file cannot be written; files there stay as they were.
    """
    folder = Path(folder)
    results, steps = store.trials(), store.steps()
    files = ReportFiles(folder / "report.html", folder / "trials.csv", folder / "sweeps.csv")
    for path in vars(files).values():
        if os.path.exists(path) and path.samefile(store.path):
            raise InputError(f"cannot write {path}: it is the store itself; give another folder")
    page = report_page(summarize(store, results), results, steps)
    tables = {
        files.trials_csv: trials_table(store.study, results),
        files.sweeps_csv: sweeps_table(store.study, steps),
    }
    with ExitStack() as stack:  # all are written before the first takes its place
        for path, table in tables.items():
            table.to_csv(stack.enter_context(atomic_path(path)), index=False)
        stack.enter_context(atomic_path(files.html)).write_text(page, encoding="utf-8")
    return files


def trials_table(study: Study, results: TrialResults) -> pd.DataFrame:
    """One row a trial: its deltas and scores, columns named with their units."""
    import pandas as pd

    columns: dict[str, Any] = {
        "trial": results.trials,
        "status": results.status,
        "message": results.messages,
    }
    columns |= {p.column: results.values[:, k] for k, p in enumerate(study.perturbations)}
    columns |= {m.column: results.scores[:, k] for k, m in enumerate(study.merits)}
    return pd.DataFrame(columns | {"passed": results.passed.astype(int)})


def sweeps_table(study: Study, steps: Sequence[StepResults]) -> pd.DataFrame:
    """One row for each sweep, step and merit."""
    import pandas as pd

    sweeps = {sweep.label: sweep for sweep in study.sweeps}
    rows = [
        {
            "sweep": step.sweep,
            "step": step.step,
            "target": sweeps[step.sweep].target,
            "parameter": sweeps[step.sweep].parameter,
            "value": step.value,
            "merit": merit,
            "score": score,
            "message": step.message,
        }
        for step in steps
        for merit, score in step.scores.items()
    ]
    names = ["sweep", "step", "target", "parameter", "value", "merit", "score", "message"]
    return pd.DataFrame(rows, columns=names)


def report_page(summary: Summary, results: TrialResults, steps: Sequence[StepResults]) -> str:
    """The report as the text of one HTML page that needs nothing beside itself."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from tolerancing import figures

    study = summary.study
    correlation = rank_correlation(study, results)
    environment = Environment(
        loader=PackageLoader("tolerancing"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number_text, "percent": percent_text}
    return environment.get_template("report.html.j2").render(
        summary=summary,
        study=study,
        record=summary.record,
        percentiles=PERCENTILES,
        toolkit_version=toolkit_version(),
        written=datetime.now(UTC).isoformat(timespec="seconds"),
        perturbations=[perturbation_row(study, results, k) for k in range(len(study.perturbations))],
        distributions=embedded(figures.distributions_figure(summary.merits, results.scores), "svg"),
        scatters=[
            embedded(figures.scatter_figure(study, results, merit, k, correlation), "png")
            for k, merit in enumerate(summary.merits)
        ],
        drivers=[drivers_text(study, correlation, k) for k in range(len(study.merits))],
        worst=worst_trials(study, results),
        failures=_failures(results),
        sweeps=[_sweep_section(study, k, steps) for k in range(len(study.sweeps))],
    )


def perturbation_row(study: Study, results: TrialResults, index: int) -> dict[str, Any]:
    """One perturbation in words, with what was drawn."""
    perturbation = study.perturbations[index]
    drawn = results.values[:, index]
    return {
        "column": perturbation.column,
        "target": perturbation.target,
        "parameter": perturbation.parameter,
        "unit": perturbation.unit,
        "distribution": distribution_text(perturbation),
        "standard_deviation": perturbation.distribution.standard_deviation,
        "drawn_mean": float(drawn.mean()) if len(drawn) else None,
        "drawn_standard_deviation": float(drawn.std(ddof=1)) if len(drawn) > 1 else None,
        "drawn_extreme": float(np.abs(drawn).max()) if len(drawn) else None,
    }


def distribution_text(perturbation: Perturbation) -> str:
    """`normal, sigma 0.01 mm` and the like."""
    distribution = perturbation.distribution
    values = {k: v for k, v in distribution.model_dump().items() if k != "mean" or v}
    parts = [
        f"{name.replace('_', ' ')} {value:g} {perturbation.unit}".strip() for name, value in values.items()
    ]
    return ", ".join([distribution.kind.replace("_", " "), *parts])


def worst_trials(study: Study, results: TrialResults) -> list[WorstTrial]:
    """Trials farthest on the bad side, in standard deviations of each merit; unscored ones first."""
    if not len(results):
        return []
    spread = [np.nanstd(c) if np.any(np.isfinite(c)) else 0.0 for c in results.scores.T]
    margins = np.column_stack(
        [m.margin(results.scores[:, k]) / (spread[k] or 1.0) for k, m in enumerate(study.merits)]
    )
    worst = np.min(np.where(np.isfinite(margins), margins, -np.inf), axis=1)
    order = np.argsort(worst, kind="stable")[:WORST_TRIALS]
    passed = np.column_stack([m.passed(results.scores[:, k]) for k, m in enumerate(study.merits)])
    return [
        WorstTrial(
            trial=results.trials[i],
            scores=tuple(zip(results.scores[i].tolist(), passed[i].tolist(), strict=True)),
            causes=_causes(study, results.values[i]),
            message=results.messages[i],
        )
        for i in order
    ]


def _causes(study: Study, values: Any, count: int = 3) -> str:
    """The largest deviations of one trial, in standard deviations."""
    sigmas = [
        (value - p.distribution.mean) / (p.distribution.standard_deviation or 1.0)
        for p, value in zip(study.perturbations, values, strict=True)
    ]
    order = sorted(range(len(sigmas)), key=lambda k: -abs(sigmas[k]))[:count]
    return ", ".join(f"{study.perturbations[k].column} {sigmas[k]:+.1f} σ" for k in order)


def drivers_text(study: Study, correlation: RankCorrelation, merit: int, count: int = 3) -> str:
    """The perturbations that go most with one merit, in words."""
    strength = correlation.strength[merit]
    order = [k for k in np.argsort(-strength, kind="stable")[:count] if strength[k] > 0.0]
    return ", ".join(f"{study.perturbations[k].column} ({strength[k]:.2f})" for k in order)


def _failures(results: TrialResults) -> list[tuple[str, int]]:
    counts: dict[str, int] = {}
    for message in results.messages:
        if message:
            counts[message] = counts.get(message, 0) + 1
    return sorted(counts.items(), key=lambda item: -item[1])[:WORST_TRIALS]


def _sweep_section(study: Study, index: int, steps: Sequence[StepResults]) -> dict[str, Any]:
    from tolerancing import figures

    sweep = study.sweeps[index]
    own = [step for step in steps if step.sweep == sweep.label]
    pictured = any(step.pictures for step in own)
    return {
        "sweep": sweep,
        "title": figures.axis_label_of_sweep(sweep),
        "steps": own,
        "merits": study.sweep_merits(sweep),
        "curves": embedded(figures.sweep_figure(study, sweep, own), "svg"),
        "pictures": embedded(figures.pictures_figure(sweep, own), "png") if pictured else None,
    }


def embedded(figure: Figure, kind: str) -> str:
    """A figure as a data URI."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=150, metadata={"Date": None} if kind == "svg" else None)
    media = {"svg": "image/svg+xml", "png": "image/png"}[kind]
    return f"data:{media};base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def number_text(value: float | None) -> str:
    """A number with four digits; a dash where there is none."""
    return "–" if value is None or not np.isfinite(value) else f"{value:.4g}".replace("-", "−")


def percent_text(share: float) -> str:
    """A share in per cent."""
    return f"{100.0 * share:.1f} %"
