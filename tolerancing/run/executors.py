"""Execution of a run's tasks in this process or in a Dask cluster.

Both executors hand out only a few tasks for each worker at a time. A task list can therefore be longer than
memory, and the choice of later tasks can depend on results that are already stored.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, TypeVar

from lensdesign.common.clusters import CHECK_SECONDS, ClusterError, open_cluster, result_of, toolkit_version
from lensdesign.errors import TransferLensError
from tolerancing.run.tasks import Task, perform

if TYPE_CHECKING:
    from tolerancing.study.files import LoadedStudy
    from tolerancing.study.results import Results

Result = TypeVar("Result")
FinishedTasks = list[tuple[Task, "Results"]]
Batches = Generator[FinishedTasks, None, None]
Perform = Callable[[Iterable[Task]], Batches]
RetryTasks = Callable[[list[Task]], Batches]

RESUME_HINT = "the finished results are in the store; repeat the command to continue"
WORKER_DIED = (
    f"a worker process died, perhaps because memory ran out; {RESUME_HINT}, with fewer --workers if so"
)

TASKS_IN_FLIGHT = 3
"""Tasks handed out for each worker: the one in progress, and two more so that the worker never waits."""


class RunError(TransferLensError):
    """A run stopped before its end.

    The store holds all finished results; another run continues from them.

    Examples
    --------
    >>> from tolerancing import RunError, load_study, run_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> try:
    ...     outcome = run_study(loaded, "study.db", trials=50, workers=1)
    ... except RunError as error:
    ...     print(f"run the study again: {error}")
    """


@contextmanager
def this_process(loaded: LoadedStudy) -> Iterator[Perform]:
    """Perform tasks one after the other in this process."""
    from tolerancing.study.evaluate import context_of

    context = context_of(loaded.lens, loaded.study)

    def batches(tasks: Iterable[Task]) -> Batches:
        for task in tasks:
            yield [(task, perform(context, loaded.study, task))]

    yield batches


@contextmanager
def cluster_workers(loaded: LoadedStudy, levels: Mapping[str, str], address: str) -> Iterator[Perform]:
    """Perform tasks in a Dask cluster. Workers may join and leave while it runs.

    Parameters
    ----------
    loaded
        Study with its files. The files are sent to the cluster once; each worker fetches them from there.
    levels
        Level of each merit, by the merit's label.
    address
        Address of the scheduler, such as ``tcp://host:8786``.

    Raises
    ------
    InputError
        If the package ``distributed`` is missing, no scheduler answers, no worker joins in time, or a worker
        has another version of the toolkit.
    """
    from tolerancing.run.workers import StudyParcel, work_in_cluster

    with open_cluster(address) as cluster:
        trust = not any(merit.lacks_consent for merit in loaded.study.all_merits)
        sent = cluster.send(
            StudyParcel(toolkit_version(), loaded.name, dict(loaded.files), loaded.fingerprint, levels, trust)
        )

        def batches(tasks: Iterable[Task]) -> Batches:
            return in_flight(
                lambda task: cluster.submit(work_in_cluster, sent, task),
                tasks,
                cluster.threads,
                check=cluster.check_workers,
            )

        yield batches


def in_flight(
    submit: Callable[[Task], Future[Results]],
    tasks: Iterable[Task],
    workers: Callable[[], int],
    retry: RetryTasks | None = None,
    check: Callable[[], None] | None = None,
) -> Batches:
    """Yield results of tasks as they finish, with a few tasks handed out for each worker at a time.

    Parameters
    ----------
    submit
        Hands out one task.
    tasks
        All tasks.
    workers
        Returns the present number of workers.
    retry
        Performs the tasks that were handed out when a worker of a process pool died, which breaks the pool.
        Default: the death of a worker is an error.
    check
        Called at intervals while tasks are in progress. It raises ClusterError when no worker is left.

    Raises
    ------
    RunError
        If a worker dies or no worker is left. Results that were finished are yielded first.
    InputError
        If a worker cannot perform its task. Results that were finished are yielded first.
    """
    from concurrent.futures import FIRST_COMPLETED, wait

    waiting, pending = iter(tasks), dict[Future["Results"], Task]()
    while True:
        free_slots = TASKS_IN_FLIGHT * max(workers(), 1) - len(pending)
        for task in islice(waiting, max(free_slots, 0)):
            pending[submitted(submit, task)] = task
        if not pending:
            return
        finished, _ = wait(pending, timeout=CHECK_SECONDS if check else None, return_when=FIRST_COMPLETED)
        if not finished and check is not None:
            try:
                check()
            except ClusterError as error:
                raise RunError(f"{error}; {RESUME_HINT}") from error
        failed = [future for future in finished if future.cancelled() or future.exception() is not None]
        good = [(pending.pop(future), future.result()) for future in finished if future not in failed]
        if good:
            yield good
        if failed and retry is not None and _is_broken(failed[0]):
            suspects = list(pending.values())
            pending.clear()
            yield from retry(suspects)
        elif failed:
            result(failed[0])


def _is_broken(future: Future[Results]) -> bool:
    from concurrent.futures.process import BrokenProcessPool

    return not future.cancelled() and isinstance(future.exception(), BrokenProcessPool)


def submitted(submit: Callable[[Task], Future[Results]], task: Task) -> Future[Results]:
    """Submit a task and return its future.

    If the pool is already broken, the future holds that error. The caller then sees it after the results that
    the pool has finished.
    """
    from concurrent.futures.process import BrokenProcessPool

    try:
        return submit(task)
    except BrokenProcessPool as error:
        future: Future[Results] = Future()
        future.set_exception(error)
        return future


def result(future: Future[Result]) -> Result:
    """Return the result of a task or of other work in a worker.

    Raises
    ------
    RunError
        If the worker died, or the cluster that performed the work is gone.
    """
    from concurrent.futures.process import BrokenProcessPool

    try:
        return result_of(future)
    except BrokenProcessPool as error:
        raise RunError(WORKER_DIED) from error
    except ClusterError as error:
        raise RunError(f"{error}; {RESUME_HINT}") from error
