"""STEP files (ISO 10303-21, application protocol 214) of named solids, by OCP: written, and read back."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError

NO_OCP = "STEP files need OCP, release 8 or later: pip install 'transferlens[cad]'"

STEP_SUFFIXES = (".step", ".stp")

TIME_STAMP = "1970-01-01T00:00:00"
"""Always the same, so that the same lens gives the same file."""

TEXT = re.compile(r"'[^']*'")
NOT_PLAIN = re.compile(r"[^ -\[\]-~]|'(?= *[),])")
USE_OF_PART = re.compile(r"^(#\d+ = NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+(?=')", re.MULTILINE)


def require_ocp() -> None:
    """Refuse to go on where OCP is missing or too old.

    Raises
    ------
    InputError
        Saying what to install.
    """
    from importlib import import_module

    try:
        for name in ("OCP", "OCP.collections", "OCP.STEPCAFControl"):
            import_module(name)
    except ImportError as error:
        raise InputError(f"{NO_OCP} ({error})") from error


def step_text(text: str) -> str:
    r"""A text in the alphabet of ISO 10303-21: all but plain ASCII as \X2\ and \X4\ directives.

    A backslash is written that way too, since OCP takes some for directives. Apostrophes it doubles itself,
    but readers built on it take one before a bracket or a comma for the end of the text. A NUL, which ends a
    text for many readers, becomes U+FFFD.
    """
    return NOT_PLAIN.sub(lambda match: _directive(ord(match[0]) or 0xFFFD), text)


def _directive(code: int) -> str:
    return f"\\X2\\{code:04X}\\X0\\" if code < 0x10000 else f"\\X4\\{code:08X}\\X0\\"


@contextmanager
def silent_ocp() -> Iterator[None]:
    """Keep OCP's statistics off the terminal meanwhile."""
    from OCP.Message import Message

    messenger = Message.DefaultMessenger_s()
    printers = list(messenger.Printers())
    for printer in printers:
        messenger.RemovePrinter(printer)
    try:
        yield
    finally:
        for printer in printers:
            messenger.AddPrinter(printer)


@contextmanager
def ocp_errors(subject: str) -> Iterator[None]:
    """Turn what OCP raises into an InputError; its kinds of errors have no base of their own.

    Errors of ours come out with the subject before them.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{subject}: {error}") from error
    except Exception as error:
        if not type(error).__module__.startswith("OCP."):
            raise
        raise InputError(f"{subject}: OCP gives up: {error}") from error


def write_solids(
    solids: Sequence[Any], names: Sequence[str], title: str, path: Path, statement: str = ""
) -> None:
    """Write named solids in mm: one as a part, several as an assembly under the title.

    Parameters
    ----------
    solids
        Shapes of OCP, in mm.
    names
        Of the products, one for each solid.
    title
        Goes into the header.
    path
        File to write.
    statement
        Goes into the description of the header.

    Raises
    ------
    InputError
        If OCP cannot write the file, or its name is not UTF-8.
    """
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.Interface import Interface_Static
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.STEPControl import STEPControl_StepModelType

    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise InputError("OCP takes names of files in UTF-8 alone") from error
    writer = STEPCAFControl_Writer()
    # The program that called may have set others; they hold for the whole process.
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    Interface_Static.SetCVal_s("write.step.schema", "AP214IS")
    document = _document(title, solids, names)
    written = writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
    _write_header(writer.ChangeWriter().Model(), title, statement)
    if not written or writer.Write(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise InputError("OCP could not write the solids")
    path.write_text(_tidied(path.read_text(encoding="ascii")), encoding="ascii")


def _write_header(model: Any, title: str, statement: str) -> None:
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.TCollection import TCollection_HAsciiString

    header = APIHeaderSection_MakeHeader(model)
    header.SetName(TCollection_HAsciiString(step_text(title)))
    header.SetTimeStamp(TCollection_HAsciiString(TIME_STAMP))
    description = "glass of a lens, lengths in mm" + (f"; {statement}" if statement else "")
    header.SetDescriptionValue(1, TCollection_HAsciiString(step_text(description)))
    header.SetAuthorValue(1, TCollection_HAsciiString(""))
    header.SetOrganizationValue(1, TCollection_HAsciiString(""))
    header.SetOriginatingSystem(TCollection_HAsciiString("transferlens"))
    header.SetAuthorisation(TCollection_HAsciiString(""))


def _tidied(text: str) -> str:
    """A file without what other readers may trip over, and without traces of what was written before it.

    OCP breaks long texts into lines, even within a directive, and numbers the uses of parts on and on for as
    long as the process lives.
    """
    text = TEXT.sub(lambda match: match[0].replace("\n", ""), text)
    number = count(1)
    return USE_OF_PART.sub(lambda match: f"{match[1]}{next(number)}", text)


def _document(title: str, solids: Sequence[Any], names: Sequence[str]) -> Any:
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.TopLoc import TopLoc_Location
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    def name_it(label: Any, name: str) -> None:
        TDataStd_Name.Set_s(label, TCollection_ExtendedString(step_text(name)))

    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    parts = [tool.AddShape(solid, False) for solid in solids]
    for part, name in zip(parts, names, strict=True):
        name_it(part, name)
    if len(parts) > 1:
        assembly = tool.NewShape()
        name_it(assembly, title or "lens")
        for part, name in zip(parts, names, strict=True):
            name_it(tool.AddComponent(assembly, part, TopLoc_Location()), name)
        tool.UpdateAssemblies()
    return document


def read_solids(path: Path) -> list[Any]:
    """Solids of a STEP file, in its order, in mm.

    Raises
    ------
    InputError
        If OCP cannot read the file, or its unit of length is not mm.
    """
    from OCP.collections import Sequence_TCollection_AsciiString
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_ShapeEnum

    reader = STEPControl_Reader()
    if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise InputError("OCP could not read the file back")
    lengths, angles, solid_angles = (Sequence_TCollection_AsciiString() for _ in range(3))
    reader.FileUnits(lengths, angles, solid_angles)
    units = {lengths.Value(i).ToCString() for i in range(1, lengths.Length() + 1)}
    if units != {"millimetre"}:
        raise InputError(f"the file's unit of length is {', '.join(sorted(units)) or 'missing'}, not mm")
    reader.SetSystemLengthUnit(1.0)
    reader.TransferRoots()
    return parts_of(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_SOLID)


def parts_of(shape: Any, kind: Any) -> list[Any]:
    """All parts of one kind (of TopAbs_ShapeEnum) in a shape."""
    from OCP.TopExp import TopExp_Explorer

    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found
