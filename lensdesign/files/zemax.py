"""Read and write sequential lens files of Zemax OpticStudio (.zmx).

The reader supports

- the surface types that the shapes of :mod:`lensdesign.lens.shapes` declare, with curvature, conic constant,
  parameters, thickness, glass, fixed semi-diameter, circular aperture and stop;
- lengths in mm, cm, inches or m (UNIT), which become mm;
- the system apertures ENPD, FNUM, OBNA and FLOA, which determine the semi-diameter of the stop;
- object heights, and wavelengths (the primary one comes first);
- one pair of coordinate breaks, which becomes the pose of the whole lens. The surface property Tilt/Decenter
  (SCBD) is read as coordinate breaks before and behind its surface.

It ignores records that do not describe the lens: weights, the merit function, settings of analyses and
drawings. Coatings are omitted with a remark. Every other record that a design cannot represent is reported
as a loss.

The format has no public specification. The meaning of the records follows the OpticStudio user's manual
(Ansys Zemax) and files that lens makers publish.
"""

from __future__ import annotations

import codecs
import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Context, Decimal
from pathlib import Path
from typing import Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError, MaterialError
from lensdesign.files.assembly import assemble
from lensdesign.files.draft import (
    MAX_SURFACES,
    CoordinateBreak,
    Draft,
    Imported,
    RecordedSurface,
    Supplement,
    SurfaceRow,
    check_writable,
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
    written_surfaces,
)
from lensdesign.files.index_records import IndexRecord
from lensdesign.files.zemax_configurations import SOLVES, text_of_configuration
from lensdesign.lens.glass import get_material, glass_summary, is_gap, list_glasses
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.shapes.base import Shape
from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.forbes import MOST_Q_TERMS, ZEMAX_FORBES_TYPE, qbfs_polynomials
from lensdesign.lens.shapes.registry import shape_classes

DEFAULT_WAVELENGTH_UM = 0.55
"""Wavelength of a new lens in OpticStudio, which also stands in the unused WAVM records of its files."""


def read_zmx(
    path: str | os.PathLike[str], supplement: Supplement | None = None, lossy: bool = False
) -> Imported:
    """Read a lens from a Zemax OpticStudio file (.zmx).

    Parameters
    ----------
    path
        A sequential OpticStudio file: text in UTF-16, UTF-8 or Latin-1.
    supplement
        Values that a design needs and the file lacks (default: none). Files of :func:`write_zmx` need no
        supplement, because their notes hold these values.
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
    >>> from lensdesign import Pose, load_design, read_zmx, write_zmx
    >>> write_zmx(load_design("designs/paper_singlet.toml"), "decentered.zmx", Pose(decenter_y_mm=0.1))
    >>> imported = read_zmx("decentered.zmx")
    >>> imported.pose.decenter_y_mm, imported.dropped, round(imported.first_order.efl_mm, 3)
    (0.1, (), 19.166)
    """
    supplement = supplement or Supplement()
    reader = FileReader(Draft(source=str(path)))
    lines = read_lines(path)
    if supplement.configuration is not None:
        configured = text_of_configuration(lines, supplement.configuration, str(path))
        lines = list(configured.lines)
        for loss in configured.losses:
            reader.draft.add_loss(loss)
        for remark in configured.remarks:
            reader.draft.add_remark(remark)
    for count, line in enumerate(lines, start=1):
        location = f"{path}, line {count}"
        word, *values = line.split() or [""]
        if word.upper() == "NOTE":
            if len(values) > 1:
                read_note(line.split(maxsplit=2)[2], reader.draft, location)
        elif word.upper() == "NAME":
            reader.name = line.strip()[4:].strip()
        elif word:
            read_record(reader, word.upper(), values, location, line[:1].isspace())
    finish_records(reader)
    _check_complete(reader)
    with losses_named(reader.draft):
        draft = _finished(reader, lines, supplement)
    return assemble(draft, supplement, lossy)


def _check_complete(reader: FileReader) -> None:
    """Raise an error if the last surface is not an image, which always has a distance of 0."""
    if len(reader.surfaces) < 3:  # reported when the lens is assembled
        return
    image = reader.surfaces[-1]
    values, location = image.first_records.get("DISZ", ([], image.location))
    if not values or _parse_distance(values[0], location) != 0.0:
        distance = f"a distance of {values[0]}" if values else "no distance (DISZ)"
        raise InputError(
            f"{location}: {image.name}, the last one, has {distance}, but the image has a distance of 0; is "
            "the file cut short?"
        )


def _finished(reader: FileReader, lines: list[str], supplement: Supplement) -> Draft:
    """Return the draft, completed with values that depend on several records."""
    draft = reader.draft
    stored = draft.notes.get("title")
    draft.title = stored if isinstance(stored, str) and plain_title(stored) == reader.name else reader.name
    count = None if reader.wavelength_count is None else max(reader.wavelength_count, 1)  # a file has one
    for i, wavelength_um in reader.listed_wavelengths_um.items():
        if i <= (count or 0):
            reader.wavelengths_um.setdefault(i, wavelength_um)
    numbers = sorted(reader.wavelengths_um)[:count]
    if reader.primary in numbers:
        numbers.sort(key=lambda n: n != reader.primary)
    found_um = [reader.wavelengths_um[n] for n in numbers]
    if not found_um and not supplement.wavelengths_um:
        found_um = [DEFAULT_WAVELENGTH_UM]
        draft.add_remark(
            f"the file states no wavelength (WAVM); that of a new lens in OpticStudio is used: "
            f"{DEFAULT_WAVELENGTH_UM:g} µm"
        )
    draft.wavelengths_um = supplement.wavelengths_or(found_um, draft)
    if reader.field_kind == 1:
        draft.set_field_heights(*(reader.heights.get(axis, [])[: reader.field_count] for axis in "xy"))
    materials = draft.notes.get("materials")
    named = iter(materials if isinstance(materials, list) else [])
    for i, surface in enumerate(reader.surfaces):
        inner = 0 < i < len(reader.surfaces) - 1 and surface.kind != "COORDBRK"
        draft.rows.append(_row(reader, surface, next(named, None) if inner else None, supplement))
    if reader.surfaces:
        draft.check_object_and_image()
    draft.recorded = _recorded(lines, reader, supplement)
    draft.rows = _with_surface_breaks(draft.rows, reader)
    if reader.unit_mm != 1.0:
        draft.scale_lengths(reader.unit_mm)
    return draft


