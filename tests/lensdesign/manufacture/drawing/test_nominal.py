"""A lens as a sheet states it: room at the edge, rounded values, and what cannot be made."""

import pytest
from drawing_checks import FULL, lens_of, said, singlet
from places import DESIGNS

from lensdesign.analysis.exit_beam import largest_spread_angle
from lensdesign.analysis.space_bandwidth import match
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.drawing.sheets import DrawingOptions, drawing_as_stated

ISO = {"chamfer": 0.5, "diameter": 0.5}
"""General tolerances of parts up to 30 mm."""


def test_the_edge_leaves_room_for_mount_bevel_and_tolerance(paper_lens: Lens) -> None:
    drawing, stated = drawing_as_stated(paper_lens)
    (element,) = closed_elements(stated.lens)
    least = 10.0 * 1.05 + ISO["chamfer"] + 0.5 * ISO["diameter"]
    assert least <= element.edge_mm < least + 0.25
    texts = said(drawing.sheets[0])
    assert "Ø 22.5 ±0.5" in texts
    assert "Øₑ 20" in texts
    (note,) = stated.notes
    assert note.startswith(
        "element 1 (surfaces 1 and 2): ground diameter 22.5 mm chosen, clear 20: 0.5 mm to"
    )


def test_closer_tolerances_take_less_room(paper_lens: Lens) -> None:
    _, stated = drawing_as_stated(paper_lens, DrawingOptions(tolerances=(FULL,)))
    (element,) = closed_elements(stated.lens)
    assert element.edge_mm == 11.0  # 10 * 1.05 + 0.3 + 0.05, up to the next half millimetre of diameter


def test_values_are_rounded_to_a_tenth_of_their_tolerance() -> None:
    lens = load_design(DESIGNS / "thinnest_singlet.toml")
    _, stated = drawing_as_stated(lens)
    (made,) = closed_elements(stated.lens)
    before, after = lens.surfaces, stated.lens.surfaces
    assert after[0].thickness_mm == 8.19  # of 8.18987, toleranced by 0.2
    for one, other, semi in zip(before, after, (8.080, 9.28), strict=True):
        allowed = 10.0 * 0.54607e-3 * (one.radius_mm / semi) ** 2
        assert 0.0 < abs(other.radius_mm - one.radius_mm) <= 0.05 * allowed
        assert other.conic == one.conic
    limit = 4.7682
    assert (
        largest_spread_angle(stated.lens).spread_deg <= largest_spread_angle(lens).spread_deg + 1e-3 * limit
    )
    assert made.edge_mm == 10.5
    assert "largest spread 4.7682°, was 4.7681°" in stated.notes[-1]


def test_rounding_is_finer_where_the_spread_does_not_bear_it() -> None:
    """A millimetre of radius either way is allowed, yet 10.7 for 10.658 mm would miss the limit."""
    lens = load_design(DESIGNS / "thinnest_singlet.toml")
    limit = match(lens, 0.532).spread_limit_deg
    coarse = FULL.replaced(right=FULL.right.replaced(radius_fringes=None, radius_mm=1.0))
    _, stated = drawing_as_stated(lens, DrawingOptions(tolerances=(coarse,)))
    assert largest_spread_angle(lens.with_surface(1, radius_mm=-10.7)).spread_deg > limit
    assert stated.lens.surfaces[1].radius_mm == round(lens.surfaces[1].radius_mm, 4)
    assert largest_spread_angle(stated.lens).spread_deg <= limit


def test_what_cannot_be_made_is_refused(paper_lens: Lens) -> None:
    narrow = paper_lens.replaced(edges=({"semi_diameter_mm": 10.1},))
    with pytest.raises(InputError, match=r"element 1 .*20\.2 mm.* 19"):
        drawing_as_stated(narrow, DrawingOptions(tolerances=(FULL.replaced(diameter_mm=0.3),)))
    with pytest.raises(InputError, match=r"cannot be made: at the chosen ground diameter, 20\.5 mm, its"):
        drawing_as_stated(singlet(30.0, -30.0, 3.0, (9.0, 9.0)))
    with pytest.raises(InputError, match=r"2 elements.* 1$"):
        drawing_as_stated(paper_lens, DrawingOptions(tolerances=(None, FULL)))


def test_general_tolerances_give_way_to_an_edge_of_the_design() -> None:
    """A moulded rim, 0.02 mm beyond the clear aperture: the cylinder may not vary by more than twice that."""
    lens = load_design(DESIGNS / "moulded_pair.toml")
    drawing, stated = drawing_as_stated(lens)
    assert [e.semi_diameter_mm for e in stated.lens.edges] == [4.4, 4.4]
    assert "Ø 8.8 ±0.04" in said(drawing.sheets[1])
    assert "Prot. chamfer –" in said(drawing.sheets[1])
    assert stated.notes[-1].endswith("ground diameter ±0.04 mm: more would cut into its clear aperture")


def test_a_plate_has_no_radius_to_round() -> None:
    lens = lens_of(
        {"thickness_mm": 3.0, "material": "N-BK7", "semi_diameter_mm": 5.0}, {"semi_diameter_mm": 5.0}
    )
    drawing, stated = drawing_as_stated(lens)
    assert "R ∞" in said(drawing.sheets[0])
    assert [s.thickness_mm for s in stated.lens.surfaces] == [3.0, None]
