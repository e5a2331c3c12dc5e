"""Sag tables: closed forms, the best-fit sphere, measured figures, files."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from random_lenses import numbers, signed
from small_lenses import lens_of

from lensdesign.analysis.sag_tables import COLUMNS, sag_table, write_sag_table
from lensdesign.errors import DesignError, InputError
from lensdesign.lens.lens import Lens


def surface_of(**surface: Any) -> Lens:
    """A lens of one surface."""
    return lens_of({"semi_diameter_mm": 8.0} | surface)


@given(radius=signed(8.5, 500.0), spacing=numbers(0.05, 20.0))
def test_a_sphere_does_not_depart_from_its_best_fit(radius: float, spacing: float) -> None:
    table = sag_table(surface_of(radius_mm=radius), 0, spacing)
    assert table.best_fit_radius_mm == pytest.approx(radius, rel=1e-11)
    np.testing.assert_allclose(table.departure_mm, 0.0, atol=1e-11)
    r = table.radial_height_mm
    np.testing.assert_allclose(
        table.sag_mm, radius - math.copysign(1.0, radius) * np.sqrt(radius**2 - r**2), atol=1e-10
    )
    np.testing.assert_allclose(table.slope, r / np.sqrt(radius**2 - r**2) * math.copysign(1.0, radius))
    assert r[0] == 0.0
    assert r[-1] == 8.0
    assert len(r) == math.ceil(8.0 / spacing * (1.0 - 1e-12)) + 1
    np.testing.assert_allclose(np.diff(r)[:-1], spacing)
    assert 0.0 < r[-1] - r[-2] <= spacing * (1.0 + 1e-9)


def test_a_plane_has_a_sphere_without_end() -> None:
    table = sag_table(surface_of(), 0, 1.0)
    assert math.isinf(table.best_fit_radius_mm)
    assert not np.any(table.sag_mm)
    assert not np.any(table.departure_mm)


def test_a_parabola_by_its_closed_form() -> None:
    radius = 60.0
    table = sag_table(surface_of(radius_mm=radius, conic=-1.0), 0, 0.25)
    r = table.radial_height_mm
    np.testing.assert_allclose(table.sag_mm, r**2 / (2.0 * radius), rtol=1e-15)
    np.testing.assert_allclose(table.slope, r / radius, rtol=1e-15)
    # To fourth order the sphere is c r^2 / 2 + c^3 r^4 / 8: minimize over c the area integral of the squares.
    c0 = 1.0 / radius
    expected = c0 * (1.0 - 3.0 / 16.0 * (c0 * 8.0) ** 2)
    assert 1.0 / table.best_fit_radius_mm == pytest.approx(expected, rel=3e-4)
    assert 1.0 / table.best_fit_radius_mm != pytest.approx(c0, rel=2e-3)


@given(radius=signed(9.0, 300.0), conic=numbers(-3.0, 0.1), a4=numbers(-2e-5, 2e-5), by=numbers(-1e-3, 1e-3))
def test_no_other_sphere_through_the_vertex_is_nearer(
    radius: float, conic: float, a4: float, by: float
) -> None:
    lens = surface_of(radius_mm=radius, conic=conic, asphere=[a4])
    table = sag_table(lens, 0, 0.002)
    r, sag = table.radial_height_mm, table.sag_mm

    def squares(curvature: float) -> float:
        sphere = curvature * r**2 / (1.0 + np.sqrt(np.maximum(1.0 - (curvature * r) ** 2, 0.0)))
        return float(np.trapezoid((sag - sphere) ** 2 * r, r))

    best = 1.0 / table.best_fit_radius_mm
    other = float(np.clip(best + by, -0.125, 0.125))
    assert squares(best) <= squares(other) + 1e-9 * squares(0.0) + 1e-15
    sphere = best * r**2 / (1.0 + np.sqrt(np.maximum(1.0 - (best * r) ** 2, 0.0)))
    np.testing.assert_allclose(table.departure_mm, sag - sphere, atol=1e-12)


@given(radius=numbers(0.01, 50.0), sign=st.sampled_from([-1.0, 1.0]))
def test_a_hemisphere_ends_upright(radius: float, sign: float) -> None:
    """Its rim is no further than its edge, whatever rounding says."""
    try:
        lens = surface_of().with_surface(0, radius_mm=sign * radius, semi_diameter_mm=radius)
    except DesignError:  # the edge came out smaller than the radius, by rounding
        assume(False)
    table = sag_table(lens, 0, 0.3 * radius)
    assert sign * table.sag_mm[-1] == pytest.approx(radius, rel=1e-6)
    assert sign * table.slope[-1] > 1e6
    assert table.best_fit_radius_mm == pytest.approx(sign * radius, rel=1e-9)


def test_a_surface_steeper_than_any_sphere_gets_the_hemisphere() -> None:
    table = sag_table(surface_of(asphere=[-0.01]), 0, 1.0)
    assert table.best_fit_radius_mm == -8.0


def test_of_a_figure_only_the_symmetric_part_is_in_the_table() -> None:
    """Spherical aberration (12) counts with its closed form; astigmatism (5) is reported as left out."""
    figure = {"zernike_um": {"12": 0.2, "5": 0.3}, "semi_diameter_mm": 8.0}
    bare = sag_table(surface_of(radius_mm=40.0), 0, 0.5)
    made = sag_table(surface_of(radius_mm=40.0, figure=figure), 0, 0.5)
    rho = made.radial_height_mm / 8.0
    spherical = 0.2e-3 * math.sqrt(5.0) * (6.0 * rho**4 - 6.0 * rho**2 + 1.0)
    slope = 0.2e-3 * math.sqrt(5.0) * (24.0 * rho**3 - 12.0 * rho) / 8.0
    np.testing.assert_allclose(made.sag_mm - bare.sag_mm, spherical, atol=1e-9)
    np.testing.assert_allclose(made.slope - bare.slope, slope, atol=1e-8)
    assert made.asymmetric_rms_mm == pytest.approx(0.3e-3, rel=1e-4)
    assert bare.asymmetric_rms_mm == 0.0


def test_the_file_reads_back_as_it_was(tmp_path: Path, paper_lens: Lens) -> None:
    table = sag_table(paper_lens, 1, 0.1)
    path = tmp_path / "sag.csv"
    write_sag_table(table, path)
    with path.open(newline="") as file:
        head, *rows = list(csv.reader(file))
    assert tuple(head) == COLUMNS
    values = np.array(rows, float)
    for name, column in zip(COLUMNS[:-1], values.T, strict=False):
        np.testing.assert_array_equal(column, getattr(table, name))
    assert set(values[:, -1]) == {table.best_fit_radius_mm}
    assert len(rows) == 101


@pytest.mark.parametrize(
    ("surface", "spacing", "message"),
    [
        (1, 0.1, "surface 2: must be from 1 to 1"),
        (-1, 0.1, "surface 0"),
        (0, 0.0, r"spacing_mm = 0.0"),
        (0, math.nan, "spacing_mm = nan"),
        (0, 1e-7, "more than 1000000 rows"),
    ],
)
def test_refusals(surface: int, spacing: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        sag_table(surface_of(radius_mm=20.0), surface, spacing)


def test_a_surface_without_an_end_is_refused() -> None:
    lens = lens_of({"semi_diameter_mm": 3.0, "thickness_mm": 2.0, "stop": True}, {"radius_mm": 30.0})
    with pytest.raises(InputError, match=r"surface 2.*semi_diameter_mm"):
        sag_table(lens, 1, 0.1)


@given(st.data())
def test_the_spacing_does_not_change_the_sphere(data: st.DataObject) -> None:
    lens = surface_of(radius_mm=data.draw(signed(9.0, 100.0)), conic=data.draw(numbers(-2.0, 0.0)))
    one, other = (sag_table(lens, 0, data.draw(numbers(0.01, 5.0))) for _ in range(2))
    assert one.best_fit_radius_mm == other.best_fit_radius_mm
