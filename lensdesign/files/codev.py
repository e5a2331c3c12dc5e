"""Read and write sequence files of CODE V (.seq) that hold lens data.

The reader supports

- lengths in mm, cm or inches (DIM), which become mm;
- RDM with S lines of radius (after RDM N: curvature), thickness and glass; and RDY, CUY, THI and GLA;
- the conic constant K and the asphere coefficients A to J (r^4 to r^20) of CON and ASP surfaces;
- circular apertures CIR and the stop STO;
- the system apertures NAO, NA, EPD and FNO (working F-number);
- object heights XOB and YOB, and wavelengths WL in nm (the reference REF comes first);
- catalogue glasses such as NBK7_SCHOTT, private glasses (PRV) given by indices or dispersion formulas, and
  glass codes (:mod:`lensdesign.files.codev_glasses`);
- the focus shift, which is the thickness of the image surface SI;
- the surfaces that a command names: S2, S2..4, SA (all), SO, SI, SS (the stop), also relative ones (SI-1);
- the present values of solves and pickups;
- XDE, YDE, ADE and BDE of a pair of surfaces, plain and REV, which become the pose of the whole lens.

It ignores weights, coupling codes, labels, identifiers, tolerances, compensators, and settings of analyses or
drawings, which do not describe the lens. Every other command or word that a design cannot represent is
reported as a loss. The commands follow the CODE V Reference Manual (Synopsys). There, the tilts ADE and BDE
are left-handed.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError
from lensdesign.files.assembly import assemble
from lensdesign.files.codev_glasses import PrivateGlass, coded_glass
from lensdesign.files.draft import (
    MAX_SURFACES,
    NO_WAVELENGTH,
    NOTE,
    CoordinateBreak,
    Draft,
    Imported,
    RecordedSurface,
    Supplement,
    SurfaceRow,
    check_writable,
    cover_glass_surfaces,
    field_height_reader,
    find_glass,
    find_glass_of_unknown_maker,
    losses_named,
    note_lines,
    omissions,
    parse_number,
    plain_title,
    pose_break,
    pose_distances,
    quoted,
    read_lines,
    read_note,
    read_vignetting,
    starts_as_number,
    written_surfaces,
)
from lensdesign.files.index_records import IndexRecord
from lensdesign.lens.glass import get_material, normalized_name, refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.shapes.even_asphere import CODEV_LETTERS, without_zeros
from lensdesign.lens.surface import Surface

MAKERS = ("SCHOTT", "OHARA", "HOYA", "CDGM", "HIKARI", "SUMITA", "CORNING")
"""Glass catalogues that CODE V also supplies."""


def read_seq(
    path: str | os.PathLike[str], supplement: Supplement | None = None, lossy: bool = False
) -> Imported:
    """Read a lens from a CODE V sequence file (.seq).

    Parameters
    ----------
    path
        A file of CODE V commands that define a lens: text in UTF-8, UTF-16 or Latin-1.
    supplement
        Values that a design needs and the file lacks (default: none). Files of :func:`write_seq` need no
        supplement, because their comments hold these values.
    lossy
        Whether to import a file that a design can represent only in part (default: False).

    Returns
    -------
    Imported
        The lens, its pose, and the lists of losses and remarks.

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
    >>> from lensdesign import Pose, load_design, read_seq, write_seq
    >>> write_seq(load_design("designs/paper_singlet.toml"), "decentered.seq", Pose(decenter_y_mm=0.1))
    >>> imported = read_seq("decentered.seq")
    >>> imported.pose.decenter_y_mm, imported.dropped, round(imported.first_order.efl_mm, 3)
    (0.1, (), 19.166)
    """
    supplement = supplement or Supplement()
    reader = FileReader(Draft(source=str(path)))
    lines = read_lines(path)
    for count, line in enumerate(lines, start=1):
        text = line.strip().lstrip("!").strip()
        if line.lstrip().startswith("!") and text.startswith(NOTE):
            read_note(text, reader.draft, f"{path}, line {count}")
    for count, words in commands(lines, str(path)):
        read_command(reader, words, f"{path}, line {count}")
    check_solves(reader)
    if reader.in_private_block:
        raise InputError(f"{path}: private glasses (PRV) without END")
    if reader.surfaces and reader.surfaces[-1].kind != "SI":
        raise InputError(
            f"{path}: no image surface (SI) behind {reader.surfaces[-1].name}; is the file cut short?"
        )
    with losses_named(reader.draft):
        draft = _finished(reader, supplement)
    return assemble(draft, supplement, lossy)


def _finished(reader: FileReader, supplement: Supplement) -> Draft:
    """Return the draft, completed with values that depend on several commands."""
    draft = reader.draft
    stored = draft.notes.get("title")
    draft.title = (
        stored if isinstance(stored, str) and plain_title(stored, QUOTES) == reader.title else reader.title
    )
    wavelengths_um = list(reader.wavelengths_um)
    if 1 <= reader.reference <= len(wavelengths_um):
        wavelengths_um.insert(0, wavelengths_um.pop(reader.reference - 1))
    draft.wavelengths_um = supplement.wavelengths_or(wavelengths_um, draft)
    draft.set_field_heights(*(reader.heights.get(axis, []) for axis in ("XOB", "YOB")))
    materials = draft.notes.get("materials")
    named = list(materials) if isinstance(materials, list) else []
    glass_before = ""
    for i, surface in enumerate(reader.surfaces):
        if any(surface.terms.values()) and surface.profile != "ASP":
            draft.add_remark(
                f"{surface.name}: its coefficients without ASP are read as those of CODE V, A of r^4 to J of "
                "r^20. Optiland writes no ASP, and its A is that of r^2"
            )
        edge = i in (0, len(reader.surfaces) - 1)
        dummy = not edge and _is_dummy(surface, glass_before)
        stored = None if edge or dummy or not named else named.pop(0)
        material = _material(reader, surface, stored, supplement)
        draft.rows += _rows(reader, surface, material, dummy)
        draft.recorded.append(
            RecordedSurface(
                0.0 if surface.radius_mm is None else 1.0 / surface.radius_mm,
                surface.thickness_mm,
                material,
                surface.stop,
                _recorded_index(surface.glass),
            )
        )
        glass_before = surface.glass
    if reader.surfaces:
        draft.check_object_and_image()
    if reader.unit_mm != 1.0:
        draft.scale_lengths(reader.unit_mm)
    if reader.surfaces:
        draft.apply_focus_shift()
    return draft


def _recorded_index(glass: str) -> IndexRecord | None:
    """Return what a glass code states on the index, read a second time for the check of the import."""
    index_text, colon, _ = glass.partition(":")
    if colon:
        return IndexRecord(float(index_text))
    code = re.fullmatch(r"(\d{3})\d{3}|(\d{3,})\.\d{3,}", glass, re.ASCII)
    return IndexRecord(float(f"1.{code[1] or code[2]}")) if code else None


def _is_dummy(surface: FileSurface, glass_before: str) -> bool:
    """Return whether a surface only carries a decenter: a plane with the same medium on both sides."""
    plane = surface.radius_mm is None and not surface.terms and not surface.stop
    return plane and surface.glass == glass_before and surface.semi_diameter_mm is None and surface.is_moved


def _rows(reader: FileReader, surface: FileSurface, material: Any, dummy: bool) -> list[SurfaceRow]:
    """Return the row of a surface with the coordinate breaks before and behind it."""
    row = SurfaceRow(
        surface.name,
        surface.location,
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
    if z or surface.move_kind not in ("", "DAR", "REV"):
        reader.draft.add_loss(f"{surface.name}: {'ZDE ' if z else ''}{surface.move_kind}".rstrip())
    axes = CoordinateBreak((x, y), (-a, -b, c))

    def change(which: CoordinateBreak, thickness_mm: float) -> SurfaceRow:
        return SurfaceRow(surface.name, surface.location, thickness_mm=thickness_mm, axes=which)

    if surface.move_kind == "REV":
        step = change(axes.inverse(), surface.thickness_mm)
        return [step] if dummy else [_without_space(row), step]
    if surface.move_kind == "DAR":
        return [change(axes, 0.0), _without_space(row), change(axes.inverse(), surface.thickness_mm)]
    return [change(axes, surface.thickness_mm)] if dummy else [change(axes, 0.0), row]


def _without_space(row: SurfaceRow) -> SurfaceRow:
    """Return the same surface with a thickness of 0."""
    return replace(row, thickness_mm=0.0)


def _material(
    reader: FileReader, surface: FileSurface, stored: Any, supplement: Supplement
) -> str | float | None:
    """Return the medium behind a surface: None for air, a glass name, or a constant index."""
    token = surface.glass
    if not token or token.upper() in ("AIR", *_MIRRORS):
        return None
    name, _, maker = token.rpartition("_") if "_" in token else (token, "", "")
    if token.upper() in reader.private_glasses:
        if isinstance(stored, str) and token.startswith(PRIVATE):
            return stored
        return _private_index(reader, surface, reader.private_glasses[token.upper()])
    code = coded_glass(token, surface.glass_location)
    if code is not None:
        if code.is_exact_at(reader.draft.wavelengths_um):
            reader.draft.add_remark(f"{surface.name}: index {code.nd:g} of the model glass {token}")
        else:
            reader.draft.add_loss(f"{surface.name}: dispersion of the model glass {token}")
        return code.nd
    if isinstance(stored, str) and normalized_name(stored.rpartition(":")[2]) == normalized_name(name):
        return stored
    makers = [maker] if maker else []

    def remark(message: str) -> None:
        reader.draft.add_remark(f"{surface.name}: {message}")

    catalogs, location = supplement.glass_catalogs, surface.glass_location
    if makers:
        return find_glass(name, makers, catalogs, location, remark)
    return find_glass_of_unknown_maker(name, catalogs, location, remark)


def _private_index(reader: FileReader, surface: FileSurface, glass: PrivateGlass) -> float:
    """Return the index of a private glass at the first wavelength; its dispersion is recorded as a loss."""
    wavelengths_um = reader.draft.wavelengths_um
    if not wavelengths_um:
        raise InputError(NO_WAVELENGTH.format(reader.draft.source))
    index, remark, loss = glass.index(wavelengths_um[0])
    if remark:
        reader.draft.add_remark(f"{surface.name}: {remark}")
    if loss:
        reader.draft.add_loss(f"{surface.name}: {loss}")
    if glass.disperses(wavelengths_um):
        reader.draft.add_loss(f"{surface.name}: dispersion of the private glass {glass.name}")
    return index


PRIVATE = "TRANSFERLENS"
"""Start of the names of private glasses in files that the toolkit writes.

