"""Permission to execute Python code from a store: the user grants it, or has an own copy of the file."""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from pathlib import Path, PurePosixPath

from lensdesign.common.input_files import read_input
from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.study.files import LoadedStudy, relative


def restrict_python(loaded: LoadedStudy, store: Path) -> LoadedStudy:
    """Return a study whose Python merits refuse to score unless the user has an own copy of their file.

    Parameters
    ----------
    loaded
        Study from the files of the store.
    store
        Path of the store. An own copy of a file lies in the same folder, has the same name and the same
        bytes, and belongs to the present user.
    """
    merits = tuple(_restrict(merit, loaded, store) for merit in loaded.study.all_merits)
    return replace(loaded, study=loaded.study.model_copy(update={"all_merits": merits}))


def _restrict(merit: Merit, loaded: LoadedStudy, store: Path) -> Merit:
    if merit.file_name is None:
        return merit
    content = loaded.files[relative(PurePosixPath(loaded.name).parent / merit.file_name)]
    copy = store.parent / PurePosixPath(merit.file_name).name
    if _is_own(copy) and _has_content(copy, content):
        return merit
    digest = hashlib.sha256(content).hexdigest()
    return merit.without_user_code(
        f"{store}: scoring again would run {merit.file_name}, Python code in the store (SHA-256 {digest}) "
        f"that would have all your rights; tolerancing report shows the code without running it. If you "
        f"trust it: --trust (in Python, open_store(..., trust=True)), or put your own copy of it at {copy}"
    )


def _is_own(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_uid == os.geteuid()
    except OSError:
        return False


def _has_content(path: Path, content: bytes) -> bool:
    try:
        return read_input(path, len(content)) == content
    except InputError:
        return False
