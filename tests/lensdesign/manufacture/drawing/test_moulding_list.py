"""The list of a moulded element on its sheet."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from drawing_checks import assert_tidy, said, singlet
from hypothesis import given, settings
from random_lenses import numbers

from lensdesign.errors import InputError
from lensdesign.lens.edges import Edge, Flange, Gate
from lensdesign.lens.lens import Lens
from lensdesign.lens.moulding import Moulding
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.drawing.moulding_list import GATE_NAME, TEXT_MM, moulding_lines
from lensdesign.manufacture.drawing.primitives import Stroke, text_width_mm
from lensdesign.manufacture.drawing.section_view import section_view
from lensdesign.manufacture.drawing.sheets import FRAME, drawing_as_stated, lens_drawing
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances

FLANGE = Flange(semi_diameter_mm=5.0, distance_mm=1.0, thickness_mm=0.6)


def plastic(**edge: Any) -> Lens:
    lens = singlet(20.0, -30.0, 2.5, (3.0, 3.0))
    edges = (Edge(semi_diameter_mm=4.0, **edge),)
    return lens.with_surface(0, material="PMMA").replaced(edges=edges)


def test_the_sheet_states_draft_gate_and_checks() -> None:
    lens = plastic(draft_deg=2.0, gate=Gate(flat_depth_mm=0.4, width_mm=2.0, thickness_mm=0.1))
    drawing = lens_drawing(lens)
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    (element,) = closed_elements(lens)
    narrow = 2.0 * element.edge_radii_mm[1]
    assert f"Draft of the edge 2°, narrow end at R: Ø {narrow:.5g}" in texts
    flat = f"{GATE_NAME}: gate flat at −y, 3.6 from A, {2.0 * math.sqrt(16.0 - 3.6**2):.4g} wide"
    assert f"{flat}; gate width 2, thickness 0.1" in texts
    assert "Moulding checks, met: draft, thickness, thickness ratio, slope, sag" in texts
    assert any(
        text.startswith("Moulding checks, beyond guidelines: gate over edge thickness 0.0") for text in texts
    )
    assert GATE_NAME in texts
    assert "Ø 8 ±0.2" in texts


def test_a_polished_lens_has_no_list() -> None:
    texts = said(lens_drawing(singlet(20.0, -30.0, 2.5, (3.0, 3.0))).sheets[0])
    assert not any("Moulding" in text or "Draft" in text for text in texts)
    off = plastic().replaced(moulding=Moulding(process="none"))
    assert not any("Moulding" in text for text in said(lens_drawing(off).sheets[0]))


@settings(max_examples=15)
@given(draft=numbers(-4.0, 4.0), depth=numbers(0.05, 0.9))
def test_the_view_is_cut_at_the_flat_and_narrows_by_the_draft(draft: float, depth: float) -> None:
    for flange in (None, FLANGE):
        lens = plastic(draft_deg=draft, gate=Gate(flat_depth_mm=depth), flange=flange)
        (element,) = closed_elements(lens)
        view = section_view(element, DrawingTolerances(), FRAME)
        assert_tidy(lens_drawing(lens))
        outline = next(item for item in view.items if isinstance(item, Stroke) and item.width_mm > 0.4)
        x, y = np.array(outline.points).T / view.scale
        middle = y[np.argmin(x)]  # the vertex of the convex front
        assert np.max(y) - middle == pytest.approx(element.outer_mm, abs=1e-6)
        assert middle - np.min(y) == pytest.approx(element.outer_mm - depth, abs=1e-6)
        front, back = element.edge_radii_mm
        assert front - back == pytest.approx(element.edge_thickness_mm * math.tan(math.radians(draft)))
        for radius in (front, back):
            assert np.min(np.abs(y - middle - radius)) < 1e-6


def test_lines_fit_their_width() -> None:
    lens = plastic(draft_deg=2.0)
    (element,) = closed_elements(lens)
    lines = moulding_lines(element, [], 30.0)
    assert len(lines) > 1
    assert all(text_width_mm(line, TEXT_MM) <= 30.0 for line in lines)
    assert " ".join(lines).startswith("Draft of the edge 2°, narrow end at R: ")


def test_the_mass_is_that_without_the_flat() -> None:
    gate = Gate(flat_depth_mm=1.0)
    glass = plastic(gate=gate).with_surface(0, material="N-BK7")
    (element,) = closed_elements(glass)
    expected = 2.51e-3 * (element.volume_mm3 - element.gate_flat_volume_mm3)
    assert f"{expected:.4g} g" in said(lens_drawing(glass).sheets[0])


def test_a_draft_that_reaches_into_the_clear_aperture_is_refused() -> None:
    lens = plastic().replaced(edges=(Edge(semi_diameter_mm=3.2, draft_deg=4.0),))
    with pytest.raises(InputError, match=r"narrow end of its draft of 4°.*semi_diameter_mm of at least 3\.3"):
        drawing_as_stated(lens)
