"""How long a run will take, before it starts."""

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

SHORT_SECONDS = 0.2
"""A trial that takes less is timed as one of a chunk, which share work: of as many as take about so long."""


MOST_LOOKED_AT = 2000
"""Trials that are looked at for what they need set up."""


@dataclass(frozen=True)
class RunEstimate:
    """What a run has to do, and how long that will take.

    Attributes
    ----------
    trials, steps, dear
        Trials, steps of series, and trials for the dear merits that are missing.
    workers
        Processes that will do it; 0 where a cluster does.
    seconds
        By what one trial takes, timed here, once all that is set up only once is, and by what series tell
        of their steps.
    """

    trials: int
    steps: int
    dear: int
    workers: int
    seconds: float

    @property
    def sentence(self) -> str:
        """For people."""
        parts = {"trials": self.trials, "steps": self.steps, "trials by dear merits": self.dear}
        what = ", ".join(f"{count} {name}" for name, count in parts.items() if count)
        whom = f"{self.workers} {'worker' if self.workers == 1 else 'workers'}"
        if not self.workers:
            whom = "one worker of a cluster like this machine"
        return f"{what}: about {duration_text(self.seconds)} by {whom}"


def estimate_run(
    loaded: LoadedStudy, lacking: dict[str, int], steps: Sequence[Task], workers: int, chunk: int
) -> RunEstimate:
    """Time some trials of a study, and tell how long what is missing takes.

    Parameters
    ----------
    loaded
        The study, its merits' levels settled.
    lacking
        How many ``trials`` and ``dear`` trials are missing.
    steps
        The steps that are missing.
    workers
        Number of processes; 0 for a cluster.
    chunk
        How many trials a task has.
    """
    study, context = loaded.study, context_of(loaded.lens, loaded.study)
    score_trials(context, study, (0,))  # once, for what is set up once
    single = _seconds(lambda: score_trials(context, study, (0,)))
    each = single
    if single < SHORT_SECONDS and chunk > 1:
        few = min(chunk, max(2, round(SHORT_SECONDS / max(single, 1e-9))))
        each = _seconds(lambda: score_trials(context, study, range(few))) / few
    seconds = each * lacking["trials"] + sum(_step_seconds(context, study, step, single) for step in steps)
    if lacking["dear"]:
        score_high_fidelity(context, study, (0,), (WORST,))
        seconds += lacking["dear"] * _seconds(lambda: score_high_fidelity(context, study, (0,), (WORST,)))
    counts = (lacking["trials"], len(steps), lacking["dear"])
    setup = _setup_seconds(context, study, lacking["trials"], steps)
    return RunEstimate(*counts, workers, setup + seconds / max(workers, 1))


def _setup_seconds(context: Context, study: Study, trials: int, steps: Sequence[Task]) -> float:
    """What each worker sets up once for further trials and steps, as their merits tell."""
    batches = [sample_perturbations(study, range(min(trials, MOST_LOOKED_AT)))] if trials else []
    batches += [
        batch for task in steps if (batch := study.series[task.series].batch(context, task.step)) is not None
    ]
    found: dict[Hashable, float] = {}
    for merit in study.merits:
        for batch in batches:
            found.update(merit.setups(context, batch))
    return sum(found.values())


def _step_seconds(context: Context, study: Study, task: Task, trial: float) -> float:
    """What its series tells, or what a trial takes."""
    told = study.series[task.series].seconds(context, task.step)
    return trial if told is None else told


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
