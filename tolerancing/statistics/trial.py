"""One trial of a store: drawn, traced and scored again, and held against what the store says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from tolerancing.merits.context import Context
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.store.store import Store
from tolerancing.study.evaluate import context_of, sample_perturbations, score_high_fidelity, score_trials
from tolerancing.study.results import RANDOM, TrialResults
from tolerancing.study.study import Study


@dataclass(frozen=True, eq=False)
class SingleTrial:
    """A trial, stored and again.

    Attributes
    ----------
    number
        Of the trial.
    study
        The study that it is one of.
    context, batch
        The nominal lens, and the trial's perturbations.
    again : TrialResults
        As it comes out now.
    stored : TrialResults or None
        As the store has it; None where the run has not got to it.
    dear : dict of str to float
        Scores of the dear merits, where the store has any of this trial.
    """

    number: int
    study: Study
    context: Context
    batch: PerturbationBatch
    again: TrialResults
    stored: TrialResults | None
    dear: dict[str, float]

    @property
    def same(self) -> bool | None:
        """Whether values and scores are those stored, to the last bit; None where none are stored."""
        if self.stored is None:
            return None
        return all(
            np.array_equal(a, b, equal_nan=True)
            for a, b in (
                (self.stored.values, self.again.values),
                (self.stored.scores, self.again.scores),
            )
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; names carry their units."""
        study, again = self.study, self.again
        scores = {m.column: _or_none(again.scores[0, k]) for k, m in enumerate(study.merits)}
        stored = self.stored
        return {
            "trial": self.number,
            "seed": study.seed,
            "deviations": {p.column: again.values[0, k].item() for k, p in enumerate(study.perturbations)},
            "scores": scores,
            "stored_scores": None
            if stored is None
            else {m.column: _or_none(stored.scores[0, k]) for k, m in enumerate(study.merits)},
            "extras": {
                name: _or_none(value)
                for name, value in zip(study.extra_columns, again.extras[0], strict=True)
            },
            "dear_scores": self.dear,
            "passed": bool(again.passed[0]),
            "message": again.messages[0],
            "same_as_stored": self.same,
        }


def single_trial(store: Store, number: int, *, dear: bool = False) -> SingleTrial:
    """Draw, trace and score one trial again.

    Parameters
    ----------
    store
        An open store; it is not written to.
    number
        Of the trial.
    dear
        Whether to score the dear merits too.

    Raises
    ------
    InputError
        If the study has no trial of this number.
    """
    loaded, planned = store.loaded, store.record().planned_trials
    if not 0 <= number < planned:
        raise InputError(f"trial = {number}: the study has trials 0 to {planned - 1}")
    study = loaded.study
    context = context_of(loaded.lens, study)
    again = score_trials(context, study, [number])
    scores: dict[str, float] = {}
    if dear and study.high_fidelity_merits:
        found = score_high_fidelity(context, study, [number], [RANDOM])
        scores = {
            m.column: float(s) for m, s in zip(study.high_fidelity_merits, found.scores[0], strict=True)
        }
    stored = store.trials(only=number)
    return SingleTrial(
        number=number,
        study=study,
        context=context,
        batch=sample_perturbations(study, [number]),
        again=again,
        stored=stored if len(stored) else None,
        dear=scores,
    )


def _or_none(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