def _with_surface_breaks(rows: Sequence[SurfaceRow], reader: FileReader) -> list[SurfaceRow]:
    """Return the rows with coordinate breaks for the surface property Tilt/Decenter (SCBD).

    The axes change immediately before and behind the surface, in front of the distance to the next one. Those
    behind the image move nothing.
    """
    result: list[SurfaceRow] = []
    for row, surface in zip(rows, reader.surfaces, strict=True):
        before = surface.breaks_before
        behind = {
            0: surface.breaks_behind,
            1: before,
            2: None if before is None else before.inverse(),
        }[surface.behind_status]
        # Axes that change in front of the object move everything alike.
        if before is not None and not before.is_identity and result:
            name = f"{row.name}, its property Tilt/Decenter (SCBD 1: {before.text})"
            result.append(SurfaceRow(name, row.location, axes=before))
        if behind is None or behind.is_identity or surface is reader.surfaces[-1]:
            result.append(row)
            continue
        name = f"{row.name}, its property Tilt/Decenter (SCBD 2: {behind.text})"
        result += [
            replace(row, thickness_mm=0.0),
            SurfaceRow(name, row.location, thickness_mm=row.thickness_mm, axes=behind),
        ]
    return result


def _recorded(lines: list[str], reader: FileReader, supplement: Supplement) -> list[RecordedSurface]:
    """Read the surfaces a second time, independently; the first record of each kind in a block counts."""
    blocks: list[dict[str, list[str]]] = []
    for line in lines:
        word, *values = line.split() or [""]
        word = word.upper()
        if word == "SURF":
            blocks.append({})
        elif blocks and word in ("TYPE", "CURV", "CONI", "DISZ", "GLAS", "STOP"):
            blocks[-1].setdefault(word, values)
        elif blocks and word == "PARM" and values[:1] == ["1"]:
            blocks[-1].setdefault("PARM 1", values[1:])
        elif blocks and word == "XDAT" and len(values) > 1:
            blocks[-1].setdefault(f"XDAT {values[0]}", values[1:])
    recorded: list[RecordedSurface] = []
    for block, row, surface in zip(blocks, reader.draft.rows, reader.surfaces, strict=True):
        glass = tuple(block.get("GLAS", ()))
        material = (
            row.material
            if glass == surface.glass
            else _material(reader, FileSurface(surface.name, surface.location, glass=glass), None, supplement)
        )
        if block.get("TYPE", [""])[:1] == ["COORDBRK"]:
            material = recorded[-1].material if recorded else None
        curvature = parse_number(block.get("CURV", ["0"])[0], surface.location)
        conic = parse_number(block.get("CONI", ["0"])[0], surface.location)
        if block.get("TYPE", [""])[:1] == ["EVENASPH"] and (not curvature or conic == -1.0):
            curvature += 2.0 * parse_number(block.get("PARM 1", ["0"])[0], surface.location)
        if block.get("TYPE", [""])[:1] == [ZEMAX_FORBES_TYPE]:
            kind, count, radius, *q = (
                parse_number(block.get(f"XDAT {i}", ["0"])[0], surface.location)
                for i in range(1, 4 + MOST_Q_TERMS)
            )
            if kind == 0.0:  # the departure of a Qbfs begins with r^2
                own = zip(q[: int(count)], qbfs_polynomials(), strict=False)
                curvature += 2.0 / radius**2 * sum(value * polynomial(0.0) for value, polynomial in own)
        recorded.append(
            RecordedSurface(
                curvature,
                _parse_distance(block.get("DISZ", ["0"])[0], surface.location),
                material,
                "STOP" in block,
                _recorded_index(glass, surface.location),
            )
        )
    return recorded


def _recorded_index(glass: Sequence[str], location: str) -> IndexRecord | None:
    """Return what a GLAS record states on the index, also for a model glass."""
    if len(glass) < 4 or glass[0].upper() in ("AIR", "MIRROR"):
        return None
    is_model = glass[0].upper() in ("___BLANK", "MODEL") or glass[1] == "1"
    if is_model:
        return IndexRecord(parse_number(glass[3], location))
    return _index_record(glass[1:], location)


def _parse_distance(text: str, location: str) -> float:
    return math.inf if text.upper() == "INFINITY" else parse_number(text, location)


def _row(reader: FileReader, surface: FileSurface, stored: Any, supplement: Supplement) -> SurfaceRow:
    if surface.kind == "COORDBRK":
        x, y, a, b, c, order = (surface.terms.get(i, 0.0) for i in range(1, 7))
        axes = CoordinateBreak((x, y), (a, b, c), order != 0.0)
        return SurfaceRow(surface.name, surface.location, thickness_mm=surface.thickness_mm, axes=axes)
    radius, conic, terms = _with_quadratic_term(reader, surface)
    if surface.kind == ZEMAX_FORBES_TYPE:
        _check_forbes(reader, surface)
    shape, keys = shape_of_type(surface.kind, terms, surface.extra_terms) or (Conic, {})
    held = shape.of_keys({"radius_mm": radius, "conic": conic} | keys).zemax()[1]
    if _is_supported(surface.kind):
        for i, value in sorted(terms.items()):
            if not math.isclose(value, held.get(i, 0.0), rel_tol=1e-14):  # a radius becomes a curvature
                reader.draft.add_loss(f"{surface.name}: {shape.ZEMAX_LOST.get(i, f'PARM {i}')} of {value:g}")
        _check_extra_terms(reader, surface)
    return SurfaceRow(
        surface.name,
        surface.location,
        radius,
        conic if "conic" in shape.KEYS else 0.0,
        keys,
        surface.thickness_mm,
        _material(reader, surface, stored, supplement),
        surface.aperture_mm or surface.semi_diameter_mm,
        surface.stop,
        automatic_mm=None if surface.aperture_mm else surface.automatic_mm,
        shape_class=shape,
    )


