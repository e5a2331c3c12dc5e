"""Whether Python that a store holds may be run: only if its user says so, or has the same file already."""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from pathlib import Path, PurePosixPath

from lensdesign.common.input_files import read_input
from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.study.files import LoadedStudy, relative


def without_leave(loaded: LoadedStudy, store: Path) -> LoadedStudy:
    """A store's study whose merits in Python refuse to score, unless a copy of one's own vouches for them.

    Parameters
    ----------
    loaded
        The study, from the files that the store holds.
    store
        The store. A copy lies in its folder, under the same name and with the same bytes, and belongs to
        whoever runs this.
    """
    merits = tuple(_without_leave(merit, loaded, store) for merit in loaded.study.all_merits)
    return replace(loaded, study=loaded.study.model_copy(update={"all_merits": merits}))


def _without_leave(merit: Merit, loaded: LoadedStudy, store: Path) -> Merit:
    if merit.file_name is None:
        return merit
    held = loaded.files[relative(PurePosixPath(loaded.name).parent / merit.file_name)]
    copy = store.parent / PurePosixPath(merit.file_name).name
    if _is_own(copy) and _has(copy, held):
        return merit
    digest = hashlib.sha256(held).hexdigest()
    return merit.without_user_code(
        f"{store}: scoring again would run {merit.file_name}, Python that the store holds (SHA-256 "
        f"{digest}), and that may do whatever you may; tolerancing report shows it without running it. If "
        f"you trust it: --trust (in Python, open_store(..., trust=True)), or your own copy of it as {copy}"
    )


def _is_own(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_uid == os.geteuid()
    except OSError:
        return False


def _has(path: Path, content: bytes) -> bool:
    try:
        return read_input(path, len(content)) == content
    except InputError:
        return False
