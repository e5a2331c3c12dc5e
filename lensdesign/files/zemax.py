"""Zemax OpticStudio's sequential lens files (.zmx), read and written.

Read are surfaces of the types that the shapes of :mod:`lensdesign.lens.shapes` name, with their curvature,
conic, parameters, thickness, glass, semi-diameter (where it is not automatic), circular aperture and stop;
the apertures ENPD, FNUM, OBNA and FLOA, which decide how wide the stop is filled; object heights;
wavelengths, the primary one first; and a pair of coordinate breaks as the pose of the whole lens. Weights,
the merit function and what only governs analyses or drawings says nothing of the lens and is passed over; so
are fields at which there is nothing but the axis. The format has no public specification: what the records
mean is taken from the OpticStudio user's manual (Ansys Zemax) and from files that lens makers publish.
"""

from __future__ import annotations

import codecs
import math
import os
from decimal import Decimal
from pathlib import Path
from typing import Any

from lensdesign.errors import MaterialError, atomic_path
from lensdesign.files.assembly import assemble
from lensdesign.files.draft import (
    Break,
    Draft,
    Imported,
    RecordedSurface,
    Row,
    Supplement,
    find_glass,
    note_lines,
    number,
    pose_break,
    pose_distances,
    read_lines,
    read_note,
    writable,
)
from lensdesign.files.zemax_records import (
    EXACT,
    FileReader,
    FileSurface,
    finish_records,
    integer_at,
    shape_of_type,
    take_record,
    value_at,
)
from lensdesign.lens.glass import get_material, glass_summary
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.shapes.conic import Conic


def read_zmx(
    path: str | os.PathLike[str], supplement: Supplement | None = None, lossy: bool = False
) -> Imported:
    """Read a lens from a .zmx file.

    Parameters
    ----------
    path
        A sequential OpticStudio file: text in UTF-16, UTF-8 or Latin-1, lengths in mm.
    supplement
        What the file does not tell; files of :func:`write_zmx` tell all in their notes.
    lossy
        Whether to go on where a design cannot hold all of the file.

    Raises
    ------
    LossyImportError
        If it cannot, and `lossy` is not set; the message lists what would be lost.
    InputError
        If the file cannot be read or is no lens; the message names file and line or surface.
    MaterialError
        If a glass is unknown.
    """
    supplement = supplement or Supplement()
    reader = FileReader(Draft(source=str(path)))
    lines = read_lines(path)
    for count, line in enumerate(lines, start=1):
        where = f"{path}, line {count}"
        word, *values = line.split() or [""]
        if word.upper() == "NOTE":
            if len(values) > 1:
                read_note(line.split(maxsplit=2)[2], reader.draft, where)
        elif word.upper() == "NAME":
            reader.name = line.strip()[4:].strip()
        elif word:
            take_record(reader, word.upper(), values, where, line[:1].isspace())
    finish_records(reader)
    return assemble(_finished(reader, lines, supplement), supplement, lossy)


def _finished(reader: FileReader, lines: list[str], supplement: Supplement) -> Draft:
    """The draft with what only the whole file tells."""
    draft = reader.draft
    noted = draft.notes.get("title")
    draft.title = noted if isinstance(noted, str) and _plain(noted) == reader.name else reader.name
    numbers = sorted(reader.waves)[: reader.wave_count]
    if reader.primary in numbers:
        numbers.sort(key=lambda n: n != reader.primary)
    draft.wavelengths_um = [reader.waves[n] for n in numbers]
    if reader.field_kind == 1:
        draft.take_heights(*(reader.heights.get(axis, [])[: reader.field_count] for axis in "xy"))
    materials = draft.notes.get("materials")
    named = iter(materials if isinstance(materials, list) else [])
    for i, surface in enumerate(reader.surfaces):
        inner = 0 < i < len(reader.surfaces) - 1 and surface.kind != "COORDBRK"
        draft.rows.append(_row(reader, surface, next(named, None) if inner else None, supplement))
    if reader.surfaces:
        draft.lose_ends()
    draft.recorded = _recorded(lines, reader, supplement)
    return draft


def _recorded(lines: list[str], reader: FileReader, supplement: Supplement) -> list[RecordedSurface]:
    """The surfaces by a second, plain look at the file: of each block the first record of a kind counts."""
    blocks: list[dict[str, list[str]]] = []
    for line in lines:
        word, *values = line.split() or [""]
        word = word.upper()
        if word == "SURF":
            blocks.append({})
        elif blocks and word in ("TYPE", "CURV", "DISZ", "GLAS", "STOP"):
            blocks[-1].setdefault(word, values)
    recorded: list[RecordedSurface] = []
    for block, row, surface in zip(blocks, reader.draft.rows, reader.surfaces, strict=True):
        glass = tuple(block.get("GLAS", ()))
        material = (
            row.material
            if glass == surface.glass
            else _material(reader, FileSurface(surface.name, surface.where, glass=glass), None, supplement)
        )
        if block.get("TYPE", [""])[:1] == ["COORDBRK"]:
            material = recorded[-1].material if recorded else None
        recorded.append(
            RecordedSurface(
                number(block.get("CURV", ["0"])[0], surface.where),
                _distance(block.get("DISZ", ["0"])[0], surface.where),
                material,
                "STOP" in block,
            )
        )
    return recorded


