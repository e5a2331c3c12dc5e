"""Registry of other programs' lens files by suffix."""

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
    """A lens file format of another program.

    Attributes
    ----------
    program
        Name of the program.
    reader, writer
        Names of the functions of :mod:`lensdesign.files` that read and write the format.
    """

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
    """Read a lens from another program's file; the suffix selects the format.

    Parameters
    ----------
    path
        A file that ends in ``.zmx`` (Zemax OpticStudio) or ``.seq`` (CODE V).
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
    of = _format_of(path, "read")
    if supplement is not None and supplement.configuration is not None and of.program != "Zemax":
        raise InputError(f"configuration = {supplement.configuration}: only a .zmx file has several")
    found: Imported = getattr(files, of.reader)(path, supplement, lossy)
    return found


def write_lens_file(lens: Lens, path: str | os.PathLike[str]) -> None:
    """Write a lens to another program's file; the suffix selects the format.

    Parameters
    ----------
    lens
        The lens.
    path
        File to write: ``.zmx`` (Zemax OpticStudio) or ``.seq`` (CODE V).

    Raises
    ------
    InputError
        If no format has the suffix, the format cannot represent the lens, or the file cannot be written.
    MaterialError
        If a glass is unknown.
    """
    getattr(files, _format_of(path, "write").writer)(lens, path)


def _format_of(path: str | os.PathLike[str], verb: str) -> LensFormat:
    suffix = Path(path).suffix.lower()
    if suffix not in LENS_FORMATS:
        raise InputError(f"cannot {verb} {path}: the name must end in {' or '.join(LENS_FORMATS)}")
    return LENS_FORMATS[suffix]
