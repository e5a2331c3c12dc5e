"""Processes of this machine that do a run's tasks; a user's code may end them, and not the run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

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
from tolerancing.run.processes import Processes, follow_parent
from tolerancing.run.tasks import Task

if TYPE_CHECKING:
    from tolerancing.study.files import LoadedStudy
    from tolerancing.study.results import Results

MOST_EARLY = 100
"""Tasks for each worker that are done before the run begins; what they come to waits in memory."""

Result = TypeVar("Result")


class LocalPool(Processes):
    """Processes of this machine for the tasks of a study, whose merits' levels may still be open."""

    def __init__(self, loaded: LoadedStudy, number: int) -> None:
        from tolerancing.run.workers import start_local

        super().__init__(number, start_local, loaded)
        self._by_code = any(merit.file_name for merit in loaded.study.all_merits)
        self._early: dict[Task, Future[Results]] = {}
        self._early_levels: Mapping[str, str] = {}

    @property
    def rehearses(self) -> bool:
        """Whether what a run scores before it begins is for these; merits in Python are tried alone."""
        return self.number > 1 and not self._by_code

    def do(self, work: Callable[[], Result], meanwhile: Iterable[Task], levels: Mapping[str, str]) -> Result:
        """What `work` returns; the others do tasks meanwhile.

        Parameters
        ----------
        work
            For one of the processes.
        meanwhile
            Tasks that come early: when the run hands them out, they are done, or under way.
        levels
            The merits' levels by their labels. Where the run settles on others, what was early is lost.

        Raises
        ------
        RunError
            If a process dies.
        """
        from concurrent.futures import FIRST_COMPLETED, wait

        self._keep_early(levels)
        asked = self.submit(work)
        waiting = islice((task for task in meanwhile if task not in self._early), MOST_EARLY * self.number)
        while not asked.done():
            room = TASKS_IN_FLIGHT * (self.number - 1) - len(self._under_way())
            for task in islice(waiting, max(room, 0)):
                self._early[task] = submitted(lambda task: self._submit_task(task, levels), task)
            wait((asked, *self._under_way()), return_when=FIRST_COMPLETED)
        return result(asked)

    def _under_way(self) -> list[Future[Any]]:
        return [future for future in self._early.values() if not future.done()]

    def _keep_early(self, levels: Mapping[str, str]) -> None:
        """Keep what was early if it was done at these levels."""
        if levels != self._early_levels:
            for future in self._early.values():
                future.cancel()
            self._early.clear()
        self._early_levels = levels

    def _submit_task(self, task: Task, levels: Mapping[str, str]) -> Future[Results]:
        from tolerancing.run.workers import work_local

        early = self._early.pop(task, None)
        return self.submit(work_local, task, levels) if early is None else early

    @contextmanager
    def performing(self, loaded: LoadedStudy) -> Iterator[Perform]:
        """Do tasks of the study, its merits' levels settled; they end at once when the run is broken off."""
        levels = loaded.study.levels
        self._keep_early(levels)

        def died(suspects: list[Task]) -> Batches:
            self.close()
            return _one_by_one(loaded, levels, suspects)

        def batches(tasks: Iterable[Task]) -> Batches:
            return in_flight(
                lambda task: self._submit_task(task, levels),
                tasks,
                lambda: self.number,
                died if self._by_code else None,
            )

        with self:
            yield batches


def _one_by_one(loaded: LoadedStudy, levels: Mapping[str, str], suspects: list[Task]) -> Batches:
    """Do tasks whose worker has died trial by trial, in one process: what ends that is that trial's failure.

    Raises
    ------
    RunError
        If none of them does, so that something else ended the worker.
    """
    from tolerancing.run.workers import start_local, work_local

    found = False
    with Processes(1, start_local, loaded) as alone:
        for task in (part for suspect in suspects for part in suspect.parts()):
            try:
                results = alone.submit(work_local, task, levels).result()
            except BrokenProcessPool:
                fault = f"{alone.end()} ended its process"
                results, found = result(alone.submit(work_local, task, levels, fault)), True
            yield [(task, results)]
    if not found:
        raise RunError(WORKER_DIED)


class EndedError(InputError):
    """A merit in Python ended the process that it was given."""


class Rehearsal(Processes):
    """Does what a run must know before it begins.

    One of several workers does it; merits in Python are tried in a process of its own.

    Parameters
    ----------
    loaded
        The study.
    here
        Whether this process does all of it.
    pool
        The workers.
    """

    def __init__(self, loaded: LoadedStudy, here: bool, pool: LocalPool) -> None:
        super().__init__(1, follow_parent)
        self._study, self._workers = loaded.study, pool
        self._files = ", ".join(sorted({m.file_name for m in loaded.study.all_merits if m.file_name}))
        self.here = here or not (self._files or pool.rehearses)

    def get_ready(self) -> None:
        """Make sure that all merits can score.

        Raises
        ------
        InputError
            If one cannot; :class:`EndedError` if it ends the process.
        """
        from tolerancing.study.evaluate import prepare_merits

        if self._files and not self.here:
            self._apart(partial(prepare_merits, self._study))
        else:
            prepare_merits(self._study)

    def do(self, work: Callable[[], Result], meanwhile: Iterable[Task], levels: Mapping[str, str]) -> Result:
        """What `work` returns; as of :meth:`LocalPool.do` where workers do it.

        Raises
        ------
        EndedError
            If a merit ends the process.
        """
        if self.here:
            return work()
        return self._apart(work) if self._files else self._workers.do(work, meanwhile, levels)

    def _apart(self, work: Callable[[], Result]) -> Result:
        try:
            return self.submit(work).result()
        except BrokenProcessPool as error:
            raise EndedError(
                f"{self._files}: {self.end()} ended the process that was to score the nominal lens; nothing "
                "was run: mend the merit"
            ) from error