They have no underscore, because ray-optics takes what follows one for the name of a catalogue.
"""

QUOTES = "'\""
"""Quotation marks, which a title in a file must not contain."""

_ENDLESS = ("INF", "INFINITY")

_WORDS = re.compile(r"""'[^']*'|"[^"]*"|;|!.*|&\s*$|[^\s;!'"&]+|['"&]""")

# Weights, labels, identifiers, coupling codes, apodization, and settings of analyses or drawings. They do not
# describe the lens.
_IDLE_WORDS = """
LEN WTW WTF INI DER DOR CWL POL SLB THC CCY GLC KC XDC YDC ZDC ADC BDC CDC GO SET CA FFO IC
AC BC CC DC EC FC GC HC JC CUC COM XAN YAN XIM YIM XRI YRI LCM BIN UID CLS CUM THM PUI PUX PUY
"""
_IDLE = frozenset(_IDLE_WORDS.split())

# Tolerances, compensators and their settings: DLF, DLR, DLT, DLN, DLX, DSX, BTX, TIR, IRR, CYN, CMP, ...
_TOLERANCES = re.compile(r"DL[A-Z]|DS[A-Z]|BT[A-Z]|CY[DN]|TI[LR]|TR[XY]|IRR|RSE|HOM|ROL|DIS|CMP|TOL")

# Solves and pickups. The file also holds their present values.
_SOLVE_WORDS = """
PIM PIY PIX UMY UMX UCY UCX HMY HMX HCY HCX IMY IMX ICY ICX AMY ACY CMY EFY EFX OAL RED PIK SOL
"""
_SOLVES = frozenset(_SOLVE_WORDS.split())


# What commands describe that a design cannot represent.
_LOST = {
    word: text
    for text, words in {
        "rectangular aperture": "REX REY REC",
        "elliptical aperture": "ELX ELY ELL",
        "decentered aperture": "ADX ADY ARO",
        "diffractive surface": "DIF GRT GRO GRS GRX GRY GRZ HOE HOR HWL HCT HCO HCC HTO",
        "cylinder, toroid or anamorphic asphere": "CYL XTO YTO AAS RDX CUX KX KY",
        "surface given by a table or a program": "SPL SPS SCO UDS UD1 UD2 UD3 FRE FRN NUR",
        "gradient index": "GRI GRN URN UDG",
        "reflection or total reflection": "RMD REFL TIRO",
        "telecentric or afocal system": "TEL AFI AFC",
        "zoom positions": "ZOO",
    }.items()
    for word in words.split()
}

_MIRRORS = ("REFL", "MIRROR")
"""Words in the place of a glass for a mirror."""


@dataclass
class FileSurface:
    """Values of one surface, collected from its commands; `kind` is SO, S or SI.

    `profile` is SPH, CON or ASP if the file states one of them. `given` names the quantities that have a
    value. `solved` maps a quantity that a solve determines to the words and the location of the solve.
    """

    kind: str
    name: str
    location: str
    radius_mm: float | None = None
    thickness_mm: float = 0.0
    glass: str = ""
    glass_location: str = ""
    conic: float = 0.0
    terms: dict[str, float] = field(default_factory=dict)
    profile: str = ""
    semi_diameter_mm: float | None = None
    stop: bool = False
    moves: dict[str, float] = field(default_factory=dict)
    move_kind: str = ""
    given: set[str] = field(default_factory=set)
    solved: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def is_moved(self) -> bool:
        """True if the surface has decenters or tilts."""
        return bool(self.moves)


@dataclass
class FileReader:
    """State of the reader of one file."""

    draft: Draft
    surfaces: list[FileSurface] = field(default_factory=list)
    title: str = ""
    wavelengths_um: list[float] = field(default_factory=list)
    reference: int = 1
    heights: dict[str, list[float]] = field(default_factory=dict)
    gives_radii: bool | None = None
    unit_mm: float = 1.0
    in_private_block: bool = False
    private_glasses: dict[str, PrivateGlass] = field(default_factory=dict)
    private_wavelengths_nm: tuple[str, ...] = ()


def commands(lines: Sequence[str], source: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the commands of a file: the number of the first line and the words of each.

    A semicolon separates commands. An ampersand at the end of a line continues the command on the next line.
    An exclamation mark starts a comment.
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
        raise InputError(f"{source}, line {start}: the file ends within a command (&)")


def read_command(reader: FileReader, words: list[str], location: str) -> None:
    """Interpret one command.

    Parameters
    ----------
    reader
        State of the reader; it is updated.
    words
        Words of the command.
    location
        File and line, for messages.

    Raises
    ------
    InputError
        If a required value is missing or invalid.
    """
    word, values = _keyword(words[0]), words[1:]
    if reader.in_private_block:
        _read_private_glass(reader, words, location)
    elif word in ("SO", "S", "SI") or re.fullmatch(r"S\d+", word):
        _start_surface(reader, word, values, location)
    elif word in _OF_FILE:
        _OF_FILE[word](reader, values, location)
    elif word in _OF_SURFACE:
        surfaces, rest = _addressed(reader, values, location)
        for surface in surfaces:
            _OF_SURFACE[word](reader, surface, word, rest, location)
    elif word in _SOLVES:
        name = reader.surfaces[-1].name if reader.surfaces else location
        reader.draft.add_remark(f"{name}: {word} solve replaced by its present value")
    elif not _is_idle(word, values):
        name = reader.surfaces[-1].name if reader.surfaces else location.rpartition(", ")[2]
        kind = f"{_LOST[word]}, " if word in _LOST else ""
        reader.draft.add_loss(f"{name}: {kind}{quoted(' '.join(words))}")


def _keyword(text: str) -> str:
    """Return a command's keyword; of a longer word CODE V reads three letters."""
    word = text.upper()
    if word in _LOST or _known(word) or not word.isalpha() or not _known(word[:3]):
        return word
    return word[:3]


