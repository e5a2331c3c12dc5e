"""Tasks that a run hands to its workers.

A task is some trials, a step of a series, or a trial for the high-fidelity merits. High-fidelity merits score
the worst trials by a low-fidelity merit, and a random sample of the others.
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


@dataclass(frozen=True)
class Task:
    """Unit of work for a worker.

    Attributes
    ----------
    trials
        Numbers of the trials; empty for a step of a series.
    chosen
        Reason why each trial was selected for the high-fidelity merits; empty for other tasks.
    series, step
        Index of the series, and index of the step in it.
    """

    trials: tuple[int, ...] = ()
    chosen: tuple[str, ...] = ()
    series: int = 0
    step: int = 0

    @property
    def size(self) -> int:
        """Number of trials, or 1 for a step; the weight of the task in a progress bar."""
        return len(self.trials) or 1

    def single_trials(self) -> list[Task]:
        """Return the task as tasks of one trial each."""
        if not self.trials:
            return [self]
        return [Task((trial,), self.chosen[k : k + 1]) for k, trial in enumerate(self.trials)]


def perform(context: Context, study: Study, task: Task) -> Results:
    """Perform one task and return its results."""
    if task.chosen:
        return score_high_fidelity(context, study, task.trials, task.chosen)
    if task.trials:
        return score_trials(context, study, task.trials)
    return score_step(context, study, task.series, task.step)


def chunk_size(study: Study, trials: int, workers: int) -> int:
    """Return the number of trials in a task.

    It is the number that the merits prefer, limited so that each worker gets at least four tasks. Otherwise
    workers would wait for the last task.
    """
    tasks_per_worker = 4
    most = min(1 if m.used_level == "wave" else m.trials_per_chunk for m in study.merits)
    return max(min(most, trials // (tasks_per_worker * workers)), 1)


def chunks(planned: int, size: int, workers: int) -> list[range]:
    """Cut the trials into tasks, in order.

    The last task of each worker is cut into four, so that all workers finish at about the same time.
    """
    tail = workers * size if workers > 1 else 0
    whole = max(planned - tail, 0) // size * size
    small = max(size // 4, 1) if tail else size
    starts = [*range(0, whole, size), *range(whole, planned, small)]
    return [range(start, end) for start, end in pairwise([*starts, planned])]


def all_tasks(study: Study, planned: int, workers: int) -> Iterator[Task]:
    """Yield all steps and trials in order, which are the tasks that an empty store lacks."""
    for k, series in enumerate(study.series):
        for step in range(len(series)):
            yield Task(series=k, step=step)
    for chunk in chunks(planned, chunk_size(study, planned, workers), workers):
        yield Task(trials=tuple(chunk))


def missing_steps(study: Study, store: Store) -> Iterator[Task]:
    """Yield the steps of series that a store still lacks."""
    for k, series in enumerate(study.series):
        for step in range(len(series)):
            if store.lacks_step(series.label, step):
                yield Task(series=k, step=step)


def missing_trials(store: Store, planned: int, size: int, workers: int, in_order: bool) -> Iterator[Task]:
    """Yield the trials that a store still lacks, in chunks.

    Each chunk is compared with the store just before it is handed out. Trials that another run has stored
    in the meantime are therefore skipped.

    Parameters
    ----------
    store
        Store of the study.
    planned
        Number of trials that the store is to hold in the end.
    size, workers
        Number of trials in a chunk, and number of workers; see :func:`chunks`.
    in_order
        Whether the chunks come in order. Several runs that share a store use a random order, so that they do
        not all perform the same trials.
    """
    ranges = chunks(planned, size, workers)
    order = np.arange(len(ranges))
    if not in_order:
        np.random.default_rng().shuffle(order)
    for k in order.tolist():
        missing = store.missing(ranges[k])
        if missing:
            yield Task(trials=missing)


def missing_high_fidelity(study: Study, store: Store, planned: int) -> Iterator[Task]:
    """Yield the high-fidelity trials that a store with all its trials still lacks, the worst trial first."""
    chosen = chosen_trials(study, store.scores(predictor(study).label, planned))
    for trials, reason in ((chosen.worst, WORST), (chosen.random, RANDOM)):
        for trial in trials.tolist():
            if store.lacks_high_fidelity(trial):
                yield Task(trials=(trial,), chosen=(reason,))


def predictor(study: Study) -> Merit:
    """Return the low-fidelity merit that selects trials: that of the study's first high-fidelity merit."""
    label = study.high_fidelity_merits[0].predicted_by
    return next(merit for merit in study.merits if merit.label == label)


def high_fidelity_counts(study: Study, trials: int) -> tuple[int, int]:
    """Return how many of the worst trials and how many random others the study's `fidelity` selects.

    A fraction above 0 selects at least one trial, as long as there are trials.
    """
    if not study.high_fidelity_merits:
        return 0, 0
    fractions = study.fidelity.worst_share, study.fidelity.random_share
    worst, random = (max(round(fraction * trials), 1) if fraction > 0.0 else 0 for fraction in fractions)
    worst = min(worst, trials)
    return worst, min(random, trials - worst)


def chosen_trials(study: Study, low_fidelity_scores: ArrayLike) -> TrialChoice:
    """Select the trials for the high-fidelity merits. The selection depends on study and scores alone.

    Parameters
    ----------
    study
        Study with at least one high-fidelity merit.
    low_fidelity_scores : array_like, shape (trials,)
        Scores of all trials by the merit of :func:`predictor`; NaN for a trial without a score.
    """
    margin = predictor(study).margin(low_fidelity_scores)
    return choose_trials(margin, study.seed, *high_fidelity_counts(study, len(margin)))
