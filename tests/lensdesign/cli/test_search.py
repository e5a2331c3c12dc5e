"""The commands that explore, and what they refuse."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from places import DESIGNS
from programs import Command

from lensdesign import load_design
from lensdesign.optimization.limits.search import Limit

Searched = Callable[..., tuple[int, str]]

SPEC = DESIGNS / "thinnest_singlet_spec.toml"


@pytest.fixture
def searched(command: Command) -> Searched:
    """Runs `lensdesign`: exit status, and all that it says on one line."""

    def run(*arguments: object) -> tuple[int, str]:
        status, out, err = command(*arguments)
        return status, out or " ".join(err.split())

    return run


def test_an_exploration_goes_on_where_it_stopped(tmp_path: Path, searched: Searched) -> None:
    out = tmp_path / "front"
    call = ["explore", SPEC, "--over", "thickness,spread", "-o", out, "--lenses", 2]
    code, said = searched(*call)
    assert code == 0, said
    assert "thickness_mm" in said
    assert sorted(p.name for p in out.glob("front.*")) == ["front.csv", "front.html", "front.png"]
    before = (out / "searches.jsonl").read_bytes()
    code, said = searched(*call, "--json")
    assert code == 0
    assert (out / "searches.jsonl").read_bytes() == before
    assert json.loads(said)["searches"] == 4
    code, said = searched(*call[:-1], 3)
    assert code == 2
    assert "holds an exploration of another" in said


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (["--over", "thickness,width"], "is not an objective"),
        (["--over", "thickness,yield"], "needs tolerances"),
        (["--over", "thickness,spread", "--glasses", "catalogue:NONE"], "no such catalogue"),
    ],
)
def test_bad_input_writes_nothing(tmp_path: Path, searched: Searched, changed: list[str], said: str) -> None:
    out = tmp_path / "front"
    code, errors = searched("explore", SPEC, "-o", out, *changed)
    assert code == 2
    assert said in errors
    assert not out.exists()


def test_the_lens_at_each_limit_is_written(
    tmp_path: Path, searched: Searched, monkeypatch: pytest.MonkeyPatch
) -> None:
    lens = load_design(DESIGNS / "thinnest_singlet.toml")
    found = (
        Limit("field", "mm", 3.0, 3.1, True, 12, ("spread",), "", lens),
        Limit("numerical aperture", "", 0.5, None, True, 12),
    )
    monkeypatch.setattr("lensdesign.optimization.limits.search.find_limits", lambda *_: found)
    code, said = searched("limits", SPEC, "-o", tmp_path / "limits", "--json")
    assert code == 1
    first, second = json.loads(said)["limits"]
    assert (first["binding"], second["design"]) == (["spread"], None)
    assert load_design(first["design"]) == lens
    assert sorted(path.name for path in (tmp_path / "limits").iterdir()) == [
        "largest_field.toml",
        "settings.toml",
    ]
    code, said = searched("limits", SPEC, "-o", tmp_path / "limits")
    assert "spread" in said
    assert f"wrote {first['design']}" in said.replace("\n", "")


def test_a_recording_is_optimized_and_checked_or_refused_with_what_gives_way(
    tmp_path: Path, searched: Searched
) -> None:
    design = (DESIGNS / "feasible_singlet_spec.toml").read_text()
    recording = '\n[recording]\nframes = 2\nobject = "complex"\noversampling = {}\n'
    spec, lens = tmp_path / "spec.toml", tmp_path / "lens.toml"
    spec.write_text(design + recording.format(1.7))
    code, said = searched("optimize", spec, "-o", lens, "--json")
    assert code == 0, said
    constraints = {one["name"]: one for one in json.loads(said)["constraints"]}
    ratio = constraints["oversampling ratio, complex object, 2 frames"]
    assert ratio["limit"] == 1.7 <= ratio["value"]
    code, said = searched("check", lens, "--against", spec, "--json")
    assert code == 0
    checked = {one["name"]: one for one in json.loads(said)["constraints"]}
    assert checked["oversampling ratio, complex object, 2 frames"]["value"] == pytest.approx(ratio["value"])
    spec.write_text(design + recording.format(4.5))
    code, said = searched("optimize", spec, "-o", lens)
    assert code == 2
    assert "record at least 3 frames" in said
