"""Edges of glass elements: flats, bevels and flanges in design files, solids, meshes, drawings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
from drawing_checks import assert_tidy
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from random_lenses import numbers
from small_lenses import lens_of

from lensdesign.analysis.check import check_design, edge_thickness_mm
from lensdesign.analysis.outline import drawn_outline
from lensdesign.errors import DesignError, InputError
from lensdesign.files.design import load_design, save_design
from lensdesign.files.zemax import read_zmx, write_zmx
from lensdesign.lens.edges import Edge, Flange, Gate
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.scaling import scaled
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.drawing.sheets import lens_drawing
from lensdesign.manufacture.dxf.outline import write_outline
from lensdesign.manufacture.mesh.mesh import lens_mesh
from lensdesign.manufacture.step.writing import write_step

FLANGE = Flange(semi_diameter_mm=13.0, distance_mm=2.0, thickness_mm=1.2)
MOULDED = Edge(
    semi_diameter_mm=11.0, front_flat_from_mm=9.0, front_bevel_mm=0.3, back_bevel_mm=0.2, flange=FLANGE
)


def plate(thickness_mm: float, *edges: dict[str, Any]) -> Lens:
    front = {"thickness_mm": thickness_mm, "material": "N-BK7", "semi_diameter_mm": 4.0}
    return lens_of(front, {"semi_diameter_mm": 4.0}, edge=list(edges))


def moulded(paper_lens: Lens, **changes: Any) -> Lens:
    return paper_lens.replaced(edges=(MOULDED.replaced(**changes),))


def test_volume_of_a_plate_with_bevels_and_a_flange() -> None:
    ring = {"semi_diameter_mm": 7.0, "distance_mm": 1.0, "thickness_mm": 0.5}
    edge = {"semi_diameter_mm": 6.0, "front_bevel_mm": 0.5, "back_bevel_mm": 0.25, "flange": ring}
    (element,) = closed_elements(plate(3.0, edge))
    cut = sum(math.pi * b * (36.0 - (36.0 + (6.0 - b) ** 2 + 6.0 * (6.0 - b)) / 3.0) for b in (0.5, 0.25))
    expected = math.pi * 36.0 * 3.0 - cut + math.pi * (49.0 - 36.0) * 0.5
    assert element.volume_mm3 == pytest.approx(expected, rel=1e-13)
    assert element.edge_thickness_mm == pytest.approx(3.0 - 0.75)
    assert element.outer_mm == 7.0
    corners = [
        (5.5, 0.0),
        (6.0, 0.5),
        (6.0, 1.0),
        (7.0, 1.0),
        (7.0, 1.5),
        (6.0, 1.5),
        (6.0, 2.75),
        (5.75, 3.0),
    ]
    assert element.rim == pytest.approx(np.array(corners))


@given(radius=numbers(4.5, 9.0), thickness=numbers(0.5, 6.0), draft=numbers(-20.0, 20.0))
def test_volume_of_a_plate_with_draft_is_that_of_a_frustum(
    radius: float, thickness: float, draft: float
) -> None:
    narrow = radius - thickness * math.tan(math.radians(abs(draft)))
    assume(narrow > 4.1)
    (element,) = closed_elements(plate(thickness, {"semi_diameter_mm": radius, "draft_deg": draft}))
    expected = math.pi * thickness / 3.0 * (radius**2 + radius * narrow + narrow**2)
    assert element.volume_mm3 == pytest.approx(expected, rel=1e-10)
    ends = (radius, narrow) if draft > 0.0 else (narrow, radius)
    assert element.edge_radii_mm == pytest.approx(ends, abs=1e-9)
    assert element.rim == pytest.approx(np.array([(ends[0], 0.0), (ends[1], thickness)]), abs=1e-9)
    assert (element.edge_mm, element.outer_mm) == (radius, radius)


@given(depth=numbers(0.01, 1.9), draft=numbers(-5.0, 5.0), flanged=st.booleans())
def test_volume_of_a_gate_flat(depth: float, draft: float, flanged: bool) -> None:
    """On a plate the flat removes, at each z, a segment of the circle there."""
    edge: dict[str, Any] = {"semi_diameter_mm": 6.0, "draft_deg": draft, "gate": {"flat_depth_mm": depth}}
    if flanged:
        edge["flange"] = {"semi_diameter_mm": 8.0, "distance_mm": 1.0, "thickness_mm": 0.5}
    (element,) = closed_elements(plate(3.0, edge))
    flat = element.outer_mm - depth
    z = (np.arange(20000) + 0.5) / 20000 * 3.0
    radius = np.interp(z, [0.0, 3.0], element.edge_radii_mm)
    if flanged:
        radius = np.where((z > 1.0) & (z < 1.5), 8.0, radius)
    r = np.maximum(radius, flat)
    segments = r * r * np.arccos(flat / r) - flat * np.sqrt(r * r - flat * flat)
    assert element.gate_flat_volume_mm3 == pytest.approx(3.0 * float(np.mean(segments)), rel=2e-3, abs=1e-6)
    gate = element.edge.gate
    assert gate is not None
    outer = element.outer_mm
    assert gate.flat_width_mm(outer) == pytest.approx(2.0 * outer * math.sin(math.acos(flat / outer)))


@pytest.mark.parametrize("draft", [3.0, -3.0])
def test_draft_meets_the_angle_between_curved_surfaces(paper_lens: Lens, draft: float) -> None:
    (element,) = closed_elements(moulded(paper_lens, draft_deg=draft, semi_diameter_mm=11.2))
    front, back = element.edge_radii_mm
    assert front - back == pytest.approx(element.edge_thickness_mm * math.tan(math.radians(draft)), rel=1e-9)
    profile = element.edge_profile
    walls = profile[[0, 1, 4, 5]]  # along the cone, before and behind the flange
    fitted = np.polyfit(walls[:, 1], walls[:, 0], 1)
    assert walls[:, 0] == pytest.approx(np.polyval(fitted, walls[:, 1]), abs=1e-9)
    assert math.degrees(math.atan(-fitted[0])) == pytest.approx(draft, abs=1e-6)


def test_a_freeform_with_draft_has_a_closed_solid_and_mesh(tmp_path: Path) -> None:
    lens = plate(4.0, {"semi_diameter_mm": 5.0, "draft_deg": 3.0}).with_surface(
        1, shape_type="toroid", radius_mm=-25.0, radius_x_mm=-40.0
    )
    (element,) = closed_elements(lens)
    front, back = element.edge_radii_mm
    tangent = math.tan(math.radians(3.0))
    # The draft is that of the design where the edge is longest, and greater elsewhere.
    assert front - back == pytest.approx(tangent * element.longest_edge_mm, rel=1e-9)
    assert element.edge_thickness_mm < element.longest_edge_mm
    mesh = lens_mesh(lens, 1.0)
    assert mesh.mesh.is_watertight
    assert mesh.volume_mm3 == pytest.approx(element.volume_mm3, rel=1e-4)
    report = write_step(lens, tmp_path / "lens.step")
    assert report.volume_mm3 == pytest.approx(element.volume_mm3, rel=1e-7)


def test_exports_have_the_draft(paper_lens: Lens, tmp_path: Path) -> None:
    lens = moulded(paper_lens, semi_diameter_mm=11.2, draft_deg=2.0, gate=Gate(flat_depth_mm=0.5))
    (element,) = closed_elements(lens)
    report = write_step(lens, tmp_path / "lens.step")
    assert report.volume_mm3 == pytest.approx(element.volume_mm3, rel=1e-9)
    write_outline(lens, tmp_path / "lens.dxf")
    entities = [e for e in ezdxf.readfile(tmp_path / "lens.dxf").modelspace() if e.dxf.layer.endswith("EDGE")]
    ends = np.array([[(p.x, abs(p.y)) for p in (e.dxf.start, e.dxf.end)] for e in entities])
    slanted = ends[np.ptp(ends[..., 1], axis=1) * np.ptp(ends[..., 0], axis=1) > 1e-9]
    assert len(slanted) == 4  # before and behind the flange, above and below the axis
    for (z0, r0), (z1, r1) in slanted:
        assert math.degrees(math.atan2(r0 - r1, z1 - z0)) == pytest.approx(2.0, abs=1e-6)
    (statement,) = drawn_outline(lens).statements
    assert ", draft 2°; without the gate flat" in statement


def test_a_flat_ring_begins_where_the_edge_says(paper_lens: Lens) -> None:
    (element,) = closed_elements(moulded(paper_lens))
    sag = float(paper_lens.surfaces[0].sag_mm(9.0))
    assert element.front.end_mm == 9.0
    assert element.rim[:3] == pytest.approx(np.array([(9.0, sag), (10.7, sag), (11.0, sag + 0.3)]))
    back = 9.7 + float(paper_lens.surfaces[1].sag_mm(10.8))
    assert element.rim[-2:] == pytest.approx(np.array([(11.0, back - 0.2), (10.8, back)]))


def test_edge_thickness_and_check_are_of_the_edge_given(paper_lens: Lens) -> None:
    lens = paper_lens.replaced(edges=(Edge(semi_diameter_mm=11.0, front_bevel_mm=0.3, back_bevel_mm=0.2),))
    front, back = paper_lens.surfaces[0].sag_mm(10.7), paper_lens.surfaces[1].sag_mm(10.8)
    expected = 9.7 + float(back) - float(front) - 0.5
    assert edge_thickness_mm(lens) == pytest.approx(expected)
    assert check_design(lens).edge_thickness_mm == pytest.approx(expected)


@st.composite
def edged_lenses(draw: st.DrawFn) -> Lens:
    """Biconvex to meniscus lenses with edges of every kind."""
    radius = draw(numbers(6.0, 9.0))
    bevels = [draw(st.just(0.0) | numbers(0.05, 0.4)) for _ in range(2)]
    flats = [draw(st.none() | numbers(4.5, radius - b - 0.05)) for b in bevels]
    lens = plate(draw(numbers(4.0, 8.0))).with_surface(0, radius_mm=draw(numbers(12.0, 60.0)))
    lens = lens.with_surface(1, radius_mm=draw(numbers(-60.0, -12.0) | numbers(30.0, 90.0)))
    edge = Edge(
        semi_diameter_mm=radius,
        front_flat_from_mm=flats[0],
        back_flat_from_mm=flats[1],
        front_bevel_mm=bevels[0],
        back_bevel_mm=bevels[1],
        draft_deg=draw(st.none() | numbers(-5.0, 5.0)),
    )
    try:
        lens = lens.replaced(edges=(edge,))
        (element,) = closed_elements(lens)
    except (DesignError, InputError):
        assume(False)
    front, back = element.cylinder_z_mm
    if draw(st.booleans()) and back - front > 0.3:
        start = draw(numbers(front, back - 0.2))
        ring = Flange(
            semi_diameter_mm=radius + draw(numbers(0.3, 3.0)),
            distance_mm=start,
            thickness_mm=draw(numbers(0.1, back - start)),
        )
        lens = lens.replaced(edges=(edge.replaced(flange=ring),))
    return lens


@settings(max_examples=40, deadline=None)
@given(edged_lenses(), numbers(-0.4, 0.4), st.booleans())
def test_meshes_close_and_have_the_volume(lens: Lens, tilt: float, back: bool) -> None:
    nominal = lens_mesh(lens, 1.0)
    meshes = [nominal]
    reach = 9.0 * math.tan(math.radians(abs(tilt)))
    (element,) = closed_elements(lens)
    ring, (begin, end) = element.flange_corners[:, 1], element.cylinder_z_mm
    if end - begin > reach and (not len(ring) or (ring[0] - reach > begin and ring[-1] + reach < end)):
        change = SurfacePerturbation(tilt_x_deg=tilt)
        meshes.append(lens_mesh(lens, 1.0, surface_perturbations={int(back): change}))
    for result in meshes:
        assert result.mesh.is_watertight
        assert result.mesh.is_winding_consistent
        assert result.mesh.euler_number == 2
        assert result.chord_error_um <= 1.0
        assert abs(result.volume_error) < 0.05 * result.volume_tolerance
    outer = element.outer_mm
    assert np.max(np.hypot(*nominal.mesh.vertices[:, :2].T)) == pytest.approx(
        outer, abs=1.001e-3 * nominal.edge_error_um
    )


@settings(max_examples=60, deadline=None)
@given(edged_lenses())
def test_drawings_stay_tidy_and_state_the_edge(lens: Lens) -> None:
    drawing = lens_drawing(lens)
    assert_tidy(drawing)
    said = [text.text for text in drawing.sheets[0].texts]
    (edge,) = lens.edges
    assert edge.semi_diameter_mm is not None
    assert any(text.startswith(f"Ø {2.0 * edge.semi_diameter_mm:.6g} ±") for text in said)
    if edge.front_bevel_mm:
        assert f"Prot. chamfer {edge.front_bevel_mm:g} × 45°" in said
    if edge.flange is not None:
        assert f"Ø {2.0 * edge.flange.semi_diameter_mm:.6g}" in said
        assert f"{edge.flange.thickness_mm:.6g}" in said


def test_files_keep_edges(paper_lens: Lens, tmp_path: Path) -> None:
    lens = moulded(paper_lens, draft_deg=-0.25, gate=Gate(flat_depth_mm=0.5, thickness_mm=0.8))
    save_design(lens, tmp_path / "a.toml")
    assert load_design(tmp_path / "a.toml") == lens
    write_zmx(lens, tmp_path / "a.zmx")
    assert read_zmx(tmp_path / "a.zmx").lens.edges == lens.edges


def test_a_twin_has_the_edge_scaled(paper_lens: Lens) -> None:
    gate = Gate(flat_depth_mm=0.6, width_mm=3.0)
    lens = moulded(paper_lens, draft_deg=0.25, gate=gate)
    (edge,) = scaled(lens, 0.5).edges
    assert edge == Edge(
        semi_diameter_mm=5.5,
        front_flat_from_mm=4.5,
        front_bevel_mm=0.15,
        back_bevel_mm=0.1,
        draft_deg=0.25,
        flange=Flange(semi_diameter_mm=6.5, distance_mm=1.0, thickness_mm=0.6),
        gate=Gate(flat_depth_mm=0.3, width_mm=1.5),
    )


@pytest.mark.parametrize(
    ("edge", "message"),
    [
        ({"semi_diameter_mm": 9.9}, r"edge 1: .*semi_diameter_mm = 9.9 .*surface 2"),
        ({"back_bevel_mm": 0.5}, r"surface 2 .*bevel of 0.5 mm"),
        ({"semi_diameter_mm": 12.0, "front_flat_from_mm": 8.0}, r"surface 1 .*flat from 8 mm"),
        ({"semi_diameter_mm": 12.0, "front_flat_from_mm": 11.9, "front_bevel_mm": 0.2}, "flat from 11.9 mm"),
        (
            {"flange": {"semi_diameter_mm": 13.0, "distance_mm": 2.0, "thickness_mm": 1.0}},
            "needs a semi_diam",
        ),
        (
            {
                "semi_diameter_mm": 11.0,
                "flange": {"semi_diameter_mm": 11.0, "distance_mm": 2.0, "thickness_mm": 1.0},
            },
            "edge's of 11",
        ),
        (
            {
                "semi_diameter_mm": 11.0,
                "flange": {"semi_diameter_mm": 12.0, "distance_mm": 0.5, "thickness_mm": 1.0},
            },
            "not on the edge cylinder, which extends from 1.455.* behind the front vertex",
        ),
        ({"front_bevel_mm": -0.1}, r"edge 1, front_bevel_mm = -0.1"),
        ({"draft_deg": 1.0}, "an edge with a draft needs a semi_diameter_mm"),
        ({"gate": {"flat_depth_mm": 0.5}}, "an edge with a gate needs a semi_diameter_mm"),
        ({"semi_diameter_mm": 11.0, "draft_deg": 31.0}, r"edge 1, draft_deg = 31"),
        ({"semi_diameter_mm": 11.0, "draft_deg": 25.0}, r"its draft narrows to 8\..*surface 2"),
        ({"semi_diameter_mm": 11.0, "gate": {"flat_depth_mm": 11.0}}, "less than the radius of the edge, 11"),
        ({"semi_diameter_mm": 11.0, "gate": {"flat_depth_mm": 0.0}}, r"edge 1, gate, flat_depth_mm = 0"),
        ({"semi_diameter_mm": 11.0, "gate": {}}, r"flat_depth_mm"),
        ({"bevel": 0.1}, "unknown key"),
    ],
)
def test_impossible_edges_are_refused(
    paper_lens: Lens, tmp_path: Path, edge: dict[str, Any], message: str
) -> None:
    import tomli_w

    path = tmp_path / "a.toml"
    data = paper_lens.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_defaults=True)
    path.write_text(tomli_w.dumps(data | {"edge": [edge]}))
    with pytest.raises(DesignError, match=message):
        load_design(path)


def test_one_edge_for_each_element(paper_lens: Lens) -> None:
    with pytest.raises(DesignError, match=r"one for each glass element, front to back .1., or none"):
        paper_lens.replaced(edges=(Edge(), Edge()))


def test_a_bevel_on_a_surface_that_falls_away_steeply_is_refused(paper_lens: Lens) -> None:
    steep = paper_lens.with_surface(1, radius_mm=-10.5, conic=0.0)
    edge = Edge(semi_diameter_mm=10.3, back_bevel_mm=0.2)
    with pytest.raises(DesignError, match="removes no glass from surface 2, whose slope there is 7"):
        steep.replaced(edges=(edge,))


def test_a_perturbed_surface_may_not_reach_into_the_flange(paper_lens: Lens) -> None:
    (element,) = closed_elements(moulded(paper_lens))
    ring = FLANGE.replaced(distance_mm=element.cylinder_z_mm[0])
    lens = moulded(paper_lens, flange=ring)
    assert lens_mesh(lens, 10.0).mesh.is_watertight
    with pytest.raises(InputError, match="the edge cylinder extends at its narrowest from"):
        lens_mesh(lens, 10.0, surface_perturbations={0: SurfacePerturbation(tilt_y_deg=0.5)})


def test_solids_for_cad_have_the_edge(paper_lens: Lens, tmp_path: Path) -> None:
    lens = moulded(paper_lens)
    report = write_step(lens, tmp_path / "lens.step")
    assert report.largest_error_mm < 1e-9
    assert report.volume_mm3 == pytest.approx(closed_elements(lens)[0].volume_mm3, rel=1e-9)