def _distance(text: str, where: str) -> float:
    return math.inf if text.upper() == "INFINITY" else number(text, where)


def _row(reader: FileReader, surface: FileSurface, noted: Any, supplement: Supplement) -> Row:
    if surface.kind == "COORDBRK":
        x, y, a, b, c, order = (surface.terms.get(i, 0.0) for i in range(1, 7))
        axes = Break((x, y), (a, b, c), order != 0.0)
        return Row(surface.name, surface.where, thickness_mm=surface.thickness_mm, axes=axes)
    shape, keys = shape_of_type(surface.kind, surface.terms) or (Conic, {})
    held = shape.of_keys({"radius_mm": surface.radius_mm, "conic": surface.conic} | keys).zemax()[1]
    for i, value in sorted(surface.terms.items()):
        if value != held.get(i, 0.0):
            reader.draft.lose(f"{surface.name}: {shape.ZEMAX_LOST.get(i, f'PARM {i}')} of {value:g}")
    return Row(
        surface.name,
        surface.where,
        surface.radius_mm,
        surface.conic,
        keys,
        surface.thickness_mm,
        _material(reader, surface, noted, supplement),
        surface.aperture_mm or surface.semi_diameter_mm,
        surface.stop,
        automatic_mm=None if surface.aperture_mm else surface.automatic_mm,
    )


def _material(
    reader: FileReader, surface: FileSurface, noted: Any, supplement: Supplement
) -> str | float | None:
    """The medium behind a surface: air, a glass by name, or a model glass without dispersion."""
    if not surface.glass or surface.glass[0].upper() == "AIR":
        return None
    name, *values = surface.glass
    if name.upper() == "MIRROR":
        reader.draft.lose(f"{surface.name}: mirror, read as a surface in air")
        return None
    kind = integer_at(values, 0, surface.glass_where) if values else 0
    if kind == 1 or name.upper() in ("___BLANK", "MODEL"):
        index = value_at(values, 2, surface.glass_where)
        abbe = value_at(values, 3, surface.glass_where) if len(values) > 3 else 0.0
        if abbe:
            reader.draft.lose(f"{surface.name}: dispersion of the model glass (Abbe number {abbe:g})")
        return index
    if kind > 1:
        reader.draft.remark(f"{surface.name}: solve or pickup of the glass replaced by its present value")
    if isinstance(noted, str) and _token(noted) == name:
        return noted

    def remark(what: str) -> None:
        reader.draft.remark(f"{surface.name}: {what}")

    found = find_glass(name, reader.makers, supplement.glass_catalogs, surface.glass_where, remark)
    _remark_catalogues(reader, surface.name, found, supplement)
    return found


# Catalogues that come with OpticStudio, by their names in GCAT.
_STANDARD_CATALOGUES = """
ANGSTROMLINK APEL ARCHER ARTON AUER BIREFRINGENT CDGM CORNING HERAEUS HIKARI HOYA INFRARED ISUZU LIEBETRAUT
LIGHTPATH LZOS MISC NHG NIKON NIKON-HIKARI OHARA OSAKAGASCHEMICAL PILKINGTON RAD_HARD RPO SCHOTT SCHOTT_IRG
SUMITA TOPAS UMICORE VITRON ZEON
"""
_STANDARD = frozenset(_STANDARD_CATALOGUES.split())


def _remark_catalogues(reader: FileReader, place: str, found: str, supplement: Supplement) -> None:
    """Say where a glass was taken from although the file names a catalogue that is not at hand."""
    own = {path.name for path in supplement.glass_catalogs}
    stems = {name.casefold().removesuffix(".agf") for name in own}
    missing = [
        c
        for c in reader.catalogues
        if c.upper() not in _STANDARD and c.casefold().removesuffix(".agf") not in stems
    ]
    try:
        catalog = get_material(found, supplement.glass_catalogs).catalog
    except MaterialError:  # said where its index is needed
        return
    if missing and catalog not in own:
        reader.draft.remark(
            f"{place}: glass {found} is that of {catalog}; the file also names {', '.join(missing)}, which "
            "may have another of this name (give it as a glass catalogue)"
        )


