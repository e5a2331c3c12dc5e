"""Registry of other programs' lens files by suffix."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
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
    """A lens file format of another program.

    Attributes
    ----------
    program
        Name of the program.
    reader, writer
        Names of the functions of :mod:`lensdesign.files` that read and write the format; the writer is None
        if the format is only read.
    """

    program: str
    reader: str
    writer: str | None = None


LENS_FORMATS = {
    ".zmx": LensFormat("Zemax", "read_zmx", "write_zmx"),
    ".seq": LensFormat("CODE V", "read_seq", "write_seq"),
    ".len": LensFormat("OSLO", "read_len"),
}

ARCHIVES = {
    ".zar": "an archive of Zemax OpticStudio; unpack it, and import the .zmx file in it",
    ".zos": "a binary file of Zemax OpticStudio; save it there as .zmx",
    ".zmf": "a binary catalogue of Zemax OpticStudio; save each lens there as .zmx",
}
"""Files of other programs that are not text, by suffix: what they are, and what to do."""

WRITTEN_LENS_FORMATS = {suffix: of for suffix, of in LENS_FORMATS.items() if of.writer is not None}
"""Formats that are also written."""


def read_lens_file(
    path: str | os.PathLike[str], supplement: Supplement | None = None, lossy: bool = False
) -> Imported:
    """Read a lens from another program's file; the suffix selects the format.

    Parameters
    ----------
    path
        A file that ends in ``.zmx`` (Zemax OpticStudio), ``.seq`` (CODE V) or ``.len`` (OSLO).
    supplement
        Values that a design needs and the file lacks (default: none).
    lossy
        Whether to import a file that a design can represent only in part (default: False).

    Returns
    -------
    Imported
        The lens, its pose, and the lists of losses and remarks.

    Raises
    ------
    LossyImportError
        If a design cannot represent the whole file and `lossy` is False.
    InputError
        If no format has the suffix, the file cannot be read, or it does not describe a lens.
    MaterialError
        If a glass is unknown.
    """
    of = _format_of(path, "read", LENS_FORMATS)
    if supplement is not None and supplement.configuration is not None and of.program != "Zemax":
        raise InputError(f"configuration = {supplement.configuration}: only a .zmx file has several")
    found: Imported = getattr(files, of.reader)(path, supplement, lossy)
    return found


def write_lens_file(
    lens: Lens, path: str | os.PathLike[str], *, warn: Callable[[str], None] = warnings.warn
) -> None:
    """Write a lens to another program's file; the suffix selects the format.

    Parameters
    ----------
    lens
        The lens.
    path
        File to write: ``.zmx`` (Zemax OpticStudio) or ``.seq`` (CODE V).
    warn
        Called with one sentence for each surface whose coating or roughness is omitted (default: a Python
        warning).

    Raises
    ------
    InputError
        If no format has the suffix, the format cannot represent the lens, or the file cannot be written.
    MaterialError
        If a glass is unknown.
    """
    writer = _format_of(path, "write", WRITTEN_LENS_FORMATS).writer
    assert writer is not None
    getattr(files, writer)(lens, path, warn=warn)


def _format_of(path: str | os.PathLike[str], verb: str, formats: Mapping[str, LensFormat]) -> LensFormat:
    suffix = Path(path).suffix.lower()
    if suffix in ARCHIVES and formats is not WRITTEN_LENS_FORMATS:
        raise InputError(f"cannot {verb} {path}: {ARCHIVES[suffix]}")
    if suffix not in formats:
        raise InputError(f"cannot {verb} {path}: the name must end in {' or '.join(formats)}")
    return formats[suffix]
