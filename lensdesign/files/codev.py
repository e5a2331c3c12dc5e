"""CODE V's sequence files (.seq) of lens data, read and written.

Read are DIM M; RDM with S lines of radius (or, after RDM N, curvature), thickness and glass, and the same as
RDY, CUY, THI and GLA; the conic K and the asphere terms A to J (r^4 to r^20) of CON and ASP surfaces;
circular apertures CIR; the stop STO; NAO, NA, EPD and FNO (working F-number); object heights XOB and YOB;
wavelengths WL in nm, the reference REF first; glasses as NBK7_SCHOTT, and the private ones (PRV) that
surfaces have, by indices or formulas (:mod:`lensdesign.files.codev_glasses`); the present values of solves
and pickups; and XDE, YDE, ADE and BDE of a pair of surfaces, plain and REV, as the pose of the whole lens.
Weights, coupling codes and labels say nothing of the lens and are passed over. Commands are those of the CODE
V Reference Manual (Synopsys); there, ADE and BDE turn left-handed.
"""

from __future__ import annotations

import os
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError, atomic_path
from lensdesign.files.assembly import assemble
from lensdesign.files.codev_commands import (
    PRIVATE,
    FileReader,
    FileSurface,
    check_solves,
    commands,
    take_command,
)
from lensdesign.files.codev_glasses import PrivateGlass
from lensdesign.files.draft import (
    NOTE,
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
    same_name,
    writable,
)
from lensdesign.lens.glass import get_material, refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.shapes.even_asphere import CODEV_LETTERS, without_zeros

MAKERS = ("SCHOTT", "OHARA", "HOYA", "CDGM", "HIKARI", "SUMITA", "CORNING")
"""Glass catalogues that CODE V has, too."""