def _with_quadratic_term(
    reader: FileReader, surface: FileSurface
) -> tuple[float | None, float, dict[int, float]]:
    """Return radius, conic constant and parameters without a term in r^2 of an even asphere, if possible.

    A term a r^2 beside a paraboloid or a plane is part of a paraboloid with the curvature c + 2 a.
    """
    quadratic = surface.terms.get(1, 0.0)
    is_parabola = surface.radius_mm is None or surface.conic == -1.0
    if surface.kind != "EVENASPH" or not quadratic or not is_parabola:
        return surface.radius_mm, surface.conic, surface.terms
    curvature = 2.0 * quadratic + (0.0 if surface.radius_mm is None else 1.0 / surface.radius_mm)
    radius = 1.0 / curvature if curvature else None
    reader.draft.add_remark(
        f"{surface.name}: the term in r^2 of {quadratic:g} is part of the paraboloid, whose curvature is "
        f"{curvature:.8g}"
    )
    return radius, -1.0, {i: value for i, value in surface.terms.items() if i != 1}


def _check_extra_terms(reader: FileReader, surface: FileSurface) -> None:
    """Add a loss if the extra data of a surface describe a departure from its shape.

    Those of a toroid are the number of Zernike terms, the radius of normalization, and the coefficients.
    """
    if surface.kind == ZEMAX_FORBES_TYPE:
        return
    terms = surface.extra_terms
    if surface.kind == "TOROIDAL":
        count = int(terms.get(1, 0.0))
        terms = {i: value for i, value in terms.items() if 3 <= i < 3 + count}
    lost = [f"XDAT {i} of {value:g}" for i, value in sorted(terms.items()) if value]
    if lost:
        name = "Zernike terms of the toroid, " if surface.kind == "TOROIDAL" else ""
        reader.draft.add_loss(f"{surface.name}: {name}{', '.join(lost)}")


def _check_forbes(reader: FileReader, surface: FileSurface) -> None:
    """Refuse a Forbes asphere without a normalization radius, and add as losses what a design cannot state.

    OpticStudio's Qbfs may have a conic as its base; that of a design is a sphere.
    """
    kind, count, radius_mm = (surface.extra_terms.get(i, 0.0) for i in (1, 2, 3))
    if not radius_mm > 0.0:
        raise InputError(
            f"{surface.location}: a Forbes asphere has the normalization radius {radius_mm:g} (XDAT 3); it "
            "must be greater than 0"
        )
    if kind not in (0.0, 1.0):
        reader.draft.add_loss(
            f"{surface.name}: Forbes asphere of kind {kind:g}, neither 0 (Qbfs) nor 1 (Qcon), read as "
            "STANDARD"
        )
    if kind == 0.0 and surface.conic:
        reader.draft.add_loss(
            f"{surface.name}: conic constant {surface.conic:g} of a Qbfs, which is read with a sphere as base"
        )
    beyond = {i: value for i, value in surface.extra_terms.items() if 4 + MOST_Q_TERMS <= i < 4 + count}
    lost = [f"XDAT {i} of {value:g}" for i, value in sorted(beyond.items()) if value]
    if lost:
        reader.draft.add_loss(f"{surface.name}: more than {MOST_Q_TERMS} Forbes terms, {', '.join(lost)}")


def _material(
    reader: FileReader, surface: FileSurface, stored: Any, supplement: Supplement
) -> str | float | None:
    """Return the medium behind a surface: None for air, a glass name, or the index of a model glass."""
    if not surface.glass or surface.glass[0].upper() == "AIR":
        return None
    name, *values = surface.glass
    if name.upper() == "MIRROR":
        return None
    kind = integer_at(values, 0, surface.glass_location) if values else 0
    if kind == 1 or name.upper() in ("___BLANK", "MODEL"):
        index = value_at(values, 2, surface.glass_location)
        abbe = value_at(values, 3, surface.glass_location) if len(values) > 3 else 0.0
        _lose_dispersion(reader, surface.name, IndexRecord(index, abbe or None), "the model glass")
        return index
    if name.isdecimal() and len(name) == 6:
        coded = IndexRecord(1.0 + int(name[:3]) / 1000, int(name[3:]) / 10)
        _lose_dispersion(reader, surface.name, coded, f"the glass number {name}")
        return coded.nd
    if kind > 3:  # 2 is a pickup, 3 a substitution by the search, 4 an offset of index and Abbe number
        offset = quoted(" ".join(surface.glass))
        reader.draft.add_loss(f"{surface.name}: offset of the index of a glass, GLAS {offset}")
    elif kind > 1:
        reader.draft.add_remark(f"{surface.name}: solve or pickup of the glass replaced by its present value")
    record = _index_record(values, surface.glass_location)
    if isinstance(stored, str) and _token(stored) == name:
        if record is not None:
            reader.draft.compare_index(surface.name, stored, record, supplement.glass_catalogs, False)
        return stored

    def remark(message: str) -> None:
        reader.draft.add_remark(f"{surface.name}: {message}")

    catalogs, location = supplement.glass_catalogs, surface.glass_location
    if reader.makers:
        found = find_glass(name, reader.makers, catalogs, location, remark)
    else:
        found = find_glass_of_unknown_maker(name, catalogs, location, remark)
    is_foreign = _remark_catalogues(reader, surface.name, found, record, supplement)
    if record is not None:
        reader.draft.compare_index(surface.name, found, record, catalogs, is_foreign)
    return found


