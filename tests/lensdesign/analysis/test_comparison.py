"""Designs side by side: what differs is marked, and nothing else."""

from __future__ import annotations

from places import DESIGNS

from lensdesign import Lens, load_design
from lensdesign.analysis.comparison import compare_designs


def test_one_changed_value_is_marked(paper_lens: Lens) -> None:
    other = paper_lens.with_surface(1, conic=-0.9)
    lines = {line.name: line for line in compare_designs([paper_lens, other])}
    assert lines["surface 2 conic"].differs
    assert not lines["surface 2 radius, mm"].differs
    assert lines["largest spread angle (Eq. 2), °"].differs
    assert lines["largest spread angle (Eq. 2), °"].met == (False, False)
    assert not any(line.differs for line in compare_designs([paper_lens, paper_lens]))


def test_designs_of_other_surfaces_have_empty_places(paper_lens: Lens) -> None:
    lines = {
        line.name: line for line in compare_designs([paper_lens, load_design(DESIGNS / "moulded_pair.toml")])
    }
    assert lines["surface 4 semi diameter, mm"].values[0] == ""
    assert lines["surface 4 semi diameter, mm"].differs


def test_a_lens_that_lets_no_light_through_is_compared_too(paper_lens: Lens) -> None:
    dark = paper_lens.with_surface(1, semi_diameter_mm=0.01)
    lines = {line.name: line for line in compare_designs([paper_lens, dark])}
    assert "no ray" in lines["check"].values[1]
