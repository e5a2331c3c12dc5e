"""Runs of a study: steps of its series, its trials, and its dear merits, into a store."""

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
from lensdesign.errors import InputError
from tolerancing.run.estimate import RunEstimate, estimate_run
from tolerancing.run.executors import Perform, RunError, cluster_workers, this_process
from tolerancing.run.pool import EndedError, LocalPool, Rehearsal
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
from tolerancing.study.evaluate import first_scores
from tolerancing.study.files import LoadedStudy
from tolerancing.study.study import MOST_TRIALS

__all__ = ["RunError", "RunOutcome", "run_study"]

Report = Callable[[int, int], None]

MANY_WORKERS = 32
"""As many are taken to be in a cluster, for the size of tasks."""


MOST_PER_PROCESSOR = 4
"""Most processes of a run for each processor: more of them only take memory from each other."""


@dataclass(frozen=True)
class RunOutcome:
    """What a run did.

    Attributes
    ----------
    trials_run, steps_run, dear_run
        Trials, steps of series, and trials for the dear merits that were scored now, not found in the store.
    workers
        Number of processes that did it; 0 where a cluster did.
    seconds
        Time taken.
    """

    trials_run: int
    steps_run: int
    dear_run: int
    workers: int
    seconds: float


@dataclass
class _Tally:
    """What is done, and what there is to do."""

    report: Report | None
    lacking: dict[str, int]
    done: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("steps", "trials", "dear"), 0))

    def add(self, task: Task) -> None:
        """Count a task."""
        self.done["dear" if task.chosen else "trials" if task.trials else "steps"] += task.size

    def tell(self) -> None:
        """Report."""
        if self.report is not None:
            total = sum(max(n, self.done[part]) for part, n in self.lacking.items())
            self.report(sum(self.done.values()), total)