def _lose_dispersion(reader: FileReader, surface_name: str, record: IndexRecord, glass: str) -> None:
    """Add a loss if the index of a glass without a name is not that at all wavelengths of the design."""
    wavelengths_um = reader.draft.wavelengths_um
    if record.is_exact_at(wavelengths_um):
        return
    w = wavelengths_um[0]
    reader.draft.add_loss(
        f"{surface_name}: dispersion of {glass} (Abbe number {record.vd:g}); its index at the d line, "
        f"{record.nd:g}, is used, and at {w:g} µm it is about {record.index(record.nd, w, ()):.4f}"
    )


def _index_record(values: Sequence[str], location: str) -> IndexRecord | None:
    """Return the index record behind the name of a glass; None if it is missing or a placeholder.

    OpticStudio writes 1.5 and 40 (or zeros, or an index of 1) where no index was ever computed.
    """
    if len(values) < 3 or integer_at(values, 0, location) > 3:  # those of an offset are no index
        return None
    nd = value_at(values, 2, location)
    vd = value_at(values, 3, location) if len(values) > 3 else 0.0
    if nd in (0.0, 1.0) or (nd, vd) == (1.5, 40.0):
        return None
    return IndexRecord(nd, vd or None)


# Names in GCAT records of the catalogues that OpticStudio supplies.
_STANDARD_CATALOGUES = """
ANGSTROMLINK APEL ARCHER ARTON AUER BIREFRINGENT CDGM CORNING HERAEUS HIKARI HOYA INFRARED ISUZU LIEBETRAUT
LIGHTPATH LZOS MISC NHG NIKON NIKON-HIKARI OHARA OSAKAGASCHEMICAL PILKINGTON RAD_HARD RPO SCHOTT SCHOTT_IRG
SUMITA TOPAS UMICORE VITRON ZEON
"""
_STANDARD = frozenset(_STANDARD_CATALOGUES.split())

# Other names of catalogues of the database.
_SAME_CATALOGUE = {"NIKON": "HIKARI", "NIKON-HIKARI": "HIKARI"}


def _remark_catalogues(
    reader: FileReader, surface_name: str, found: str, record: IndexRecord | None, supplement: Supplement
) -> bool:
    """Return whether the file does not name the catalogue that has a glass.

    A remark is added if the file also names a catalogue that is not available, and that may have the same
    glass name: one of the user's, or one of OpticStudio's that comes first, unless the name has the form of a
    maker (a hyphen) or the file's index record shows which glass is meant.
    """
    own = {path.name for path in supplement.glass_catalogs}
    try:
        catalog = get_material(found, supplement.glass_catalogs).catalog
    except MaterialError:  # reported later, when the index is needed
        return False
    if catalog in own or is_gap(found):
        return False
    named = [maker.casefold() for maker in reader.makers]
    is_foreign = catalog.casefold() not in named
    known = {name.casefold() for _, name in list_glasses()}
    stems = {name.casefold().removesuffix(".agf") for name in own}
    missing = []
    is_first = not is_foreign
    for c in reader.catalogues:
        alias = _SAME_CATALOGUE.get(c.upper(), c).casefold()
        if c.upper() in _STANDARD:
            alias = alias.split("_")[0]
        is_first = is_first and catalog.casefold() != alias
        is_ambiguous = is_first and record is None and "-" not in found
        is_available = c.casefold().removesuffix(".agf") in stems or alias in known
        if not is_available and (c.upper() not in _STANDARD or is_ambiguous):
            missing.append(c)
    if missing:
        reader.draft.add_remark(
            f"{surface_name}: glass {found} is that of {catalog}; the file also names {', '.join(missing)}, "
            "which may have another of this name (give it as a glass catalogue)"
        )
    return is_foreign


# With 25 digits a radius survives the conversion to a curvature and back without loss.
EXACT = Context(prec=25)

# Records of analyses, drawings, weights, variables, polarization, authors and comments, expansions by heat
# (TCED), and points of an aperture that USAP names (UDAD). They do not describe the lens at 20 degrees C.
_IDLE_WORDS = """
VERS PFIL LANG DBDT GLRS GSTD NSCD COFN RAIM PUSH SDMA OMMA ROPD HYPR PICB POLS LUID FWGN FWGT WWGT WWGN
MNCA MNEA MNCG MNEG MXCA MXCG RWRE BLNK TOL TOLE MOFF FCOM COMM HIDE MIRR SLAB POPS MEMA OEMA FIMP CONF
TBTP RSCE RWCE VDSZ VPAR VCON AUTH IWDP EERA SSID STUD SCOL BOOK CSUM FENF TCED UDAD
"""
_IDLE = frozenset(_IDLE_WORDS.split())


# Apertures that a design cannot represent; its surfaces end in circles.
_APERTURES = {
    "SQAP": "rectangular aperture",
    "ELAP": "elliptical aperture",
    "OBSC": "circular obscuration",
    "SQOB": "rectangular obscuration",
    "ELOB": "elliptical obscuration",
    "SPID": "spider",
    "USAP": "aperture drawn by the user",
    "USOB": "obscuration drawn by the user",
}

