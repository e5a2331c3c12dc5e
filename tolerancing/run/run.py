"""Runs of a study: its steps, trials and high-fidelity trials are scored and written into a store."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path

from lensdesign.common.clusters import toolkit_version
from lensdesign.common.given import FilePath, object_of
from lensdesign.errors import InputError
from tolerancing.run.estimate import RunEstimate, estimate_run
from tolerancing.run.executors import Perform, RunError, cluster_workers, this_process
from tolerancing.run.pool import LocalPool, Rehearsal, WorkerEndedError
from tolerancing.run.tasks import (
    Task,
    all_tasks,
    chunk_size,
    high_fidelity_counts,
    missing_high_fidelity,
    missing_steps,
    missing_trials,
)
from tolerancing.store.creation import remove_empty_store
from tolerancing.store.store import Store, create_store, open_store
from tolerancing.study.evaluate import levels_and_nominal_scores
from tolerancing.study.files import LoadedStudy, load_study
from tolerancing.study.study import MOST_TRIALS

__all__ = ["RunError", "RunOutcome", "run_study"]

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class RunOutcome:
    """Amount of work of a run, and the time that it took.

    Attributes
    ----------
    trials_run, steps_run, high_fidelity_run
        Number of trials, of steps of series, and of trials with high-fidelity merits that this run has
        scored. Results that the store already held are not counted.
    workers
        Number of worker processes; 0 if a cluster did the work.
    seconds
        Wall-clock time (s).

    Examples
    --------
    >>> from tolerancing import load_study, run_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> first = run_study(loaded, "outcome.db", trials=10, workers=1, fresh=True)
    >>> second = run_study(loaded, "outcome.db", trials=15, workers=1)
    >>> first.trials_run, second.trials_run
    (10, 5)
    """

    trials_run: int
    steps_run: int
    high_fidelity_run: int
    workers: int
    seconds: float


@dataclass
class _ProgressReporter:
    """Counts of the work that is finished and of the work that was missing at the start."""

    progress: Progress | None
    missing: dict[str, int]
    done: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("steps", "trials", "high_fidelity"), 0)
    )

    def add(self, task: Task) -> None:
        """Count a finished task."""
        self.done["high_fidelity" if task.chosen else "trials" if task.trials else "steps"] += task.size

    def report(self) -> None:
        """Call the progress callback."""
        if self.progress is not None:
            total = sum(max(count, self.done[kind]) for kind, count in self.missing.items())
            self.progress(sum(self.done.values()), total)


def run_study(
    loaded: LoadedStudy | FilePath,
    store_path: str | os.PathLike[str],
    *,
    workers: int | None = None,
    trials: int | None = None,
    fresh: bool = False,
    cluster: str | None = None,
    progress: Progress | None = None,
    on_estimate: Callable[[RunEstimate], None] | None = None,
) -> RunOutcome:
    """Run a study: score all trials and steps that its store still lacks.

    The rows of the store depend on the study alone, not on the number of workers or on interruptions. A run
    that is killed loses only the tasks that its workers were performing. Several runs may share one store
    and its work.

    A trial whose Python merit raises an exception, or ends its worker process, is stored as failed. Worker
    processes import the main module when they start, so a script that calls this function needs
    ``if __name__ == "__main__":``.

    Parameters
    ----------
    loaded
        Study with its lens, or the path of a study file.
    store_path
        Path of the store. It is created if it does not exist, and continued if it holds the same study.
    workers
        Number of worker processes. Default: the number of processors. There are never more workers than
        trials, nor more than four for each processor. With 1, the calling process does the work.
    trials
        Number of trials that the store holds after the run. Default: the number in the study.
    fresh
        Whether an existing store is replaced instead of continued.
    cluster
        Address of a Dask scheduler whose workers do the work instead of processes on this machine.
    progress
        Called as ``progress(completed, total)`` after each batch of results is stored.
    on_estimate
        Called once with a :class:`~tolerancing.run.estimate.RunEstimate` before anything is stored. Some
        trials are timed for it. It is not called if a Python merit ends the process that times them.

    Returns
    -------
    RunOutcome
        Amount of work that was done, and the time that it took.

    Raises
    ------
    InputError
        If the store cannot be used, holds another study, or is to be replaced while it is in use; if the
        nominal lens cannot be scored; or if the cluster cannot be used.
    RunError
        If a worker process dies, or the cluster is gone.

    Examples
    --------
    >>> from tolerancing import load_study, run_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "run.db", trials=20, workers=1, fresh=True)
    >>> outcome.trials_run, outcome.steps_run
    (20, 48)
    """
    start = time.perf_counter()
    loaded = object_of(loaded, LoadedStudy, load_study, "loaded")
    planned = loaded.study.trials if trials is None else trials
    _check_counts(planned, workers, cluster)
    processes = 0 if cluster else _process_count(workers, planned)
    assumed_cluster_workers = 32  # Only the size of tasks depends on it.
    crew = processes or assumed_cluster_workers
    pool = LocalPool(loaded, processes)
    # User code may end its process, and must not end this one.
    in_this_process = workers == 1 and not any(merit.file_name for merit in loaded.study.all_merits)
    with pool, Rehearsal(loaded, in_this_process, pool) as rehearsal:
        rehearsal.get_ready()
        store, is_new = _ready_store(Path(store_path), loaded, planned, crew, fresh, rehearsal)
        try:
            with store:
                levels = {merit.label: merit.level for merit in store.merits()}
                loaded = replace(loaded, study=loaded.study.with_levels(levels))
                missing = _missing(loaded, store, planned)
                size = chunk_size(loaded.study, planned, crew)
                tasks = missing["steps"] + -(-missing["trials"] // size) + missing["high_fidelity"]
                processes = min(processes, max(1, tasks))
                reporter = _ProgressReporter(progress, missing)
                if tasks:
                    if on_estimate is not None:
                        steps = tuple(missing_steps(loaded.study, store))
                        estimate = partial(estimate_run, loaded, missing, steps, processes, size)
                        early = all_tasks(loaded.study, planned, crew) if is_new else ()
                        with suppress(WorkerEndedError):  # The run finds out which trial it is.
                            on_estimate(rehearsal.run(estimate, early, levels))
                    in_this_process = processes == 1 and rehearsal.in_this_process
                    rehearsal.close()
                    store.start_writing()
                    with _workers(loaded, levels, pool, cluster, in_this_process) as perform:
                        trial_tasks = missing_trials(store, planned, size, crew, in_order=is_new)
                        _score(loaded, store, perform, reporter, trial_tasks, planned)
                    store.finish_writing()
        except InputError:
            if is_new:
                remove_empty_store(Path(store_path))
            raise
    done = reporter.done
    seconds = time.perf_counter() - start
    return RunOutcome(done["trials"], done["steps"], done["high_fidelity"], processes, seconds)


def _process_count(workers: int | None, planned: int) -> int:
    """Return the number of processes: at most one for each trial and four for each processor.

    More processes than that only take memory from each other.
    """
    processors = len(os.sched_getaffinity(0))
    return min(workers or processors, planned, 4 * processors)


def _check_counts(planned: int, workers: int | None, cluster: str | None) -> None:
    if not 1 <= planned <= MOST_TRIALS:
        raise InputError(f"trials = {planned}: must be at least 1 and at most {MOST_TRIALS}")
    if workers is not None and workers < 1:
        raise InputError(f"workers = {workers}: must be at least 1")
    if workers is not None and cluster is not None:
        raise InputError(f"workers = {workers}: a cluster has its own workers; give one or the other")


def _workers(
    loaded: LoadedStudy, levels: dict[str, str], pool: LocalPool, address: str | None, in_this_process: bool
) -> AbstractContextManager[Perform]:
    if address is not None:
        return cluster_workers(loaded, levels, address)
    return this_process(loaded) if in_this_process else pool.performing(loaded)


def _score(
    loaded: LoadedStudy,
    store: Store,
    perform: Perform,
    reporter: _ProgressReporter,
    trials: Iterable[Task],
    planned: int,
) -> None:
    """Score steps and trials, then the high-fidelity trials, which depend on the scores of the others."""
    study = loaded.study
    _store_results(store, perform, chain(missing_steps(study, store), trials), reporter)
    if study.high_fidelity_merits:
        _store_results(store, perform, missing_high_fidelity(study, store, planned), reporter)


def _store_results(
    store: Store, perform: Perform, tasks: Iterable[Task], reporter: _ProgressReporter
) -> None:
    with closing(perform(tasks)) as batches:
        for batch in batches:
            store.add(*(results for _, results in batch))
            for task, _ in batch:
                reporter.add(task)
            reporter.report()


def _missing(loaded: LoadedStudy, store: Store, planned: int) -> dict[str, int]:
    """Count the steps, trials and high-fidelity trials that a store lacks."""
    study = loaded.study
    trials = planned - store.trial_count(planned)
    steps = sum(len(series) for series in study.series) - len(store.finished_steps())
    if trials or not study.high_fidelity_merits:
        high_fidelity = sum(high_fidelity_counts(study, planned))
    else:
        high_fidelity = sum(1 for _ in missing_high_fidelity(study, store, planned))
    return {"steps": steps, "trials": trials, "high_fidelity": high_fidelity}


def _ready_store(
    path: Path, loaded: LoadedStudy, planned: int, crew: int, fresh: bool, rehearsal: Rehearsal
) -> tuple[Store, bool]:
    """Return a store of this study with the planned number of trials, and whether it is new."""
    if os.path.exists(path):
        open_store(path).close()  # Raises for a file that is no store, which must never be replaced.
        if not fresh:
            return _continued(path, loaded, planned), False
    # The levels are decided by the scores of the nominal lens. Tasks performed in the meantime use the
    # cheapest levels; they are discarded if the decision differs.
    cheapest = loaded.study.with_levels({})
    early = all_tasks(cheapest, planned, crew)
    levels, nominal = rehearsal.run(
        partial(levels_and_nominal_scores, loaded.lens, loaded.study), early, cheapest.levels
    )
    if create_store(loaded, path, nominal, planned, levels=levels, replace=fresh):
        return open_store(path), True
    return _continued(path, loaded, planned), False


def _continued(path: Path, loaded: LoadedStudy, planned: int) -> Store:
    """Open an existing store, which must hold the same study."""
    store = open_store(path)
    try:
        _check_same_study(store, loaded)
        store.plan(planned)
    except BaseException:
        store.close()
        raise
    return store


def _check_same_study(store: Store, loaded: LoadedStudy) -> None:
    record = store.record()
    if record.fingerprint != loaded.fingerprint:
        raise InputError(
            f"{store.path} holds another study, or this one before its files were changed; give another "
            "store, or --fresh to replace it (for more trials of the same study: --trials N)"
        )
    if record.toolkit_version != toolkit_version():
        raise InputError(
            f"{store.path} was created by version {record.toolkit_version} of the toolkit, this is version "
            f"{toolkit_version()}, whose results may differ; give another store, or --fresh to replace it"
        )
