"""Moulding checks: values agree with closed forms, and every check can miss, be met, stay open and be off."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from random_lenses import numbers
from small_lenses import lens_of

from lensdesign.analysis.check import check_design
from lensdesign.analysis.moulding import MouldingCheck, moulding_checks
from lensdesign.lens.edges import Edge, Flange, Gate
from lensdesign.lens.lens import Lens
from lensdesign.lens.moulding import Moulding

GATE = Gate(flat_depth_mm=0.4, width_mm=2.0, thickness_mm=1.4)


def moulded(
    *, material: Any = "PMMA", thickness_mm: float = 2.5, edge: Edge | None = None, **more: Any
) -> Lens:
    """A plane-parallel plate unless `front` or `back` have keys of surfaces."""
    front, back = more.pop("front", {}), more.pop("back", {})
    glass = {"thickness_mm": thickness_mm, "material": material, "semi_diameter_mm": 3.0}
    edge = edge or Edge(semi_diameter_mm=4.0, draft_deg=1.5, gate=GATE)
    lens = lens_of(glass | front, {"semi_diameter_mm": 3.0} | back, edge=[])
    return lens.replaced(edges=(edge,), moulding=Moulding(**more) if more else None)


def checks_of(lens: Lens) -> dict[tuple[str, str], MouldingCheck]:
    return {(check.name, check.relation): check for check in moulding_checks(lens)}


def test_a_moulded_plate_meets_all_checks() -> None:
    found = moulding_checks(moulded())
    assert {check.check for check in found} == {
        "draft",
        "gate",
        "thickness",
        "thickness_ratio",
        "slope",
        "sag",
    }
    assert all(check.met and check.miss == "" and check.source for check in found)


def test_polished_glass_is_not_checked(paper_lens: Lens) -> None:
    assert moulding_checks(paper_lens) == ()
    report = check_design(paper_lens, refined=False)
    assert report.moulding == ()
    assert report.mouldable


@pytest.mark.parametrize(
    ("edge", "name", "relation", "value", "limit"),
    [
        (Edge(semi_diameter_mm=4.0, draft_deg=-0.5), "draft of the edge", ">=", 0.5, 1.0),
        (
            Edge(semi_diameter_mm=4.0, gate=Gate(flat_depth_mm=0.6)),
            "gate flat to clear aperture",
            ">=",
            0.4,
            0.5,
        ),
        (
            Edge(semi_diameter_mm=4.0, gate=Gate(flat_depth_mm=0.4, width_mm=1.0)),
            "width of the gate",
            ">=",
            1.0,
            1.5,
        ),
        (
            Edge(semi_diameter_mm=4.0, gate=Gate(flat_depth_mm=0.4, width_mm=3.9)),
            "width of the gate, on its flat",
            "<=",
            3.9,
            2.0 * math.sqrt(16.0 - 3.6**2),
        ),
        (
            Edge(semi_diameter_mm=4.0, gate=Gate(flat_depth_mm=0.4, thickness_mm=1.0)),
            "gate over edge thickness",
            ">=",
            0.4,
            0.5,
        ),
        (
            Edge(semi_diameter_mm=4.0, gate=Gate(flat_depth_mm=0.4, thickness_mm=2.25)),
            "gate over edge thickness",
            "<=",
            0.9,
            0.8,
        ),
        (
            Edge(
                semi_diameter_mm=4.0,
                flange=Flange(semi_diameter_mm=5.0, distance_mm=1.0, thickness_mm=0.5),
                gate=Gate(flat_depth_mm=0.4, thickness_mm=0.45),
            ),
            "gate over flange thickness",
            "<=",
            0.9,
            0.8,
        ),
        (
            Edge(
                semi_diameter_mm=4.0,
                flange=Flange(semi_diameter_mm=5.0, distance_mm=1.0, thickness_mm=0.5),
            ),
            "flange thickness",
            ">=",
            0.5,
            0.635,
        ),
    ],
)
def test_edges_that_miss_a_limit(edge: Edge, name: str, relation: str, value: float, limit: float) -> None:
    check = checks_of(moulded(edge=edge))[name, relation]
    assert check.met is False
    assert check.value == pytest.approx(value)
    assert check.limit == pytest.approx(limit)
    assert check.source in check.miss
    assert f"element 1: {name}: " in check.miss


@pytest.mark.parametrize(
    ("material", "least", "most"), [("PMMA", 0.635, 12.7), ("PC", 1.016, 3.81), ("PS", 0.889, 3.81)]
)
def test_thicknesses_have_the_limits_of_their_material(material: str, least: float, most: float) -> None:
    for thickness, missed in (
        (0.99 * least, ">="),
        (1.01 * least, ""),
        (0.99 * most, ""),
        (1.01 * most, "<="),
    ):
        found = checks_of(moulded(material=material, thickness_mm=thickness, off=("gate",)))
        assert [
            relation for (_, relation), check in found.items() if check.check == "thickness" if not check.met
        ][:1] == ([missed] if missed else [])


def test_materials_without_a_published_thickness_stay_open_until_the_design_states_one() -> None:
    found = checks_of(moulded(material="E48R"))
    for name in ("centre thickness", "edge thickness"):
        check = found[name, ">="]
        assert check.met is None
        assert check.limit is None
        assert "state [moulding] min_thickness_mm" in check.miss
    stated = checks_of(moulded(material="E48R", min_thickness_mm=3.0))["centre thickness", ">="]
    assert stated.met is False
    assert stated.source == "[moulding] min_thickness_mm"


def test_values_that_the_design_does_not_state_stay_open() -> None:
    lens = moulded(edge=Edge(semi_diameter_mm=4.0))
    found = checks_of(lens)
    assert found["draft of the edge", ">="].met is None
    assert found["gate flat to clear aperture", ">="].met is None
    assert check_design(lens, refined=False).mouldable


@pytest.mark.parametrize(
    "name", ["draft", "gate", "thickness", "thickness_ratio", "slope", "sag", "tool_radius"]
)
def test_each_check_can_be_switched_off(name: str) -> None:
    every = {check.check for check in moulding_checks(moulded(tool_radius_mm=0.5))}
    left = {check.check for check in moulding_checks(moulded(tool_radius_mm=0.5, off=(name,)))}
    assert every - left == {name}


def test_limits_of_the_design_replace_those_of_the_table() -> None:
    strict = moulded(
        min_draft_deg=2.0,
        min_gate_clearance_mm=1.0,
        min_gate_width_mm=2.5,
        min_gate_thickness_ratio=0.6,
        max_gate_thickness_ratio=0.7,
        min_thickness_mm=2.6,
        max_thickness_mm=3.0,
        max_thickness_ratio=1.0,
        max_slope_deg=10.0,
        max_sag_mm=0.1,
    )
    found = [check for check in moulding_checks(strict) if check.limit_key]
    assert {check.limit_key for check in found} == set(Moulding.model_fields) - {
        "process",
        "elements",
        "off",
        "tool_radius_mm",
        "tool_included_angle_deg",
    }
    for check in found:
        assert check.limit == getattr(strict.moulding, check.limit_key)
        assert check.source == f"[moulding] {check.limit_key}"
    assert {check.limit_key for check in found if check.met is False} == {
        "min_draft_deg",
        "min_gate_clearance_mm",
        "min_gate_width_mm",
        "min_gate_thickness_ratio",
        "min_thickness_mm",
    }


@given(radius=numbers(5.0, 40.0), sign=st.sampled_from([-1.0, 1.0]))
@example(radius=10.0, sign=1.0)
def test_slope_sag_and_radius_of_a_sphere(radius: float, sign: float) -> None:
    lens = moulded(
        front={"radius_mm": sign * radius},
        thickness_mm=5.0,
        edge=Edge(semi_diameter_mm=4.0),
        tool_radius_mm=10.0,
        tool_included_angle_deg=40.0,
    )
    found = checks_of(lens)
    slope = math.degrees(math.asin(4.0 / radius))
    assert found["slope of surface 1", "<="].value == pytest.approx(slope, rel=1e-9)
    assert found["slope of surface 1", "<="].met is (slope <= 60.0)
    assert found["slope of surface 1, for the tool", "<="].met is (slope <= 20.0)
    sag = radius - math.sqrt(radius**2 - 16.0)
    assert found["sag of surface 1", "<="].value == pytest.approx(sag, rel=1e-9)
    # The insert of a convex surface is concave.
    check = found["smallest concave radius of the insert of surface 1", ">="]
    assert check.value == pytest.approx(radius if sign > 0.0 else math.inf, rel=1e-5)
    assert check.met is (sign < 0.0 or radius >= 10.0 * (1.0 - 5e-7))


def test_the_tool_meets_both_sides_of_the_element() -> None:
    convex_behind = moulded(back={"radius_mm": -8.0}, thickness_mm=4.0, tool_radius_mm=10.0)
    found = checks_of(convex_behind)
    behind = found["smallest concave radius of the insert of surface 2", ">="]
    assert behind.value == pytest.approx(8.0, rel=1e-5)
    assert behind.met is False
    assert found["smallest concave radius of the insert of surface 1", ">="].value == math.inf


def test_a_toroid_is_checked_in_all_its_sections() -> None:
    lens = moulded(
        front={"shape": "toroid", "radius_mm": 30.0, "radius_x_mm": 6.0},
        thickness_mm=4.0,
        edge=Edge(semi_diameter_mm=4.0),
        tool_radius_mm=7.0,
    )
    found = checks_of(lens)
    assert found["smallest concave radius of the insert of surface 1", ">="].value == pytest.approx(
        6.0, rel=1e-4
    )
    assert found["slope of surface 1", "<="].value == pytest.approx(math.degrees(math.asin(4.0 / 6.0)))


def test_pressed_glass_has_no_limits_of_injection_moulding() -> None:
    lens = moulded(material="N-BK7", process="pressed_glass")
    assert {check.check for check in moulding_checks(lens)} == {"thickness", "slope", "sag"}


def test_the_report_has_the_checks_apart_from_the_constraints() -> None:
    lens = moulded(edge=Edge(semi_diameter_mm=4.0, draft_deg=0.25))
    report = check_design(lens, refined=False)
    assert report.mouldable  # a guideline does not bind
    binding = moulded(edge=Edge(semi_diameter_mm=4.0, draft_deg=0.25), min_draft_deg=0.5)
    bound = check_design(binding, refined=False)
    assert not bound.mouldable
    assert bound.as_dict()["mouldable"] is False
    assert [check.check for check in bound.moulding if check.is_missed] == ["draft"]
    assert not any("draft" in sentence for sentence in report.violations)
    data = report.as_dict()
    assert data["mouldable"] is True
    (draft,) = (row for row in data["moulding"] if row["check"] == "draft")
    assert draft == {
        "element": 1,
        "check": "draft",
        "name": "draft of the edge",
        "value": 0.25,
        "relation": ">=",
        "limit": 1.0,
        "unit": "deg",
        "met": False,
        "miss": draft["miss"],
        "limit_key": "min_draft_deg",
        "source": "MFGABC, Plastic part design rules",
        "source_address": "https://www.mfgabc.com/guide/plastic-part-design-rules.html",
        "is_guideline": True,
    }


def test_a_gate_beside_an_unknown_clear_aperture_stays_open() -> None:
    gate = Gate(flat_depth_mm=0.3, width_mm=2.0, thickness_mm=0.5)
    lens = moulded(edge=Edge(semi_diameter_mm=4.0, gate=gate))
    lens = lens.with_surface(len(lens.surfaces) - 1, semi_diameter_mm=None)
    check = checks_of(lens)["gate flat to clear aperture", ">="]
    assert (check.value, check.met) == (None, None)