# Surface types that no shape declares, by the start of their names.
_SURFACE_TYPES = {
    "BINARY_": "diffractive phase",
    "BIRE_": "birefringent medium",
    "DGRATING": "diffraction grating",
    "EGRATING": "diffraction grating",
    "FRESNEL": "Fresnel surface",
    "FZERNPHA": "Zernike phase",
    "FZERNSAG": "Zernike sag",
    "GRID_": "values on a grid",
    "GRINSU": "gradient index",
    "HOLOGRM": "hologram",
    "IRREGUL": "irregular surface",
    "JONESMAT": "Jones matrix",
    "NONSEQ": "components in the order in which rays meet them",
    "PARAX": "ideal thin lens",
    "SZERNSAG": "Zernike sag",
    "TILTSURF": "tilted plane",
    "TOROGRAT": "diffraction grating",
    "USERSURF": "program of the user",
    "VLSGRAT": "diffraction grating",
    "XPOLYNOM": "polynomial in x and y",
}


@dataclass
class FileSurface:
    """Values of one surface, collected from its records.

    `terms` maps a parameter number (PARM) to its value, `extra_terms` that of extra data (XDAT).
    `breaks_before` and `breaks_behind` are the surface property Tilt/Decenter; `behind_status` is 1 if the
    latter repeats the former, and 2 if it undoes it.
    `automatic_mm` is a semi-diameter that OpticStudio computed from rays; it is not an aperture.
    `first_records` holds values and location of each record that may occur only once.
    """

    name: str
    location: str
    kind: str = "STANDARD"
    radius_mm: float | None = None
    conic: float = 0.0
    thickness_mm: float = 0.0
    glass: tuple[str, ...] = ()
    glass_location: str = ""
    semi_diameter_mm: float | None = None
    automatic_mm: float | None = None
    aperture_mm: float | None = None
    stop: bool = False
    breaks_before: CoordinateBreak | None = None
    breaks_behind: CoordinateBreak | None = None
    behind_status: int = 0
    terms: dict[int, float] = field(default_factory=dict)
    extra_terms: dict[int, float] = field(default_factory=dict)
    first_records: dict[str, tuple[list[str], str]] = field(default_factory=dict)


@dataclass
class FileReader:
    """State of the reader of one file.

    `wavelengths_um` maps the number of a wavelength to its value. `listed_wavelengths_um` does the same for
    an old record, whose entries beyond the number of wavelengths are void. `trailing_records` holds unknown
    records behind the last surface; they become losses if another surface follows.
    """

    draft: Draft
    surfaces: list[FileSurface] = field(default_factory=list)
    makers: list[str] = field(default_factory=list)
    catalogues: list[str] = field(default_factory=list)
    wavelengths_um: dict[int, float] = field(default_factory=dict)
    listed_wavelengths_um: dict[int, float] = field(default_factory=dict)
    wavelength_count: int | None = None
    primary: int = 1
    unit_mm: float = 1.0
    field_kind: int = 0
    field_count: int | None = None
    heights: dict[str, list[float]] = field(default_factory=dict)
    name: str = ""
    in_trailing_block: bool = False
    trailing_records: list[str] = field(default_factory=list)
    aperture_location: str = ""


def read_record(reader: FileReader, word: str, values: list[str], location: str, indented: bool) -> None:
    """Interpret one record of the file.

    The keyword decides whether a record describes the file or the most recent surface; indentation does not
    matter. An unknown record is a loss. The exception are records behind the last surface, where the merit
    function, tolerances and configurations follow (see :func:`finish_records`).

    Parameters
    ----------
    reader
        State of the reader; it is updated.
    word, values
        Keyword of the record in capitals, and the words that follow it.
    location
        File and line, for messages.
    indented
        Whether the record is indented.

    Raises
    ------
    InputError
        If a required value is missing or invalid.
    """
    if word == "SURF":
        _start_surface(reader, values, location)
        return
    surface = reader.surfaces[-1] if reader.surfaces else None
    line = location.rpartition(", ")[2]
    # Keywords that start the part behind the last surface: tolerances, configurations, the merit function.
    tail_starts = ("TOL", "TOLE", "MNUM", "MOFF")
    if word in _OF_FILE:
        _OF_FILE[word](reader, values, location)
    elif surface is not None and word in _OF_SURFACE:
        _drop_trailing_records(reader)
        _check_duplicate(surface, word, values, location)
        _OF_SURFACE[word](reader, surface, values, location)
    elif surface is not None and word in tail_starts:
        reader.in_trailing_block = True
    elif word in _IDLE:
        return
    elif surface is None and word.startswith("FSV"):
        reader.draft.add_remark(
            f"{word} {quoted(' '.join(values))} ({line}): field solve replaced by its value"
        )
    elif surface is None:
        reader.draft.add_loss(f"{word} {quoted(' '.join(values))} ({line})")
    elif word in _APERTURES:
        _drop_trailing_records(reader)
        reader.draft.add_loss(f"{surface.name}: {_APERTURES[word]}, {word} {quoted(' '.join(values))}")
    elif word in SOLVES and not reader.in_trailing_block:
        reader.draft.add_remark(f"{surface.name}: {word} solve or pickup replaced by its present value")
    elif indented and not _is_supported(surface.kind) and not reader.in_trailing_block:
        return  # data of a surface type whose name is a loss already
    elif reader.in_trailing_block or not indented:
        reader.trailing_records.append(f"{surface.name}: {word} {quoted(' '.join(values))}")
    else:
        reader.draft.add_loss(f"{surface.name}: {word} {quoted(' '.join(values))}")


def finish_records(reader: FileReader) -> None:
    """Decide whether unknown records behind the last surface are losses.

    A complete file lists its merit function there, followed by tolerances or configurations. In a file
    without the latter the unknown records are losses.
    """
    if not reader.in_trailing_block:
        _drop_trailing_records(reader)


def _drop_trailing_records(reader: FileReader) -> None:
    """Record the trailing records as losses, because the block of surfaces has not ended."""
    for record in reader.trailing_records:
        reader.draft.add_loss(record)
    reader.trailing_records.clear()
    reader.in_trailing_block = False


