"""Read lens files of OSLO (.len).

The reader supports

- LEN NEW with the name and the number of surfaces; lengths in mm (UNI 1.0);
- the surfaces 0 (object) to the image, separated by NXT: RD or CV, TH, the conic constant CC and the asphere
  coefficients AD, AE, AF and AG (r^4 to r^10);
- the media AIR, catalogue glasses (GLA name), and glasses given by an index at each wavelength (GLA 1.5168,
  GLA MOD name 1.5168 1.5224);
- apertures AP CHK, which block rays, and the aperture stop AST; without AST, surface 1 is the stop;
- the entrance beam radius EBR at surface 1 and the object NA NAO, the object height OBH, and wavelengths WV
  in um (the first one is the primary wavelength);
- the solves PY, PU, PI, PYC, PUC, PIC and EC, and the pickups PK CV, TH, LN, GLA, AP, which
  :mod:`lensdesign.files.oslo_surfaces` evaluates in the order of the surfaces, because the file holds no
  present values of them;
- the focus shift, which is the thickness of the image surface.

It ignores weights, notes, thermal expansion, drawings, and the blocks VAR, OPE and RST behind the lens, which
do not describe it. Every other command that a design cannot represent is reported as a loss. The focal length
in the LEN command is a value that the user once entered (100 for a new lens), so nothing is compared with it.

The commands follow the OSLO Program Reference and the OSLO Optics Reference (Lambda Research).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from lensdesign.errors import InputError, MaterialError
from lensdesign.files.assembly import assemble
from lensdesign.files.draft import (
    MAX_SURFACES,
    Draft,
    Imported,
    RecordedSurface,
    Supplement,
    SurfaceRow,
    find_glass_of_unknown_maker,
    parse_number,
    quoted,
    read_lines,
    starts_as_number,
)
from lensdesign.files.index_tables import LARGEST_INDEX, tabulated_index
from lensdesign.files.oslo_surfaces import (
    PICKUPS,
    SOLVED_QUANTITIES,
    TERMS,
    Beam,
    FileSurface,
    Solve,
    evaluate_solves,
)
from lensdesign.lens.catalogues.thermal import LOWEST_INDEX
from lensdesign.lens.glass import list_glasses, refractive_index
from lensdesign.lens.shapes.even_asphere import without_zeros

INFINITE_MM = 1e8
"""Distance from which OSLO treats the object as infinitely far."""

DEFAULT_WAVELENGTHS_UM = (0.58756, 0.48613, 0.65627)
"""Wavelengths of a new lens in OSLO; the commands WV, WV2, ... replace them."""


def read_len(
    path: str | os.PathLike[str], supplement: Supplement | None = None, lossy: bool = False
) -> Imported:
    """Read a lens from an OSLO lens file (.len).

    Parameters
    ----------
    path
        A file of OSLO commands that define a lens, in mm: text in UTF-8, UTF-16 or Latin-1.
    supplement
        Values that a design needs and the file lacks (default: none).
    lossy
        Whether to import a file that a design can represent only in part (default: False).

    Returns
    -------
    Imported
        The lens, and the lists of losses and remarks. The pose is always the nominal one.

    Raises
    ------
    LossyImportError
        If a design cannot represent the whole file and `lossy` is False. The message lists the losses.
    InputError
        If the file cannot be read or does not describe a lens. The message names the file and the line or
        surface.
    MaterialError
        If a glass is unknown.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lensdesign import read_len
    >>> from lensdesign.files import Supplement
    >>> _ = Path("lens.len").write_text(
    ...     'LEN NEW "Singlet" 100 3; NAO 0.1; OBH 4; UNI 1; WV 0.5876; TH 60; NXT; '
    ...     'GLA N-BK7; RD 50; TH 5; NXT; RD -50; PY 0; NXT; END 3'
    ... )
    >>> imported = read_len("lens.len", Supplement(pixel_pitch_um=3.2, pixels=(1000, 800)))
    >>> imported.lens.surfaces[0].material, round(imported.first_order.efl_mm, 3)
    ('N-BK7', 49.213)
    """
    supplement = supplement or Supplement()
    reader = FileReader(Draft(source=str(path)))
    lines = read_lines(path, "CODE V's own lens files end in .len, too: save such a lens there as .seq")
    for count, words in commands(lines, str(path)):
        _read_command(reader, words, f"{path}, line {count}")
    _check_complete(reader, supplement)
    _set_stop(reader)
    _set_aperture(reader)
    _set_materials(reader, supplement)
    _evaluate_solves(reader, supplement)
    return assemble(_finished(reader), supplement, lossy)


@dataclass
class FileReader:
    """State of the reader of one file.

    `aperture` is the system aperture as the file states it: EBR or NAO, its value, and its location. `field`
    is OBH or ANG and its value. `block` is the name of the open block behind the lens.
    """

    draft: Draft
    surfaces: list[FileSurface] = field(default_factory=list)
    surface_count: int | None = None
    wavelengths_um: list[float] = field(default_factory=lambda: list(DEFAULT_WAVELENGTHS_UM))
    has_wavelengths: bool = False
    has_units: bool = False
    aperture: tuple[str, float, str] | None = None
    field: tuple[str, float] | None = None
    ended: bool = False
    block: str = ""

    @property
    def is_infinite(self) -> bool:
        """True if the object is at infinity."""
        return self.surfaces[0].thickness_mm == math.inf


_WORDS = re.compile(r"""//.*|"(?:\\.|[^"\\])*"|;|(?:(?!//)[^\s;"])+|\"""")


