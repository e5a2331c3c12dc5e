"""Records of Zemax OpticStudio's lens files: what each says of the file or of a surface."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Context, Decimal
from typing import Any

from lensdesign.errors import InputError
from lensdesign.files.draft import MOST_SURFACES, Draft, heights_of, lose_vignetting, number, shown
from lensdesign.lens.shapes.base import Shape
from lensdesign.lens.shapes.registry import shape_classes

EXACT = Context(prec=25)
"""Arithmetic of digits enough to have a radius back from its curvature without loss."""

ROUNDING = 2e-14
"""Relative; other programs round more than once on the way from a radius to its curvature."""

# What governs analyses, drawings, weights and polarization, and what names authors, files and surfaces: it
# says nothing of the lens.
_IDLE_WORDS = """
VERS PFIL LANG DBDT GFAC GLRS GSTD NSCD COFN RAIM PUSH SDMA OMMA ROPD HYPR PICB POLS LUID FWGN FWGT WWGT WWGN
MNCA MNEA MNCG MNEG MXCA MXCG RWRE ROTA BLNK TOL TOLE MOFF FCOM COMM HIDE MIRR SLAB POPS MEMA OEMA FIMP CONF
SCBD TBTP RSCE RWCE VDSZ VPAR AUTH IWDP EERA SSID STUD
"""
_IDLE = frozenset(_IDLE_WORDS.split())

# With these begins what follows the last surface: tolerances, configurations, the merit function.
_TAIL_STARTS = frozenset(("TOL", "TOLE", "MNUM", "MOFF"))

# Solves and pickups: the value that they last had stands in the file.
_SOLVES = ("MAZH", "CHZH", "PZUP", "PPAR", "MRAY", "PRAM")


@dataclass
class FileSurface:
    """A surface while its records are being read.

    `terms` are its parameters by number; `automatic_mm` is a semi-diameter that follows the rays, and no
    aperture; `seen` holds the values and the line of each record that a surface has once.
    """

    name: str
    where: str
    kind: str = "STANDARD"
    radius_mm: float | None = None
    conic: float = 0.0
    thickness_mm: float = 0.0
    glass: tuple[str, ...] = ()
    glass_where: str = ""
    semi_diameter_mm: float | None = None
    automatic_mm: float | None = None
    aperture_mm: float | None = None
    stop: bool = False
    terms: dict[int, float] = field(default_factory=dict)
    seen: dict[str, tuple[list[str], str]] = field(default_factory=dict)


@dataclass
class FileReader:
    """A file while it is being read; `waves` are (number, um).

    `behind` holds records behind the surfaces that have no meaning here; they are lost if another surface
    follows.
    """

    draft: Draft
    surfaces: list[FileSurface] = field(default_factory=list)
    makers: list[str] = field(default_factory=list)
    catalogues: list[str] = field(default_factory=list)
    waves: dict[int, float] = field(default_factory=dict)
    wave_count: int | None = None
    primary: int = 1
    field_kind: int = 0
    field_count: int | None = None
    heights: dict[str, list[float]] = field(default_factory=dict)
    name: str = ""
    in_tail: bool = False
    behind: list[str] = field(default_factory=list)
    aperture_where: str = ""


def take_record(reader: FileReader, word: str, values: list[str], where: str, indented: bool) -> None:
    """Take one record: of the header, of a surface, or behind the last one.

    The keyword says to what a record belongs: one that a surface can have belongs to the surface before it,
    with or without indent. One that is not known is a loss, unless it stands behind the surfaces, where the
    merit function, tolerances and configurations follow (:func:`finish_records`).

    Raises
    ------
    InputError
        If it does not hold what it must.
    """
    if word == "SURF":
        _start_surface(reader, values, where)
        return
    surface = reader.surfaces[-1] if reader.surfaces else None
    line = where.rpartition(", ")[2]
    if word in _OF_FILE:
        _OF_FILE[word](reader, values, where)
    elif surface is not None and word in _OF_SURFACE:
        _leave_tail(reader)
        _refuse_second(surface, word, values, where)
        _OF_SURFACE[word](reader, surface, values, where)
    elif surface is not None and word in _TAIL_STARTS:
        reader.in_tail = True
    elif word in _IDLE:
        return
    elif surface is None:
        reader.draft.lose(f"{word} {shown(' '.join(values))} ({line})")
    elif word in _SOLVES and not reader.in_tail:
        reader.draft.remark(f"{surface.name}: {word} solve or pickup replaced by its present value")
    elif reader.in_tail or not indented:
        reader.behind.append(f"{surface.name}: {word} {shown(' '.join(values))}")
    else:
        reader.draft.lose(f"{surface.name}: {word} {shown(' '.join(values))}")


def finish_records(reader: FileReader) -> None:
    """Decide about the unknown records behind the last surface.

    Operands of the merit function stand there, before the tolerances and configurations that every whole file
    has; in a file without these they are a loss.
    """
    if not reader.in_tail:
        _leave_tail(reader)


def _leave_tail(reader: FileReader) -> None:
    """List as lost what may have stood behind the surfaces, as a surface or a record of one follows."""
    for record in reader.behind:
        reader.draft.lose(record)
    reader.behind.clear()
    reader.in_tail = False


def _refuse_second(surface: FileSurface, word: str, values: list[str], where: str) -> None:
    """Refuse a second record of one kind that says something else than the first."""
    if word not in _ONCE:
        return
    first, first_where = surface.seen.setdefault(word, (values, where))
    if first != values:
        raise InputError(
            f"{where}: {word} {shown(' '.join(values))} is a second {word} record of {surface.name}; "
            f"{first_where.rpartition(', ')[2]} has {shown(' '.join(first))}, and a surface has one"
        )


def _start_surface(reader: FileReader, values: list[str], where: str) -> None:
    expected = len(reader.surfaces)
    if values != [str(expected)]:
        raise InputError(f"{where}: SURF {shown(' '.join(values))} where surface {expected} must follow")
    if expected > MOST_SURFACES:
        raise InputError(f"{where}: more than {MOST_SURFACES} surfaces")
    _leave_tail(reader)
    reader.surfaces.append(FileSurface(f"surface {expected}", where))


def value_at(values: Sequence[str], index: int, where: str) -> float:
    if index >= len(values):
        raise InputError(f"{where}: {len(values)} values where at least {index + 1} must stand")
    return number(values[index], where)


def integer_at(values: Sequence[str], index: int, where: str) -> int:
    value = value_at(values, index, where)
    if value != int(value) or abs(value) > 1e6:
        raise InputError(f"{where}: {shown(values[index])} stands where a whole number must")
    return int(value)


def _type(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    surface.kind = values[0] if values else ""
    if surface.kind != "COORDBRK" and shape_of_type(surface.kind, {}) is None:
        reader.draft.lose(f"{surface.name}: surface type {shown(surface.kind)}, read as STANDARD")


def shape_of_type(kind: str, parameters: Mapping[int, float]) -> tuple[type[Shape], dict[str, Any]] | None:
    """The shape that a surface type stands for, and its keys beside radius and conic; None for any other."""
    for shape in shape_classes():
        keys = shape.keys_of_zemax(kind, parameters)
        if keys is not None:
            return shape, keys
    return None


def _curvature(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    surface.radius_mm = radius_mm(values[0], where) if value_at(values, 0, where) else None
    if len(values) > 1 and number(values[1], where) > 1.0:  # 1 marks a variable
        reader.draft.remark(f"{surface.name}: curvature solve replaced by its present value")


def _conic(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    surface.conic = value_at(values, 0, where)


def _distance(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    endless = bool(values) and values[0].upper() == "INFINITY"
    surface.thickness_mm = math.inf if endless else value_at(values, 0, where)


def _glass(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    if not values:
        raise InputError(f"{where}: GLAS without a name")
    surface.glass, surface.glass_where = tuple(values), where


def _diameter(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    """A semi-diameter and how it is had: 0 automatic, 1 fixed, 2 picked up, 3 the maximum of configurations.

    Automatic ones and maxima follow the rays and stop none. A file that does not say means a fixed one.
    """
    value = value_at(values, 0, where)
    solve = integer_at(values, 1, where) if len(values) > 1 else 1
    surface.semi_diameter_mm = surface.automatic_mm = None
    if value <= 0.0:
        return
    if solve in (0, 3):
        surface.automatic_mm = value
        return
    surface.semi_diameter_mm = value
    if solve != 1:
        reader.draft.remark(f"{surface.name}: semi-diameter solve replaced by its present value")


def _aperture(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    if value_at(values, 0, where) > 0.0:
        reader.draft.lose(f"{surface.name}: central obscuration of radius {values[0]}")
    value = value_at(values, 1, where)
    surface.aperture_mm = value if value > 0.0 else None


def _shift(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    if any(number(v, where) for v in values):
        reader.draft.lose(f"{surface.name}: decentered aperture")


def _stop(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    surface.stop = True


def _parameter(reader: FileReader, surface: FileSurface, values: list[str], where: str) -> None:
    surface.terms[integer_at(values, 0, where)] = value_at(values, 1, where)


_OF_SURFACE: dict[str, Callable[[FileReader, FileSurface, list[str], str], None]] = {
    "TYPE": _type,
    "CURV": _curvature,
    "CONI": _conic,
    "DISZ": _distance,
    "GLAS": _glass,
    "DIAM": _diameter,
    "CLAP": _aperture,
    "FLAP": _aperture,
    "OBDC": _shift,
    "STOP": _stop,
    "PARM": _parameter,
}

_ONCE = frozenset(("TYPE", "CURV", "CONI", "DISZ", "GLAS", "DIAM"))


def _mode(reader: FileReader, values: list[str], where: str) -> None:
    if values != ["SEQ"]:
        raise InputError(f"{where}: MODE {shown(' '.join(values))}; only sequential files (SEQ) can be read")


def _unit(reader: FileReader, values: list[str], where: str) -> None:
    if not values or values[0] != "MM":
        raise InputError(f"{where}: UNIT {shown(' '.join(values[:1]))}; only lengths in MM can be read")


def _set_aperture(reader: FileReader, kind: str, value: float, where: str) -> None:
    """Take the system aperture, of which a file has one."""
    if reader.draft.aperture not in (None, (kind, value)):
        raise InputError(
            f"{where}: a second system aperture; {reader.aperture_where} gives another one, and a lens has "
            "one"
        )
    reader.draft.aperture, reader.aperture_where = (kind, value), where.rpartition(", ")[2]


def _pupil(reader: FileReader, values: list[str], where: str) -> None:
    _set_aperture(reader, "pupil_diameter_mm", value_at(values, 0, where), where)


def _f_number(reader: FileReader, values: list[str], where: str) -> None:
    working = len(values) > 1 and number(values[1], where) == 1.0
    kind = "working_f_number" if working else "image_f_number"
    _set_aperture(reader, kind, value_at(values, 0, where), where)


def _object_aperture(reader: FileReader, values: list[str], where: str) -> None:
    value = value_at(values, 0, where)
    in_degrees = len(values) > 1 and number(values[1], where) == 1.0
    _set_aperture(reader, "object_na", math.sin(math.radians(value)) if in_degrees else value, where)


def _floating(reader: FileReader, values: list[str], where: str) -> None:
    _set_aperture(reader, "stop", 0.0, where)


def _field_type(reader: FileReader, values: list[str], where: str) -> None:
    reader.field_kind = integer_at(values, 0, where)
    if len(values) > 1 and integer_at(values, 1, where):
        reader.draft.lose("telecentric object space")
    if len(values) > 3:
        reader.field_count, reader.wave_count = integer_at(values, 2, where), integer_at(values, 3, where)


def _wave(reader: FileReader, values: list[str], where: str) -> None:
    reader.waves[integer_at(values, 0, where)] = value_at(values, 1, where)


def _waves(reader: FileReader, values: list[str], where: str) -> None:
    reader.waves = {i: number(v, where) for i, v in enumerate(values, start=1)}


def _primary(reader: FileReader, values: list[str], where: str) -> None:
    reader.primary = integer_at(values, 0, where)


def _catalogues(reader: FileReader, values: list[str], where: str) -> None:
    reader.makers = list(dict.fromkeys(name for maker in values for name in (maker, maker.split("_")[0])))
    reader.catalogues = values


def _environment(reader: FileReader, values: list[str], where: str) -> None:
    celsius, atmospheres = value_at(values, 0, where), value_at(values, 1, where)
    if (celsius, atmospheres) != (20.0, 1.0):
        reader.draft.lose(
            f"environment of {celsius:g} degrees C and {atmospheres:g} atm; a design has 20 and 1"
        )


def _configurations(reader: FileReader, values: list[str], where: str) -> None:
    reader.in_tail |= bool(reader.surfaces)
    if integer_at(values, 0, where) > 1:
        reader.draft.lose(f"{values[0]} configurations; the one whose values the surfaces hold is read")


_OF_FILE: dict[str, Callable[[FileReader, list[str], str], None]] = {
    "MODE": _mode,
    "UNIT": _unit,
    "ENPD": _pupil,
    "FNUM": _f_number,
    "OBNA": _object_aperture,
    "FLOA": _floating,
    "FTYP": _field_type,
    "XFLN": heights_of("x"),
    "YFLN": heights_of("y"),
    "XFLD": heights_of("x"),
    "YFLD": heights_of("y"),
    **dict.fromkeys(
        ("VDXN", "VDYN", "VCXN", "VCYN", "VANN", "ZVDX", "ZVDY", "ZVCX", "ZVCY"), lose_vignetting
    ),
    "WAVM": _wave,
    "WAVL": _waves,
    "PWAV": _primary,
    "GCAT": _catalogues,
    "ENVD": _environment,
    "MNUM": _configurations,
}


def radius_mm(curvature: str, where: str) -> float:
    """Radius for a curvature in digits: one of 12 digits at most where that is as near as rounding leaves it.

    One of more digits than a number holds tells neighbouring radii apart, and gives the one it came from.
    """
    value = number(curvature, where)
    digits = curvature.lower().split("e")[0].strip("+-").replace(".", "").strip("0")
    exact = float(EXACT.divide(Decimal(1), Decimal(curvature.lower().replace("d", "e"))))
    if len(digits) <= 21:
        for count in range(1, 13):
            short = float(f"{exact:.{count}g}")
            if abs(short * value - 1.0) <= ROUNDING:
                return short
    if not math.isfinite(exact):
        raise InputError(
            f"{where}: curvature {shown(curvature)} is too small for a number to hold its radius"
        )
    return exact
