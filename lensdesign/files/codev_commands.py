"""Commands of CODE V's sequence files: how a file falls into them, and what each says of the lens."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal

from lensdesign.errors import InputError
from lensdesign.files.codev_glasses import PrivateGlass
from lensdesign.files.draft import MOST_SURFACES, Draft, heights_of, lose_vignetting, number, shown
from lensdesign.lens.shapes.even_asphere import CODEV_LETTERS

PRIVATE = "TRANSFERLENS_"
"""Start of the names of private glasses in files that the toolkit writes."""

_ENDLESS = ("INF", "INFINITY")

INFINITE_MM = 1e10
"""From here on CODE V takes a distance for infinite."""

_WORDS = re.compile(r"""'[^']*'|"[^"]*"|;|!.*|&\s*$|[^\s;!'"&]+|['"&]""")

# Weights, labels, coupling codes and what governs analyses or drawings: they say nothing of the lens.
_IDLE_WORDS = """
LEN WTW WTF INI DER DOR CWL POL SLB THC CCY GLC KC XDC YDC ZDC ADC BDC CDC SPH CON ASP GO SET CA FFO IC
AC BC CC DC EC FC GC HC JC CUC COM XAN YAN XIM YIM XRI YRI LCM BIN
"""
_IDLE = frozenset(_IDLE_WORDS.split())

# The value that a solve or a pickup last had stands in the file.
_SOLVE_WORDS = """
PIM PIY PIX UMY UMX UCY UCX HMY HMX HCY HCX IMY IMX ICY ICX AMY ACY CMY EFY PIK SOL
"""
_SOLVES = frozenset(_SOLVE_WORDS.split())


@dataclass
class FileSurface:
    """A surface while its commands are being read; `kind` is SO, S or SI.

    `given` names the quantities that have a value; `solved` those for which a solve stands, with its words
    and line.
    """

    kind: str
    name: str
    where: str
    radius_mm: float | None = None
    thickness_mm: float = 0.0
    glass: str = ""
    glass_where: str = ""
    conic: float = 0.0
    terms: dict[str, float] = field(default_factory=dict)
    semi_diameter_mm: float | None = None
    stop: bool = False
    moves: dict[str, float] = field(default_factory=dict)
    moved_how: str = ""
    given: set[str] = field(default_factory=set)
    solved: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def is_moved(self) -> bool:
        """Whether decenters or tilts are given for it."""
        return bool(self.moves)


@dataclass
class FileReader:
    """A file while it is being read."""

    draft: Draft
    surfaces: list[FileSurface] = field(default_factory=list)
    title: str = ""
    wavelengths_um: list[float] = field(default_factory=list)
    reference: int = 1
    heights: dict[str, list[float]] = field(default_factory=dict)
    holds_radii: bool | None = None
    in_private: bool = False
    private: dict[str, PrivateGlass] = field(default_factory=dict)
    private_nm: tuple[str, ...] = ()


def commands(lines: Sequence[str], source: str) -> Iterator[tuple[int, list[str]]]:
    """Commands of a file, each as its words, with the line on which it starts.

    Semicolons part commands, an ampersand at the end of a line goes on with the next, and an exclamation mark
    starts a comment.
    """
    words: list[str] = []
    start = 1
    for count, line in enumerate(lines, start=1):
        start = count if not words else start
        goes_on = False
        for word in _WORDS.findall(line):
            if word == ";":
                if words:
                    yield start, words
                words, start = [], count
            elif word.startswith("&"):
                goes_on = True
            elif not word.startswith("!"):
                words.append(word)
        if words and not goes_on:
            yield start, words
            words = []
    if words:
        raise InputError(f"{source}, line {start}: the command goes on behind the end of the file")


def take_command(reader: FileReader, words: list[str], where: str) -> None:
    """Take one command.

    Raises
    ------
    InputError
        If it does not hold what it must.
    """
    word, values = words[0].upper(), words[1:]
    if not _known(word) and _known(word[:3]) and word.isalpha():
        word = word[:3]  # CODE V reads three letters
    if reader.in_private:
        _take_private(reader, words, where)
    elif word in ("SO", "S", "SI") or re.fullmatch(r"S\d+", word):
        _start_surface(reader, word, values, where)
    elif word in _OF_FILE:
        _OF_FILE[word](reader, values, where)
    elif word in _OF_SURFACE:
        surface, rest = _addressed(reader, values, where)
        _OF_SURFACE[word](reader, surface, word, rest, where)
    elif word in _SOLVES:
        name = reader.surfaces[-1].name if reader.surfaces else where
        reader.draft.remark(f"{name}: {word} solve replaced by its present value")
    elif word not in _IDLE:
        place = reader.surfaces[-1].name if reader.surfaces else where.rpartition(", ")[2]
        reader.draft.lose(f"{place}: {shown(' '.join(words))}")


def _known(word: str) -> bool:
    return word in _OF_FILE or word in _OF_SURFACE or word in _SOLVES or word in _IDLE


def _take_private(reader: FileReader, words: list[str], where: str) -> None:
    if words[0].upper() == "END":
        reader.in_private = False
    elif words[0].upper() == "PWL":
        reader.private_nm = tuple(words[1:])
    else:
        name = words[0].strip("'\"")
        reader.private[name.upper()] = PrivateGlass(name, tuple(words[1:]), reader.private_nm, where)


def check_solves(reader: FileReader) -> None:
    """Say which solves were replaced by their present values.

    Raises
    ------
    InputError
        If the file has no present value of one.
    """
    for surface in reader.surfaces:
        for quantity, (words, where) in surface.solved.items():
            if quantity not in surface.given:
                raise InputError(
                    f"{where}: the {quantity} of {surface.name} is left to a solve or pickup "
                    f"({shown(words)}), and the "
                    "file does not give its present value; give the value instead"
                )
            reader.draft.remark(f"{surface.name}: {words.split()[0]} solve replaced by its present value")


def _solved(
    reader: FileReader, surface: FileSurface, quantity: str, values: Sequence[str], where: str
) -> bool:
    """Whether a solve or a pickup stands where a value could; else the quantity counts as given.

    Another word than a solve's is a loss where the quantity has its value already.
    """
    word = values[0].upper() if values else ""
    if word in _SOLVES:
        surface.solved[quantity] = (" ".join(values), where)
        return True
    if word.isalpha() and word not in _ENDLESS and quantity in surface.given:
        reader.draft.lose(f"{surface.name}: {quantity} by {shown(' '.join(values))}; its value is kept")
        return True
    surface.given.add(quantity)
    return False


def _addressed(reader: FileReader, values: list[str], where: str) -> tuple[FileSurface, list[str]]:
    """The surface that a command names (as S2), else the last one; and the rest of the command."""
    named = re.fullmatch(r"[Ss](\d{1,6}|[OoIi])", values[0]) if values else None
    if named is None:
        if not reader.surfaces:
            raise InputError(f"{where}: a command of a surface before the first surface")
        return reader.surfaces[-1], values
    key = named[1].upper()
    index = {"O": 0, "I": len(reader.surfaces) - 1}.get(key, int(key) if key.isdecimal() else 0)
    if not 0 <= index < len(reader.surfaces):
        raise InputError(f"{where}: there is no surface {shown(values[0])} yet")
    return reader.surfaces[index], values[1:]


def _start_surface(reader: FileReader, word: str, values: list[str], where: str) -> None:
    count = len(reader.surfaces)
    if (word == "SO") != (count == 0):
        raise InputError(f"{where}: {word} as surface {count}; the object (SO) comes first, and once")
    if reader.surfaces and reader.surfaces[-1].kind == "SI":
        raise InputError(f"{where}: {word} behind the image surface (SI)")
    if count > MOST_SURFACES:
        raise InputError(f"{where}: more than {MOST_SURFACES} surfaces")
    surface = FileSurface(word if word in ("SO", "SI") else "S", f"surface {count}", where)
    reader.surfaces.append(surface)
    if values and not _solved(reader, surface, "radius", values, where):
        value = _finite_or_plane(values[0], where)
        if value and reader.holds_radii is None:
            raise InputError(
                f"{where}: {shown(values[0])} may be a radius or a curvature; RDM or RDM N must come before"
            )
        surface.radius_mm = value or None
        if value and not reader.holds_radii:
            surface.radius_mm = _inverse(value, where)
    if len(values) > 1:
        _thickness(reader, surface, "THI", values[1:], where)
    if len(values) > 2:
        _glass(reader, surface, "GLA", values[2:], where)


def _finite_or_plane(text: str, where: str) -> float:
    """A radius or curvature; an infinite radius is a plane, as 0 is."""
    return 0.0 if text.upper() in _ENDLESS else number(text, where)


def _inverse(curvature: float, where: str) -> float:
    radius = 1.0 / curvature
    if not math.isfinite(radius):
        raise InputError(f"{where}: curvature {curvature:g} is too small for a number to hold its radius")
    return radius


def _value(values: Sequence[str], where: str) -> float:
    if not values:
        raise InputError(f"{where}: a command without its value")
    return number(values[0], where)


def _radius(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    if _solved(reader, surface, "radius", values, where):
        return
    value = _finite_or_plane(values[0], where) if values else _value(values, where)
    surface.radius_mm = value or None
    if value and word == "CUY":
        surface.radius_mm = _inverse(value, where)


def _thickness(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    if _solved(reader, surface, "thickness", values, where):
        return
    endless = bool(values) and values[0].upper() in _ENDLESS
    value = math.inf if endless else _value(values, where)
    surface.thickness_mm = math.inf if value >= INFINITE_MM else value


def _glass(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    if not values:
        raise InputError(f"{where}: a glass without its name")
    surface.glass, surface.glass_where = values[0].strip("'\""), where


def _conic(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    if not _solved(reader, surface, "conic constant", values, where):
        surface.conic = _value(values, where)


def _term(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    if not _solved(reader, surface, f"asphere term {word}", values, where):
        surface.terms[word] = _value(values, where)


def _aperture(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    kind = values[0].upper() if len(values) > 1 else "CLR"
    if kind == "EDG":
        return
    if kind != "CLR":
        reader.draft.lose(f"{surface.name}: aperture CIR {shown(' '.join(values))}")
        return
    value = _value(values[-1:], where)
    surface.semi_diameter_mm = value if value > 0.0 else None


def _fresnel(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    if _value(values, where):
        reader.draft.lose(f"{surface.name}: Fresnel base curvature of {values[0]}")


def _stop(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    surface.stop = True


def _move(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    if not _solved(reader, surface, word, values, where):
        surface.moves[word] = _value(values, where)


def _move_kind(reader: FileReader, surface: FileSurface, word: str, values: list[str], where: str) -> None:
    surface.moved_how = word
    if word not in ("DAR", "REV"):
        reader.draft.lose(f"{surface.name}: {word}")


_OF_SURFACE: dict[str, Callable[[FileReader, FileSurface, str, list[str], str], None]] = {
    "RDY": _radius,
    "CUY": _radius,
    "THI": _thickness,
    "GLA": _glass,
    "GL1": _glass,
    "K": _conic,
    "CIR": _aperture,
    "CUF": _fresnel,
    "STO": _stop,
    **dict.fromkeys(CODEV_LETTERS, _term),
    **dict.fromkeys(("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE"), _move),
    **dict.fromkeys(("DAR", "REV", "BEN", "RET", "GLB"), _move_kind),
}


def _mode(reader: FileReader, values: list[str], where: str) -> None:
    reader.holds_radii = not values or not values[0].upper().startswith("N")


def _dimension(reader: FileReader, values: list[str], where: str) -> None:
    if not values or values[0].upper() not in ("M", "MM"):
        raise InputError(f"{where}: DIM {shown(' '.join(values))}; only lengths in mm (M) can be read")


def _title(reader: FileReader, values: list[str], where: str) -> None:
    reader.title = " ".join(" ".join(v.strip("'\"") for v in values).split())


def _aperture_kind(kind: str) -> Callable[[FileReader, list[str], str], None]:
    def take(reader: FileReader, values: list[str], where: str) -> None:
        reader.draft.aperture = (kind, _value(values, where))

    return take


def _wavelengths(reader: FileReader, values: list[str], where: str) -> None:
    for value in values:
        number(value, where)
    reader.wavelengths_um = [float(Decimal(v.lower().replace("d", "e")) / 1000) for v in values]


def _reference(reader: FileReader, values: list[str], where: str) -> None:
    value = _value(values, where)
    reader.reference = int(value) if 0.0 < value < 1e3 else 0


def _temperature(reader: FileReader, values: list[str], where: str) -> None:
    if any(number(v, where) not in (20.0, 22.0) for v in values):
        reader.draft.lose(f"temperature of {shown(' '.join(values))} degrees C")


def _pressure(reader: FileReader, values: list[str], where: str) -> None:
    if any(number(v, where) != 760.0 for v in values):
        reader.draft.lose(f"pressure of {shown(' '.join(values))} mmHg")


def _private(reader: FileReader, values: list[str], where: str) -> None:
    reader.in_private = True


_OF_FILE: dict[str, Callable[[FileReader, list[str], str], None]] = {
    "RDM": _mode,
    "DIM": _dimension,
    "TIT": _title,
    "TITLE": _title,
    "NAO": _aperture_kind("object_na"),
    "NA": _aperture_kind("image_na"),
    "EPD": _aperture_kind("pupil_diameter_mm"),
    "FNO": _aperture_kind("working_f_number"),
    "WL": _wavelengths,
    "REF": _reference,
    "XOB": heights_of("XOB"),
    "YOB": heights_of("YOB"),
    **dict.fromkeys(("VUX", "VLX", "VUY", "VLY"), lose_vignetting),
    "TEM": _temperature,
    "PRE": _pressure,
    "PRV": _private,
}
