"""Summary of a store: yield with its confidence interval, and statistics of each merit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.notebook import html_table
from tolerancing.merits.base import Merit
from tolerancing.perturbations.draws import replicates
from tolerancing.statistics.yields import CONFIDENCE, Yield, yield_of
from tolerancing.study.results import TrialResults

if TYPE_CHECKING:
    from tolerancing.store.store import Store, StudyRecord
    from tolerancing.study.study import Study

PERCENTILES = (1, 5, 50, 95, 99)


@dataclass(frozen=True)
class MeritSummary:
    """Statistics of one merit over all trials.

    Trials without a score count as bad in the yield; the other statistics exclude them.

    Attributes
    ----------
    merit
        The merit.
    nominal
        Score of the nominal lens; None if it has none.
    good
        Yield by the limit of this merit alone; None if there are no trials.
    scored
        Number of trials with a score.
    mean, standard_deviation
        Mean and standard deviation of the scores; None with fewer than one, or two, scores.
    percentiles
        Percentiles of the scores by the numbers of `PERCENTILES`; empty without scores.
    """

    merit: Merit
    nominal: float | None
    good: Yield | None
    scored: int
    mean: float | None
    standard_deviation: float | None
    percentiles: dict[int, float]


@dataclass(frozen=True, repr=False)
class Summary:
    """Summary of a store: yields with their confidence intervals, and statistics of the merits.

    Attributes
    ----------
    record, study
        Record of the run, and the study.
    trials
        Number of trials in the store.
    failed
        Number of trials that could not be scored; they count as bad lenses.
    good
        Yield: fraction of the trials that meet all limits; None without trials.
    merits
        Summary of each merit.
    steps, planned_steps
        Number of steps of series in the store, and number in the study.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, summarize
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     merit = summarize(store).merits[0]
    >>> merit.merit.label, round(merit.percentiles[50], 3)
    ('wavefront', 0.116)
    """

    record: StudyRecord
    study: Study
    trials: int
    failed: int
    good: Yield | None
    merits: tuple[MeritSummary, ...]
    steps: int
    planned_steps: int

    def __repr__(self) -> str:
        return f"Summary({self._title!r}, all limits: {_yield_text(self.good)})"

    def _repr_html_(self) -> str:
        rows = [("all limits", _yield_text(self.good))]
        for own in self.merits:
            median = own.percentiles.get(50)
            numbers = "" if median is None else f"; median {median:.4g}"
            numbers += "" if own.nominal is None else f"; nominal {own.nominal:.4g}"
            rows.append((own.merit.column, f"{own.merit.limit_text}: {_yield_text(own.good)}{numbers}"))
        return html_table(self._title, rows, _yield_bars([self.good, *(m.good for m in self.merits)]))

    @property
    def _title(self) -> str:
        name = self.study.title or self.study.design
        return f"{name}: {self.trials} of {self.record.planned_trials} trials"

    @property
    def complete(self) -> bool:
        """True if the store holds all planned trials and steps."""
        return self.trials >= self.record.planned_trials and self.steps >= self.planned_steps

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON. Names carry their units; missing numbers are None."""
        return {
            "title": self.study.title,
            "design": self.study.design,
            "seed": self.study.seed,
            "created": self.record.created,
            "toolkit_version": self.record.toolkit_version,
            "complete": self.complete,
            "trials": self.trials,
            "planned_trials": self.record.planned_trials,
            "failed": self.failed,
            "sweep_steps": self.steps,
            "planned_sweep_steps": self.planned_steps,
            "yield": _yield_dict(self.good),
            "merits": {m.merit.column: _merit_dict(m) for m in self.merits},
        }