def _known(word: str) -> bool:
    return word in _OF_FILE or word in _OF_SURFACE or word in _SOLVES or _is_idle(word, ())


def _is_idle(word: str, values: Sequence[str]) -> bool:
    """Return whether a command leaves the nominal lens as it is."""
    if word in _IDLE or _TOLERANCES.fullmatch(word):
        return True
    if word in ("TEL", "AFI", "AFC"):
        return [v.upper() for v in values] in (["N"], ["NO"])
    # Outlines of edges do not clip rays.
    return word in ("REX", "REY", "ELX", "ELY", "ADX", "ADY", "ARO") and "EDG" in [v.upper() for v in values]


def _read_private_glass(reader: FileReader, words: list[str], location: str) -> None:
    if words[0].upper() == "END":
        reader.in_private_block = False
    elif words[0].upper() == "PWL":
        reader.private_wavelengths_nm = tuple(words[1:])
    else:
        name = words[0].strip("'\"")
        reader.private_glasses[name.upper()] = PrivateGlass(
            name, tuple(words[1:]), reader.private_wavelengths_nm, location
        )


def check_solves(reader: FileReader) -> None:
    """Add a remark for each solve that is replaced by its present value.

    Raises
    ------
    InputError
        If the file lacks the present value of a solve.
    """
    for surface in reader.surfaces:
        for quantity, (words, location) in surface.solved.items():
            if quantity not in surface.given:
                raise InputError(
                    f"{location}: the {quantity} of {surface.name} is defined by a solve or pickup "
                    f"({quoted(words)}), and the file lacks its present value; give the value instead"
                )
            reader.draft.add_remark(f"{surface.name}: {words.split()[0]} solve replaced by its present value")


