"""Tasks done by the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from lensdesign.common.clusters import RETRIES, cluster_client, thread_counter, toolkit_version
from tolerancing.run.executors import Batches, Perform, in_flight
from tolerancing.run.tasks import Task

if TYPE_CHECKING:
    from tolerancing.study.files import LoadedStudy


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
        As of :func:`lensdesign.common.clusters.cluster_client`.
    """
    from tolerancing.run.workers import StudyParcel, deliver, work_in_cluster

    with cluster_client(address) as client:
        parcel = StudyParcel(toolkit_version(), loaded.name, dict(loaded.files), loaded.fingerprint, levels)
        # A task's result, unlike scattered data, is made again when the workers that hold it die.
        sent = client.submit(deliver, parcel, pure=False)
        executor = client.get_executor(retries=RETRIES, pure=False)
        workers = thread_counter(client)

        def batches(tasks: Iterable[Task]) -> Batches:
            return in_flight(lambda task: executor.submit(work_in_cluster, sent, task), tasks, workers)

        try:
            yield batches
        finally:
            executor.shutdown(wait=False)