def summarize(store: Store) -> Summary:
    """Return yields and statistics of the trials of an open store.

    Parameters
    ----------
    store
        Open store; its run need not be finished.

    Returns
    -------
    Summary
        Yields with their confidence intervals, and statistics of each merit.

    Raises
    ------
    InputError
        If the store cannot be read.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, summarize
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     good = summarize(store).good
    >>> good.passed, good.total, round(good.low, 2), round(good.high, 2)
    (26, 50, 0.39, 0.65)
    """
    record, steps = store.record(), len(store.finished_steps())
    return summary_of(record, store.study, store.nominal(), store.trials(), steps)


def summary_of(
    record: StudyRecord,
    study: Study,
    nominal: Mapping[str, float],
    results: TrialResults,
    steps: int,
) -> Summary:
    """Return the summary of trials.

    Parameters
    ----------
    record, study
        Record of the run, and its study.
    nominal
        Scores of the nominal lens, by the merit's label.
    results
        All trials in the store.
    steps
        Number of steps of the study's series in the store.
    """
    own = replicates(study.draws, results.trials)
    return Summary(
        record=record,
        study=study,
        trials=len(results),
        failed=sum(1 for message in results.messages if message),
        good=yield_of(results.passed, own),
        merits=tuple(
            merit_summary(merit, nominal.get(merit.label), results.scores[:, k], own)
            for k, merit in enumerate(study.merits)
        ),
        steps=steps,
        planned_steps=sum(len(series) for series in study.series),
    )


def merit_summary(
    merit: Merit,
    nominal: float | None,
    scores: NDArray[np.float64],
    replicates: NDArray[np.int64] | None,
) -> MeritSummary:
    """Return the summary of one merit from its scores of all trials; `replicates` as in :func:`yield_of`."""
    known = scores[np.isfinite(scores)]
    nominal = None if nominal is None or not np.isfinite(nominal) else nominal
    values = np.percentile(known, PERCENTILES) if len(known) else ()
    mean, deviation = mean_and_deviation(known)
    return MeritSummary(
        merit=merit,
        nominal=nominal,
        good=yield_of(merit.passed(scores), replicates),
        scored=len(known),
        mean=mean,
        standard_deviation=deviation,
        percentiles={p: float(v) for p, v in zip(PERCENTILES, values, strict=False)},
    )


def mean_and_deviation(known: NDArray[np.float64]) -> tuple[float | None, float | None]:
    """Return mean and standard deviation of values; None with fewer than one, or two, values."""
    mean = float(known.mean()) if len(known) else None
    return mean, float(known.std(ddof=1)) if len(known) > 1 else None


def _yield_text(good: Yield | None) -> str:
    if good is None:
        return "no trials"
    return f"{100.0 * good.fraction:.1f} % good ({100.0 * good.low:.1f} to {100.0 * good.high:.1f} %)"


def _yield_bars(yields: Sequence[Yield | None]) -> str:
    """Draw a bar for each yield, from 0 to 100 %, with its confidence interval as a line."""
    marks = [
        f'<rect y="{10 * k + 2}" width="{200.0 * good.fraction:.1f}" height="6" fill="#2a6f97"/>'
        f'<path d="M{200.0 * good.low:.1f} {10 * k + 5}H{200.0 * good.high:.1f}" stroke="#e07a1f"/>'
        for k, good in enumerate(yields)
        if good is not None
    ]
    height = 10 * len(yields)
    return f'<svg xmlns="http://www.w3.org/2000/svg" width="200" height="{height}">{"".join(marks)}</svg>'


def _yield_dict(good: Yield | None) -> dict[str, Any] | None:
    return None if good is None else {**good.as_dict(), "confidence": CONFIDENCE}


def _merit_dict(summary: MeritSummary) -> dict[str, Any]:
    merit = summary.merit
    return {
        "kind": merit.kind,
        "at_least": merit.at_least,
        "at_most": merit.at_most,
        "nominal": summary.nominal,
        "yield": _yield_dict(summary.good),
        "scored": summary.scored,
        "mean": summary.mean,
        "standard_deviation": summary.standard_deviation,
        "percentiles": {str(p): v for p, v in summary.percentiles.items()},
    }
