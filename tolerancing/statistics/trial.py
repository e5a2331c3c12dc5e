"""A trial of a store, which is drawn, traced and scored again and compared with the stored results."""

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
from wavesim.scene.system_state import SystemState


@dataclass(frozen=True, eq=False)
class SingleTrial:
    """A trial as it is stored, and as it was scored again.

    Attributes
    ----------
    number
        Number of the trial, from 0.
    study
        The study to which the trial belongs.
    context, batch
        Nominal lens with its cached analyses, and perturbations of the trial.
    again : TrialResults
        Results of the new calculation.
    stored : TrialResults or None
        Results in the store; None if the run has not scored this trial yet.
    high_fidelity : dict of str to float
        New scores of the high-fidelity merits; empty if they were not requested.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, single_trial
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     trial = single_trial(store, 7)
    >>> row = trial.as_dict()
    >>> round(row["deviations"]["lens_tilt_x_deg"], 4), round(row["scores"]["wavefront"], 3)
    (-0.003, 0.074)
    """

    number: int
    study: Study
    context: Context
    batch: PerturbationBatch
    again: TrialResults
    stored: TrialResults | None
    high_fidelity: dict[str, float]

    @property
    def same(self) -> bool | None:
        """True if values and scores equal the stored ones to the last bit; None if none are stored."""
        if self.stored is None:
            return None
        return all(
            np.array_equal(a, b, equal_nan=True)
            for a, b in (
                (self.stored.values, self.again.values),
                (self.stored.scores, self.again.scores),
            )
        )

    @property
    def state(self) -> SystemState:
        """System of the trial, at the design's first wavelength: a state for :func:`wavesim.image`."""
        lens = self.context.lens
        (state,) = self.batch.states(lens, lens.wavelengths_um[0])
        return state

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; names carry their units."""
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
            "high_fidelity_scores": self.high_fidelity,
            "passed": bool(again.passed[0]),
            "message": again.messages[0],
            "same_as_stored": self.same,
        }


def single_trial(store: Store, number: int, *, high_fidelity: bool = False) -> SingleTrial:
    """Draw, trace and score one trial of a store again, and return it with the stored results.

    Parameters
    ----------
    store
        Open store; nothing is written to it.
    number
        Number of the trial, from 0.
    high_fidelity
        Whether the high-fidelity merits are scored too.

    Returns
    -------
    SingleTrial
        The trial with its new and its stored results.

    Raises
    ------
    InputError
        If the study has no trial of this number.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, single_trial
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     trial = single_trial(store, 7)
    >>> trial.same, bool(trial.again.passed[0])
    (True, True)
    """
    loaded, planned = store.loaded, store.record().planned_trials
    if not 0 <= number < planned:
        raise InputError(f"trial = {number}: the study has trials 0 to {planned - 1}")
    study = loaded.study
    context = context_of(loaded.lens, study)
    again = score_trials(context, study, [number])
    scores: dict[str, float] = {}
    if high_fidelity and study.high_fidelity_merits:
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
        high_fidelity=scores,
    )


def _or_none(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
