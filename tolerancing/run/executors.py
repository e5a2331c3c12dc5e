"""Who does a run's tasks: this process, or a Dask cluster; and how few are handed out at a time."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, TypeVar

from lensdesign.common.clusters import LOOK_SECONDS, ClusterError, open_cluster, result_of, toolkit_version
from lensdesign.errors import TransferLensError
from tolerancing.run.tasks import Task, perform

if TYPE_CHECKING:
    from tolerancing.study.files import LoadedStudy
    from tolerancing.study.results import Results

Result = TypeVar("Result")
Done = list[tuple[Task, "Results"]]
Batches = Generator[Done, None, None]
Perform = Callable[[Iterable[Task]], Batches]

Died = Callable[[list[Task]], Batches]

KEPT = "what was finished is in the store, and the same command goes on from there"
WORKER_DIED = f"a worker process died (out of memory, perhaps); {KEPT}: fewer --workers need less memory"

TASKS_IN_FLIGHT = 3
"""Tasks handed out for each worker: one it does, and some so that it need not wait."""


class RunError(TransferLensError):
    """A run that had to stop; its store holds what was finished."""


@contextmanager
def this_process(loaded: LoadedStudy) -> Iterator[Perform]:
    """Do tasks one after the other, here."""
    from tolerancing.study.evaluate import context_of

    context = context_of(loaded.lens, loaded.study)

    def batches(tasks: Iterable[Task]) -> Batches:
        for task in tasks:
            yield [(task, perform(context, loaded.study, task))]

    yield batches


@contextmanager
def cluster_workers(loaded: LoadedStudy, levels: Mapping[str, str], address: str) -> Iterator[Perform]:
    """Do tasks in a Dask cluster; its workers may come and go.

    Parameters
    ----------
    loaded
        The study. Its files are sent to the cluster once; from there each worker fetches them.
    levels
        The merits' levels by their labels.
    address
        Of the scheduler, as in ``tcp://host:8786``.

    Raises
    ------
    InputError
        As of :func:`lensdesign.common.clusters.open_cluster`.
    """
    from tolerancing.run.workers import StudyParcel, work_in_cluster

    with open_cluster(address) as cluster:
        sent = cluster.send(
            StudyParcel(toolkit_version(), loaded.name, dict(loaded.files), loaded.fingerprint, levels)
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
    died: Died | None = None,
    check: Callable[[], None] | None = None,
) -> Batches:
    """Results of tasks as they come, a few tasks for each worker handed out at a time.

    Parameters
    ----------
    submit
        Hands out a task.
    tasks
        All tasks.
    workers
        How many do them at a time.
    died
        Does the tasks that had been handed out when a worker of a pool died, which breaks the pool.
    check
        Called now and then while tasks are under way; raises ClusterError where nobody does them any more.

    Raises
    ------
    RunError, InputError
        If a worker dies or cannot do its task, or no worker is left; what others have finished is handed
        over first.
    """
    from concurrent.futures import FIRST_COMPLETED, wait

    waiting, pending = iter(tasks), dict[Future["Results"], Task]()
    while True:
        room = TASKS_IN_FLIGHT * max(workers(), 1) - len(pending)
        for task in islice(waiting, max(room, 0)):
            pending[submitted(submit, task)] = task
        if not pending:
            return
        finished, _ = wait(pending, timeout=LOOK_SECONDS if check else None, return_when=FIRST_COMPLETED)
        if not finished and check is not None:
            try:
                check()
            except ClusterError as error:
                raise RunError(f"{error}; {KEPT}") from error
        failed = [future for future in finished if future.cancelled() or future.exception() is not None]
        good = [(pending.pop(future), future.result()) for future in finished if future not in failed]
        if good:
            yield good
        if failed and died is not None and _is_broken(failed[0]):
            suspects = list(pending.values())
            pending.clear()
            yield from died(suspects)
        elif failed:
            result(failed[0])


def _is_broken(future: Future[Results]) -> bool:
    from concurrent.futures.process import BrokenProcessPool

    return not future.cancelled() and isinstance(future.exception(), BrokenProcessPool)


def submitted(submit: Callable[[Task], Future[Results]], task: Task) -> Future[Results]:
    """A task handed out; a pool that is broken tells so by the task's future, after what it has finished."""
    from concurrent.futures.process import BrokenProcessPool

    try:
        return submit(task)
    except BrokenProcessPool as error:
        future: Future[Results] = Future()
        future.set_exception(error)
        return future


def result(future: Future[Result]) -> Result:
    """What a task, or other work of a worker, came to.

    Raises
    ------
    RunError
        If its worker died, or whatever handed it out is gone.
    """
    from concurrent.futures.process import BrokenProcessPool

    try:
        return result_of(future)
    except BrokenProcessPool as error:
        raise RunError(WORKER_DIED) from error
    except ClusterError as error:
        raise RunError(f"{error}; {KEPT}") from error