def _solved(
    reader: FileReader, surface: FileSurface, quantity: str, values: Sequence[str], location: str
) -> bool:
    """Return whether a solve or a pickup replaces a value; if not, mark the quantity as given.

    A word that is neither a number nor a known solve is a loss if the quantity already has a value.
    """
    word = values[0].upper() if values else ""
    if word in _SOLVES:
        surface.solved[quantity] = (" ".join(values), location)
        return True
    if word.isalpha() and word not in _ENDLESS and quantity in surface.given:
        reader.draft.add_loss(f"{surface.name}: {quantity} by {quoted(' '.join(values))}; its value is kept")
        return True
    surface.given.add(quantity)
    return False


_ADDRESS = re.compile(r"S(\d{1,6}|[OISA])([+-]\d{1,6})?(?:\.\.S?(\d{1,6}|[OIS])([+-]\d{1,6})?)?")


def _addressed(reader: FileReader, values: list[str], location: str) -> tuple[list[FileSurface], list[str]]:
    """Return the surfaces that a command names (S2, S2..4), or the last one; and the remaining words."""
    named = _ADDRESS.fullmatch(values[0].upper()) if values else None
    if named is None:
        if not reader.surfaces:
            raise InputError(f"{location}: a command of a surface before the first surface")
        return [reader.surfaces[-1]], values
    last = len(reader.surfaces) - 1
    stops = [i for i, surface in enumerate(reader.surfaces) if surface.stop]

    def index(key: str, offset: str | None) -> int:
        start = {"O": 0, "I": last, "S": stops[0] if stops else -1}.get(key)
        return -1 if start == -1 else (int(key) if start is None else start) + int(offset or 0)

    if named[1] == "A":
        first, end = 0, last
    else:
        first = index(named[1], named[2])
        end = first if named[3] is None else index(named[3], named[4])
    if not 0 <= first <= end <= last:
        raise InputError(f"{location}: there is no surface {quoted(values[0])} yet")
    return reader.surfaces[first : end + 1], values[1:]


