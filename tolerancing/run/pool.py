"""Processes of this machine that do a run's tasks; a user's code may end them, and not the run."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ParamSpec, Self, TypeVar

from lensdesign.errors import InputError
from tolerancing.run.executors import WORKER_DIED, Batches, Perform, RunError, in_flight, result
from tolerancing.run.tasks import Task
from tolerancing.run.threads import one_blas_thread

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.process import BaseProcess

    from tolerancing.study.files import LoadedStudy

Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")


class Processes:
    """Some processes, started when there is work, and started anew after one of them has died."""

    def __init__(self, number: int, start: Callable[..., None], *arguments: Any) -> None:
        self.number, self._start, self._arguments = number, start, arguments
        self._pool: ProcessPoolExecutor | None = None
        self._started: set[BaseProcess] = set()

    def submit(
        self, work: Callable[Arguments, Result], *arguments: Arguments.args, **named: Arguments.kwargs
    ) -> Future[Result]:
        """Hand out work."""
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import active_children, get_context

        others = set(active_children())
        if self._pool is None:
            one_blas_thread()
            self._started = set()
            self._pool = ProcessPoolExecutor(
                self.number, get_context("spawn"), initializer=self._start, initargs=self._arguments
            )
        with _not_heard():
            future = self._pool.submit(work, *arguments, **named)
        self._started |= set(active_children()) - others
        return future

    def end(self) -> str:
        """End the processes; what ended the first of them, which may have died by itself."""
        for process in self._started:
            process.terminate()
        self.close()
        return next((_end_of(process.exitcode or 0) for process in self._started), "nothing")

    def close(self) -> None:
        """Wait for the processes to end."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.end()


@contextmanager
def _not_heard() -> Iterator[None]:
    """Keep signals to stop, which go to the whole group, from processes that are started meanwhile.

    They would end with a traceback before they can leave them to the process that started them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_of(code: int) -> str:
    names = {-number.value: number.name for number in signal.Signals}
    return names.get(code, f"status {code}")


class LocalPool(Processes):
    """Processes of this machine for the tasks of a study, whose merits' levels may still be open."""

    def __init__(self, loaded: LoadedStudy, number: int) -> None:
        from tolerancing.run.workers import start_local

        super().__init__(number, start_local, loaded)
        self._by_code = any(merit.file_name for merit in loaded.study.all_merits)

    def get_ready(self) -> None:
        """Start them beside what goes on here; not with merits in Python, which are tried alone before."""
        from tolerancing.run.workers import get_warm

        if self.number > 1 and not self._by_code:
            for _ in range(self.number):
                self.submit(get_warm)

    @contextmanager
    def performing(self, loaded: LoadedStudy) -> Iterator[Perform]:
        """Do tasks of the study, its merits' levels settled; they end at once when the run is broken off."""
        from tolerancing.run.workers import work_local

        levels = {merit.label: merit.level for merit in loaded.study.all_merits}

        def died(suspects: list[Task]) -> Batches:
            self.close()
            return _one_by_one(loaded, levels, suspects)

        def batches(tasks: Iterable[Task]) -> Batches:
            return in_flight(
                lambda task: self.submit(work_local, task, levels),
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
    """Does what a run scores before it begins, merits in Python in a process of its own.

    Parameters
    ----------
    loaded
        The study.
    here
        Whether those are scored in this process too.
    """

    def __init__(self, loaded: LoadedStudy, here: bool) -> None:
        from tolerancing.run.workers import follow_parent

        super().__init__(1, follow_parent)
        self._files = ", ".join(sorted({m.file_name for m in loaded.study.all_merits if m.file_name}))
        self.here = here or not self._files

    def do(
        self, work: Callable[Arguments, Result], *arguments: Arguments.args, **named: Arguments.kwargs
    ) -> Result:
        """What `work` returns.

        Raises
        ------
        EndedError
            If a merit ends the process.
        """
        if self.here:
            return work(*arguments, **named)
        try:
            return self.submit(work, *arguments, **named).result()
        except BrokenProcessPool as error:
            raise EndedError(
                f"{self._files}: {self.end()} ended the process that was to score the nominal lens; nothing "
                "was run: mend the merit"
            ) from error
