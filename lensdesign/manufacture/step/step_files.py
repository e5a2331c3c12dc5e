"""Writing and reading of STEP files (ISO 10303-21) of named solids by OCP.

Solids alone have the application protocol 214, solids with semantic tolerances 242.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError
from lensdesign.manufacture.step.semantic_tolerances import (
    SemanticTolerances,
    add_tolerances,
    read_tolerances,
)
from lensdesign.manufacture.step.solids import subshapes

STEP_SUFFIXES = (".step", ".stp")

_QUOTED_TEXT = re.compile(r"'[^']*'")
_ESCAPED = re.compile(r"[^ -\[\]-~]|'(?= *[),])")
_COMPONENT_USE = re.compile(r"^(#\d+ = NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+(?=')", re.MULTILINE)


def require_ocp() -> None:
    """Check that OCP is installed.

    Raises
    ------
    InputError
        If OCP is missing or too old. The message names the package to install.
    """
    from importlib import import_module

    try:
        for name in ("OCP", "OCP.collections", "OCP.STEPCAFControl"):
            import_module(name)
    except ImportError as error:
        raise InputError(
            f"STEP files need OCP, release 8 or later: pip install 'transferlens[cad]' ({error})"
        ) from error


def step_text(text: str) -> str:
    r"""Return a text in the alphabet of ISO 10303-21, with other characters as \X2\ and \X4\ directives.

    A backslash is escaped, too, because OCP interprets some as directives. OCP doubles apostrophes, but
    readers based on OCP treat one before a bracket or a comma as the end of the text; these are escaped. A
    NUL, which ends a text for many readers, becomes U+FFFD.
    """
    return _ESCAPED.sub(lambda match: _directive(ord(match[0]) or 0xFFFD), text)


def _directive(code: int) -> str:
    return f"\\X2\\{code:04X}\\X0\\" if code < 0x10000 else f"\\X4\\{code:08X}\\X0\\"


@contextmanager
def silent_ocp() -> Iterator[None]:
    """Suppress OCP's output to the terminal within the context."""
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
    """Convert exceptions of OCP, which have no common base class, to an InputError that names a subject."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{subject}: {error}") from error
    except Exception as error:
        if not type(error).__module__.startswith("OCP."):
            raise
        raise InputError(f"{subject}: OCP failed: {error}") from error


def write_solids(
    solids: Sequence[Any],
    names: Sequence[str],
    title: str,
    path: Path,
    statement: str = "",
    tolerances: Sequence[SemanticTolerances] = (),
) -> None:
    """Write named solids in mm: a single one as a part, several as an assembly with the title as its name.

    Parameters
    ----------
    solids
        Shapes of OCP, in mm.
    names
        Names of the products, one for each solid.
    title
        Title of the lens, for the header.
    path
        File to write.
    statement
        Comment for the description of the header (default: none).
    tolerances
        Semantic tolerances of each solid (default: none).

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
        raise InputError("OCP requires a file name in UTF-8") from error
    writer = STEPCAFControl_Writer()
    # These settings are global; the calling program may have changed them.
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    Interface_Static.SetCVal_s("write.step.schema", "AP242DIS" if tolerances else "AP214IS")
    writer.SetDimTolMode(bool(tolerances))
    document = _document(title, solids, names, tolerances)
    written = writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
    _write_header(writer.ChangeWriter().Model(), title, statement)
    if not written or writer.Write(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise InputError("OCP could not write the solids")
    path.write_text(_normalized(path.read_text(encoding="ascii")), encoding="ascii")


def _write_header(model: Any, title: str, statement: str) -> None:
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.TCollection import TCollection_HAsciiString

    header = APIHeaderSection_MakeHeader(model)
    header.SetName(TCollection_HAsciiString(step_text(title)))
    # With a constant time stamp the same lens yields identical files.
    header.SetTimeStamp(TCollection_HAsciiString("1970-01-01T00:00:00"))
    description = "glass of a lens, lengths in mm" + (f"; {statement}" if statement else "")
    header.SetDescriptionValue(1, TCollection_HAsciiString(step_text(description)))
    header.SetAuthorValue(1, TCollection_HAsciiString(""))
    header.SetOrganizationValue(1, TCollection_HAsciiString(""))
    header.SetOriginatingSystem(TCollection_HAsciiString("transferlens"))
    header.SetAuthorisation(TCollection_HAsciiString(""))


def _normalized(text: str) -> str:
    """Return the text of a file with unbroken strings and with components numbered from 1.

    OCP breaks long strings into lines, even within a directive, and numbers components continuously over all
    files of a process.
    """
    text = _QUOTED_TEXT.sub(lambda match: match[0].replace("\n", ""), text)
    index = count(1)
    return _COMPONENT_USE.sub(lambda match: f"{match[1]}{next(index)}", text)


def _document(
    title: str, solids: Sequence[Any], names: Sequence[str], tolerances: Sequence[SemanticTolerances]
) -> Any:
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopLoc import TopLoc_Location
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    def set_name(label: Any, name: str) -> None:
        TDataStd_Name.Set_s(label, TCollection_ExtendedString(step_text(name)))

    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    labels = [tool.AddShape(solid, False) for solid in solids]
    for label, name in zip(labels, names, strict=True):
        set_name(label, name)
    for solid, label, stated in zip(solids, labels, tolerances, strict=False):
        add_tolerances(document, label, subshapes(solid, TopAbs_ShapeEnum.TopAbs_FACE), stated)
    if len(labels) > 1:
        assembly = tool.NewShape()
        set_name(assembly, title or "lens")
        for label, name in zip(labels, names, strict=True):
            set_name(tool.AddComponent(assembly, label, TopLoc_Location()), name)
        tool.UpdateAssemblies()
    return document


def read_semantic_tolerances(path: Path) -> list[SemanticTolerances]:
    """Return the semantic tolerances of each solid of a STEP file, in their order.

    Raises
    ------
    InputError
        If OCP cannot read the file, or a tolerance is not one that this package writes.
    """
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document

    reader, document = STEPCAFControl_Reader(), TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    reader.SetGDTMode(True)
    is_read = reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
    if not is_read or not reader.Transfer(document):
        raise InputError("OCP could not read the tolerances back")
    return read_tolerances(document)


def read_solids(path: Path) -> list[Any]:
    """Return the solids of a STEP file in their order, in mm.

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
    return subshapes(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_SOLID)