def _check_duplicate(surface: FileSurface, word: str, values: list[str], location: str) -> None:
    """Raise an error if a record that may occur only once occurs again with other values."""
    if word not in ("TYPE", "CURV", "CONI", "DISZ", "GLAS", "DIAM"):
        return
    first, first_location = surface.first_records.setdefault(word, (values, location))
    if first != values:
        raise InputError(
            f"{location}: {word} {quoted(' '.join(values))} is a second {word} record of {surface.name}; "
            f"{first_location.rpartition(', ')[2]} has {quoted(' '.join(first))}, and a surface has one"
        )


def _start_surface(reader: FileReader, values: list[str], location: str) -> None:
    expected = len(reader.surfaces)
    if values != [str(expected)]:
        raise InputError(f"{location}: SURF {quoted(' '.join(values))} where surface {expected} must follow")
    if expected > MAX_SURFACES:
        raise InputError(f"{location}: more than {MAX_SURFACES} surfaces")
    _drop_trailing_records(reader)
    reader.surfaces.append(FileSurface(f"surface {expected}", location))


def value_at(values: Sequence[str], index: int, location: str) -> float:
    """Return one value of a record as a number."""
    if index >= len(values):
        raise InputError(f"{location}: {len(values)} values; at least {index + 1} are required")
    return parse_number(values[index], location)


def integer_at(values: Sequence[str], index: int, location: str) -> int:
    """Return one value of a record as a whole number."""
    value = value_at(values, index, location)
    if value != int(value) or abs(value) > 1e6:
        raise InputError(f"{location}: {quoted(values[index])} must be a whole number")
    return int(value)


