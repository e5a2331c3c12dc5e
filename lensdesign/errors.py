"""What the toolkit raises, and the one way in which it writes files."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from numbers import Integral
from pathlib import Path


class TransferLensError(Exception):
    """Base of everything that the toolkit raises on purpose."""


class InputError(TransferLensError, ValueError):
    """Bad input: the message names what, where, which value, and what is allowed.

    Commands print the message and exit with status 2.
    """


class DesignError(InputError):
    """A design or specification that cannot be a lens."""


class MaterialError(InputError):
    """An unknown material, or a wavelength outside the range for which it is known."""


class SamplingError(InputError):
    """A grid that cannot hold what was asked of it."""


UNFINISHED: set[Path] = set()
"""Temporary files and folders that are being written; a process that ends at once removes them."""


MARK = r"(?P<process>[0-9]{1,10})-[0-9a-f]{8}"
"""What :func:`new_mark` gives, as a regular expression."""

ABANDONED_SECONDS = 6 * 3600.0
"""Age at which a temporary file is taken to be abandoned, though a process has the number in its name."""


def validate_positive(name: str, value: float) -> None:
    """Raise InputError unless a value is finite and above 0."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} = {value!r}: must be finite and above 0")


def validate_whole_number(name: str, value: int, least: int) -> None:
    """Raise InputError unless a value is a whole number that is large enough."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise InputError(f"{name} = {value!r}: must be a whole number from {least}")


def validate_choice(name: str, value: str, allowed: Sequence[str]) -> None:
    """Raise InputError unless a value is one of those that are allowed."""
    if value not in allowed:
        raise InputError(f"{name} = {value!r}: allowed: {', '.join(allowed)}")


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path` to write to, and rename it into place at the end.

    A failure while writing leaves whatever stood at `path` as it was. A symbolic link stays one: what it
    points to is replaced.

    Parameters
    ----------
    path
        Where the finished file is to stand. Its folder is made if needed.

    Yields
    ------
    Path
        A temporary path in the same folder, with the same suffix.

    Raises
    ------
    InputError
        If the folder or the file cannot be written.
    """
    temporary, place = _temporary_for(Path(path))
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, place)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # of a disk that has become read-only; what went wrong first is reported
            temporary.unlink(missing_ok=True)
        UNFINISHED.discard(temporary)


def writable_place(target: Path) -> Path:
    """The place of a file to write, without symbolic links.

    Raises
    ------
    InputError
        If a folder or another thing that is no regular file stands there, or links lead back to themselves.
    OSError, ValueError
        What the system says of the name.
    """
    if target.is_dir():
        raise InputError(f"cannot write {target}: it is a folder; give a file name")
    if target.exists() and not target.is_file():
        raise InputError(f"cannot write {target}: it is no regular file, and would be lost")
    place = Path(os.path.realpath(target))
    if place.is_symlink():
        raise InputError(f"cannot write {target}: a symbolic link that leads back to itself")
    return place


def _temporary_for(target: Path) -> tuple[Path, Path]:
    """An empty file beside the one that is to be written, and that one without symbolic links."""
    try:
        place = writable_place(target)
        place.parent.mkdir(parents=True, exist_ok=True)
        # The start of the name will do: with all of a long one, the temporary name would be too long.
        start, end = f".{place.stem[:32]}.", place.suffix
        _remove_abandoned(place.parent, start, end)
        temporary = place.parent / f"{start}{new_mark()}{end}"
        UNFINISHED.add(temporary)
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(f"cannot write {target}: a file stands where a folder is needed") from error
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror or error}") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"cannot write {str(target)!r}: {error}") from error  # a NUL character in the name
    return temporary, place


def new_mark() -> str:
    """A new part of the name of a temporary file or folder: the process that writes it, and random digits."""
    return f"{os.getpid()}-{os.urandom(4).hex()}"


def is_abandoned(path: Path, process: str | None) -> bool:
    """Whether nobody writes a temporary file or folder any more, since its process was killed.

    Parameters
    ----------
    path
        The file or folder.
    process
        Number of the process, from its name; None where the name has none.
    """
    if path in UNFINISHED:
        return False
    if process is None:
        return True
    age_seconds = time.time() - path.stat().st_mtime
    if int(process) == os.getpid():  # in containers that share a folder, processes share numbers
        return age_seconds > 60.0
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # of another user
        pass
    # Numbers of processes are used again.
    return age_seconds > ABANDONED_SECONDS


def _remove_abandoned(folder: Path, start: str, end: str) -> None:
    """Remove temporary files of one name that killed processes left."""
    name = re.compile(rf"{re.escape(start)}{MARK}{re.escape(end)}")
    with suppress(OSError):
        for path in folder.iterdir():
            found = name.fullmatch(path.name)
            if found and path.is_file() and is_abandoned(path, found["process"]):
                path.unlink()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
