"""Other programs' lens files, by the suffix of their names: the one place that names them all."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lensdesign import files
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from lensdesign.files.draft import Imported, Supplement
    from lensdesign.lens.lens import Lens


@dataclass(frozen=True)
class LensFormat:
    """A format of lens files: whose it is, and what of `lensdesign.files` reads and writes it."""

    program: str
    reader: str
    writer: str


LENS_FORMATS = {
    ".zmx": LensFormat("Zemax", "read_zmx", "write_zmx"),
    ".seq": LensFormat("CODE V", "read_seq", "write_seq"),
}


def read_lens_file(
    path: str | os.PathLike[str], supplement: Supplement | None = None, lossy: bool = False
) -> Imported:
    """Read a lens from another program's file, by its suffix; parameters and errors are those of the readers.

    Raises
    ------
    InputError
        Also if no format has the suffix.
    """
    found: Imported = getattr(files, _format_of(path, "read").reader)(path, supplement, lossy)
    return found


def write_lens_file(lens: Lens, path: str | os.PathLike[str]) -> None:
    """Write a lens to another program's file, by its suffix; errors are those of the writers.

    Raises
    ------
    InputError
        Also if no format has the suffix.
    """
    getattr(files, _format_of(path, "write").writer)(lens, path)


def _format_of(path: str | os.PathLike[str], verb: str) -> LensFormat:
    suffix = Path(path).suffix.lower()
    if suffix not in LENS_FORMATS:
        raise InputError(f"cannot {verb} {path}: the name must end in {' or '.join(LENS_FORMATS)}")
    return LENS_FORMATS[suffix]