def commands(lines: Sequence[str], source: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the commands of a file: the number of the line and the words of each.

    A semicolon separates commands. Two slashes start a comment.

    Raises
    ------
    InputError
        If a quotation mark is not closed.
    """
    for count, line in enumerate(lines, start=1):
        words: list[str] = []
        for match in _WORDS.finditer(line):  # stops at the first quotation mark that is not closed
            word = match[0]
            if word == '"':
                raise InputError(f"{source}, line {count}: a quotation mark is not closed")
            if word.startswith("//"):
                break
            if word != ";":
                words.append(word)
            elif words:
                yield count, words
                words = []
        if words:
            yield count, words


def _read_command(reader: FileReader, words: list[str], location: str) -> None:
    """Interpret one command."""
    word, values = words[0].upper(), words[1:]
    if word == "LEN":
        _start_lens(reader, values, location)
    elif not reader.surfaces:
        raise InputError(f"{location}: {quoted(words[0])} before LEN NEW, which starts an OSLO lens file")
    elif reader.ended:
        _read_trailing(reader, word, words, location)
    elif word in _STRUCTURAL:
        raise InputError(f"{location}: {quoted(' '.join(words))}; only files in the order of NXT are read")
    elif word in _OF_FILE:
        _OF_FILE[word](reader, values, location)
    elif re.fullmatch(r"WV[1-9]\d{0,2}", word):
        _single_wavelength(reader, int(word[2:]), values, location)
    elif word in _OF_SURFACE:
        _OF_SURFACE[word](reader, reader.surfaces[-1], word, values, location)
    elif word not in _IDLE and not _IDLE_FORMS.fullmatch(word):
        _lose(reader, word, words, location)


def _start_lens(reader: FileReader, values: list[str], location: str) -> None:
    if reader.surfaces:
        raise InputError(f"{location}: a second LEN; a file must hold one lens")
    if len(values) not in (2, 4) or values[0].upper() != "NEW" or not values[1].startswith('"'):
        raise InputError(
            f"{location}: LEN {quoted(' '.join(values))}; "
            'expected is LEN NEW "name", a focal length and the number of surfaces'
        )
    reader.draft.title = " ".join(re.sub(r"\\(.)", r"\1", values[1][1:-1]).split())
    if len(values) == 4:
        parse_number(values[2], location)
        reader.surface_count = _whole(values[3], location)
    reader.surfaces.append(FileSurface("surface 0", location))


def _whole(text: str, location: str) -> int:
    if not re.fullmatch(r"[+-]?\d{1,6}", text, re.ASCII):
        raise InputError(f"{location}: {quoted(text)} must be a whole number")
    return int(text)


def _next_surface(reader: FileReader, values: list[str], location: str) -> None:
    count = len(reader.surfaces)
    if count > MAX_SURFACES:
        raise InputError(f"{location}: more than {MAX_SURFACES} surfaces")
    reader.surfaces.append(FileSurface(f"surface {count}", location))


def _end(reader: FileReader, values: list[str], location: str) -> None:
    last = len(reader.surfaces) - 1
    stated = [_whole(v, location) for v in values[:1]]
    if reader.surface_count is not None:
        stated.append(reader.surface_count)
    for number in stated:
        if number != last:
            raise InputError(
                f"{location}: the file states {number} surfaces behind the object, but has {last}; is it "
                "damaged?"
            )
    reader.ended = True


# Settings of blocks behind the lens: variables, error function, field points and rays.
_IDLE_BLOCKS = ("VAR", "OPE", "RST")


def _read_trailing(reader: FileReader, word: str, words: list[str], location: str) -> None:
    """Interpret a command behind the lens; a block extends to its END."""
    if reader.block:
        if word == "END":
            reader.block = ""
        elif reader.block == "RST" and word == "F":
            _check_pupil_bounds(reader, words[2:], location)
    elif word == "CFG" or word in _IDLE_BLOCKS:
        reader.block = word
        if word == "CFG":
            reader.draft.add_loss(f"{_line(location)}: configurations (CFG); the first one is read")
    elif not _IDLE_FORMS.fullmatch(word):
        reader.draft.add_loss(f"{_line(location)}: {quoted(' '.join(words))}")


def _check_pupil_bounds(reader: FileReader, values: list[str], location: str) -> None:
    """Add a loss if the pupil of a field point is not the whole one: bounds -1 and 1 along y and x."""
    bounds = [parse_number(v, location) for v in values[5:9]]
    if any(bound != (-1.0, 1.0)[i % 2] for i, bound in enumerate(bounds)):
        reader.draft.add_loss("vignetting factors")


def _line(location: str) -> str:
    return location.rpartition(", ")[2]


# Commands that change the order of the surfaces.
_STRUCTURAL = ("GTO", "INS", "DEL", "REV", "INV")

# Designer, notes, weights, and settings of analyses or drawings. They do not describe the lens. Fields at
# infinity are angles (ANG) or image heights (GIH); a design needs an object height instead.
_IDLE_WORDS = "DES NOT WW TCE GIH DRW LDP CBK ELMDF1 ELMDF2 BDI BDD VX PF LMN LME DT"
_IDLE = frozenset(_IDLE_WORDS.split())

# Notes, weights, and the conditions of lens drawings (DLRS, DLNF, DLFD, ...).
_IDLE_FORMS = re.compile(r"SNO\d+|WW\d+|DL[A-Z]{2}")

_MOVED = "decenter or tilt"

_LOST_IF_NOT_ZERO = {
    **dict.fromkeys(("DCX", "DCY", "DCZ", "TLA", "TLB", "TLC", "TOX", "TOY", "TOZ"), _MOVED),
    **dict.fromkeys(("CVX", "RDX"), "toroid or cylinder"),
    **dict.fromkeys(("AH", "AI", "AJ"), "asphere term"),
}

_LOST = {
    **dict.fromkeys(("PFL", "PFM"), "perfect lens"),
    **dict.fromkeys(("GSP", "GOR", "GDP"), "grating"),
    **dict.fromkeys(("RFL", "RFH"), "mirror, read as a surface in air,"),
    **dict.fromkeys(("RCO", "BEN", "GC"), "coordinates of another surface"),
    **dict.fromkeys(("NAP", "FNO", "PUK"), "system aperture at the image"),
    "TELE": "telecentric object space",
    "LMO": "group of surfaces",
    "CALLBACK": "commands that OSLO runs",
}


def _lose(reader: FileReader, word: str, words: list[str], location: str) -> None:
    """Add a command to the losses, unless it states that there is nothing to lose."""
    values = words[1:]
    kind = _LOST_IF_NOT_ZERO.get(word, "")
    if (kind or re.fullmatch(r"AS\d+", word)) and len(values) == 1 and not parse_number(values[0], location):
        return
    state = values[0].upper() if len(values) == 1 else ""
    if (word, state) in (("TELE", "OFF"), ("APCK", "ON"), ("CALLBACK", "0"), ("ASP", "ADO")):
        return
    if word == "LMO" and values and values[0].upper() in ("ELE", "EGR"):  # elements, for drawings
        return
    surface = reader.surfaces[-1]
    surface.is_misread, surface.is_moved = True, surface.is_moved or kind == _MOVED
    kind = kind or _LOST.get(word, "")
    reader.draft.add_loss(
        f"{surface.name}, {_line(location)}: {kind + ' ' if kind else ''}{quoted(' '.join(words))}"
    )


def _value(word: str, values: Sequence[str], location: str) -> float:
    if len(values) != 1:
        raise InputError(f"{location}: {word} has {len(values)} values; it needs one")
    return parse_number(values[0], location)


def _note_given(surface: FileSurface, quantity: str, word: str, location: str) -> None:
    """Record that a command gives a quantity.

    Raises
    ------
    InputError
        If another command of the surface gives it, too.
    """
    if quantity in surface.given:
        raise InputError(
            f"{location}: {word} gives the {quantity} of {surface.name}, which {surface.given[quantity]} "
            "gives already"
        )
    surface.given[quantity] = word


def _radius(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    _note_given(surface, "radius", word, location)
    value = _value(word, values, location)
    if value:
        inverse = 1.0 / value
        if not math.isfinite(inverse):
            raise InputError(f"{location}: {word} of {value:g}; its inverse exceeds the range of numbers")
        surface.radius_mm, surface.curvature_per_mm = (value, inverse) if word == "RD" else (inverse, value)


def _thickness(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    _note_given(surface, "thickness", word, location)
    value = _value(word, values, location)
    surface.thickness_mm = math.inf if value >= INFINITE_MM else value


def _air(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    _note_given(surface, "medium", word, location)


def _glass(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    _note_given(surface, "medium", word, location)
    if not values:
        raise InputError(f"{location}: GLA without a glass")
    surface.glass = tuple(v.strip('"') for v in values)
    surface.glass_location = f"{location} ({surface.name})"
    surface.glass_wavelengths_um = tuple(reader.wavelengths_um)


def _aperture(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    _note_given(surface, "aperture", word, location)
    checked = bool(values) and values[0].upper() == "CHK"
    value = _value(word, values[1:] if checked else values, location)
    if value < 0.0:
        raise InputError(f"{location}: AP of {value:g}; an aperture must be at least 0")
    if value and checked:
        surface.semi_diameter_mm = value
    elif value:
        surface.unchecked_mm = value


def _conic(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    _note_given(surface, "conic constant", word, location)
    surface.conic = _value(word, values, location)


def _term(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    _note_given(surface, f"asphere term {word}", word, location)
    surface.terms[word] = _value(word, values, location)


def _stop(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    surface.stop = True


def _solve(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    quantity = SOLVED_QUANTITIES[word]
    _note_given(surface, quantity, word, location)
    if _value(word, values, location) < 0.0 and word == "EC":
        raise InputError(f"{location}: EC of {values[0]}; the height of an edge must be at least 0")
    surface.solved[quantity] = Solve((word, *values), location)


def _pickup(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    kind = values[0].upper() if values else ""
    text = quoted(" ".join([word, *values]))
    if kind in ("TD", "TDM") and len(values) == 2:
        if reader.surfaces[_source(reader, surface, values[1], location)].is_moved:
            surface.is_misread = surface.is_moved = True
            reader.draft.add_loss(f"{surface.name}, {_line(location)}: {_MOVED} {text}")
        return
    quantity, sources, optional = PICKUPS.get(kind, ("", 0, 0))
    if not 0 < sources < len(values) <= 1 + sources + optional:
        raise InputError(
            f"{location}: {surface.name} has the pickup {text}, which is not supported; replace it by its "
            "value in OSLO and save the file again"
        )
    first = _source(reader, surface, values[1], location)
    named = [first]
    if sources == 2:
        current = len(reader.surfaces) - 1
        is_current = _whole(values[2], location) == 0
        named.append(current if is_current else _source(reader, surface, values[2], location))
        if named[1] <= first:
            raise InputError(f"{location}: {text} of {surface.name} ends in front of its first surface")
    _note_given(surface, quantity, f"PK {kind}", location)
    if quantity == "radius":
        for part in ("conic constant", *(f"asphere term {term}" for term in TERMS)):
            _note_given(surface, part, f"PK {kind}", location)
    for value in values[1 + sources :]:
        parse_number(value, location)
    surface.solved[quantity] = Solve((word, kind, *values[1:]), location, tuple(named))


def _source(reader: FileReader, surface: FileSurface, text: str, location: str) -> int:
    """Return the number of a preceding surface: absolute, or counted backwards if negative."""
    current, number = len(reader.surfaces) - 1, _whole(text, location)
    source = current + number if number < 0 else number
    if not 0 <= source < current:
        raise InputError(
            f"{location}: {surface.name} picks up from {quoted(text)}; only a preceding surface, by its "
            "number or counted backwards (-1, -2, ...), is understood"
        )
    return source


_OF_SURFACE: dict[str, Callable[[FileReader, FileSurface, str, list[str], str], None]] = {
    "RD": _radius,
    "CV": _radius,
    "TH": _thickness,
    "AIR": _air,
    "GLA": _glass,
    "AP": _aperture,
    "CC": _conic,
    "AST": _stop,
    **dict.fromkeys(TERMS, _term),
    **dict.fromkeys(SOLVED_QUANTITIES, _solve),
    "PK": _pickup,
}


def _units(reader: FileReader, values: list[str], location: str) -> None:
    value = _value("UNI", values, location)
    if value != 1.0:
        raise InputError(
            f"{location}: UNI {values[0]}: a unit of {value:g} mm; only lengths in mm (1.0) can be read"
        )
    reader.has_units = True


def _system_aperture(word: str) -> Callable[[FileReader, list[str], str], None]:
    def read(reader: FileReader, values: list[str], location: str) -> None:
        value = _value(word, values, location)
        if reader.aperture is not None:
            raise InputError(f"{location}: {word} is a second system aperture beside {reader.aperture[0]}")
        if value <= 0.0 or (word == "NAO" and value >= 1.0):
            allowed = "between 0 and 1" if word == "NAO" else "greater than 0"
            raise InputError(f"{location}: {word} of {value:g} must be {allowed}")
        reader.aperture = (word, value, location)

    return read


def _object_height(reader: FileReader, values: list[str], location: str) -> None:
    reader.field = ("OBH", _value("OBH", values, location))
    reader.draft.half_field_mm = abs(reader.field[1])


def _field_angle(reader: FileReader, values: list[str], location: str) -> None:
    reader.field = ("ANG", _value("ANG", values, location))


def _wavelengths(reader: FileReader, values: list[str], location: str) -> None:
    if not values:
        raise InputError(f"{location}: WV without a wavelength")
    reader.wavelengths_um = [_wavelength(v, location) for v in values]
    reader.has_wavelengths = True


def _single_wavelength(reader: FileReader, number: int, values: list[str], location: str) -> None:
    value = _wavelength(values[0] if len(values) == 1 else " ".join(values), location)
    if number > len(reader.wavelengths_um) + 1:
        raise InputError(f"{location}: WV{number}, but there are {len(reader.wavelengths_um)} wavelengths")
    reader.wavelengths_um[number - 1 : number] = [value]
    reader.has_wavelengths = True


def _wavelength(text: str, location: str) -> float:
    value = parse_number(text, location)
    if value <= 0.0:
        raise InputError(f"{location}: a wavelength of {value:g} um; it must be greater than 0")
    return value


_OF_FILE: dict[str, Callable[[FileReader, list[str], str], None]] = {
    "NXT": _next_surface,
    "END": _end,
    "UNI": _units,
    "EBR": _system_aperture("EBR"),
    "NAO": _system_aperture("NAO"),
    "OBH": _object_height,
    "ANG": _field_angle,
    "WV": _wavelengths,
}


def _check_complete(reader: FileReader, supplement: Supplement) -> None:
    """Check that the file ends where it should, and add remarks on values that OSLO supplies."""
    source, draft = reader.draft.source, reader.draft
    if not reader.surfaces:
        raise InputError(f"{source}: no LEN NEW found; an OSLO lens file starts with it")
    if not reader.ended:
        raise InputError(f"{source}: no END behind {reader.surfaces[-1].name}; is the file cut short?")
    if reader.block:
        raise InputError(f"{source}: no END behind {reader.block}; is the file cut short?")
    if len(reader.surfaces) < 3:
        raise InputError(
            f"{source}: {len(reader.surfaces)} surfaces found; there must be an object, a surface and an "
            "image"
        )
    if not reader.has_units:
        draft.add_remark("the file states no units (UNI); lengths are read as mm, as OSLO does")
    reader.wavelengths_um = supplement.wavelengths_or(
        reader.wavelengths_um if reader.has_wavelengths or not supplement.wavelengths_um else (), draft
    )
    if not (reader.has_wavelengths or supplement.wavelengths_um):
        draft.add_remark(
            "the file states no wavelengths (WV); those of a new lens in OSLO are used: "
            + ", ".join(f"{w:g}" for w in DEFAULT_WAVELENGTHS_UM)
            + " um"
        )
    draft.wavelengths_um = reader.wavelengths_um
    image = reader.surfaces[-1]
    if "thickness" in image.solved:
        draft.add_loss(f"{image.name}: focus shift by {quoted(image.solved.pop('thickness').text)}")
    _pick_up_apertures(reader)
    unchecked = [s for s in reader.surfaces[1:-1] if s.unchecked_mm is not None]
    if unchecked:
        draft.add_remark(
            "apertures that do not block rays (AP without CHK) were ignored: "
            + ", ".join(f"{s.name} {s.unchecked_mm:.6g} mm" for s in unchecked)
        )


def _pick_up_apertures(reader: FileReader) -> None:
    """Replace pickups of apertures by their values, which do not block rays."""
    for surface in reader.surfaces:
        solve = surface.solved.pop("aperture", None)
        if solve is not None:
            source = reader.surfaces[solve.sources[0]]
            surface.unchecked_mm = source.semi_diameter_mm or source.unchecked_mm
            value = f"an aperture of {surface.unchecked_mm:.6g} mm" if surface.unchecked_mm else "none"
            reader.draft.add_remark(f"{surface.name}: {solve.text} replaced by its value, {value}")


def _set_stop(reader: FileReader) -> None:
    """Set the stop; in a file without AST it is surface 1."""
    stops = [s for s in reader.surfaces if s.stop]
    inner = reader.surfaces[1:-1]
    if len(stops) > 1 or any(s is reader.surfaces[0] or s is reader.surfaces[-1] for s in stops):
        names = ", ".join(s.name for s in stops)
        raise InputError(
            f"{reader.draft.source}: aperture stop (AST) at {names}; it must be one surface between the "
            "object and the image"
        )
    if not stops and inner:
        inner[0].stop = True
        reader.draft.add_remark("the file marks no aperture stop (AST); in OSLO it is surface 1 then")


def _set_aperture(reader: FileReader) -> None:
    """Convert the system aperture: EBR is the beam's radius at surface 1."""
    if reader.aperture is None:
        return
    word, value, location = reader.aperture
    distance = reader.surfaces[0].thickness_mm
    if word == "NAO" and reader.is_infinite:
        raise InputError(f"{location}: an object NA (NAO), but the object is at infinity")
    if word == "NAO":
        reader.draft.aperture = ("object_na", value)
    elif reader.is_infinite:
        reader.draft.aperture = ("pupil_diameter_mm", 2.0 * value)
    elif distance > 0.0:
        reader.draft.aperture = ("object_na", math.sin(math.atan(value / distance)))


def _set_materials(reader: FileReader, supplement: Supplement) -> None:
    """Set the medium behind each surface, in order, because a pickup copies a preceding one."""
    for surface in reader.surfaces:
        solve = surface.solved.pop("medium", None)
        if solve is not None:
            surface.material = reader.surfaces[solve.sources[0]].material
            reader.draft.add_remark(
                f"{surface.name}: pickup of the glass replaced by {surface.material or 'AIR'}"
            )
        else:
            surface.material = _material(reader, surface, supplement)


def _material(reader: FileReader, surface: FileSurface, supplement: Supplement) -> str | float | None:
    """Return the medium behind a surface: None for air, a glass name, or an index."""
    words = surface.glass
    if not words or (len(words) == 1 and words[0].upper() == "AIR"):
        return None
    model = words[0].upper() == "MOD"
    values = list(words[1:]) if model else list(words)
    name = "" if values and starts_as_number(values[0]) else "".join(values[:1])
    indices = values[1:] if name else values
    if indices:
        return _tabulated(reader, surface, name, indices)
    if model:
        raise InputError(f"{surface.glass_location}: model glass {quoted(' '.join(words))} without an index")
    return _catalog_glass(reader, surface, name, supplement)


def _tabulated(reader: FileReader, surface: FileSurface, name: str, values: Sequence[str]) -> float:
    """Return the index of a glass that the file defines by its index at each wavelength."""
    location = surface.glass_location
    label = f"the model glass {name}" if name else f"the glass {quoted(' '.join(values))}"
    indices = [parse_number(v, location) for v in values]
    for index in indices:
        if not LOWEST_INDEX <= index <= LARGEST_INDEX:
            raise InputError(
                f"{location}: {label} has an index of {index:g}; allowed is {LOWEST_INDEX} to "
                f"{LARGEST_INDEX:g}, one for each wavelength"
            )
    if len(set(indices)) == 1:
        return indices[0]
    wavelengths_um = surface.glass_wavelengths_um
    if len(indices) != len(wavelengths_um):
        raise InputError(
            f"{location}: {label} has {len(indices)} indices, and there are {len(wavelengths_um)} "
            "wavelengths (WV) in front of it"
        )
    wavelengths_nm = [1000.0 * w for w in wavelengths_um]
    index, remark, loss = tabulated_index(label, wavelengths_nm, indices, 1000.0 * reader.wavelengths_um[0])
    if remark:
        reader.draft.add_remark(f"{surface.name}: {remark}")
    if loss:
        reader.draft.add_loss(f"{surface.name}: {loss}")
    if len(reader.wavelengths_um) > 1:
        reader.draft.add_loss(f"{surface.name}: dispersion of {label}")
    return index


def _catalog_glass(reader: FileReader, surface: FileSurface, name: str, supplement: Supplement) -> str:
    location, catalogs = surface.glass_location, supplement.glass_catalogs
    own = {path.name for path in catalogs}
    prefix = re.fullmatch(
        r"[A-Za-z]_.+", name
    )  # a maker in OSLO's own catalogues; which one is not documented
    if prefix and not any(n.casefold() == name.casefold() for n, c in list_glasses(catalogs) if c in own):
        raise MaterialError(
            f"{location}: glass {quoted(name)}: the maker of the prefix {name[:2]} is not known; replace "
            "the name by the maker's, or give a glass catalogue that has it"
        )

    def remark(message: str) -> None:
        reader.draft.add_remark(f"{surface.name}: {message}")

    return find_glass_of_unknown_maker(name, catalogs, location, remark)


def _evaluate_solves(reader: FileReader, supplement: Supplement) -> None:
    """Replace solves and pickups by their values."""
    aperture = None if reader.aperture is None else reader.aperture[:2]
    beam = Beam(reader.surfaces[0].thickness_mm, aperture, reader.field)
    evaluate_solves(
        reader.surfaces,
        beam,
        lambda surface: _index(reader, surface, supplement),
        reader.draft.add_remark,
    )


def _index(reader: FileReader, surface: FileSurface, supplement: Supplement) -> float:
    if surface.material is None:
        return 1.0
    try:
        return refractive_index(surface.material, reader.wavelengths_um[0], supplement.glass_catalogs)
    except MaterialError as error:
        raise MaterialError(f"{surface.glass_location}: {error}") from error


def _finished(reader: FileReader) -> Draft:
    """Return the draft, completed with the surfaces."""
    draft = reader.draft
    if reader.is_infinite:
        draft.half_field_mm = None  # OSLO states angles then; OBH lies at infinity
    for surface in reader.surfaces:
        draft.rows.append(
            SurfaceRow(
                surface.name,
                surface.location,
                surface.radius_mm,
                surface.conic,
                {"asphere": without_zeros([surface.terms.get(letter, 0.0) for letter in TERMS])},
                surface.thickness_mm,
                surface.material,
                surface.semi_diameter_mm,
                surface.stop,
            )
        )
        draft.recorded.append(
            RecordedSurface(surface.curvature_per_mm, surface.thickness_mm, surface.material, surface.stop)
        )
    draft.check_object_and_image()
    draft.apply_focus_shift()
    return draft
