"""What a run hands to its workers: some trials, a step of a series, or a trial for the dear merits.

Dear merits score the worst trials by a cheap merit, and some drawn from the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.statistics.control_variates import TrialChoice, choose_trials
from tolerancing.store.store import Store
from tolerancing.study.evaluate import score_high_fidelity, score_step, score_trials
from tolerancing.study.results import RANDOM, WORST, Results
from tolerancing.study.study import Study

TASKS_PER_WORKER = 4
"""At least so many, where there are enough trials, lest some workers wait for the last one."""


TAIL_PARTS = 4
"""The last task of each worker is cut into as many."""


@dataclass(frozen=True)
class Task:
    """What a worker does at a time.

    Attributes
    ----------
    trials
        Numbers of the trials; empty for a step.
    chosen
        Why each was chosen, for the dear merits; empty for the others.
    series, step
        Index of the series, and number of the step.
    """

    trials: tuple[int, ...] = ()
    chosen: tuple[str, ...] = ()
    series: int = 0
    step: int = 0

    @property
    def size(self) -> int:
        """How much it counts in a progress bar."""
        return len(self.trials) or 1

    def parts(self) -> list[Task]:
        """The same, trial by trial."""
        if not self.trials:
            return [self]
        return [Task((trial,), self.chosen[k : k + 1]) for k, trial in enumerate(self.trials)]


def perform(context: Context, study: Study, task: Task) -> Results:
    """Do one task."""
    if task.chosen:
        return score_high_fidelity(context, study, task.trials, task.chosen)
    if task.trials:
        return score_trials(context, study, task.trials)
    return score_step(context, study, task.series, task.step)


def chunk_size(study: Study, trials: int, workers: int) -> int:
    """How many trials make a task: as many as the merits like, but some tasks for each worker."""
    most = min(1 if m.used_level == "wave" else m.trials_per_chunk for m in study.merits)
    return max(min(most, trials // (TASKS_PER_WORKER * workers)), 1)


def chunks(planned: int, size: int, workers: int) -> list[range]:
    """Trials by tasks, in order: the last ones smaller, lest all workers but one wait for the last one."""
    tail = workers * size if workers > 1 else 0
    whole = max(planned - tail, 0) // size * size
    part = max(size // TAIL_PARTS, 1) if tail else size
    starts = [*range(0, whole, size), *range(whole, planned, part)]
    return [range(start, end) for start, end in pairwise([*starts, planned])]


def all_tasks(study: Study, planned: int, workers: int) -> Iterator[Task]:
    """Steps and trials, in order; what a store lacks in which there is nothing yet."""
    for k, series in enumerate(study.series):
        for step in range(len(series)):
            yield Task(series=k, step=step)
    for chunk in chunks(planned, chunk_size(study, planned, workers), workers):
        yield Task(trials=tuple(chunk))


def missing_steps(study: Study, store: Store) -> Iterator[Task]:
    """Steps that a store still lacks."""
    for k, series in enumerate(study.series):
        for step in range(len(series)):
            if store.lacks_step(series.label, step):
                yield Task(series=k, step=step)


def missing_trials(store: Store, planned: int, size: int, workers: int, in_order: bool) -> Iterator[Task]:
    """Trials that a store still lacks, in chunks.

    Each chunk is looked up when its turn comes, so that what another run has stored meanwhile is left out.

    Parameters
    ----------
    store
        Where to look.
    planned
        How many trials there are to be.
    size, workers
        Of a chunk, and how many do them, as of :func:`chunks`.
    in_order
        Whether to go through them in order. Runs that share a store do not, lest they all do the same.
    """
    parts = chunks(planned, size, workers)
    order = np.arange(len(parts))
    if not in_order:
        np.random.default_rng().shuffle(order)
    for k in order.tolist():
        lacking = store.lacking(parts[k])
        if lacking:
            yield Task(trials=lacking)


def missing_high_fidelity(study: Study, store: Store, planned: int) -> Iterator[Task]:
    """Dear scores that a store with all its trials still lacks, trial by trial, the worst first."""
    chosen = chosen_trials(study, store.scores(predictor(study).label, planned))
    for trials, why in ((chosen.worst, WORST), (chosen.random, RANDOM)):
        for trial in trials.tolist():
            if store.lacks_high_fidelity(trial):
                yield Task(trials=(trial,), chosen=(why,))


def predictor(study: Study) -> Merit:
    """The cheap merit that trials are chosen by: that of the study's first dear merit."""
    label = study.high_fidelity_merits[0].predicted_by
    return next(merit for merit in study.merits if merit.label == label)


def high_fidelity_counts(study: Study, trials: int) -> tuple[int, int]:
    """How many of the worst and of the other trials the study's `fidelity` chooses.

    A share above 0 is at least one trial, as long as there are trials.
    """
    if not study.high_fidelity_merits:
        return 0, 0
    shares = study.fidelity.worst_share, study.fidelity.random_share
    worst, random = (max(round(share * trials), 1) if share > 0.0 else 0 for share in shares)
    worst = min(worst, trials)
    return worst, min(random, trials - worst)


def chosen_trials(study: Study, cheap_scores: ArrayLike) -> TrialChoice:
    """The trials to choose, which follow from the study and the scores alone.

    Parameters
    ----------
    study
        With at least one dear merit.
    cheap_scores : array_like, shape (trials,)
        Of all trials, by :func:`predictor`; NaN where there is none.
    """
    margin = predictor(study).margin(cheap_scores)
    return choose_trials(margin, study.seed, *high_fidelity_counts(study, len(margin)))