def _start_surface(reader: FileReader, word: str, values: list[str], location: str) -> None:
    count = len(reader.surfaces)
    if (word == "SO") != (count == 0):
        raise InputError(f"{location}: {word} as surface {count}; the object (SO) comes first, and once")
    if reader.surfaces and reader.surfaces[-1].kind == "SI":
        raise InputError(f"{location}: {word} behind the image surface (SI)")
    if count > MAX_SURFACES:
        raise InputError(f"{location}: more than {MAX_SURFACES} surfaces")
    surface = FileSurface(word if word in ("SO", "SI") else "S", f"surface {count}", location)
    reader.surfaces.append(surface)
    if values and not _solved(reader, surface, "radius", values, location):
        value = _finite_or_plane(values[0], location)
        if value and reader.gives_radii is None:
            raise InputError(
                f"{location}: {quoted(values[0])} may be a radius or a curvature; add RDM (radii) or RDM N "
                "(curvatures) before the surfaces"
            )
        surface.radius_mm = value or None
        if value and not reader.gives_radii:
            surface.radius_mm = _inverse(value, location)
    if len(values) > 1:
        is_solve = values[1].upper() in _SOLVES
        _thickness(reader, surface, "THI", values[1:] if is_solve else values[1:2], location)
    if len(values) > 2:
        _glass(reader, surface, "GLA", values[2:], location)


