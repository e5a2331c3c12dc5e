"""The command `wavesim choose-engine`."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from places import DESIGNS
from programs import Command

from lensdesign import load_design, save_design, scaled
from wavesim.scene.settings import DEFAULT_ERROR

PAPER = DESIGNS / "paper_singlet.toml"
WHERE = ("--patch-mm", "0.05", "--plane-distance-mm", "0.125", "--meridional")


@pytest.fixture
def choose(wavesim: Command) -> Command:
    """The command `wavesim choose-engine`."""
    return partial(wavesim, "choose-engine")


@pytest.fixture
def twin_file(tmp_path: Path) -> Path:
    path = tmp_path / "twin.toml"
    save_design(scaled(load_design(PAPER), 1 / 16), path)
    return path


def test_the_default_finds_an_engine_for_the_papers_lens(choose: Command) -> None:
    code, out, err = choose(PAPER, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert (found["object"], found["engine"]) == ("usaf", "eikonal")
    taken = [p for p in found["predictions"] if p["engine"] == "eikonal"]
    assert min(p["relative_error"] for p in taken) <= DEFAULT_ERROR <= 0.05
    assert {"relative_error", "seconds", "peak_mb", "refused"} <= set(found["predictions"][0])
    assert {p["polarization"] for p in found["predictions"]} == {"auto"}


def test_components_are_chosen_where_the_error_of_scalar_waves_is_too_large(choose: Command) -> None:
    code, out, err = choose(PAPER, "--patch-mm", "0.05", "--coating", "bare", "--error", "0.02", "--json")
    assert code == 0, err
    found = json.loads(out)
    assert (found["engine"], found["polarization"]) == ("eikonal", "unpolarized")
    assert found["reason"].startswith("Scalar waves have a predicted error of 0.0")
    assert {p["polarization"] for p in found["predictions"]} == {"unpolarized"}


def test_errors_are_of_the_objects_light(choose: Command, twin_file: Path) -> None:
    predicted = {}
    for name in ("even", "phase", "usaf"):
        code, out, err = choose(twin_file, *WHERE, "--object", name, "--json")
        assert code == 0, err
        first = json.loads(out)["predictions"][0]
        assert first["engine"] == "eikonal"
        predicted[name] = first["relative_error"]
    assert predicted["phase"] < 0.5 * predicted["even"]
    assert predicted["usaf"] < 0.7 * predicted["even"]


def test_table(choose: Command, twin_file: Path) -> None:
    code, out, err = choose(twin_file, *WHERE, "--ground", "dark", "--error", "0.1")
    assert code == 0, err
    assert out.startswith("object usaf, patch 0.05 mm, field height 0 mm\n")
    assert "eikonal" in out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--error", "0"), "error = 0.0: must be above 0"),
        (("--patch-mm", "9"), "patch_mm = 9: must be above 0"),
        (("--memory-gb", "-1"), "memory_gb = -1"),
        (("--object", "usf"), "object = 'usf': allowed: usaf, star, phase, tissue"),
    ],
)
def test_refused(choose: Command, twin_file: Path, options: tuple[str, ...], said: str) -> None:
    code, out, err = choose(twin_file, *WHERE, *options)
    assert (code, out) == (2, "")
    assert err.startswith(f"error: {said}")
