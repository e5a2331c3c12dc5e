"""What runs in the worker processes of a run, on this machine or in a cluster."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from lensdesign.common.clusters import check_same_version, worker_name
from lensdesign.errors import InputError
from tolerancing.run.processes import follow_parent
from tolerancing.run.tasks import Task, perform

if TYPE_CHECKING:
    from tolerancing.merits.context import Context
    from tolerancing.study.files import LoadedStudy
    from tolerancing.study.results import Results
    from tolerancing.study.study import Study

_own: tuple[Context, Study] | None = None


def start_local(loaded: LoadedStudy) -> None:
    """Get a process of a local pool ready."""
    from tolerancing.study.evaluate import context_of

    follow_parent()
    global _own
    _own = (context_of(loaded.lens, loaded.study), loaded.study)


def work_local(task: Task, levels: Mapping[str, str], fault: str = "") -> Results:
    """Do a task in a process of a local pool; with a fault, that is what merits in Python come to."""
    assert _own is not None  # the initializer saw to it
    context, study = _own[0], _own[1].with_levels(levels)
    if fault:
        merits = tuple(merit.refused(fault) for merit in study.all_merits)
        study = study.model_copy(update={"all_merits": merits})
    return perform(context, study, task)


@dataclass(frozen=True)
class StudyParcel:
    """A study as it travels to a cluster, whose machines need not have its files.

    Attributes
    ----------
    toolkit_version
        Of the toolkit that sent it.
    name, files, fingerprint
        Of the :class:`LoadedStudy`.
    levels
        The merits' levels by their labels.
    """

    toolkit_version: str
    name: str
    files: Mapping[str, bytes]
    fingerprint: str
    levels: Mapping[str, str]


_unpacked: dict[str, tuple[LoadedStudy, TemporaryDirectory[str]]] = {}
_unpacking = threading.Lock()
_by_thread = threading.local()


def work_in_cluster(parcel: StudyParcel, task: Task) -> Results:
    """Do a task in a worker of a cluster.

    Raises
    ------
    InputError
        If the worker's toolkit is of another version, or reads other numbers from the same files.
    """
    key = f"{parcel.fingerprint} {sorted(parcel.levels.items())}"
    # Threads of one worker may not share what a context keeps.
    contexts: dict[str, tuple[Context, Study]] = _by_thread.__dict__
    if key not in contexts:
        from tolerancing.study.evaluate import context_of

        with _unpacking:
            loaded = _unpack(parcel, key)
        contexts[key] = (context_of(loaded.lens, loaded.study), loaded.study)
    context, study = contexts[key]
    return perform(context, study, task)


def _unpack(parcel: StudyParcel, key: str) -> LoadedStudy:
    """The study, its files in a folder of this process."""
    if key not in _unpacked:
        from threadpoolctl import threadpool_limits

        from tolerancing.study.files import load_from_files

        check_same_version(parcel.toolkit_version)
        threadpool_limits(limits=1, user_api="blas")
        folder = TemporaryDirectory(prefix="tolerancing-")
        loaded = load_from_files(parcel.name, parcel.files, Path(folder.name))
        if loaded.fingerprint != parcel.fingerprint:
            folder.cleanup()
            raise InputError(f"{worker_name()}: its glass data give other refractive indices than those here")
        _unpacked[key] = (replace(loaded, study=loaded.study.with_levels(parcel.levels)), folder)
    return _unpacked[key][0]
