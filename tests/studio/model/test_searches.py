"""Searches that the page asks for are those of `lensdesign optimize` and `explore`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import InputError, Lens, load_specification, optimize
from studio.model.built import manufacturing_quality
from studio.model.searches import Search, run_exploration, run_search, specification_text, variables_of
from studio.model.session import Session

VARIED = ("surface 1 radius_mm", "surface 2 radius_mm", "surface 2 conic")


def test_a_search_finds_what_the_command_finds(paper_lens: Lens) -> None:
    lines: list[str] = []
    found = run_search(paper_lens, Search(VARIED), None, lines.append)
    assert found.feasible
    assert found.binding == ("footprint on sensor plane 2",)
    own = optimize(load_specification(DESIGNS / "feasible_singlet_spec.toml"))
    radius = tomllib.loads(found.text)["surface"][1]["radius_mm"]
    assert radius == pytest.approx(own.lens.surfaces[1].radius_mm, rel=1e-4)
    improvements = [json.loads(line) for line in lines if "goal" in line and "seconds" in line]
    assert [one["seconds"] for one in improvements] == sorted(one["seconds"] for one in improvements)
    assert any(one["feasible"] for one in improvements)


def test_what_cannot_be_asked_is_refused(paper_lens: Lens, tmp_path: Path) -> None:
    for search, said in (
        (Search(()), "no variable is selected"),
        (Search(VARIED, "yield"), "choose tolerances"),
    ):
        with pytest.raises(InputError, match=said):
            specification_text(paper_lens, search, tmp_path, None)
    tight = Search(VARIED, constraints={"max_spread_deg": 1.0})
    with pytest.raises(InputError, match="etendue"):
        run_search(paper_lens, tight, None, lambda _: None)


def test_goals_as_built_take_the_tolerances_of_the_page(paper_lens: Lens, tmp_path: Path) -> None:
    from studio.model.studies import write_study

    made = manufacturing_quality("precision", paper_lens)
    write_study(paper_lens, made, 100, tmp_path)
    asked = Search(VARIED, "yield", {"max_lens_thickness_mm": 9.7})
    (tmp_path / "asked.toml").write_text(specification_text(paper_lens, asked, tmp_path, "study.toml"))
    specification = load_specification(tmp_path / "asked.toml")
    assert specification.as_built is not None
    assert specification.optimize.goal == "yield"


def test_every_variable_can_be_asked_for(paper_lens: Lens, tmp_path: Path) -> None:
    asked = Search(tuple(variables_of(paper_lens)))
    (tmp_path / "asked.toml").write_text(specification_text(paper_lens, asked, tmp_path, None))
    assert len(load_specification(tmp_path / "asked.toml").variables) == len(variables_of(paper_lens))


def test_lenses_of_a_front_arrive_one_by_one(paper_lens: Lens) -> None:
    lines: list[str] = []
    searches = run_exploration(paper_lens, Search(VARIED[:2]), None, "semi_diameter,spread", 2, lines.append)
    assert searches >= len(lines) >= 2
    for line in lines:
        one = json.loads(line)
        assert set(one["values"]) == {"semi_diameter_mm", "spread_deg"}
        assert len(tomllib.loads(one["text"])["surface"]) == 2


def test_ranges_and_limits_of_the_page_are_those_of_the_specification(
    paper_lens: Lens, tmp_path: Path
) -> None:
    session = Session.of_lens(paper_lens)
    assert session.varied == VARIED
    session.varied = (*VARIED, "surface 1 thickness_mm", "surface 9 radius_mm")
    session.ranges = {"surface 1 thickness_mm": (9.0, 11.0), "surface 1 radius_mm": (20.0,)}
    session.limits |= {"max_track_mm": "46", "max_footprint_radius_mm": ""}
    asked = session.requested_search(paper_lens)
    (tmp_path / "asked.toml").write_text(specification_text(paper_lens, asked, tmp_path, None))
    found = load_specification(tmp_path / "asked.toml")
    by_name = {one.name: one for one in found.variables}
    assert by_name["surface 1 thickness_mm"].bounds == (9.0, 11.0)
    assert by_name["surface 1 radius_mm"].smallest_radius_mm == 20.0
    assert found.constraints.max_track_mm == 46.0
    assert found.constraints.max_footprint_radius_mm == "none"
    assert found.constraints.max_spread_deg == "sensor"
    session.limits["max_track_mm"] = "long"
    with pytest.raises(InputError, match="track, at most"):
        session.requested_search(paper_lens)
