"""What the toolkit raises, and the one way in which it writes files."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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


def refuse_not_positive(name: str, value: float) -> None:
    """Raise InputError unless a value is finite and above 0."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} = {value!r}: must be finite and above 0")


def refuse_not_whole(name: str, value: int, least: int) -> None:
    """Raise InputError unless a value is a whole number that is large enough."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise InputError(f"{name} = {value!r}: must be a whole number from {least}")


def refuse_other(name: str, value: str, allowed: Sequence[str]) -> None:
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
        temporary.unlink(missing_ok=True)
        UNFINISHED.discard(temporary)


def _temporary_for(target: Path) -> tuple[Path, Path]:
    """An empty file beside the one that is to be written, and that one without symbolic links."""
    try:
        if target.is_dir():
            raise InputError(f"cannot write {target}: it is a folder; give a file name")
        if target.exists() and not target.is_file():
            raise InputError(f"cannot write {target}: it is no regular file, and would be lost")
        place = Path(os.path.realpath(target))
        if place.is_symlink():
            raise InputError(f"cannot write {target}: a symbolic link that leads back to itself")
        place.parent.mkdir(parents=True, exist_ok=True)
        # The start of the name will do: with all of a long one, the temporary name would be too long.
        temporary = place.parent / f".{place.stem[:32]}.{os.urandom(4).hex()}{place.suffix}"
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


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
