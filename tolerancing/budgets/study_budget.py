"""Budgets of studies: tolerances sought on a response model, then held against trials of the lens itself."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.analysis.response import Response, fit_response
from tolerancing.analysis.scorer import ROWS_AT_ONCE, StudyScorer
from tolerancing.analysis.tolerance_search import (
    MOST_COUNTS,
    Budget,
    SearchInterrupted,
    draws_needed,
    loosest_tolerances,
)
from tolerancing.analysis.yields import Yield, yield_of
from tolerancing.perturbations.draws import probabilities
from tolerancing.perturbations.parameters import Perturbation
from tolerancing.store.store import Store
from tolerancing.study.evaluate import context_of, realise
from tolerancing.study.files import LoadedStudy, study_from_tables
from tolerancing.study.scoring import score_batch
from tolerancing.study.study import Study

FRESH = 1 << 20
"""First number of the trials by which scales are judged, beyond those of any store."""

SCALES = (0.1, 4.0)

Report = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class StudyBudget:
    """A budget, and what the lens itself says of it.

    Attributes
    ----------
    budget
        As sought on the response model and corrected by trials of the lens.
    response
        The model.
    verified
        Yield of the lens with these tolerances, rounded as the study states them, in random trials of
        another seed; None where it was interrupted before one was scored.
    seed
        Of those trials: the study's, plus one.
    """

    budget: Budget
    response: Response
    verified: Yield | None
    seed: int


class BudgetInterrupted(KeyboardInterrupt):
    """A budget that was interrupted; `found` is what there is of it, None before any is known to do."""

    def __init__(self, found: StudyBudget | None) -> None:
        super().__init__("interrupted")
        self.found = found


def budget(
    store: Store,
    required: float,
    weights: Mapping[str, float] | None = None,
    *,
    fixed: Collection[str] = (),
    fresh: int = 500,
    report: Report | None = None,
) -> StudyBudget:
    """The loosest tolerances that keep a yield, from the trials of a store.

    :func:`scaled_study` gives the study that has them.

    Parameters
    ----------
    store
        An open store.
    required, weights, fixed, fresh, report
        As of :func:`budget_of_study`.

    Raises
    ------
    InputError, BudgetInterrupted
        As of :func:`budget_of_study`.
    """
    loaded, trials = store.loaded, store.trials()
    return budget_of_study(
        loaded.lens,
        loaded.study,
        trials.values,
        trials.scores,
        required,
        weights,
        fixed=fixed,
        fresh=fresh,
        report=report,
    )


def budget_of_study(
    lens: Lens,
    study: Study,
    values: Array,
    scores: Array,
    required: float,
    weights: Mapping[str, float] | None = None,
    *,
    fixed: Collection[str] = (),
    fresh: int = 500,
    report: Report | None = None,
) -> StudyBudget:
    """The loosest tolerances of a study whose yield's interval lies above what is required.

    A second-order response model of the merits, fitted to the trials, is searched for the shares of the
    tolerances; trials of the lens itself then tell by which common factor they may be scaled, and as many
    random ones of another seed the true yield. Each trial has figures of its own as irregularities.

    Parameters
    ----------
    lens, study
        What was run.
    values, scores
        Trials of the study, shapes (n, perturbations) and (n, merits).
    required
        Yield, above 0 and below 1.
    weights
        Of the cost of each perturbation's tolerance, by column; 1 where left out.
    fixed
        Columns whose tolerances stay as they are.
    fresh
        Number of trials of the lens for the common factor, and of fresh ones for the yield.
    report
        Called with the numbers of trials scored, and to score at most, once before and after each part.

    Raises
    ------
    InputError
        If a weight names no perturbation, a distribution has no width to scale, the trials are too few for
        a model, or the yield is out of reach.
    BudgetInterrupted
        If it is interrupted.
    """
    columns = [p.column for p in study.perturbations]
    unknown = [name for name in (*(weights or {}), *fixed) if name not in columns]
    if unknown:
        raise InputError(
            f"weight of {unknown[0]!r}: there is no such perturbation; allowed: {', '.join(columns)}"
        )
    held = np.array([column in fixed for column in columns])
    scaled_perturbations(study, np.ones(len(columns)))
    draws_needed(fresh, required, "low")
    response = fit_response(values, scores)
    count = _Count(report, most_trials(fresh))
    count.add(0)
    scorer = StudyScorer(context_of(lens, study), study, count.add)
    trials = range(FRESH, FRESH + fresh)
    mean, deviations = _deviations(study, trials)
    seed = study.seed + 1
    try:
        budget = loosest_tolerances(
            response.predict,
            study.merits,
            mean,
            deviations,
            required,
            low=np.where(held, 1.0, SCALES[0]),
            high=np.where(held, 1.0, SCALES[1]),
            weights=np.array([(weights or {}).get(column, 1.0) for column in columns]),
            verify=lambda values: scorer(values, trials),
        )
    except SearchInterrupted as stop:
        found = None if stop.budget is None else StudyBudget(stop.budget, response, None, seed)
        raise BudgetInterrupted(found) from None
    verified, complete = _verified(lens, study, budget.scales, seed, fresh, count)
    made = StudyBudget(budget, response, verified, seed)
    if not complete:
        raise BudgetInterrupted(made)
    return made


def most_trials(fresh: int) -> int:
    """How many trials of the lens a budget takes at most, with so many fresh ones."""
    return (MOST_COUNTS + 1) * fresh


def most_seconds(store: Store, fresh: int) -> float:
    """How long a budget takes at most, by what the trials of a store took."""
    return most_trials(fresh) * float(np.mean(store.trials().seconds))


@dataclass
class _Count:
    """How many trials are scored, of how many at most."""

    report: Report | None
    most: int
    scored: int = 0

    def add(self, rows: int) -> None:
        self.scored += rows
        if self.report is not None:
            self.report(self.scored, self.most)


def _verified(
    lens: Lens, study: Study, scales: Array, seed: int, fresh: int, count: _Count
) -> tuple[Yield | None, bool]:
    """Yield of a run of the study that is written, with another seed; as far as it came, if interrupted."""
    perturbations = scaled_perturbations(study, scales)
    other = study.model_copy(update={"perturbations": perturbations, "seed": seed, "draws": "random"})
    context, passed = context_of(lens, other), list[NDArray[np.bool_]]()
    try:
        for start in range(0, fresh, ROWS_AT_ONCE):
            batch = realise(other, range(start, min(start + ROWS_AT_ONCE, fresh)))
            scores, _ = score_batch(study.merits, context, batch)
            passed.append(np.all([m.passed(scores[:, k]) for k, m in enumerate(study.merits)], axis=0))
            count.add(len(batch))
    except KeyboardInterrupt:
        return yield_of(np.concatenate([np.empty(0, bool), *passed])), False
    return yield_of(np.concatenate(passed)), True


def scaled_perturbations(study: Study, scales: Array) -> tuple[Perturbation, ...]:
    """The perturbations of a study with their distributions scaled, to four digits.

    Raises
    ------
    InputError
        If a distribution has no width to scale.
    """
    perturbations = []
    for perturbation, scale in zip(study.perturbations, scales, strict=True):
        if not perturbation.distribution.widths:
            raise InputError(
                f"{perturbation.column}: a measured distribution has no width in the study file to scale; "
                "give it another distribution"
            )
        if scale != 1.0:
            shape = perturbation.scaled(float(scale)).distribution
            moved = ("mean",) if perturbation.is_irregularity and shape.centre else ()
            rounded = {name: float(f"{getattr(shape, name):.4g}") for name in (*shape.widths, *moved)}
            own = perturbation.distribution.model_copy(update=rounded)
            perturbation = perturbation.model_copy(update={"distribution": own})
        perturbations.append(perturbation)
    return tuple(perturbations)


def scaled_study(loaded: LoadedStudy, scales: Array) -> Study:
    """The study of a file with each perturbation's distribution scaled, to four digits.

    Parameters
    ----------
    loaded
        The study.
    scales : ndarray, shape (perturbations,)
        Of the widths of the distributions.

    Raises
    ------
    InputError
        If a distribution has no width to scale.
    """
    study = study_from_tables(tomllib.loads(loaded.study_text), loaded.name)
    return study.model_copy(update={"perturbations": scaled_perturbations(study, scales)})


def _deviations(study: Study, trials: range) -> tuple[Array, Array]:
    """What is not scaled of each perturbation, and what is, as random trials draw it."""
    drawn = probabilities("random", study.seed, trials, len(study.perturbations), study.trials)
    dependent = study.dependence.apply(drawn)
    values = [p.distribution.quantile(dependent[:, k]) for k, p in enumerate(study.perturbations)]
    mean = np.array([0.0 if p.is_irregularity else p.distribution.centre for p in study.perturbations])
    return mean, np.column_stack(values) - mean
