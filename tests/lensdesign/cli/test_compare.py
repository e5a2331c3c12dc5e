"""The command `lensdesign compare`, end to end."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from places import DESIGNS
from programs import Command

from lensdesign import load_design
from lensdesign.analysis.oversampling import oversampling_of
from lensdesign.lens.solid import glass_elements

PAPER, FEASIBLE = DESIGNS / "paper_singlet.toml", DESIGNS / "feasible_singlet.toml"


def test_designs_are_side_by_side(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = command(
        "compare", PAPER, FEASIBLE, DESIGNS / "moulded_pair.toml", DESIGNS / "phone_lens.toml"
    )
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    rows = [line.strip().split("  ") for line in out.splitlines()]
    (spread, *_) = [row for row in rows if row[0].startswith("largest spread angle (Eq. 2), °")]
    values = [text.strip() for text in spread[1:] if text.strip()]
    assert values[0].endswith("*")
    assert not values[1].endswith("*")
    (missed, *_) = [row for row in rows if row[0] == "constraints not met"]
    assert [text.strip() for text in missed[1:] if text.strip()][:2] == ["1 of 7 *", "0 of 7"]
    assert "surface 1" not in out
    assert out.splitlines()[-1] == "* constraint not met"


def test_json_has_numbers_yield_and_cost(command: Command) -> None:
    code, out, err = command(
        "compare", PAPER, FEASIBLE, "--tolerances", DESIGNS / "as_built_tolerances.toml", "--json"
    )
    assert (code, err) == (0, "")
    paper, feasible = json.loads(out)["designs"]
    assert (paper["design"], feasible["design"]) == (str(PAPER), str(FEASIBLE))
    volume = sum(one.volume_mm3 for one in glass_elements(load_design(PAPER)))
    assert paper["values"]["glass volume, mm³"] == pytest.approx(volume, rel=1e-6)
    assert paper["values"]["largest spread angle (Eq. 2), °"] == pytest.approx(4.8105, abs=1e-3)
    assert paper["met"]["largest spread angle (Eq. 2), °"] is False
    assert all(feasible["met"].values())
    ratio = oversampling_of(load_design(PAPER), "complex").ratio
    assert paper["values"]["oversampling, complex object, all planes"] == pytest.approx(ratio, rel=1e-6)
    assert 0.0 <= paper["as_built"]["yield"] <= 1.0
    assert paper["as_built"]["cost"] > 1.0


def test_a_specification_gives_the_constraints_and_surfaces_are_shown_on_request(command: Command) -> None:
    specification = DESIGNS / "feasible_singlet_spec.toml"
    code, out, err = command("compare", PAPER, FEASIBLE, "--against", specification, "--surfaces")
    assert (code, err) == (0, "")
    assert "SBP of the sensor" in out
    assert "surface 2 conic" in out
    assert "surface 1 material" not in out  # it does not differ


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ((PAPER,), "only one design"),
        ((PAPER, Path("none.toml")), "cannot read none.toml"),
        ((PAPER, FEASIBLE, "--tolerances", "best"), "'best': no grade of tolerances (commercial"),
    ],
)
def test_bad_input_is_one_message(command: Command, arguments: tuple[object, ...], part: str) -> None:
    code, out, err = command("compare", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert part in err
