"""What a study tells a calibration of the lens as made."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import load_design, save_design, scaled
from lensdesign.errors import InputError
from tolerancing.study.priors import calibration_priors

MERIT = '[[merit]]\nkind = "largest_spread_deg"\nat_most = 4.9\n'
PAPER = DESIGNS / "paper_singlet.toml"


def study(tmp_path: Path, *perturbations: str) -> Path:
    tables = "".join(f"[[perturbation]]\n{text}\n" for text in perturbations)
    path = tmp_path / "study.toml"
    path.write_text(f'design = "{PAPER}"\ntrials = 10\nseed = 1\n{tables}{MERIT}')
    return path


def test_the_papers_study_is_what_its_file_says() -> None:
    found = calibration_priors(DESIGNS / "paper_tolerances.toml", load_design(PAPER))
    assert found.deviations["decenter_x_mm"] == pytest.approx(0.008)
    assert found.deviations["working_distance_mm"] == pytest.approx(0.020 / math.sqrt(3.0))
    assert found.deviations["surface_1_thickness_mm"] == pytest.approx(0.015 / math.sqrt(3.0))
    # A normal distribution cut at two sigma is narrower by a known factor.
    assert found.deviations["surface_1_radius_mm"] == pytest.approx(0.8796 * 0.015, rel=1e-3)
    assert found.not_sought == ("surface_2_conic", "wedge_x_deg", "wedge_y_deg")


def test_units_are_converted_means_count_and_equal_effects_add_up(tmp_path: Path) -> None:
    uniform = 'distribution = "uniform"\nhalf_width = 1.0'
    path = study(
        tmp_path,
        f'target = "surface 2"\nparameter = "radius_percent"\n{uniform}',
        'target = "lens"\nparameter = "tilt_x_deg"\ndistribution = "normal"\nsigma = 0.03\nmean = 0.04',
        'target = "object"\nparameter = "working_distance_mm"\ndistribution = "normal"\nsigma = 0.03',
        'target = "lens"\nparameter = "despace_mm"\ndistribution = "normal"\nsigma = 0.04',
        'target = "sensor"\nparameter = "tilt_y_deg"\ndistribution = "normal"\nsigma = 0.2',
        'target = "sensor"\nparameter = "plane_distance_2_mm"\ndistribution = "normal"\nsigma = 0.01',
    )
    found = calibration_priors(path, load_design(PAPER)).deviations
    assert found == {
        "surface_2_radius_mm": pytest.approx(0.12 / math.sqrt(3.0)),
        "tilt_x_deg": pytest.approx(0.05),
        "working_distance_mm": pytest.approx(0.05),
        "sensor_tilt_y_deg": pytest.approx(0.2),
        "plane_distance_2_mm": pytest.approx(0.01),
    }


def test_an_irregularity_is_shared_among_the_terms_of_a_figure(tmp_path: Path) -> None:
    sigma = 'distribution = "normal"\nsigma = 0.1'
    path = study(tmp_path, f'target = "surface 1"\nparameter = "irregularity_rms_waves"\n{sigma}')
    found = calibration_priors(path, load_design(PAPER)).deviations
    assert set(found) == {f"surface_1_figure_{j}_um" for j in (3, 5, 7, 8)}
    # All terms together have the root mean square that is stated; second orders have most of it.
    assert 0.5 < math.hypot(*found.values()) / (0.1 * 0.6328) < 1.0
    assert found["surface_1_figure_3_um"] > 1.5 * found["surface_1_figure_7_um"]


def test_a_study_of_another_design_is_refused(tmp_path: Path) -> None:
    lens = scaled(load_design(PAPER), 0.5)
    with pytest.raises(InputError, match=r"paper_tolerances\.toml: .*another design, paper_singlet"):
        calibration_priors(DESIGNS / "paper_tolerances.toml", lens)
    save_design(load_design(PAPER), tmp_path / "copy.toml")
    assert calibration_priors(DESIGNS / "paper_tolerances.toml", load_design(tmp_path / "copy.toml"))