def run_study(
    loaded: LoadedStudy,
    store_path: str | os.PathLike[str],
    *,
    workers: int | None = None,
    trials: int | None = None,
    fresh: bool = False,
    cluster: str | None = None,
    report: Report | None = None,
    announce: Callable[[RunEstimate], None] | None = None,
) -> RunOutcome:
    """Score what the store still lacks of a study.

    The rows of the store are the same whatever number of workers made them, in however many runs, whatever
    ended those. A run that is killed loses what its workers were at. Several runs may share one store, and
    the work. Where a merit in Python ends its worker, as a fault of memory does, that is its trial's failure,
    as all that it raises; with `workers` = 1 it would end this process. Worker processes start by importing
    the main module, so a script that calls this needs the usual ``if __name__ == "__main__":``.

    Parameters
    ----------
    loaded
        The study, with its lens.
    store_path
        The store; made if it is not there, gone on with if it holds the same study.
    workers
        Number of processes; as many as there are processors where left out. There are never more than
        trials, nor than four for each processor. One that is asked for is this process.
    trials
        Number of trials that the store is to hold in the end; the study's where left out.
    fresh
        Start over: replace a store that is there.
    cluster
        Address of a Dask scheduler whose workers are to do it, in place of processes of this machine.
    report
        Called with the amounts done and to do after each batch.
    announce
        Called once, before anything is stored, with what there is to do and about how long it takes; some
        trials are timed for it. Not where a merit in Python ends the process that does so.

    Raises
    ------
    InputError
        If the store cannot be used, holds another study, or is in use where it is to be replaced; if the
        nominal lens cannot be scored; if the cluster cannot be used.
    RunError
        If a worker process dies, or the cluster goes away.
    """
    start = time.perf_counter()
    planned = loaded.study.trials if trials is None else trials
    _check_counts(planned, workers, cluster)
    processes = 0 if cluster else _process_count(workers, planned)
    crew = processes or MANY_WORKERS
    pool = LocalPool(loaded, processes)
    with pool, Rehearsal(loaded, workers == 1, pool) as rehearsal:
        rehearsal.get_ready()
        store, is_new = _ready_store(Path(store_path), loaded, planned, crew, fresh, rehearsal)
        try:
            with store:
                levels = {merit.label: merit.level for merit in store.merits()}
                loaded = replace(loaded, study=loaded.study.with_levels(levels))
                lacking = _lacking(loaded, store, planned)
                size = chunk_size(loaded.study, planned, crew)
                tasks = lacking["steps"] + -(-lacking["trials"] // size) + lacking["dear"]
                processes = min(processes, max(1, tasks))
                tally = _Tally(report, lacking)
                if tasks:
                    if announce is not None:
                        steps = tuple(missing_steps(loaded.study, store))
                        asked = partial(estimate_run, loaded, lacking, steps, processes, size)
                        early = all_tasks(loaded.study, planned, crew) if is_new else ()
                        with suppress(EndedError):  # by one of the first trials; which, will show
                            announce(rehearsal.do(asked, early, levels))
                    here = processes == 1 and rehearsal.here
                    rehearsal.close()
                    store.start_writing()
                    with _workers(loaded, levels, pool, cluster, here) as perform:
                        trial_tasks = missing_trials(store, planned, size, crew, in_order=is_new)
                        _score(loaded, store, perform, tally, trial_tasks, planned)
                    store.finish_writing()
        except InputError:
            if is_new:
                remove_empty_store(Path(store_path))
            raise
    done = tally.done
    return RunOutcome(done["trials"], done["steps"], done["dear"], processes, time.perf_counter() - start)


def _process_count(workers: int | None, planned: int) -> int:
    """Processes for a run: no more than it has trials, and than processors do well with."""
    processors = len(os.sched_getaffinity(0))
    return min(workers or processors, planned, MOST_PER_PROCESSOR * processors)


def _check_counts(planned: int, workers: int | None, cluster: str | None) -> None:
    if not 1 <= planned <= MOST_TRIALS:
        raise InputError(f"trials = {planned}: must be at least 1 and at most {MOST_TRIALS}")
    if workers is not None and workers < 1:
        raise InputError(f"workers = {workers}: must be at least 1")
    if workers is not None and cluster is not None:
        raise InputError(f"workers = {workers}: a cluster has its own workers; give one or the other")


def _workers(
    loaded: LoadedStudy, levels: dict[str, str], pool: LocalPool, address: str | None, here: bool
) -> AbstractContextManager[Perform]:
    if address is not None:
        return cluster_workers(loaded, levels, address)
    return this_process(loaded) if here else pool.performing(loaded)


def _score(
    loaded: LoadedStudy, store: Store, perform: Perform, tally: _Tally, trials: Iterable[Task], planned: int
) -> None:
    """Fill the store: steps and trials, then what these choose for the dear merits."""
    study = loaded.study
    _store_results(store, perform, chain(missing_steps(study, store), trials), tally)
    if study.high_fidelity_merits:
        _store_results(store, perform, missing_high_fidelity(study, store, planned), tally)


def _store_results(store: Store, perform: Perform, tasks: Iterable[Task], tally: _Tally) -> None:
    with closing(perform(tasks)) as batches:
        for batch in batches:
            store.add(*(results for _, results in batch))
            for task, _ in batch:
                tally.add(task)
            tally.tell()


def _lacking(loaded: LoadedStudy, store: Store, planned: int) -> dict[str, int]:
    """How many steps, trials and dear trials a store lacks."""
    study = loaded.study
    trials = planned - store.trial_count(planned)
    steps = sum(len(series) for series in study.series) - len(store.finished_steps())
    if trials or not study.high_fidelity_merits:
        dear = sum(high_fidelity_counts(study, planned))
    else:
        dear = sum(1 for _ in missing_high_fidelity(study, store, planned))
    return {"steps": steps, "trials": trials, "dear": dear}


def _ready_store(
    path: Path, loaded: LoadedStudy, planned: int, crew: int, fresh: bool, rehearsal: Rehearsal
) -> tuple[Store, bool]:
    """The store that holds this study and knows what is planned, and whether it was made just now."""
    if os.path.exists(path):
        open_store(path).close()  # what is no store of ours is never replaced
        if not fresh:
            return _continued(path, loaded, planned), False
    # Levels are open yet: what is done meanwhile counts where the cheapest ones will do.
    cheapest = loaded.study.with_levels({})
    early = all_tasks(cheapest, planned, crew)
    levels, nominal = rehearsal.do(partial(first_scores, loaded.lens, loaded.study), early, cheapest.levels)
    if create_store(loaded, path, nominal, planned, levels=levels, replace=fresh):
        return open_store(path), True
    return _continued(path, loaded, planned), False


def _continued(path: Path, loaded: LoadedStudy, planned: int) -> Store:
    """A store that is there, if it holds the same study."""
    store = open_store(path)
    try:
        _refuse_other_study(store, loaded)
        store.plan(planned)
    except BaseException:
        store.close()
        raise
    return store


def _refuse_other_study(store: Store, loaded: LoadedStudy) -> None:
    record = store.record()
    if record.fingerprint != loaded.fingerprint:
        raise InputError(
            f"{store.path} holds another study, or this one before its files were changed; give another "
            "store, or --fresh to replace it (more trials alone: --trials N)"
        )
    if record.toolkit_version != toolkit_version():
        raise InputError(
            f"{store.path} was begun with version {record.toolkit_version} of the toolkit, this is "
            f"{toolkit_version()}: rows of both need not agree; give another store, or --fresh to replace it"
        )
