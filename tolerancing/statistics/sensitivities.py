"""What each perturbation of a study does alone, beside what the trials found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError
from tolerancing.perturbations.draws import replicates
from tolerancing.statistics.quadratic_response import (
    Comparison,
    Sensitivity,
    compare_with_trials,
    fit_sensitivity,
    root_sum_square,
)
from tolerancing.statistics.scorer import scatter_of
from tolerancing.store.store import Store
from tolerancing.study.results import StepResults
from tolerancing.study.study import Study
from tolerancing.study.sweep import SENSITIVITY, OneAtATime


@dataclass(frozen=True, eq=False)
class StudySensitivity:
    """Sensitivities of a study, and what follows from them.

    Attributes
    ----------
    study
        What was run.
    found
        Sensitivities of its merits to its perturbations, each alone.
    compared
        Each merit as predicted by root sum square, and as the trials found it.
    """

    study: Study
    found: Sensitivity
    compared: tuple[Comparison, ...]

    def as_dict(self) -> dict[str, list[dict[str, Any]]]:
        """For JSON: for each merit's column the perturbations, the most harmful first; null: not known."""
        ranking = self.found.ranking(self.study.merits)
        return {m.column: [self._row(i, k) for i in ranking[k]] for k, m in enumerate(self.study.merits)}

    def _row(self, i: int, k: int) -> dict[str, Any]:
        found, perturbation = self.found, self.study.perturbations[i]
        return {
            "perturbation": perturbation.column,
            "tolerance": perturbation.distribution.largest,
            "derivative": finite_or_none(float(found.derivative[i, k])),
            "change_at_minus_tolerance": finite_or_none(float(found.change[i, 0, k])),
            "change_at_plus_tolerance": finite_or_none(float(found.change[i, -1, k])),
            "quadratic_coefficients": [finite_or_none(c) for c in found.coefficients[i, :, k].tolist()],
            "residual": finite_or_none(float(found.residual[i, k])),
            "standard_deviation": finite_or_none(float(found.standard_deviation[i, k])),
        }


def sensitivity(store: Store) -> StudySensitivity:
    """What each perturbation of a stored study does alone, and what follows for the yield.

    Parameters
    ----------
    store
        An open store whose sensitivities have been run.

    Raises
    ------
    InputError
        If the study leaves sensitivities out, or the run has not got to them.
    """
    study = store.study
    found = study_sensitivities(study, store.nominal(), store.steps())
    predicted, trials = root_sum_square(found, study.merits), store.trials()
    own = replicates(study.draws, trials.trials)
    return StudySensitivity(study, found, compare_with_trials(predicted, trials.scores, own))


def study_sensitivities(
    study: Study, nominal: Mapping[str, float], steps: Sequence[StepResults]
) -> Sensitivity:
    """Sensitivities from the steps that a store holds.

    Parameters
    ----------
    study
        The study.
    nominal
        Scores of the nominal lens, by merit.
    steps
        Of the store; those of other series are passed over.

    Raises
    ------
    InputError
        If the study leaves sensitivities out, or the run has not got to them.
    """
    if not study.sensitivity:
        raise InputError("the study has sensitivity = false: there are no sensitivities")
    own = sorted((s for s in steps if s.series == SENSITIVITY), key=lambda s: s.step)
    wanted = len(OneAtATime(study.perturbations))
    if len(own) < wanted:
        raise InputError(f"the store holds {len(own)} of {wanted} steps of the sensitivities: finish its run")
    labels = [m.label for m in study.merits]
    scores = np.array([[step.scores.get(label, np.nan) for label in labels] for step in own], float)
    middle = np.array([nominal.get(label, np.nan) for label in labels], float)
    scores[~np.isfinite(scores)], middle[~np.isfinite(middle)] = np.nan, np.nan
    scatter = scatter_of(study)
    return fit_sensitivity(
        middle,
        scores,
        scatter.tolerance,
        scatter.standard_deviation,
        scatter.mean,
        scatter.kurtosis,
    )
