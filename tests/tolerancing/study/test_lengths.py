"""Lengths of studies in another unit are refused with the value that may be meant."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from places import DESIGNS, GOLDEN
from tests_studies import DECENTER, DESIGN, FULL_STUDY, HEAD, RADIUS, SPREAD, STREHL, SWEEP

from lensdesign import DesignError
from tolerancing.study.files import load_study
from tolerancing.study.lengths import implausible_study_lengths

THICKNESS = DECENTER.replace('"lens"', '"surface 1"').replace("decenter_y_mm", "thickness_mm")
PLANE = DECENTER.replace('"lens"', '"sensor"').replace("decenter_y_mm", "plane_distance_2_mm")
LIGHT = DECENTER.replace('"lens"', '"light"').replace("decenter_y_mm", "wavelength_um")
HALF_WIDTH = DECENTER.replace('"normal"', '"uniform"').replace("sigma", "half_width")


@pytest.fixture
def study(tmp_path: Path) -> Path:
    (tmp_path / "design.toml").write_text(DESIGN)
    return tmp_path / "study.toml"


@pytest.mark.parametrize("path", sorted(DESIGNS.glob("*tolerances.toml")), ids=lambda path: path.stem)
def test_studies_of_the_designs_are_plausible(path: Path) -> None:
    loaded = load_study(path)
    assert list(implausible_study_lengths(loaded.study, loaded.lens)) == []


@pytest.mark.parametrize(
    ("table", "old", "new", "message"),
    [
        (DECENTER, "0.02", "20.0", r"perturbation 1: lens_decenter_y_mm, sigma = 20: .*0\.02 mm"),
        (DECENTER, "0.02", "2e-5", r"perturbation 1: lens_decenter_y_mm, sigma = 2e-05: .*0\.02 mm"),
        (HALF_WIDTH, "0.02", "20.0", r"perturbation 1: lens_decenter_y_mm, half_width = 20: .*; 0\.02 mm"),
        (THICKNESS, "0.02", "20.0", r"surface_1_thickness_mm, sigma = 20: .*thickness.*0\.02 mm"),
        (DECENTER, "sigma", "mean = 20.0\nsigma", r"lens_decenter_y_mm, mean = 20: .*0\.02 mm"),
        (PLANE, "0.02", "50.0", r"sensor_plane_distance_2_mm, sigma = 50: .*0\.05 mm"),
        (LIGHT, "0.02", "2.0", r"light_wavelength_um, sigma = 2: .*0\.002 µm"),
        (SWEEP, "0.04", "40.0", r"sweep 1: decenter_mm, values = 40: .*0\.04 mm"),
        (RADIUS, "0.0", "2", r"shop_radius_mm, sigma = 21: .*0\.021 mm"),
        (STREHL, "[[merit]]", "[[merit]]\nfield_mm = [0.0, 500.0]", r"merit 2, field_mm = 500: .*; 0\.5 mm"),
        (STREHL, "[[merit]]", "[[merit]]\nwavelength_um = 532.0", r"merit 2, wavelength_um = 532: .*; 0\.5"),
    ],
)
def test_another_unit_is_questioned(study: Path, table: str, old: str, new: str, message: str) -> None:
    first = "" if "perturbation" in table else DECENTER
    study.write_text(HEAD + first + SPREAD + table.replace(old, new))
    with pytest.raises(DesignError, match=message):
        load_study(study)


def test_an_index_in_percent_is_refused() -> None:
    """Indices from -0.05 to 3.3 had scores."""
    with pytest.raises(
        DesignError, match=r"surface_1_index, sigma = 0\.5: .* at most 0\.05 .*; 0\.005 may be"
    ):
        load_study(GOLDEN / "study_units" / "index_percent.toml")


@pytest.mark.parametrize(
    ("parameter", "value", "meant"),
    [
        ("index", 0.3, "0.003"),
        ("conic", 300.0, "3"),
        ("asphere_4", 1.0, ""),
        ("index", 0.06, "0.0006"),
        ("radius_percent", 120.0, ""),
        ("radius_fringes", 5000.0, ""),
        ("irregularity_pv_waves", 100.0, "0.158028 waves"),
        ("tilt_x_deg", 60.0, "1°"),
    ],
)
def test_numbers_that_no_tolerance_has_are_refused(
    study: Path, parameter: str, value: float, meant: str
) -> None:
    design = DESIGN.replace("stop = true", "stop = true\nasphere = [1e-7]")
    (study.parent / "design.toml").write_text(design if parameter.startswith("asphere") else DESIGN)
    table = DECENTER.replace('"lens"', '"surface 1"').replace("decenter_y_mm", parameter)
    study.write_text(HEAD + table.replace("0.02", f"{value:g}") + SPREAD)
    with pytest.raises(DesignError, match=re.escape(f"sigma = {value:g}: must be at most")) as refused:
        load_study(study)
    assert (f"{meant} may be meant" in str(refused.value)) == bool(meant)
    study.write_text(HEAD + table.replace("0.02", "1e-09") + SPREAD)
    load_study(study)


def test_a_far_pivot_is_questioned(study: Path) -> None:
    study.write_text(FULL_STUDY.replace("seed = 7", "seed = 7\npivot_z_mm = 4850.0"))
    with pytest.raises(DesignError, match=r"pivot_z_mm = 4850: .*4\.85 mm"):
        load_study(study)
