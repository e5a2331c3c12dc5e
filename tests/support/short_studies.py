"""The designs, with studies that are done in seconds."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path
from typing import Any

import tomli_w
from places import DESIGNS, GOLDEN

from lensdesign import load_design, save_design, scaled

# The perturbation of the designs' studies that commands name, and the merit that they do without.
NAMED = ("surface 2", "conic")
LEFT_OUT = "contrast_1p55um"


def copy_designs(folder: Path) -> None:
    """The designs into a folder's own: three merits, four perturbations, small pupils; twins; frames."""
    designs = folder / "designs"
    shutil.copytree(DESIGNS, designs)
    shutil.copytree(GOLDEN / "through_focus", folder / "through_focus")
    lens = load_design(designs / "paper_singlet.toml")
    save_design(scaled(lens, 0.02), designs / "small_twin.toml")
    save_design(scaled(lens, 0.008), designs / "tiny_twin.toml")
    shorten(designs / "as_built_spec.toml")
    for path in designs.glob("*.toml"):
        study = tomllib.loads(path.read_text(encoding="utf-8"))
        if "trials" not in study:
            continue
        if "pupil_samples" in study.get("sampling", {}):
            study["sampling"]["pupil_samples"] //= 2
        every = study["perturbation"]
        study["perturbation"] = every[:3] + [p for p in every[3:] if (p["target"], p["parameter"]) == NAMED]
        study["merit"] = [m for m in study.get("merit", []) if m.get("name") != LEFT_OUT]
        for sweep in study.get("sweep", []):
            sweep["values"] = sweep["values"][:2]
            sweep.pop("picture_values", None)
        study["slice_count"] = study.get("slice_count", [])[:1]
        for count in study["slice_count"]:
            count["slices"] = [10]
            count.pop("picture_slices", None)
        if any(merit["kind"] == "reconstruction" for merit in study["merit"]):
            shorten_chain(study)
        for grid in study.get("grid", []):
            grid["x"]["values"], grid["y"]["values"] = grid["x"]["values"][:2], grid["y"]["values"][:2]
        path.write_text(tomli_w.dumps(study), encoding="utf-8")


def shorten_chain(study: dict[str, Any]) -> None:
    """The whole chain on the axis of a twin, through few slices."""
    study["design"] = "small_twin.toml"
    study["merit"] = [m for m in study["merit"] if "field_mm" not in m]
    for merit in study["merit"]:
        merit["slices"] = 3
    names = {merit["name"] for merit in study["merit"]}
    for perturbation in study["perturbation"]:
        if "half_width" in perturbation:
            perturbation["half_width"] *= 0.02
        else:
            perturbation["values"] = [2, 3]
    for sweep in study["sweep"]:
        sweep["values"] = [2, 3] if sweep["parameter"] == "slices" else [0.0, 1e-4]
        sweep["merits"] = [name for name in sweep["merits"] if name in names]


def shorten(specification: Path) -> None:
    """Few trials, and one start of a lens that is near the best."""
    asked = tomllib.loads(specification.read_text(encoding="utf-8"))
    asked["optimize"] |= {"starts": 1, "agreeing": 1}
    asked["tolerances"]["trials"] = 100
    asked["variable"] = [v for v in asked["variable"] if v["parameter"] in ("radius_mm", "thickness_mm")]
    asked["surface"][1]["conic"] = -0.8
    specification.write_text(tomli_w.dumps(asked), encoding="utf-8")
