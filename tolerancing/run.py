"""Runs of a study: chunks of trials and steps of sweeps, by one process or many, into a store."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lensdesign.errors import InputError, TransferLensError
from tolerancing.context import Context
from tolerancing.evaluate import nominal_scores, score_step, score_trials
from tolerancing.results import Results
from tolerancing.store import Store, create_store, open_store, toolkit_version
from tolerancing.study import MOST_TRIALS, LoadedStudy, Study
from tolerancing.threads import one_blas_thread

if TYPE_CHECKING:
    from concurrent.futures import Future

Report = Callable[[int, int], None]


class RunError(TransferLensError):
    """A run that had to stop; its store holds what was finished."""


@dataclass(frozen=True)
class Task:
    """What a worker does at a time: some trials, or one step of one sweep."""

    trials: tuple[int, ...] = ()
    sweep: int = 0
    step: int = 0

    @property
    def size(self) -> int:
        """How much it counts in a progress bar."""
        return len(self.trials) or 1


@dataclass(frozen=True)
class RunOutcome:
    """What a run did.

    Attributes
    ----------
    trials_run, steps_run
        Trials and sweep steps that were scored now, not found in the store.
    workers
        Number of processes that did it.
    seconds
        Time taken.
    """

    trials_run: int
    steps_run: int
    workers: int
    seconds: float


def run_study(
    loaded: LoadedStudy,
    store_path: str | os.PathLike[str],
    *,
    workers: int | None = None,
    trials: int | None = None,
    fresh: bool = False,
    report: Report | None = None,
) -> RunOutcome:
    """Score what the store still lacks of a study.

    The rows of the store are the same whatever number of workers made them, in however many runs.
    Worker processes start by importing the main module, so a script that calls this needs the usual
    ``if __name__ == "__main__":``.

    Parameters
    ----------
    loaded
        The study, with its lens.
    store_path
        The store; made if it is not there, gone on with if it holds the same study.
    workers
        Number of processes; as many as there are processors where left out. One works in this process.
    trials
        Number of trials that the store is to hold in the end; the study's where left out.
    fresh
        Start over: replace a store that is there.
    report
        Called with the amounts done and to do after each batch.

    Raises
    ------
    InputError
        If the store cannot be used, holds another study, or the nominal lens cannot be scored.
    RunError
        If a worker process dies.
    """
    start = time.perf_counter()
    planned = loaded.study.trials if trials is None else trials
    if not 1 <= planned <= MOST_TRIALS:
        raise InputError(f"trials = {planned}: must be at least 1 and at most {MOST_TRIALS}")
    if workers is not None and workers < 1:
        raise InputError(f"workers = {workers}: must be at least 1")
    with _ready_store(Path(store_path), loaded, planned, fresh) as store:
        tasks = missing_tasks(loaded.study, store, planned)
        processes = min(workers or len(os.sched_getaffinity(0)), max(1, len(tasks)))
        done, total = 0, sum(task.size for task in tasks)
        trials_run = 0
        # Closing ends the pool at once, whatever interrupts the loop.
        with closing(_results(loaded, tasks, processes)) as batches:
            for task, results in batches:
                store.add(results)
                done += task.size
                trials_run += len(task.trials)
                if report is not None:
                    report(done, total)
    return RunOutcome(trials_run, done - trials_run, processes, time.perf_counter() - start)


def missing_tasks(study: Study, store: Store, planned: int) -> list[Task]:
    """What a store still lacks of its study, in chunks."""
    finished = store.finished_trials()
    missing = [trial for trial in range(planned) if trial not in finished]
    size = min(merit.trials_per_chunk for merit in study.merits)
    chunks = [Task(trials=tuple(missing[i : i + size])) for i in range(0, len(missing), size)]
    steps = store.finished_steps()
    return [
        Task(sweep=k, step=step)
        for k, sweep in enumerate(study.sweeps)
        for step in range(len(sweep.values))
        if (sweep.label, step) not in steps
    ] + chunks


def perform(context: Context, study: Study, task: Task) -> Results:
    """Do one task."""
    if task.trials:
        return score_trials(context, study, task.trials)
    return score_step(context, study, study.sweeps[task.sweep], task.step)


def _ready_store(path: Path, loaded: LoadedStudy, planned: int, fresh: bool) -> Store:
    """The store, made if need be, that holds this study and knows what is planned."""
    if os.path.exists(path):
        store = open_store(path)
        if not fresh:
            try:
                _refuse_other_study(store, loaded)
                store.plan(max(planned, len(store.finished_trials())))
            except BaseException:
                store.close()
                raise
            return store
        store.close()
    nominal = nominal_scores(Context(loaded.lens, loaded.study.sampling), loaded.study)
    create_store(path, loaded, nominal, planned)
    return open_store(path)


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


def _results(
    loaded: LoadedStudy, tasks: Sequence[Task], processes: int
) -> Generator[tuple[Task, Results], None, None]:
    """Results of tasks as they come, from this process or from a pool."""
    if processes == 1 or not tasks:
        context = Context(loaded.lens, loaded.study.sampling)
        for task in tasks:
            yield task, perform(context, loaded.study, task)
        return
    from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
    from multiprocessing import get_context

    one_blas_thread()
    pool = ProcessPoolExecutor(
        processes, mp_context=get_context("spawn"), initializer=_start_worker, initargs=(loaded,)
    )
    try:
        pending = {pool.submit(_work, task): task for task in tasks}
        while pending:
            finished, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                yield pending.pop(future), _result(future)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _result(future: Future[Results]) -> Results:
    from concurrent.futures.process import BrokenProcessPool

    try:
        return future.result()
    except BrokenProcessPool as error:
        raise RunError(
            "a worker process died (out of memory, perhaps); what was finished is in the store, and the "
            "same command goes on from there: fewer --workers need less memory"
        ) from error


_worker: tuple[Context, Study] | None = None


def _start_worker(loaded: LoadedStudy) -> None:
    # An interrupt goes to the whole group; only the process that holds the store may act on it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    global _worker
    _worker = (Context(loaded.lens, loaded.study.sampling), loaded.study)


def _work(task: Task) -> Results:
    assert _worker is not None  # the initializer saw to it
    return perform(*_worker, task)
