"""Budgets of studies: tolerances sought on a response model, then held against trials of the lens itself."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.analysis.response import Response, fit_response
from tolerancing.analysis.scorer import Report, StudyScorer, scatter_of
from tolerancing.analysis.tolerance_search import Budget, loosest_tolerances
from tolerancing.analysis.yields import Yield, yield_of
from tolerancing.perturbations.draws import probabilities
from tolerancing.store.store import Store
from tolerancing.study.evaluate import context_of
from tolerancing.study.files import LoadedStudy, study_from_tables
from tolerancing.study.study import Study

FRESH = 1 << 20
"""First number of the trials that are drawn to verify, beyond those of any store."""

SCALES = (0.1, 4.0)


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
        Yield of fresh trials of the lens with these tolerances.
    """

    budget: Budget
    response: Response
    verified: Yield


def budget(
    store: Store,
    required: float,
    weights: Mapping[str, float] | None = None,
    *,
    fresh: int = 500,
    report: Report | None = None,
) -> StudyBudget:
    """The loosest tolerances that keep a yield, from the trials of a store.

    :func:`scaled_study` gives the study that has them.

    Parameters
    ----------
    store
        An open store.
    required, weights, fresh, report
        As of :func:`budget_of_study`.

    Raises
    ------
    InputError
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
    fresh: int = 500,
    report: Report | None = None,
) -> StudyBudget:
    """The loosest tolerances of a study whose yield's interval lies above what is required.

    A second-order response model of the merits, fitted to the trials, is searched for the shares of the
    tolerances; trials of the lens itself then tell by which common factor they may be scaled, and as many
    fresh ones the true yield.

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
    fresh
        Number of trials of the lens for the common factor, and of fresh ones for the yield.
    report
        Called with the number of trials scored after each part of them.

    Raises
    ------
    InputError
        If a weight names no perturbation, the trials are too few for a model, or the yield is out of reach.
    """
    columns = [p.column for p in study.perturbations]
    unknown = [name for name in weights or {} if name not in columns]
    if unknown:
        raise InputError(
            f"weight of {unknown[0]!r}: there is no such perturbation; allowed: {', '.join(columns)}"
        )
    scatter = scatter_of(study)
    scorer = StudyScorer(context_of(lens, study), study, report)
    response = fit_response(values, scores)
    budget = loosest_tolerances(
        response.predict,
        study.merits,
        scatter.mean,
        _deviations(study, range(FRESH, FRESH + fresh)),
        required,
        low=SCALES[0],
        high=SCALES[1],
        weights=np.array([(weights or {}).get(column, 1.0) for column in columns]),
        verify=scorer,
    )
    checks = _deviations(study, range(2 * FRESH, 2 * FRESH + fresh))
    fresh_scores = scorer(scatter.mean + budget.scales * checks)
    passed = np.all([m.passed(fresh_scores[:, k]) for k, m in enumerate(study.merits)], axis=0)
    good = yield_of(passed)
    assert good is not None
    return StudyBudget(budget, response, good)


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
    perturbations = []
    for perturbation, scale in zip(study.perturbations, scales, strict=True):
        distribution = perturbation.distribution
        if not distribution.widths:
            raise InputError(
                f"{perturbation.column}: a measured distribution has no width in the study file to scale; "
                "give it another distribution"
            )
        scaled = distribution.scaled(float(scale))
        widths = {name: float(f"{getattr(scaled, name):.4g}") for name in distribution.widths}
        changed = distribution.model_copy(update=widths)
        perturbations.append(perturbation.model_copy(update={"distribution": changed}))
    return study.model_copy(update={"perturbations": tuple(perturbations)})


def _deviations(study: Study, trials: range) -> Array:
    """Deviations from the mean, as random trials draw them."""
    drawn = probabilities("random", study.seed, trials, len(study.perturbations), study.trials)
    dependent = study.dependence.apply(drawn)
    return np.column_stack(
        [
            p.distribution.quantile(dependent[:, k]) - p.distribution.centre
            for k, p in enumerate(study.perturbations)
        ]
    )
