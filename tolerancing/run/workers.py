"""Functions that run in the worker processes of a run, on this machine or in a cluster."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from lensdesign.common.clusters import check_same_version, worker_name
from lensdesign.common.processes import follow_parent
from lensdesign.errors import InputError
from tolerancing.run.tasks import Task, perform

if TYPE_CHECKING:
    from tolerancing.merits.context import Context
    from tolerancing.study.files import LoadedStudy
    from tolerancing.study.results import Results
    from tolerancing.study.study import Study

_local: tuple[Context, Study] | None = None


def start_local(loaded: LoadedStudy) -> None:
    """Prepare a process of a local pool for a study."""
    from tolerancing.study.evaluate import context_of

    follow_parent()
    global _local
    _local = (context_of(loaded.lens, loaded.study), loaded.study)


def work_local(task: Task, levels: Mapping[str, str], failure: str = "") -> Results:
    """Perform a task in a process of a local pool.

    With a `failure`, merits in Python are not called; this message is the reason why they failed.
    """
    assert _local is not None  # start_local has run in this process.
    context, study = _local[0], _local[1].with_levels(levels)
    if failure:
        merits = tuple(merit.without_user_code(failure) for merit in study.all_merits)
        study = study.model_copy(update={"all_merits": merits})
    return perform(context, study, task)


@dataclass(frozen=True)
class StudyParcel:
    """A study as it is sent to a cluster, whose machines may not have its files.

    Attributes
    ----------
    toolkit_version
        Version of the toolkit that sends it.
    name, files, fingerprint
        Name, files and fingerprint of the :class:`tolerancing.study.files.LoadedStudy`.
    levels
        Level of each merit, by the merit's label.
    trust
        Whether the sender consents to the execution of its Python merits.
    """

    toolkit_version: str
    name: str
    files: Mapping[str, bytes]
    fingerprint: str
    levels: Mapping[str, str]
    trust: bool


_unpacked: dict[str, tuple[LoadedStudy, TemporaryDirectory[str]]] = {}
_unpacking = threading.Lock()
_by_thread = threading.local()


def work_in_cluster(parcel: StudyParcel, task: Task) -> Results:
    """Perform a task in a worker of a cluster.

    Raises
    ------
    InputError
        If the worker's toolkit has another version, or reads other refractive indices from the same files.
    """
    key = f"{parcel.fingerprint} {sorted(parcel.levels.items())}"
    # A context caches results, so each thread of a worker has its own.
    contexts: dict[str, tuple[Context, Study]] = _by_thread.__dict__
    if key not in contexts:
        from tolerancing.study.evaluate import context_of

        with _unpacking:
            loaded = _unpack(parcel, key)
        contexts[key] = (context_of(loaded.lens, loaded.study), loaded.study)
    context, study = contexts[key]
    return perform(context, study, task)


def _unpack(parcel: StudyParcel, key: str) -> LoadedStudy:
    """Return the study, with its files in a temporary folder of this process."""
    if key not in _unpacked:
        from threadpoolctl import threadpool_limits

        from tolerancing.study.files import load_from_files

        check_same_version(parcel.toolkit_version)
        threadpool_limits(limits=1, user_api="blas")
        folder = TemporaryDirectory(prefix="tolerancing-")
        loaded = load_from_files(parcel.name, parcel.files, Path(folder.name), trust=parcel.trust)
        if loaded.fingerprint != parcel.fingerprint:
            folder.cleanup()
            raise InputError(
                f"{worker_name()}: its glass data give other refractive indices than those of the sender. "
                "Install the same glass catalogues on both"
            )
        _unpacked[key] = (replace(loaded, study=loaded.study.with_levels(parcel.levels)), folder)
    return _unpacked[key][0]
