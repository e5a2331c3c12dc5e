"""Refractive indices: constants, glass catalogue files, and the refractiveindex.info database.

All indices are relative to air of 20 degrees Celsius and 101,325 Pa, as glass makers publish them. Air has
the index 1, and a vacuum 0.99973 (the inverse of the index of air).
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from numbers import Real
from pathlib import Path
from typing import Any

from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.agf import LINE_C_UM, LINE_D_UM, LINE_F_UM, AgfGlass, read_agf
from lensdesign.lens.catalogues.database import (
    Page,
    Table,
    database_pages,
    database_version,
    read_page,
)
from lensdesign.lens.catalogues.thermal import (
    LOWEST_INDEX,
    REFERENCE_C,
    HeatedDispersion,
    Thermal,
    air_index,
    at_temperature,
    split_temperature,
)

# Books of the database's `specs` shelf and their makers. Where two makers use the same name, the first one
# in this table is used.
_MAKER_BOOKS = {
    "SCHOTT-optical": "Schott",
    "OHARA-optical": "Ohara",
    "HOYA-optical": "Hoya",
    "CDGM-optical": "CDGM",
    "HIKARI-optical": "Hikari",
    "SUMITA-optical": "Sumita",
    "LZOS-optical": "LZOS",
    "SCHOTT-misc": "Schott",
    "HIKARI-misc": "Hikari",
    "CORNING-display": "Corning",
    "SCHOTT-infrared": "Schott",
    "VITRON-infrared": "Vitron",
    "AMI-infrared": "AMI",
    "LightPath-infrared": "LightPath",
    "CRYSTRAN-optical": "Crystran",
    "BARBERINI-filter": "Barberini",
    "ISUZU-filter": "Isuzu",
    "Cargille": "Cargille",
}

# Measurements from the literature for materials that no maker's catalogue lists: page -> names.
# Birefringent crystals have the index of their ordinary ray.
_LITERATURE_PAGES = {
    ("organic", "poly_methyl_methacrylate", "Beadie"): ("PMMA", "ACRYLIC"),
    ("organic", "polycarbonate", "Sultanova"): ("POLYCARB", "PC", "POLYCARBONATE"),
    ("organic", "polystyrene", "Sultanova"): ("POLYSTYR", "PS", "POLYSTYRENE"),
    ("other", "ZeonexE48R", "Sultanova"): ("E48R", "COP", "ZEONEX"),
    ("other", "Optorez1330", "Sultanova"): ("OPTOREZ1330",),
    ("other", "C8H8_n-C3H3N_m", "Sultanova"): ("SAN",),
    ("other", "NAS-21", "Sultanova"): ("NAS-21", "NAS"),
    ("main", "SiO2", "Malitson"): ("SILICA", "F_SILICA", "FUSED_SILICA", "FUSED SILICA", "SiO2"),
    ("main", "CaF2", "Malitson"): ("CaF2",),
    ("main", "BaF2", "Malitson"): ("BaF2",),
    ("main", "MgF2", "Dodge-o"): ("MgF2",),
    ("main", "Al2O3", "Malitson-o"): ("SAPPHIRE", "Al2O3"),
}


@dataclass(frozen=True)
class Material:
    """An optical medium and its index over a range of wavelengths.

    Parameters
    ----------
    name
        Name in its catalogue, or the value of a constant index as text.
    wavelength_range_um
        Shortest and longest wavelength for which the index is known; both ends are allowed.
    catalog
        Maker, "refractiveindex.info", the name of a catalogue file, or "constant".
    source
        Source of the data as text; empty for a constant.
    dispersion
        Function that returns the index at a wavelength in um without a check of the range.
    thermal
        Thermal data of the material.
    density_g_per_cm3
        Density; None if the catalogue does not state it.
    notes
        Remarks on the catalogue entry that a user of the material should know.
    """

    name: str
    wavelength_range_um: tuple[float, float]
    catalog: str
    source: str = field(repr=False)
    dispersion: Callable[[float], float] = field(repr=False)
    thermal: Thermal = field(default=Thermal(), repr=False)
    density_g_per_cm3: float | None = field(default=None, repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)

    def index(self, wavelength_um: float) -> float:
        """Return the refractive index relative to air.

        Parameters
        ----------
        wavelength_um
            Vacuum wavelength (air has the index 1).

        Raises
        ------
        MaterialError
            If the wavelength is outside the range, or the data give no index of `LOWEST_INDEX` or more there.
        """
        shortest, longest = self.wavelength_range_um
        if not shortest <= wavelength_um <= longest:
            raise MaterialError(
                f"{self.name} ({self.catalog}): the index at {wavelength_um:g} µm is not known; "
                f"the wavelength must be from {shortest:g} to {longest:g} µm"
            )
        if not 0.0 < wavelength_um < math.inf:
            raise MaterialError(f"wavelength_um = {wavelength_um:g}: must be finite and above 0")
        index = float(self.dispersion(float(wavelength_um)))
        if not LOWEST_INDEX <= index < math.inf:
            raise MaterialError(
                f"{self.name} ({self.catalog}): the data gives {index:g} as the index at "
                f"{wavelength_um:g} µm; a transparent medium has a finite index of at least {LOWEST_INDEX} "
                "relative to air (a vacuum has 0.99973)"
            )
        return index


def is_air(material: str | float | None) -> bool:
    """Return whether a material of a design file is air: None, AIR or the index 1."""
    if isinstance(material, str):
        return material.strip().upper() == "AIR"
    return material is None or material == 1.0


def is_vacuum(material: str | float | None) -> bool:
    """Return whether a material of a design file is a vacuum, also one at a temperature or of a catalogue."""
    if not isinstance(material, str):
        return False
    return material.rpartition(":")[2].partition("@")[0].strip().upper() == "VACUUM"


def is_gap(material: str | float | None) -> bool:
    """Return whether a medium is nothing solid: air, a vacuum, or an index of at most 1."""
    return is_air(material) or is_vacuum(material) or (isinstance(material, float) and material <= 1.0)


def get_material(material: str | float, catalogs: Iterable[Path] = ()) -> Material:
    """Return a material by its name, or one with a constant index.

    A name may be any of

    - ``AIR``, with the index 1, since catalogue indices are relative to air, or ``VACUUM``, with 0.99973;
    - a glass name such as ``N-BK7``, in upper or lower case. It is searched first in the given catalogue
      files, in their order, then in the refractiveindex.info database: Schott, Ohara, Hoya, CDGM, Hikari,
      Sumita, LZOS, then infrared glasses, crystals and filters. The first maker that has the name is used;
    - a plastic or a crystal: PMMA, POLYCARB, POLYSTYR, E48R, SILICA, CaF2, SAPPHIRE (ordinary ray) ...;
    - any of these with its catalogue, such as ``OHARA:S-BSL7`` or ``my_glasses.agf:X1``;
    - any of these with a temperature, such as ``N-BK7@50C``: the index at 50 degrees Celsius, relative to air
      at 50 degrees Celsius.

    Names are never guessed: an unknown name raises an error that lists similar ones.

    Parameters
    ----------
    material
        Name of a material, or a constant index of at least `LOWEST_INDEX` for every wavelength.
    catalogs
        Paths of glass catalogue files in Zemax's AGF format.

    Returns
    -------
    Material
        The material; its method `index` returns the refractive index at a vacuum wavelength in um.

    Raises
    ------
    MaterialError
        If the name is unknown or matches two materials, the index is too small or not finite, a catalogue
        file cannot be read, or its entry for this glass contradicts itself or another entry.

    Notes
    -----
    Some of the database's pages are tables and not fits (LZOS, SCHOTT:B270, most of Crystran's). They are
    interpolated linearly. In the visible the interpolation error reaches 1e-3 between the most widely spaced
    lines (LZOS's densest flints). A dispersion formula is as accurate as the fit of its maker.

    Examples
    --------
    >>> from lensdesign import get_material
    >>> glass = get_material("N-BK7")
    >>> glass.catalog, round(glass.index(0.5875618), 4)
    ('Schott', 1.5168)
    """
    if not isinstance(material, str):
        return _constant(material)
    if is_air(material):
        return _constant(1.0, name="AIR")
    if material.strip().upper() == "VACUUM":
        return _vacuum(REFERENCE_C, "VACUUM")
    files = tuple(Path(path) for path in catalogs)
    if "@" in material:
        return _at_temperature(material, files)
    return _find(material, files) if files else _find_in_database(material)


@lru_cache(maxsize=256)
def _find_in_database(material: str) -> Material:
    return _find(material, ())


def _find(material: str, files: tuple[Path, ...]) -> Material:
    maker, name = _split(material)
    for entries in _sources(files):
        found = [
            entry
            for entry in entries
            if entry.name.casefold() == name and (not maker or maker in entry.makers)
        ]
        if found:
            return _choose(material, found).load()
    raise MaterialError(_unknown_message(material, files))


def _at_temperature(material: str, files: tuple[Path, ...]) -> Material:
    name, temperature_c = split_temperature(material)
    if name.upper() == "VACUUM":
        return _vacuum(temperature_c, at_temperature("VACUUM", temperature_c))
    found = get_material(name, files)
    if is_air(name):
        return found
    if not found.thermal.knows_index:
        raise MaterialError(
            f"{found.name} ({found.catalog}): the change of its index with temperature is not known; use a "
            "glass for which it is, or an AGF catalogue with a TD record"
        )
    heated = HeatedDispersion(found.dispersion, found.thermal, temperature_c)
    return replace(found, name=at_temperature(name, temperature_c), dispersion=heated)


def refractive_index(material: str | float, wavelength_um: float, catalogs: Iterable[Path] = ()) -> float:
    """Return the refractive index of a material at one wavelength; see :func:`get_material`.

    Examples
    --------
    >>> refractive_index(1.5, 0.55)
    1.5
    """
    return get_material(material, catalogs).index(wavelength_um)


def list_glasses(catalogs: Iterable[Path] = ()) -> tuple[tuple[str, str], ...]:
    """Return every (name, catalogue) that `get_material` knows, in the order of its search.

    Examples
    --------
    >>> ("N-BK7", "Schott") in list_glasses()
    True
    """
    entries = _all_entries(tuple(Path(path) for path in catalogs))
    return tuple((entry.name, entry.catalog) for entry in entries)


def glass_summary(material: str | float, catalogs: Iterable[Path] = ()) -> dict[str, Any]:
    """Return the key figures of a material.

    Parameters
    ----------
    material, catalogs
        Name or constant index, and catalogue files, as for :func:`get_material`.

    Returns
    -------
    dict
        ``name``, ``catalog``, ``source``; ``wavelength_range_um`` (None if every wavelength is allowed);
        ``nd``, the index at the helium d line; ``vd``, the Abbe number (nd - 1) / (nF - nC). `nd` and `vd`
        are None where the range does not contain the lines. `vd` is also None for a constant index.

    Raises
    ------
    MaterialError
        If the material is not found.

    Examples
    --------
    >>> round(glass_summary("N-BK7")["vd"], 1)
    64.2
    """
    glass = get_material(material, catalogs)
    shortest, longest = glass.wavelength_range_um

    def in_range(wavelength_um: float) -> bool:
        return shortest <= wavelength_um <= longest

    nd = glass.index(LINE_D_UM) if in_range(LINE_D_UM) else None
    vd = None
    if nd is not None and in_range(LINE_F_UM) and in_range(LINE_C_UM):
        spread = glass.index(LINE_F_UM) - glass.index(LINE_C_UM)
        vd = (nd - 1.0) / spread if spread else None
    return {
        "name": glass.name,
        "catalog": glass.catalog,
        "source": glass.source,
        "wavelength_range_um": [shortest, longest] if math.isfinite(longest) else None,
        "nd": nd,
        "vd": vd,
    }


@dataclass(frozen=True)
class _Vacuum:
    temperature_c: float

    def __call__(self, wavelength_um: float) -> float:
        return 1.0 / air_index(wavelength_um, self.temperature_c)


def _vacuum(temperature_c: float, name: str) -> Material:
    """Return a vacuum, relative to air of a temperature; the formula of air has poles below 0.16 um."""
    return Material(name, (0.2, math.inf), "vacuum", "", _Vacuum(temperature_c))


@dataclass(frozen=True)
class _Constant:
    value: float

    def __call__(self, _wavelength_um: float) -> float:
        return self.value


def _constant(value: float, name: str | None = None) -> Material:
    if isinstance(value, bool) or not isinstance(value, Real) or not LOWEST_INDEX <= value < math.inf:
        raise MaterialError(
            f"material {value!r}: must be the name of a material or a finite refractive index of at least "
            f"{LOWEST_INDEX} (air has 1, a vacuum 0.99973)"
        )
    value = float(value)
    return Material(name or repr(value), (0.0, math.inf), "constant", "", _Constant(value))


@dataclass(frozen=True)
class _Entry:
    """A name under which a material can be found, and how to load it."""

    name: str
    catalog: str
    load: Callable[[], Material]

    @property
    def makers(self) -> tuple[str, ...]:
        """Prefixes allowed before the colon: the catalogue, for a file also without its suffix."""
        catalog = self.catalog.casefold()
        return (catalog, catalog.removesuffix(".agf"))


@lru_cache(maxsize=1)
def _database_entries() -> tuple[_Entry, ...]:
    pages = database_pages()
    entries: list[_Entry] = []

    def add(names: Sequence[str], catalog: str, page: Page) -> None:
        def load() -> Material:
            data = read_page(page)
            source = (
                f"{page.book_name}; {page.name} "
                f"(refractiveindex.info {database_version()}, {page.shelf}/{page.book}/{page.page})"
            )
            notes: tuple[str, ...] = ()
            if isinstance(data.dispersion, Table):
                notes = (
                    f"the index of {names[0]} ({catalog}) is known at "
                    f"{len(data.dispersion.wavelengths_um)} wavelengths; between them it is interpolated "
                    "linearly, and may differ from a dispersion formula by 1e-4 and more",
                )
            return Material(
                names[0],
                data.wavelength_range_um,
                catalog,
                source,
                data.dispersion,
                data.thermal,
                data.density_g_per_cm3,
                notes,
            )

        entries.extend(_Entry(name, catalog, load) for name in names)

    for key, names in _LITERATURE_PAGES.items():
        if key in pages:
            add(names, "refractiveindex.info", pages[key])
    for book, maker in _MAKER_BOOKS.items():
        for page in pages.values():
            if page.shelf == "specs" and page.book == book:
                add((page.page,), maker, page)
    return tuple(entries)


def _file_entries(path: Path) -> tuple[_Entry, ...]:
    def entry(glass: AgfGlass) -> _Entry:
        temperature = glass.reference_temperature_c
        parts = [str(path), glass.comment, "" if temperature is None else f"index at {temperature:g} C"]
        source = "; ".join(part for part in parts if part)
        reference_c = REFERENCE_C if temperature is None else temperature
        thermal = Thermal(glass.schott, None, reference_c, glass.expansion_per_k)
        material = Material(
            glass.name,
            glass.wavelength_range_um,
            path.name,
            source,
            glass,
            thermal,
            glass.density_g_per_cm3,
            glass.notes,
        )

        def load() -> Material:
            if glass.fault:
                raise MaterialError(glass.fault)
            return material

        return _Entry(glass.name, path.name, load)

    return tuple(entry(glass) for glass in read_agf(path))


def _sources(files: tuple[Path, ...]) -> Iterator[tuple[_Entry, ...]]:
    """Yield the entries of each source in order of search; the database is read only if it is reached."""
    for path in files:
        yield _file_entries(path)
    yield _database_entries()


def _all_entries(files: tuple[Path, ...]) -> tuple[_Entry, ...]:
    return tuple(entry for entries in _sources(files) for entry in entries)


def _split(material: str) -> tuple[str, str]:
    """Return the catalogue before the colon (may be empty) and the name, both case-folded."""
    maker, colon, name = material.strip().casefold().rpartition(":")
    if not name or (colon and not maker):
        raise MaterialError(f"material {material!r}: must be a name such as 'N-BK7' or 'SCHOTT:N-BK7'")
    return maker.strip(), name.strip()


def _choose(material: str, found: Sequence[_Entry]) -> _Entry:
    """Return the entry with this very spelling, else the first; refuse names that differ only in case."""
    requested = material.rpartition(":")[2].strip()
    exact = [entry for entry in found if entry.name == requested]
    if not exact and len({entry.name for entry in found}) > 1:
        options = ", ".join(f"{entry.name} ({entry.catalog})" for entry in found)
        raise MaterialError(f"material {material!r} could be any of {options}; write it in one of these ways")
    return (exact or list(found))[0]


def normalized_name(name: str) -> str:
    """Return the letters and digits of a glass name in lower case; programs differ in other characters."""
    return "".join(letter for letter in name.casefold() if letter.isalnum())


def _unknown_message(material: str, files: tuple[Path, ...]) -> str:
    longest_name = 80  # no name of a glass is longer; a damaged file may hold any text in its place
    if len(material) > longest_name:
        return f"unknown material {material[:longest_name]!r}... ({len(material)} characters)"
    if _is_number(material):
        return f"unknown material {material!r}; a constant index is a number, without quotation marks"
    maker, name = _split(material)
    entries = _all_entries(files)
    makers = {label for entry in entries for label in entry.makers}
    if maker and maker not in makers:
        known = ", ".join(dict.fromkeys(entry.catalog for entry in entries))
        return f"unknown catalogue in material {material!r}; known are {known}"
    if maker:
        entries = tuple(entry for entry in entries if maker in entry.makers)
    similar = _similar(name, entries)
    if not similar:
        return f"unknown material {material!r}; nothing known has a similar name"
    options = ", ".join(f"{entry.name} ({entry.catalog})" for entry in similar)
    return f"unknown material {material!r}; did you mean {options}?"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _similar(name: str, entries: Sequence[_Entry]) -> list[_Entry]:
    """Return entries with the same letters and digits, then those that contain them, then close spellings."""
    requested = normalized_name(name)
    plain = [(normalized_name(entry.name), entry) for entry in entries]
    containing = [pair for pair in plain if requested and requested in pair[0]]
    containing.sort(key=lambda pair: len(pair[0]))
    close = difflib.get_close_matches(requested, dict.fromkeys(key for key, _ in plain), n=5)
    first = dict(reversed(plain))
    ranked = [entry for _, entry in containing] + [first[key] for key in close]
    return list({(entry.name, entry.catalog): entry for entry in ranked}.values())[:5]
