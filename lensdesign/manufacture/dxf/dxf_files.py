"""DXF documents in mm (AutoCAD 2010, UTF-8), written and read by ezdxf (imported inside functions)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from lensdesign.errors import InputError

if TYPE_CHECKING:
    from ezdxf.document import Drawing as Document

CENTRE_LINE = "CENTER"
"""Name of the line type of an axis."""


def new_document(properties: dict[str, str], centre_line_mm: tuple[float, ...]) -> Document:
    """Return an empty document in mm with a line type for axes.

    Parameters
    ----------
    properties
        Texts of the file's properties by name.
    centre_line_mm
        Dash pattern of the line type in mm: dash, gap, dash, gap.
    """
    import ezdxf
    from ezdxf import units

    with _constant_metadata():
        document = ezdxf.new("R2010", units=units.MM)
    for name, text in properties.items():
        document.header.custom_vars.append(name, text)
    signed = [length * (-1.0) ** i for i, length in enumerate(centre_line_mm)]
    document.linetypes.add(CENTRE_LINE, [sum(centre_line_mm), *signed], description="axis")
    return document


def save_document(document: Document, path: Path) -> None:
    """Write a document; the same content yields identical bytes."""
    with _constant_metadata():
        document.saveas(path)


@contextmanager
def _constant_metadata() -> Iterator[None]:
    """Give documents constant time stamps and identifiers: the same drawing yields identical files."""
    import ezdxf

    before = ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True
    try:
        yield
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = before


def read_document(path: Path) -> Document:
    """Return the document of a DXF file in mm.

    Raises
    ------
    InputError
        If ezdxf cannot read the file, or its unit of length is not mm.
    """
    import ezdxf
    from ezdxf import units

    try:
        document = ezdxf.readfile(path)
    except ezdxf.DXFError as error:
        raise InputError(f"ezdxf could not read the file back: {error}") from error
    if document.units != units.MM:
        raise InputError(f"the file's unit of length has the code {document.units}, not {units.MM} (mm)")
    return document