def read_seq(
    path: str | os.PathLike[str], supplement: Supplement | None = None, lossy: bool = False
) -> Imported:
    """Read a lens from a .seq file.

    Parameters
    ----------
    path
        A file of CODE V commands that enter a lens, in mm: text in UTF-8, UTF-16 or Latin-1.
    supplement
        What the file does not tell; files of :func:`write_seq` tell all in their comments.
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
        text = line.strip().lstrip("!").strip()
        if line.lstrip().startswith("!") and text.startswith(NOTE):
            read_note(text, reader.draft, f"{path}, line {count}")
    for count, words in commands(lines, str(path)):
        take_command(reader, words, f"{path}, line {count}")
    check_solves(reader)
    if reader.in_private:
        raise InputError(f"{path}: private glasses (PRV) without END")
    if reader.surfaces and reader.surfaces[-1].kind != "SI":
        raise InputError(
            f"{path}: no image surface (SI) behind {reader.surfaces[-1].name}; is the file cut short?"
        )
    return assemble(_finished(reader, supplement), supplement, lossy)


def _finished(reader: FileReader, supplement: Supplement) -> Draft:
    """The draft with what only the whole file tells."""
    draft = reader.draft
    noted = draft.notes.get("title")
    draft.title = noted if isinstance(noted, str) and _plain(noted) == reader.title else reader.title
    waves = list(reader.wavelengths_um)
    if 1 <= reader.reference <= len(waves):
        waves.insert(0, waves.pop(reader.reference - 1))
    draft.wavelengths_um = waves
    draft.take_heights(*(reader.heights.get(axis, []) for axis in ("XOB", "YOB")))
    materials = draft.notes.get("materials")
    named = list(materials) if isinstance(materials, list) else []
    glass_before = ""
    for i, surface in enumerate(reader.surfaces):
        edge = i in (0, len(reader.surfaces) - 1)
        dummy = not edge and _is_dummy(surface, glass_before)
        noted = None if edge or dummy or not named else named.pop(0)
        material = _material(reader, surface, noted, supplement)
        draft.rows += _rows(reader, surface, material, dummy)
        draft.recorded.append(
            RecordedSurface(
                0.0 if surface.radius_mm is None else 1.0 / surface.radius_mm,
                surface.thickness_mm,
                material,
                surface.stop,
            )
        )
        glass_before = surface.glass
    if reader.surfaces:
        draft.lose_ends()
    return draft


def _is_dummy(surface: FileSurface, glass_before: str) -> bool:
    """Whether a surface is but the place of a decenter: a plane with one medium on both sides."""
    plane = surface.radius_mm is None and not surface.terms and not surface.stop
    return plane and surface.glass == glass_before and surface.semi_diameter_mm is None and surface.is_moved


def _rows(reader: FileReader, surface: FileSurface, material: Any, dummy: bool) -> list[Row]:
    """A surface with the breaks before and behind it."""
    row = Row(
        surface.name,
        surface.where,
        surface.radius_mm,
        surface.conic,
        {"asphere": without_zeros([surface.terms.get(letter, 0.0) for letter in CODEV_LETTERS])},
        surface.thickness_mm,
        material,
        surface.semi_diameter_mm,
        surface.stop,
    )
    if not surface.is_moved:
        return [row]
    x, y, z, a, b, c = (surface.moves.get(key, 0.0) for key in ("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE"))
    if z or surface.moved_how not in ("", "DAR", "REV"):
        reader.draft.lose(f"{surface.name}: {'ZDE ' if z else ''}{surface.moved_how}".rstrip())
    axes = Break((x, y), (-a, -b, c))

    def change(which: Break, thickness_mm: float) -> Row:
        return Row(surface.name, surface.where, thickness_mm=thickness_mm, axes=which)

    if surface.moved_how == "REV":
        step = change(axes.inverse(), surface.thickness_mm)
        return [step] if dummy else [_still(row), step]
    if surface.moved_how == "DAR":
        return [change(axes, 0.0), _still(row), change(axes.inverse(), surface.thickness_mm)]
    return [change(axes, surface.thickness_mm)] if dummy else [change(axes, 0.0), row]


def _still(row: Row) -> Row:
    """The same surface with no space behind it."""
    return replace(row, thickness_mm=0.0)


def _material(
    reader: FileReader, surface: FileSurface, noted: Any, supplement: Supplement
) -> str | float | None:
    """The medium behind a surface: air, a glass by name, or one of a constant index."""
    token = surface.glass
    if not token or token.upper() == "AIR":
        return None
    if token.upper() == "REFL":
        reader.draft.lose(f"{surface.name}: mirror, read as a surface in air")
        return None
    name, _, maker = token.rpartition("_") if "_" in token else (token, "", "")
    if token.upper() in reader.private:
        if isinstance(noted, str) and token.startswith(PRIVATE):
            return noted
        return _private_index(reader, surface, reader.private[token.upper()])
    model = _model_glass(token, surface.glass_where)
    if model is not None:
        reader.draft.lose(f"{surface.name}: dispersion of the fictitious glass {token}")
        return model
    if isinstance(noted, str) and same_name(noted.rpartition(":")[2]) == same_name(name):
        return noted
    makers = [maker] if maker else []

    def remark(what: str) -> None:
        reader.draft.remark(f"{surface.name}: {what}")

    return find_glass(name, makers or list(MAKERS), supplement.glass_catalogs, surface.glass_where, remark)


def _private_index(reader: FileReader, surface: FileSurface, glass: PrivateGlass) -> float:
    """Index of a private glass at the first wavelength; its dispersion is lost."""
    waves = reader.draft.wavelengths_um
    if not waves:
        raise InputError(f"{reader.draft.source}: no wavelength found")
    index, remark, loss = glass.index(waves[0])
    if remark:
        reader.draft.remark(f"{surface.name}: {remark}")
    if loss:
        reader.draft.lose(f"{surface.name}: {loss}")
    if glass.disperses(waves):
        reader.draft.lose(f"{surface.name}: dispersion of the private glass {glass.name}")
    return index


def _model_glass(token: str, where: str) -> float | None:
    """Index at the d line of a glass given as 517642, 516800.641700 or 1.5168:64.17; None for a name."""
    index, _, abbe = token.partition(":")
    if abbe:
        number(abbe, where)
        return number(index, where)
    if not token.replace(".", "").isdecimal() or not token.isascii():
        return None
    whole, _, _ = token.partition(".")
    digits = whole if "." in token else whole[: len(whole) // 2]
    return 1.0 + number(f"0.{digits}", where)


def write_seq(lens: Lens, path: str | os.PathLike[str], pose: Pose = Pose()) -> None:
    """Write a lens to a .seq file, from which :func:`read_seq` has the same lens and pose again.

    Numbers have all their digits. The pose becomes a pair of dummy surfaces at its pivot, the first
    decentered and tilted, the second in reverse (REV). Glasses that CODE V has are named; others, and
    constant indices, become private glasses with their index at each wavelength. Sensor, title and exact
    glass names stand in comments.

    Raises
    ------
    InputError
        If the format cannot hold the lens (a measured figure, a shape that it does not have), or the file
        cannot be written; whatever stood there stays.
    MaterialError
        If a glass is unknown, or not known at one of the wavelengths.
    """
    target = Path(path)
    writable(lens, pose, lambda shape: shape.codev(), "a .seq file")
    half = 0.5 * lens.object.field_diameter_mm
    lines = [
        "RDM;LEN",
        *(f"! {line}" for line in note_lines(lens, pose, target.parent)),
        f"TITLE '{_plain(lens.title)}'",
        f"NAO {lens.object.numerical_aperture!r}",
        "DIM M",
        "WL " + " ".join(str(Decimal(repr(w)) * 1000) for w in lens.wavelengths_um),
        "REF 1",
        "WTW" + " 1" * len(lens.wavelengths_um),
        "XOB 0.0 0.0",
        f"YOB 0.0 {half!r}",
        *_private_glasses(lens),
        *_surface_lines(lens, pose),
        "GO",
    ]
    with atomic_path(target) as temporary:
        temporary.write_text("\n".join([*lines, ""]), encoding="utf-8", errors="replace")


def _private_glasses(lens: Lens) -> list[str]:
    lines = []
    for i, surface in enumerate(lens.surfaces, start=1):
        if surface.material is not None and _catalog_glass(surface.material, lens) is None:
            indices = [
                refractive_index(surface.material, w, lens.glass_catalogs) for w in lens.wavelengths_um
            ]
            lines.append(f"'{PRIVATE}{i}' " + " ".join(map(repr, indices)))
    waves = " ".join(str(Decimal(repr(w)) * 1000) for w in lens.wavelengths_um)
    return ["PRV", f"PWL {waves}", *lines, "END"] if lines else []


def _catalog_glass(material: str | float, lens: Lens) -> str | None:
    """CODE V's name of a glass that it has in a catalogue."""
    if not isinstance(material, str):
        return None
    glass = get_material(material, lens.glass_catalogs)
    if glass.catalog.upper() not in MAKERS:
        return None
    return f"{''.join(c for c in glass.name.upper() if c.isalnum())}_{glass.catalog.upper()}"