def _finite_or_plane(text: str, location: str) -> float:
    """Return a radius or a curvature; both infinity and 0 denote a plane and return 0."""
    return 0.0 if text.upper() in _ENDLESS else parse_number(text, location)


def _inverse(curvature: float, location: str) -> float:
    radius = 1.0 / curvature
    if not math.isfinite(radius):
        raise InputError(
            f"{location}: curvature {curvature:g} is too small; its radius exceeds the range of numbers"
        )
    return radius


def _value(values: Sequence[str], location: str) -> float:
    if not values:
        raise InputError(f"{location}: a command without its value")
    return parse_number(values[0], location)


def _value_of(
    reader: FileReader, surface: FileSurface, word: str, values: Sequence[str], location: str
) -> float:
    """Return the value of a command of a surface; words behind it are a loss."""
    if len(values) > 1:
        reader.draft.add_loss(f"{surface.name}: {quoted(' '.join(values[1:]))} behind the value of {word}")
    return _value(values, location)


def _radius(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    if _solved(reader, surface, "radius", values, location):
        return
    is_plane = bool(values) and values[0].upper() in _ENDLESS
    value = 0.0 if is_plane else _value_of(reader, surface, word, values, location)
    surface.radius_mm = value or None
    if value and word == "CUY":
        surface.radius_mm = _inverse(value, location)


def _thickness(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    if _solved(reader, surface, "thickness", values, location):
        return
    endless = bool(values) and values[0].upper() in _ENDLESS
    value = math.inf if endless else _value_of(reader, surface, word, values, location)
    # Distance from which CODE V treats the object as infinitely far.
    infinite_mm = 1e10
    surface.thickness_mm = math.inf if value >= infinite_mm else value


def _glass(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    if not values:
        raise InputError(f"{location}: a glass without its name")
    name, *rest = values
    if starts_as_number(name) and rest and starts_as_number(rest[0]):
        # A model glass in two words: 1.5168 64.17.
        name, *rest = f"{name}:{rest[0]}", *rest[1:]
    surface.glass, surface.glass_location = name.strip("'\""), f"{location} ({surface.name})"
    if surface.glass.upper() in _MIRRORS or "REFL" in map(str.upper, rest):
        reader.draft.add_loss(f"{surface.name}: mirror, read as a surface in air")
        surface.glass = "AIR"
    rest = [word for word in rest if word.upper() not in ("REFL", "REFR")]  # refraction is the default
    if rest:
        reader.draft.add_loss(f"{surface.name}: {quoted(' '.join(rest))} behind the glass {surface.glass}")


def _conic(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    if not _solved(reader, surface, "conic constant", values, location):
        surface.conic = _value_of(reader, surface, word, values, location)


def _term(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    if not _solved(reader, surface, f"asphere term {word}", values, location):
        surface.terms[word] = _value_of(reader, surface, word, values, location)


def _profile(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    surface.profile = word
    if values:
        reader.draft.add_loss(f"{surface.name}: {quoted(' '.join([word, *values]))}")


def _aperture(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    kind = values[0].upper() if len(values) > 1 else "CLR"
    if kind == "EDG":
        return
    if kind != "CLR":
        reader.draft.add_loss(f"{surface.name}: aperture CIR {quoted(' '.join(values))}")
        return
    value = _value(values[-1:], location)
    surface.semi_diameter_mm = value if value > 0.0 else None


def _fresnel(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    if _value(values, location):
        reader.draft.add_loss(f"{surface.name}: Fresnel base curvature of {values[0]}")


def _stop(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    surface.stop = True


def _move(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    if not _solved(reader, surface, word, values, location):
        surface.moves[word] = _value_of(reader, surface, word, values, location)


def _move_kind(reader: FileReader, surface: FileSurface, word: str, values: list[str], location: str) -> None:
    surface.move_kind = word
    if word not in ("DAR", "REV"):
        reader.draft.add_loss(f"{surface.name}: {word}")


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
    **dict.fromkeys(("SPH", "CON", "ASP"), _profile),
    **dict.fromkeys(CODEV_LETTERS, _term),
    **dict.fromkeys(("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE"), _move),
    **dict.fromkeys(("DAR", "REV", "BEN", "RET", "GLB"), _move_kind),
}


def _mode(reader: FileReader, values: list[str], location: str) -> None:
    reader.gives_radii = not values or not values[0].upper().startswith("N")


UNITS_MM = {"M": 1.0, "MM": 1.0, "C": 10.0, "CM": 10.0, "I": 25.4, "IN": 25.4}
"""Length in mm of each unit of a .seq file."""


def _dimension(reader: FileReader, values: list[str], location: str) -> None:
    unit = values[0].upper() if values else ""
    if unit not in UNITS_MM:
        raise InputError(
            f"{location}: DIM {quoted(' '.join(values))}; lengths must be in mm (M), cm (C) or inches (I)"
        )
    reader.unit_mm = UNITS_MM[unit]
    if reader.unit_mm != 1.0:
        reader.draft.add_remark(f"lengths in {unit} converted to mm ({reader.unit_mm:g} mm each)")


def _title(reader: FileReader, values: list[str], location: str) -> None:
    if values and re.fullmatch(r"Z\d+", values[0].upper()):  # title of a zoom position
        return
    reader.title = " ".join(" ".join(v.strip("'\"") for v in values).split())


def _aperture_kind(kind: str) -> Callable[[FileReader, list[str], str], None]:
    def read(reader: FileReader, values: list[str], location: str) -> None:
        if len(values) > 1:
            reader.draft.add_loss(f"{quoted(' '.join(values[1:]))} behind the value of the system aperture")
        reader.draft.aperture = (kind, _value(values, location))

    return read


def _wavelengths(reader: FileReader, values: list[str], location: str) -> None:
    for value in values:
        parse_number(value, location)
    reader.wavelengths_um = [float(Decimal(v.lower().replace("d", "e")) / 1000) for v in values]


def _reference(reader: FileReader, values: list[str], location: str) -> None:
    value = _value(values, location)
    reader.reference = int(value) if 0.0 < value < 1e3 else 0


def _temperature(reader: FileReader, values: list[str], location: str) -> None:
    if any(parse_number(v, location) not in (20.0, 22.0) for v in values):
        reader.draft.add_loss(f"temperature of {quoted(' '.join(values))} degrees C")


def _pressure(reader: FileReader, values: list[str], location: str) -> None:
    if any(parse_number(v, location) != 760.0 for v in values):
        reader.draft.add_loss(f"pressure of {quoted(' '.join(values))} mmHg")


def _private(reader: FileReader, values: list[str], location: str) -> None:
    reader.in_private_block = True


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
    "XOB": field_height_reader("XOB"),
    "YOB": field_height_reader("YOB"),
    **dict.fromkeys(("VUX", "VLX", "VUY", "VLY"), read_vignetting),
    "TEM": _temperature,
    "PRE": _pressure,
    "PRV": _private,
}


def write_seq(
    lens: Lens,
    path: str | os.PathLike[str],
    pose: Pose = Pose(),
    *,
    warn: Callable[[str], None] = warnings.warn,
) -> None:
    """Write a lens to a CODE V sequence file (.seq).

    :func:`read_seq` reads the same lens and pose from the file. Numbers are written with all digits. The pose
    becomes a pair of dummy surfaces at its pivot: the first is decentered and tilted, the second reverses
    this (REV). Glasses of CODE V's catalogues are written by name. Other glasses and constant indices become
    private glasses with an index at each wavelength. Comments hold the sensor, the title and the exact glass
    names.

    Parameters
    ----------
    lens
        The lens.
    path
        File to write.
    pose
        Pose of the lens (default: aligned). It must hold scalars, not one value for each trial.
    warn
        Called with one sentence for each surface whose coating or roughness is omitted (default: a Python
        warning).

    Raises
    ------
    InputError
        If the format cannot represent the lens (a measured figure, or a shape that CODE V lacks), or if the
        file cannot be written. An existing file then stays unchanged.
    MaterialError
        If a glass is unknown, or its index is unknown at one of the wavelengths.

    Examples
    --------
    >>> from lensdesign import load_design, read_seq, write_seq
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> write_seq(lens, "lens.seq")
    >>> read_seq("lens.seq").lens == lens
    True
    """
    target = Path(path)
    check_writable(lens, pose, lambda shape: shape.codev(), "a .seq file")
    for note in omissions(lens, "a .seq file"):
        warn(note)
    half, title = 0.5 * lens.object.field_diameter_mm, plain_title(lens.title, QUOTES)
    lines = [
        "RDM;LEN",
        *(f"! {line}" for line in note_lines(lens, pose, target.parent)),
        *([f"TITLE '{title}'"] if title else []),
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
    for i, surface in enumerate(written_surfaces(lens), start=1):
        if surface.material is not None and _catalog_glass(surface.material, lens) is None:
            indices = [
                refractive_index(surface.material, w, lens.glass_catalogs) for w in lens.wavelengths_um
            ]
            lines.append(f"'{PRIVATE}{i}' " + " ".join(map(repr, indices)))
    wavelengths_um = " ".join(str(Decimal(repr(w)) * 1000) for w in lens.wavelengths_um)
    return ["PRV", f"PWL {wavelengths_um}", *lines, "END"] if lines else []


def _catalog_glass(material: str | float, lens: Lens) -> str | None:
    """Return CODE V's name of a glass; None if its catalogues lack it."""
    if not isinstance(material, str):
        return None
    glass = get_material(material, lens.glass_catalogs)
    if glass.catalog.upper() not in MAKERS:
        return None
    return f"{''.join(c for c in glass.name.upper() if c.isalnum())}_{glass.catalog.upper()}"


def _surface_lines(lens: Lens, pose: Pose) -> list[str]:
    """Return the commands of every surface from the object to the image."""
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
    plate = lens.sensor.cover_glass
    if plate is not None:
        thicknesses[-1] -= plate.depth_mm if pose == Pose() else 0.0
        to_sensor -= 0.0 if pose == Pose() else plate.depth_mm
    lines = []
    for i, (surface, thickness) in enumerate(zip(lens.surfaces, thicknesses, strict=True), start=1):
        glass = _glass_word(lens, surface, i)
        lines.append(f"S {surface.radius_mm or 0.0!r} {thickness!r}{glass}")
        kind, terms = surface.shape.codev()
        lines += ["  STO"] if surface.stop else []
        lines += [f"  {kind}", f"  K {surface.conic!r}"] if terms or surface.conic else []
        lines += [f"  {letter} {a!r}" for letter, a in terms.items()]
        lines += [f"  CIR {surface.semi_diameter_mm!r}"] if surface.semi_diameter_mm is not None else []
    back = [f"S 0.0 {to_sensor!r}{glass}", *back] if back else []
    cover = []
    if plate is not None:
        front_face, _ = cover_glass_surfaces(lens)
        word = _glass_word(lens, front_face, len(lens.surfaces) + 1)
        cover = [f"S 0.0 {plate.thickness_mm!r}{word}", f"S 0.0 {plate.distance_mm!r}"]
    return [*front, *lines, *back, *cover, "SI 0.0 0.0"]


def _glass_word(lens: Lens, surface: Surface, number: int) -> str:
    """Return the glass behind a surface as it follows the thickness in its line; empty for air."""
    if surface.material is None:
        return ""
    return " " + (_catalog_glass(surface.material, lens) or f"'{PRIVATE}{number}'")
