"""Estimate of the time that a run takes, made before the run starts."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

from lensdesign.common.text import duration_text
from tolerancing.merits.context import Context
from tolerancing.run.tasks import Task
from tolerancing.study.evaluate import context_of, sample_perturbations, score_high_fidelity, score_trials
from tolerancing.study.files import LoadedStudy
from tolerancing.study.results import WORST
from tolerancing.study.study import Study


@dataclass(frozen=True)
class RunEstimate:
    """Work that a run still has to do, and the time that this takes.

    Attributes
    ----------
    trials, steps, high_fidelity
        Number of missing trials, of missing steps of series, and of missing trials for the high-fidelity
        merits.
    workers
        Number of worker processes; 0 for a cluster.
    seconds
        Expected wall-clock time (s). It follows from the time of some trials, measured here after the
        one-time setup, and from the estimates of the series for their steps.
    """

    trials: int
    steps: int
    high_fidelity: int
    workers: int
    seconds: float

    @property
    def sentence(self) -> str:
        """The estimate as a line of text."""
        counts = {
            "trials": self.trials,
            "steps": self.steps,
            "trials by high-fidelity merits": self.high_fidelity,
        }
        work = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
        workers = f"{self.workers} {'worker' if self.workers == 1 else 'workers'}"
        if not self.workers:
            workers = "one cluster worker as fast as this machine"
        return f"{work}: about {duration_text(self.seconds)} by {workers}"


def estimate_run(
    loaded: LoadedStudy, missing: dict[str, int], steps: Sequence[Task], workers: int, chunk: int
) -> RunEstimate:
    """Time some trials of a study, and estimate how long the missing work takes.

    Parameters
    ----------
    loaded
        Study whose merits have their final levels.
    missing
        Number of missing trials under the keys ``trials`` and ``high_fidelity``.
    steps
        Missing steps of series.
    workers
        Number of worker processes; 0 for a cluster.
    chunk
        Number of trials in a task.
    """
    study, context = loaded.study, context_of(loaded.lens, loaded.study)
    score_trials(context, study, (0,))  # The first call includes the one-time setup; it is not timed.
    single = _seconds(lambda: score_trials(context, study, (0,)))
    each = single
    timed_seconds = (
        0.2  # Trials of a chunk share work, so short ones are timed together, for about this long.
    )
    if single < timed_seconds and chunk > 1:
        few = min(chunk, max(2, round(timed_seconds / max(single, 1e-9))))
        each = _seconds(lambda: score_trials(context, study, range(few))) / few
    seconds = each * missing["trials"] + sum(_step_seconds(context, study, step, single) for step in steps)
    if missing["high_fidelity"]:
        score_high_fidelity(context, study, (0,), (WORST,))
        one = _seconds(lambda: score_high_fidelity(context, study, (0,), (WORST,)))
        seconds += missing["high_fidelity"] * one
    counts = (missing["trials"], len(steps), missing["high_fidelity"])
    setup = _setup_seconds(context, study, missing["trials"], steps)
    return RunEstimate(*counts, workers, setup + seconds / max(workers, 1))


def _setup_seconds(context: Context, study: Study, trials: int, steps: Sequence[Task]) -> float:
    """Estimate the one-time setup that each worker needs for further trials and steps, from the merits."""
    inspected = min(trials, 2000)  # Enough draws to find every kind of setup.
    batches = [sample_perturbations(study, range(inspected))] if trials else []
    batches += [
        batch for task in steps if (batch := study.series[task.series].batch(context, task.step)) is not None
    ]
    found: dict[Hashable, float] = {}
    for merit in study.merits:
        for batch in batches:
            found.update(merit.setups(context, batch))
    return sum(found.values())


def _step_seconds(context: Context, study: Study, task: Task, trial: float) -> float:
    """Return the estimate of the series for its step, or else the time of a trial."""
    estimated = study.series[task.series].seconds(context, task.step)
    return trial if estimated is None else estimated


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
