"""The command `wavesim plan`."""

from __future__ import annotations

import json
from pathlib import Path

from programs import Command

from lensdesign import load_design, save_design, scaled


def test_a_table_a_chart_and_figures(wavesim: Command, tmp_path: Path) -> None:
    design, chart = tmp_path / "twin.toml", tmp_path / "plans.png"
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 64), design)
    usual = (design, "--patch-mm", 0.02, "--kind", "amplitude", "--exposures", 1)
    code, out, err = wavesim("plan", *usual, "--max-planes", 2, "-o", chart)
    assert code == 0, err
    assert "amplitude object; simulated on the lens itself, patch 0.02 mm" in out
    assert "0.03125," in out
    assert "0.3438" in out  # on the next line of a narrow terminal
    assert chart.stat().st_size > 3_000
    assert out.count("*") == 2
    assert "few grains (dark grains on 3 %" in out
    assert "The prediction assumes:" in out
    assert "depending on the object" in out
    code, out, err = wavesim("plan", *usual, "--max-planes", 1, "--correlation", 0.999999, "--json")
    assert code == 0, err
    found = json.loads(out)
    (plan,) = found["plans"]
    assert (plan["frames"], plan["planes_mm"], plan["exposures"]) == (1, [0.03125], [1.0])
    assert 0.0 < plan["correlation"] < 0.999999
    assert plan["recommended"] is True
    assert plan["correlation"] == min(plan["correlation_by_object"].values())
    assert plan["highest_correlation"] == max(plan["correlation_by_object"].values())
    assert {one["name"] for one in found["objects"]} == set(plan["correlation_by_object"])
    assert any(line.startswith("Engine:") for line in found["assumptions"])
    assert found["enough"] is False


def test_an_example_of_the_object_decides(wavesim: Command, tmp_path: Path) -> None:
    design = tmp_path / "twin.toml"
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 64), design)
    usual = (design, "--patch-mm", 0.03, "--kind", "amplitude", "--exposures", 1, "--max-planes", 1)
    code, out, err = wavesim("plan", *usual, "--object", "star")
    assert code == 0, err
    assert "described" in out
    assert "for star" in out
    assert "predicted 0." in out
    code, out, err = wavesim("plan", *usual, "--object", "star", "--json")
    assert code == 0, err
    found = json.loads(out)
    (plan,) = found["plans"]
    assert found["described"]["name"] == "star"
    assert 0.0 < found["described"]["changes_of_amplitude"] < 1.0
    assert found["described"]["twin"]["scale"] >= found["twin"]["scale"]
    assert 0.0 < plan["predicted_correlation"] < 1.0
    assert 0.0 < plan["oversampling"] < 8.0
    assert 0.0 < plan["information"]["fraction_determined"] < 1.0
    assert "described" not in plan["correlation_by_object"]


def test_refused(wavesim: Command) -> None:
    usual = ("plan", "designs/paper_singlet.toml", "--plane-distance-mm", "3,1")
    code, out, err = wavesim(*usual)
    assert (code, out) == (2, "")
    assert "--plane-distance-mm = '3,1': must be two numbers, increasing" in err