def write_zmx(lens: Lens, path: str | os.PathLike[str], pose: Pose = Pose()) -> None:
    """Write a lens to a .zmx file, from which :func:`read_zmx` has the same lens and pose again.

    Numbers have all their digits. The pose becomes a pair of coordinate breaks about its pivot; a constant
    index becomes a model glass without dispersion; sensor, title and exact glass names stand in notes.
    Asphere coefficients of zero behind the last other one are left out.

    Raises
    ------
    InputError
        If the format cannot hold the lens (a measured figure, a shape that it does not have), or the
        file cannot be written; whatever stood there stays.
    MaterialError
        If a glass is unknown.
    """
    target = Path(path)
    writable(lens, pose, lambda shape: shape.zemax(), "a .zmx file")
    lines = _header(lens) + [f"NOTE 0 {line}" for line in note_lines(lens, pose, target.parent)]
    blocks = _blocks(lens, pose)
    for i, block in enumerate(blocks):
        lines += [f"SURF {i}", *(f"  {line}" for line in block)]
    text = "\r\n".join([*lines, ""])
    with atomic_path(target) as temporary:
        temporary.write_bytes(codecs.BOM_UTF16_LE + text.encode("utf-16-le", errors="replace"))


def _header(lens: Lens) -> list[str]:
    catalogs = [
        get_material(s.material, lens.glass_catalogs).catalog
        for s in lens.surfaces
        if isinstance(s.material, str)
    ]
    names = dict.fromkeys(c.removesuffix(".agf").removesuffix(".AGF").upper() for c in catalogs)
    makers = [name for name in names if name.isalnum()]
    half, count = 0.5 * lens.object.field_diameter_mm, len(lens.wavelengths_um)
    return [
        "VERS 171115 0 0",
        "MODE SEQ",
        f"NAME {_plain(lens.title)}",
        "PFIL 0 0 0",
        "LANG 0",
        "UNIT MM X W X CM MR CPMM",
        f"OBNA {lens.object.numerical_aperture!r} 0",
        "ENVD 20 1 0",
        "GFAC 0 0",
        f"GCAT {' '.join(makers or ['SCHOTT'])}",
        "RAIM 0 0 1 1 0 0 0 0 0",
        f"FTYP 1 0 2 {count} 0 0 0",
        "XFLN 0 0",
        f"YFLN 0 {half!r}",
        "FWGN 1 1",
        *(f"WAVM {i} {w!r} 1" for i, w in enumerate(lens.wavelengths_um, start=1)),
        "PWAV 1",
    ]


def _blocks(lens: Lens, pose: Pose) -> list[list[str]]:
    """Records of every surface from the object to the image."""
    inner = [
        [
            f"TYPE {kind}",
            f"CURV {EXACT.divide(Decimal(1), Decimal(s.radius_mm))}"
            if s.radius_mm is not None
            else "CURV 0.0",
            *(["STOP"] if i == lens.stop_index and s.stop else []),
            *(f"PARM {n} {value!r}" for n, value in parameters.items()),
            *([f"CONI {s.conic!r}"] if s.conic else []),
            *([f"GLAS {_glass_values(s.material, lens)}"] if s.material is not None else []),
            *(
                [f'DIAM {s.semi_diameter_mm!r} 1 0 0 1 ""', f"FLAP 0 {s.semi_diameter_mm!r} 0"]
                if s.semi_diameter_mm is not None
                else []
            ),
        ]
        for i, s in enumerate(lens.surfaces)
        for kind, parameters in [s.shape.zemax()]
    ]
    distances = [s.thickness_mm for s in lens.surfaces[:-1]]
    front, back = ["TYPE STANDARD", "CURV 0.0"], ["TYPE STANDARD", "CURV 0.0", "DISZ 0.0"]
    if pose == Pose():
        blocks = [front, *inner]
        distances = [lens.object.working_distance_mm, *distances, lens.sensor.plane_distances_mm[0]]
    else:
        to_pivot, to_front, to_back, to_sensor = pose_distances(lens, pose)
        axes = pose_break(pose)
        blocks = [front, _break_records(axes), *inner, _break_records(axes.inverse())]
        distances = [to_pivot, to_front, *distances, to_back, to_sensor]
    placed = [[*block, f"DISZ {d!r}"] for block, d in zip(blocks, distances, strict=True)]
    return [*placed, back]


def _break_records(axes: Break) -> list[str]:
    values = (*axes.decenter_mm, *axes.tilt_deg, float(axes.reverse))
    return ["TYPE COORDBRK", "CURV 0.0", *(f"PARM {i} {v!r}" for i, v in enumerate(values, start=1))]


def _glass_values(material: str | float, lens: Lens) -> str:
    if not isinstance(material, str):
        return f"___BLANK 1 0 {material!r} 0.0 0 0 0 0 0 0"
    summary = glass_summary(material, lens.glass_catalogs)
    return f"{_token(material)} 0 0 {summary['nd'] or 1.5!r} {summary['vd'] or 0.0!r} 0 0 0 0 0 0"


def _token(material: str) -> str:
    """A glass name as one word, without its catalogue."""
    return "_".join(material.rpartition(":")[2].split())


def _plain(title: str) -> str:
    """A title as it fits on one line."""
    return " ".join("".join(c if c.isprintable() else " " for c in title).split())
