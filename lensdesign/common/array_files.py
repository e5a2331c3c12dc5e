"""Readers of NumPy's files (.npy, .npz) that check the size of every array before they unpack it.

A packed file of a few megabytes can contain arrays of many gigabytes, and a header can declare more values
than follow it. Both are refused by the declared sizes.
"""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.input_files import check_input
from lensdesign.common.memory import check_memory
from lensdesign.errors import InputError

FIELD_BYTES = 3_200_000_000
"""Largest size of a field's arrays: 400 million complex values in single precision, the limit of grids."""


def read_arrays(
    path: str | os.PathLike[str],
    most_bytes: float = FIELD_BYTES,
    *,
    named: str = "",
    only: Collection[str] | None = None,
    copies: float = 3,
) -> dict[str, NDArray[Any]]:
    """Read the arrays of an .npz file, or the array of an .npy file, up to a size.

    Parameters
    ----------
    path
        The file. Its type is determined from its content, not from its name.
    most_bytes
        Largest total size of the unpacked arrays in bytes.
    named
        Description of the file in messages, before its path, such as "the field".
    only
        Names of the arrays to read (default: all).
    copies
        Memory that must be free, in multiples of the size of the arrays (default: 3, since packed, unpacked
        and converted arrays exist at the same time).

    Returns
    -------
    dict of str to ndarray
        Arrays by name. The array of an .npy file has the name ``"values"``.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, contains Python objects, or declares arrays that are larger
        than `most_bytes` or than the free memory.
    """
    path = Path(path)
    check_input(path, named=named)
    with _reported(path, named):
        if not zipfile.is_zipfile(path):
            with path.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                _check_array(file, size, most_bytes, copies)
                file.seek(0)
                return {"values": np.lib.format.read_array(file, allow_pickle=False)}
        with zipfile.ZipFile(path) as archive:
            members = _members(archive, only)
            unpacked = sum(member.file_size for member in members.values())
            _check_size(unpacked, most_bytes, copies)
            found = {}
            for name, member in members.items():
                with archive.open(member) as head:
                    _check_array(head, member.file_size, most_bytes, copies)
                with archive.open(member) as whole:
                    found[name] = np.lib.format.read_array(whole, allow_pickle=False)
            return found


def array_names(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the names of the arrays of an .npz file.

    Raises
    ------
    InputError
        If the file cannot be read or is not an .npz file.
    """
    path = Path(path)
    check_input(path)
    with _reported(path, ""), zipfile.ZipFile(path) as archive:
        return tuple(_members(archive, None))


def _members(archive: zipfile.ZipFile, only: Collection[str] | None) -> dict[str, zipfile.ZipInfo]:
    entries = archive.infolist()
    most_members = 1000
    if len(entries) > most_members:
        raise InputError(f"holds {len(entries)} entries; at most {most_members} are allowed")
    found = {entry.filename.removesuffix(".npy"): entry for entry in entries}
    if len(found) < len(entries):
        raise InputError("holds two arrays of one name")
    return {name: entry for name, entry in found.items() if only is None or name in only}


def _check_array(file: IO[bytes], size: int, most_bytes: float, copies: float) -> None:
    """Refuse an array whose header declares more bytes than the file has."""
    version = np.lib.format.read_magic(file)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise InputError(f"holds an array in version {version[0]}.{version[1]} of NumPy's format: not known")
    shape, _, kind = readers[version](file)
    if kind.hasobject:
        raise InputError("holds objects of Python, and not numbers; save numeric arrays only")
    declared = math.prod(shape) * kind.itemsize
    _check_size(declared, most_bytes, copies)
    if declared > size:
        raise InputError(f"is damaged: an array of {declared} bytes is declared, in {size} bytes")


def _check_size(declared: int, most_bytes: float, copies: float) -> None:
    if declared > most_bytes:
        raise InputError(f"unpacks to {1e-9 * declared:.3g} GB; at most {1e-9 * most_bytes:.3g} GB are read")
    check_memory(copies * declared, f"unpacking {1e-9 * declared:.3g} GB", "use a machine with more memory")


@contextmanager
def _reported(path: Path, named: str) -> Iterator[None]:
    """Add the name of the file to all errors."""
    prefix = f"cannot read {named} {path}".replace("  ", " ")
    try:
        yield
    except InputError as error:
        raise InputError(f"{prefix}: {error}") from error
    except (Exception, MemoryError) as error:  # damaged files raise errors of many kinds
        reason = getattr(error, "strerror", None) or str(error)[:200] or type(error).__name__
        raise InputError(f"{prefix}: {reason}") from error
