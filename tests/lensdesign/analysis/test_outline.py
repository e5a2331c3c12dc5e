"""The outline of drawings, which exports, scenes and constraints on edges share."""

from __future__ import annotations

import numpy as np
import pytest
from drawing_checks import lens_of, singlet
from places import DESIGNS, GOLDEN

from lensdesign.analysis.check import check_design
from lensdesign.analysis.outline import (
    GENERAL_EDGES,
    drawn_edge_thicknesses_mm,
    drawn_outline,
    general_edge,
    ground_semi_diameter_mm,
    highest_ground_mm,
)
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.nominal import stated_lens
from lensdesign.manufacture.drawing.sheets import DrawingOptions, drawing_as_stated, element_tolerances
from lensdesign.manufacture.mesh.mesh import lens_mesh


@pytest.mark.parametrize(
    "name",
    ["paper_singlet", "thinnest_singlet", "feasible_singlet", "moulded_pair", "stock_pair", "wide_field"],
)
def test_exports_have_the_outline_of_the_drawing(name: str) -> None:
    lens = load_design(DESIGNS / f"{name}.toml")
    outline = drawn_outline(lens)
    _, stated = drawing_as_stated(lens)
    assert [e.semi_diameter_mm for e in outline.lens.edges] == [e.semi_diameter_mm for e in stated.lens.edges]
    for number, edge in enumerate(outline.edges):
        mesh = lens_mesh(outline.lens, 5.0, number).mesh
        reach = np.hypot(*mesh.vertices[:, :2].T).max()
        flange = outline.lens.edges[number].flange
        widest = 0.5 * edge.diameter_mm if flange is None else flange.semi_diameter_mm
        assert reach == pytest.approx(widest, abs=0.02)
        assert edge.fits


def test_an_element_says_how_its_edge_was_found(paper_lens: Lens) -> None:
    (chosen,) = drawn_outline(paper_lens).edges
    assert (chosen.origin, chosen.diameter_mm, chosen.clear_mm) == ("chosen", 22.5, 20.0)
    assert chosen.statement == (
        "element 1 (surfaces 1 and 2): ground diameter 22.5 mm, chosen as for a drawing (clear 20 mm), "
        "edge 2.78 mm thick"
    )
    (own,) = drawn_outline(paper_lens.replaced(edges=({"semi_diameter_mm": 12.0},))).edges
    assert (own.origin, own.diameter_mm) == ("design", 24.0)
    assert "from the design's [[edge]]" in own.statement


def test_a_thin_edge_is_exported_with_its_drawn_outline_and_a_warning() -> None:
    """The bevels of a sheet do not fit, so that it cannot be drawn; the body closes."""
    lens = load_design(GOLDEN / "designer_b" / "thin.toml")
    (edge,) = drawn_outline(lens).edges
    assert (edge.diameter_mm, edge.origin, edge.fits) == (7.3, "chosen", False)
    assert edge.thickness_mm == pytest.approx(0.3022, abs=1e-4)
    assert edge.statement.endswith("a drawing with general tolerances needs more than 0.7 mm")
    with pytest.raises(InputError, match=r"at the chosen ground diameter, 7\.3 mm"):
        drawing_as_stated(lens)


def test_an_element_that_does_not_close_keeps_its_clear_aperture_and_says_so() -> None:
    lens = singlet(30.0, -30.0, 3.0, (9.0, 9.0))
    outline = drawn_outline(lens)
    (edge,) = outline.edges
    assert (edge.origin, edge.diameter_mm, edge.drawn_diameter_mm) == ("clear aperture", 18.0, 20.5)
    assert edge.drawn_thickness_mm < 0.0 < edge.thickness_mm
    assert "diameter 18 mm (clear aperture)" in edge.statement
    assert lens_mesh(outline.lens, 5.0).mesh.is_watertight


def test_each_element_has_an_outline_of_its_own() -> None:
    glass = {"thickness_mm": 3.0, "material": "N-BK7"}
    lens = lens_of(
        glass | {"semi_diameter_mm": 5.0},
        {"thickness_mm": 2.0, "semi_diameter_mm": 5.0},
        glass | {"semi_diameter_mm": 9.0},
        {"semi_diameter_mm": 9.0},
    )
    assert [e.diameter_mm for e in drawn_outline(lens).edges] == [12.0, 20.5]


def test_the_general_table_is_the_drawings() -> None:
    """Both read one table, so that a sheet without tolerances of its own has the outline of exports."""
    lens = load_design(DESIGNS / "thinnest_singlet.toml")
    stated = stated_lens(lens, lambda element: element_tolerances(element, DrawingOptions()))
    assert stated.lens.edges == drawn_outline(lens).lens.edges


@pytest.mark.parametrize("thickness", [1.0, 9.4, 9.8, 10.01, 29.0, 31.0])
def test_searches_know_a_continuous_upper_bound(thickness: float) -> None:
    clear = np.linspace(0.3, 40.0, 1500)
    bounds, exact = [], []
    for c in clear.tolist():
        semi = c
        for _ in range(2):
            semi = ground_semi_diameter_mm(c, general_edge(max(2.0 * semi, thickness)).margin)
        exact.append(semi)
        bounds.append(highest_ground_mm(c, thickness)[0])
    assert np.all(np.array(bounds) >= np.array(exact) - 1e-9)
    assert np.all(np.diff(bounds) > 0.0)
    assert max(np.diff(bounds)) < 0.2  # of steps of 0.026 mm: no jumps
    step = 1e-6
    for c in (1.3, 4.3, 9.2, 13.0, 20.0):
        height, by_clear, by_thickness = highest_ground_mm(c, thickness)
        assert (highest_ground_mm(c + step, thickness)[0] - height) / step == pytest.approx(
            by_clear, rel=1e-5
        )
        slope = (highest_ground_mm(c, thickness + step)[0] - height) / step
        assert slope == pytest.approx(by_thickness, rel=1e-5, abs=1e-8)


def test_a_larger_part_than_the_table_knows_has_its_last_row() -> None:
    assert general_edge(1e4) == GENERAL_EDGES[300.0]


def test_the_check_reports_the_edge_that_will_be_drawn(paper_lens: Lens) -> None:
    report = check_design(load_design(GOLDEN / "designer_b" / "thin.toml"))
    edge = report.drawn_edge
    assert edge is not None
    assert (edge.drawn_diameter_mm, edge.fits) == (7.3, False)
    assert report.edge_thickness_mm == pytest.approx(0.8073, abs=1e-4)  # at the clear aperture
    assert report.as_dict()["drawn_edge"]["drawn_thickness_mm"] == pytest.approx(0.3022, abs=1e-4)
    assert drawn_edge_thicknesses_mm(paper_lens) == pytest.approx([2.7796], abs=1e-3)
    no_glass = paper_lens.with_surface(0, material=None)
    assert check_design(no_glass).drawn_edge is None