def _type(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    surface.kind = values[0] if values else ""
    if not _is_supported(surface.kind):
        known = (text for start, text in _SURFACE_TYPES.items() if surface.kind.startswith(start))
        words = "".join(f" ({text})" for text in known)
        reader.draft.add_loss(f"{surface.name}: surface type {quoted(surface.kind)}{words}, read as STANDARD")


def _is_supported(kind: str) -> bool:
    return kind == "COORDBRK" or shape_of_type(kind, {}, {}) is not None


def shape_of_type(
    kind: str, parameters: Mapping[int, float], extra_data: Mapping[int, float]
) -> tuple[type[Shape], dict[str, Any]] | None:
    """Return the shape class of a surface type and its keys except radius and conic; None if unknown."""
    for shape in shape_classes():
        keys = shape.keys_of_zemax(kind, parameters, extra_data)
        if keys is not None:
            return shape, keys
    return None


def _curvature(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    surface.radius_mm = radius_mm(values[0], location) if value_at(values, 0, location) else None
    if len(values) > 1 and parse_number(values[1], location) > 1.0:  # 1 marks a variable
        reader.draft.add_remark(f"{surface.name}: curvature solve replaced by its present value")


def _conic(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    surface.conic = value_at(values, 0, location)


def _distance(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    endless = bool(values) and values[0].upper() == "INFINITY"
    surface.thickness_mm = math.inf if endless else value_at(values, 0, location)


def _glass(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    if not values:
        raise InputError(f"{location}: GLAS without a name")
    surface.glass, surface.glass_location = tuple(values), f"{location} ({surface.name})"
    if values[0].upper() == "MIRROR":
        reader.draft.add_loss(f"{surface.name}: mirror, read as a surface in air")


def _diameter(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    """Read a semi-diameter and its solve: 0 automatic, 1 fixed, 2 pickup, 3 maximum of configurations.

    Automatic values and maxima follow the rays and do not clip. Without a solve the value is fixed.
    """
    value = value_at(values, 0, location)
    solve = integer_at(values, 1, location) if len(values) > 1 else 1
    surface.semi_diameter_mm = surface.automatic_mm = None
    if value <= 0.0:
        return
    if solve in (0, 3):
        surface.automatic_mm = value
        return
    surface.semi_diameter_mm = value
    if solve != 1:
        reader.draft.add_remark(f"{surface.name}: semi-diameter solve replaced by its present value")


def _aperture(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    if value_at(values, 0, location) > 0.0:
        reader.draft.add_loss(f"{surface.name}: central obscuration of radius {values[0]}")
    value = value_at(values, 1, location)
    surface.aperture_mm = value if value > 0.0 else None


def _shift(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    if any(parse_number(v, location) for v in values):
        reader.draft.add_loss(f"{surface.name}: decentered aperture")


def _tilt_decenter(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    """Read the surface property Tilt/Decenter: before (1) or behind (2) the surface, order, status, values.

    The order is 0 for decenters before tilts, and 1 for the reverse. The status behind a surface is 0 for the
    values of the record, 1 for those before the surface, and 2 for their inverse. Others refer to preceding
    surfaces and are a loss.
    """
    place, order, status = (integer_at(values, i, location) for i in range(3))
    x, y, a, b, c = (value_at(values, i, location) for i in range(3, 8))
    axes = CoordinateBreak((x, y), (a, b, c), order != 0)
    if place == 1 and status == 0:
        surface.breaks_before = axes
    elif place == 2 and status in (0, 1, 2):
        surface.breaks_behind, surface.behind_status = axes, status
    else:
        reader.draft.add_loss(f"{surface.name}: tilt and decenter, SCBD {quoted(' '.join(values))}")


def _rotation(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    """Add a loss for a record of old versions, whose meaning is not published, unless its values are zero."""
    if any(parse_number(v, location) for v in values):
        reader.draft.add_loss(f"{surface.name}: ROTA {quoted(' '.join(values))}")


def _coating(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    reader.draft.add_remark(
        f"{surface.name}: coating {quoted(' '.join(values))} omitted; it does not change the paths of rays"
    )


def _stop(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    surface.stop = True


def _parameter(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    surface.terms[integer_at(values, 0, location)] = value_at(values, 1, location)


def _extra_term(reader: FileReader, surface: FileSurface, values: list[str], location: str) -> None:
    surface.extra_terms[integer_at(values, 0, location)] = value_at(values, 1, location)


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
    "XDAT": _extra_term,
    "COAT": _coating,
    "SCBD": _tilt_decenter,
    "ROTA": _rotation,
}


def _mode(reader: FileReader, values: list[str], location: str) -> None:
    if values != ["SEQ"]:
        raise InputError(
            f"{location}: MODE {quoted(' '.join(values))}; only sequential files (SEQ) can be read"
        )


UNITS_MM = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "METER": 1000.0}
"""Length in mm of each unit of a .zmx file."""


def _unit(reader: FileReader, values: list[str], location: str) -> None:
    if not values or values[0] not in UNITS_MM:
        raise InputError(
            f"{location}: UNIT {quoted(' '.join(values[:1]))}; lengths must be in {', '.join(UNITS_MM)}"
        )
    reader.unit_mm = UNITS_MM[values[0]]
    if reader.unit_mm != 1.0:
        reader.draft.add_remark(f"lengths in {values[0]} converted to mm ({reader.unit_mm:g} mm each)")


def _set_aperture(reader: FileReader, kind: str, value: float, location: str) -> None:
    """Set the system aperture; a file has exactly one."""
    if reader.draft.aperture not in (None, (kind, value)):
        raise InputError(
            f"{location}: a second system aperture that differs from the one of {reader.aperture_location}; "
            "a file must have exactly one"
        )
    reader.draft.aperture, reader.aperture_location = (kind, value), location.rpartition(", ")[2]


def _pupil(reader: FileReader, values: list[str], location: str) -> None:
    _set_aperture(reader, "pupil_diameter_mm", value_at(values, 0, location), location)


def _f_number(reader: FileReader, values: list[str], location: str) -> None:
    working = len(values) > 1 and parse_number(values[1], location) == 1.0
    kind = "working_f_number" if working else "image_f_number"
    _set_aperture(reader, kind, value_at(values, 0, location), location)


def _object_aperture(reader: FileReader, values: list[str], location: str) -> None:
    value = value_at(values, 0, location)
    in_degrees = len(values) > 1 and parse_number(values[1], location) == 1.0
    _set_aperture(reader, "object_na", math.sin(math.radians(value)) if in_degrees else value, location)


def _floating(reader: FileReader, values: list[str], location: str) -> None:
    _set_aperture(reader, "stop", 0.0, location)


def _field_type(reader: FileReader, values: list[str], location: str) -> None:
    reader.field_kind = integer_at(values, 0, location)
    if len(values) > 1 and integer_at(values, 1, location):
        reader.draft.add_loss("telecentric object space")
    if len(values) > 3:
        reader.field_count, reader.wavelength_count = (
            integer_at(values, 2, location),
            integer_at(values, 3, location),
        )


def _further_field(reader: FileReader, values: list[str], location: str) -> None:
    """Read a field behind the twelfth one: x, y, weight and vignetting factors."""
    listed = [reader.heights.setdefault(axis, []) for axis in "xy"]
    count = max(map(len, listed))
    for index, heights in enumerate(listed):
        heights += [0.0] * (count - len(heights)) + [value_at(values, index, location)]
    read_vignetting(reader, values[3:], location)


def _wave(reader: FileReader, values: list[str], location: str) -> None:
    reader.wavelengths_um[integer_at(values, 0, location)] = value_at(values, 1, location)


def _waves(reader: FileReader, values: list[str], location: str) -> None:
    reader.wavelengths_um = {i: parse_number(v, location) for i, v in enumerate(values, start=1)}


def _listed_waves(reader: FileReader, values: list[str], location: str) -> None:
    reader.listed_wavelengths_um = {i: parse_number(v, location) for i, v in enumerate(values, start=1)}


def _primary(reader: FileReader, values: list[str], location: str) -> None:
    reader.primary = integer_at(values, 0, location)


def _catalogues(reader: FileReader, values: list[str], location: str) -> None:
    names = [
        name
        for maker in values
        for name in (maker, maker.split("_")[0], _SAME_CATALOGUE.get(maker.upper(), maker))
    ]
    reader.makers = list(dict.fromkeys(names))
    reader.catalogues = values


def _environment(reader: FileReader, values: list[str], location: str) -> None:
    celsius, atmospheres = value_at(values, 0, location), value_at(values, 1, location)
    if (celsius, atmospheres) != (20.0, 1.0):
        reader.draft.add_loss(
            f"environment of {celsius:g} degrees C and {atmospheres:g} atm; a design has 20 and 1"
        )


def _apodization(reader: FileReader, values: list[str], location: str) -> None:
    if parse_number(values[0], location) if values else 0.0:
        reader.draft.add_remark("apodization of the pupil omitted; it does not change the paths of rays")


def _configurations(reader: FileReader, values: list[str], location: str) -> None:
    reader.in_trailing_block |= bool(reader.surfaces)
    if integer_at(values, 0, location) > 1:
        reader.draft.add_loss(
            f"{values[0]} configurations; the one whose values the surfaces hold is read, unless another "
            "is chosen (--configuration 2, Supplement(configuration=2))"
        )


_OF_FILE: dict[str, Callable[[FileReader, list[str], str], None]] = {
    "MODE": _mode,
    "UNIT": _unit,
    "ENPD": _pupil,
    "FNUM": _f_number,
    "OBNA": _object_aperture,
    "FLOA": _floating,
    "FTYP": _field_type,
    "XFLN": field_height_reader("x"),
    "YFLN": field_height_reader("y"),
    "XFLD": field_height_reader("x"),
    "YFLD": field_height_reader("y"),
    **dict.fromkeys(
        ("VDXN", "VDYN", "VCXN", "VCYN", "VANN", "ZVDX", "ZVDY", "ZVCX", "ZVCY", "ZVAN"), read_vignetting
    ),
    "FEFD": _further_field,
    "WAVM": _wave,
    "WAVL": _waves,
    "WAVN": _listed_waves,
    "PWAV": _primary,
    "GCAT": _catalogues,
    "ENVD": _environment,
    "GFAC": _apodization,
    "MNUM": _configurations,
}


def radius_mm(curvature: str, location: str) -> float:
    """Return the radius of a curvature that is given as text.

    Other programs round a radius more than once before they store its curvature. If a radius of at most 12
    digits explains the curvature within this rounding, it is returned. A curvature with more than 21 digits
    identifies its radius exactly.
    """
    rounding = 2e-14  # relative
    value = parse_number(curvature, location)
    digits = curvature.lower().split("e")[0].strip("+-").replace(".", "").strip("0")
    exact = float(EXACT.divide(Decimal(1), Decimal(curvature.lower().replace("d", "e"))))
    if len(digits) <= 21:
        for count in range(1, 13):
            short = float(f"{exact:.{count}g}")
            if abs(short * value - 1.0) <= rounding:
                return short
    if not math.isfinite(exact):
        raise InputError(
            f"{location}: curvature {quoted(curvature)} is too small; its radius exceeds the range of numbers"
        )
    return exact


def write_zmx(
    lens: Lens,
    path: str | os.PathLike[str],
    pose: Pose = Pose(),
    *,
    warn: Callable[[str], None] = warnings.warn,
) -> None:
    """Write a lens to a Zemax OpticStudio file (.zmx).

    :func:`read_zmx` reads the same lens and pose from the file. Numbers are written with all digits. The pose
    becomes a pair of coordinate breaks at its pivot. A constant index becomes a model glass without
    dispersion. Notes hold the sensor, the title and the exact glass names. Trailing asphere coefficients of
    zero are omitted.

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
        If the format cannot represent the lens (a measured figure, or a shape that OpticStudio lacks), or if
        the file cannot be written. An existing file then stays unchanged.
    MaterialError
        If a glass is unknown.

    Examples
    --------
    >>> from lensdesign import load_design, read_zmx, write_zmx
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> write_zmx(lens, "lens.zmx")
    >>> read_zmx("lens.zmx").lens == lens
    True
    """
    target = Path(path)
    check_writable(lens, pose, lambda shape: shape.zemax(), "a .zmx file")
    for note in omissions(lens, "a .zmx file"):
        warn(note)
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
        for s in written_surfaces(lens)
        if isinstance(s.material, str)
    ]
    names = dict.fromkeys(c.removesuffix(".agf").removesuffix(".AGF").upper() for c in catalogs)
    makers = [name for name in names if name.isalnum()]
    half, count = 0.5 * lens.object.field_diameter_mm, len(lens.wavelengths_um)
    return [
        "VERS 171115 0 0",
        "MODE SEQ",
        f"NAME {plain_title(lens.title)}",
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
    """Return the records of every surface from the object to the image."""
    records = [
        [
            f"TYPE {kind}",
            f"CURV {EXACT.divide(Decimal(1), Decimal(s.radius_mm))}"
            if s.radius_mm is not None
            else "CURV 0.0",
            *(["STOP"] if i == lens.stop_index and s.stop else []),
            *(f"PARM {n} {value!r}" for n, value in parameters.items()),
            *(f'XDAT {n} {value!r} 0 0 1.0 0.0 0 ""' for n, value in s.shape.zemax_extra_data().items()),
            *([f"CONI {s.conic!r}"] if s.conic else []),
            *([f"GLAS {_glass_values(s.material, lens)}"] if s.material is not None else []),
            *(
                [f'DIAM {s.semi_diameter_mm!r} 1 0 0 1 ""', f"FLAP 0 {s.semi_diameter_mm!r} 0"]
                if s.semi_diameter_mm is not None
                else []
            ),
        ]
        for i, s in enumerate(written_surfaces(lens))
        for kind, parameters in [s.shape.zemax()]
    ]
    inner, plate = records[: len(lens.surfaces)], records[len(lens.surfaces) :]
    distances = [s.thickness_mm or 0.0 for s in lens.surfaces[:-1]]
    front, back = ["TYPE STANDARD", "CURV 0.0"], ["TYPE STANDARD", "CURV 0.0", "DISZ 0.0"]
    if pose == Pose():
        blocks = [front, *inner]
        distances = [lens.object.working_distance_mm, *distances, lens.sensor.plane_distances_mm[0]]
    else:
        to_pivot, to_front, to_back, to_sensor = pose_distances(lens, pose)
        axes = pose_break(pose)
        blocks = [front, _break_records(axes), *inner, _break_records(axes.inverse())]
        distances = [to_pivot, to_front, *distances, to_back, to_sensor]
    glass = lens.sensor.cover_glass
    if glass is not None:
        blocks += plate
        distances = [*distances[:-1], distances[-1] - glass.depth_mm, glass.thickness_mm, glass.distance_mm]
    placed = [[*block, f"DISZ {d!r}"] for block, d in zip(blocks, distances, strict=True)]
    return [*placed, back]


def _break_records(axes: CoordinateBreak) -> list[str]:
    values = (*axes.decenter_mm, *axes.tilt_deg, float(axes.reverse))
    return ["TYPE COORDBRK", "CURV 0.0", *(f"PARM {i} {v!r}" for i, v in enumerate(values, start=1))]


def _glass_values(material: str | float, lens: Lens) -> str:
    if not isinstance(material, str):
        return f"___BLANK 1 0 {material!r} 0.0 0 0 0 0 0 0"
    summary = glass_summary(material, lens.glass_catalogs)
    return f"{_token(material)} 0 0 {summary['nd'] or 1.5!r} {summary['vd'] or 0.0!r} 0 0 0 0 0 0"


def _token(material: str) -> str:
    """Return a glass name as one word, without its catalogue."""
    return "_".join(material.rpartition(":")[2].split())
