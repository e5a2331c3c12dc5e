"""Worker processes on this machine that perform a run's tasks.

Before a run begins, the nominal lens is scored and some trials are timed. With several workers, one of them
does this (:class:`Rehearsal`). The others meanwhile perform the first tasks of the run in advance
(:meth:`LocalPool.run_with_prefetch`). Without this they would be idle for a noticeable part of a short study.

A merit in Python may end its process. The run then scores the trials in question one at a time in another
process, and a trial that ends its process again is stored as failed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from lensdesign.common.processes import Processes, follow_parent
from lensdesign.errors import InputError
from tolerancing.run.executors import (
    TASKS_IN_FLIGHT,
    WORKER_DIED,
    Batches,
    Perform,
    RunError,
    in_flight,
    result,
    submitted,
)
from tolerancing.run.tasks import Task

if TYPE_CHECKING:
    from tolerancing.study.files import LoadedStudy
    from tolerancing.study.results import Results

Result = TypeVar("Result")


class LocalPool(Processes):
    """Processes of this machine for the tasks of a study. The levels of its merits may still be undecided."""

    def __init__(self, loaded: LoadedStudy, count: int) -> None:
        from tolerancing.run.workers import start_local

        super().__init__(count, start_local, loaded)
        self._has_python_merits = any(merit.file_name for merit in loaded.study.all_merits)
        self._prefetched: dict[Task, Future[Results]] = {}
        self._prefetch_levels: Mapping[str, str] = {}

    @property
    def can_rehearse(self) -> bool:
        """True if a worker may do the rehearsal. Merits in Python need a process of their own."""
        return self.count > 1 and not self._has_python_merits

    def run_with_prefetch(
        self, work: Callable[[], Result], tasks: Iterable[Task], levels: Mapping[str, str]
    ) -> Result:
        """Do `work` in one process while the others perform tasks of the run in advance.

        Parameters
        ----------
        work
            Work for one of the processes.
        tasks
            Tasks for the other processes. They are finished or in progress when the run hands them out later.
        levels
            Level of each merit, by the merit's label. If the run decides on other levels, the results of
            tasks that were performed in advance are discarded.

        Raises
        ------
        RunError
            If a process dies.
        """
        from concurrent.futures import FIRST_COMPLETED, wait

        self._keep_prefetched(levels)
        requested = self.submit(work)
        most_for_each = 100  # Their results wait in memory.
        waiting = islice((task for task in tasks if task not in self._prefetched), most_for_each * self.count)
        while not requested.done():
            free_slots = TASKS_IN_FLIGHT * (self.count - 1) - len(self._unfinished())
            for task in islice(waiting, max(free_slots, 0)):
                self._prefetched[task] = submitted(lambda task: self._submit_task(task, levels), task)
            wait((requested, *self._unfinished()), return_when=FIRST_COMPLETED)
        return result(requested)

    def _unfinished(self) -> list[Future[Any]]:
        return [future for future in self._prefetched.values() if not future.done()]

    def _keep_prefetched(self, levels: Mapping[str, str]) -> None:
        """Discard results that were computed at other levels."""
        if levels != self._prefetch_levels:
            for future in self._prefetched.values():
                future.cancel()
            self._prefetched.clear()
        self._prefetch_levels = levels

    def _submit_task(self, task: Task, levels: Mapping[str, str]) -> Future[Results]:
        from tolerancing.run.workers import work_local

        prefetched = self._prefetched.pop(task, None)
        return self.submit(work_local, task, levels) if prefetched is None else prefetched

    @contextmanager
    def performing(self, loaded: LoadedStudy) -> Iterator[Perform]:
        """Perform tasks of a study whose merits have their final levels.

        The processes end at once when the run is interrupted.
        """
        levels = loaded.study.levels
        self._keep_prefetched(levels)

        def retry(suspects: list[Task]) -> Batches:
            self.close()
            return _one_by_one(loaded, levels, suspects)

        def batches(tasks: Iterable[Task]) -> Batches:
            return in_flight(
                lambda task: self._submit_task(task, levels),
                tasks,
                lambda: self.count,
                retry if self._has_python_merits else None,
            )

        with self:
            yield batches


def _one_by_one(loaded: LoadedStudy, levels: Mapping[str, str], suspects: list[Task]) -> Batches:
    """Perform tasks whose worker died, trial by trial in one process. A trial that ends it has failed.

    Raises
    ------
    RunError
        If no trial ends the process, so that something else ended the worker.
    """
    from tolerancing.run.workers import start_local, work_local

    found = False
    with Processes(1, start_local, loaded) as alone:
        for task in (single for suspect in suspects for single in suspect.single_trials()):
            try:
                results = alone.submit(work_local, task, levels).result()
            except BrokenProcessPool:
                failure = f"{alone.end()} ended its process"
                results, found = result(alone.submit(work_local, task, levels, failure)), True
            yield [(task, results)]
    if not found:
        raise RunError(WORKER_DIED)


class WorkerEndedError(InputError):
    """A merit in Python ended the process that scored it."""


class Rehearsal(Processes):
    """Work that a run needs before it begins: a check of the merits, nominal scores, and timed trials.

    With several workers, one of them does it. Merits in Python are tried in a process of their own.

    Parameters
    ----------
    loaded
        Study with its lens.
    in_this_process
        Whether this process does all work.
    pool
        Workers of the run.
    """

    def __init__(self, loaded: LoadedStudy, in_this_process: bool, pool: LocalPool) -> None:
        super().__init__(1, follow_parent)
        self._study, self._pool_of_run = loaded.study, pool
        self._files = ", ".join(sorted({m.file_name for m in loaded.study.all_merits if m.file_name}))
        self.in_this_process = in_this_process or not (self._files or pool.can_rehearse)

    def get_ready(self) -> None:
        """Check that all merits can score.

        Raises
        ------
        InputError
            If a merit cannot score. The error is an :class:`WorkerEndedError` if the merit ends its process.
        """
        from tolerancing.study.evaluate import prepare_merits

        if self._files and not self.in_this_process:
            self._in_another_process(partial(prepare_merits, self._study))
        else:
            prepare_merits(self._study)

    def run(self, work: Callable[[], Result], tasks: Iterable[Task], levels: Mapping[str, str]) -> Result:
        """Do `work` and return its result. See :meth:`LocalPool.run_with_prefetch` for the parameters.

        Raises
        ------
        WorkerEndedError
            If a merit ends the process.
        RunError
            If a worker dies for another reason.
        """
        if self.in_this_process:
            return work()
        if self._files:
            return self._in_another_process(work)
        return self._pool_of_run.run_with_prefetch(work, tasks, levels)

    def _in_another_process(self, work: Callable[[], Result]) -> Result:
        try:
            return self.submit(work).result()
        except BrokenProcessPool as error:
            raise WorkerEndedError(
                f"{self._files}: {self.end()} ended the process that was to score the nominal lens; nothing "
                "was run. Correct the merit and run the command again"
            ) from error