def _surface_lines(lens: Lens, pose: Pose) -> list[str]:
    """Commands of every surface from the object to the image."""
    thicknesses = [s.thickness_mm or 0.0 for s in lens.surfaces]
    if pose == Pose():
        front = [f"SO 0.0 {lens.object.working_distance_mm!r}"]
        thicknesses[-1], to_sensor, back = lens.sensor.plane_distances_mm[0], 0.0, []
    else:
        to_pivot, to_front, thicknesses[-1], to_sensor = pose_distances(lens, pose)
        (x, y), (a, b, _) = pose_break(pose).decenter_mm, pose_break(pose).tilt_deg
        moves = [f"  XDE {x!r}; YDE {y!r}; ADE {-a!r}; BDE {-b!r}"]
        front = [f"SO 0.0 {to_pivot!r}", f"S 0.0 {to_front!r}", *moves]
        back = [*moves, "  REV"]
    lines = []
    for i, (surface, thickness) in enumerate(zip(lens.surfaces, thicknesses, strict=True), start=1):
        glass = ""
        if surface.material is not None:
            glass = " " + (_catalog_glass(surface.material, lens) or f"'{PRIVATE}{i}'")
        lines.append(f"S {surface.radius_mm or 0.0!r} {thickness!r}{glass}")
        kind, terms = surface.shape.codev()
        lines += ["  STO"] if surface.stop else []
        lines += [f"  {kind}", f"  K {surface.conic!r}"] if terms or surface.conic else []
        lines += [f"  {letter} {a!r}" for letter, a in terms.items()]
        lines += [f"  CIR {surface.semi_diameter_mm!r}"] if surface.semi_diameter_mm is not None else []
    back = [f"S 0.0 {to_sensor!r}{glass}", *back] if back else []
    return [*front, *lines, *back, "SI 0.0 0.0"]


def _plain(title: str) -> str:
    """A title as it fits between quotation marks on one line."""
    kept = "".join(c if c.isprintable() and c not in "'\"" else " " for c in title)
    return " ".join(kept.split())
