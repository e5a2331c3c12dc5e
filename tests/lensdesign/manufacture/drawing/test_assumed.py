"""Tolerances that a study assumed, on the sheet."""

from pathlib import Path

import pytest
from drawing_checks import assert_tidy, said

from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.assumed import load_tolerances
from lensdesign.manufacture.drawing.sheets import DrawingOptions, drawing_as_stated
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances

STUDY = """
design = "paper_singlet.toml"
trials = 10

[[perturbation]]
target = "surface 1"
parameter = "radius_percent"
distribution = "truncated_normal"
sigma = 0.05
limit = 0.1

[[perturbation]]
target = "surface 2"
parameter = "radius_fringes"
distribution = "normal"
sigma = 1.5

[[perturbation]]
target = "surface 1"
parameter = "irregularity_pv_waves"
distribution = "uniform"
mean = 0.125
half_width = 0.125

[[perturbation]]
target = "surface 2"
parameter = "irregularity_rms_waves"
distribution = "uniform"
mean = 0.02
half_width = 0.02

[[perturbation]]
target = "surface 2"
parameter = "tilt_x_deg"
distribution = "uniform"
half_width = 0.05

[[perturbation]]
target = "surface 2"
parameter = "tir_y_mm"
distribution = "uniform"
half_width = 0.01

[[perturbation]]
target = "surface 2"
parameter = "conic"
distribution = "uniform"
half_width = 0.0012

[[perturbation]]
target = "surface 2"
parameter = "decenter_x_mm"
distribution = "uniform"
half_width = 0.01

[[perturbation]]
target = "surface 1"
parameter = "thickness_mm"
distribution = "uniform"
half_width = 0.03

[[perturbation]]
target = "surface 1"
parameter = "index"
distribution = "uniform"
half_width = 0.0005

[[perturbation]]
target = "surface 1"
parameter = "abbe_percent"
distribution = "uniform"
half_width = 0.8

[[perturbation]]
target = "lens"
parameter = "tilt_x_deg"
distribution = "uniform"
half_width = 0.1

[[perturbation]]
target = "surface 1"
parameter = "despace_mm"
distribution = "empirical"
file = "a.csv"
column = "a"
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "budget.toml"
    path.write_text(STUDY)
    return path


def test_the_sheet_states_what_the_study_assumed(paper_lens: Lens, study: Path) -> None:
    assumed = load_tolerances(study, paper_lens)
    drawing, _ = drawing_as_stated(paper_lens, None, assumed)
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    for text in (
        "R 42.3 ±0.0423 CX",  # 0.1 %
        "R 12 (±0.0027) CX, conic",  # 3 fringes of 632.8 nm: 3 wavelengths R^2 / h^2
        "9.7 ±0.03",
        "3/ –(0.5)",  # a quarter wave of sag is half a fringe spacing
        "3/ 3(1.726*) RMSi < 0.08",  # B is the general tolerance, in fringes of the other wavelength
        "4/ 1.719′ (0.01)",  # 0.01 mm over 20 mm, less than 3 arc minutes
        "k = -0.89862 ±0.0012",
        "n(532 nm) = 1.519473 ±0.0005",
        "n(587.56 nm) = 1.51680   ν(587.56 nm) = 64.17 ±0.8 %",
    ):
        assert text in texts, text
    (notes,) = (text for text in texts if text.startswith("Ind. according to ISO 10110;"))
    assert "632.8 nm" in notes
    assert "tolerances of budget.toml; * general" in notes
    assert assumed.missing(paper_lens) == ["centring of surface 1"]
    assert assumed.left_out == [
        "lens tilt_x_deg (of the mount or the light)",
        "surface 1 despace_mm (a measured distribution)",
    ]


def test_what_the_study_did_not_assume_is_named(paper_lens: Lens, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text('[[perturbation]]\ntarget = "element 1"\nparameter = "roll_x_deg"\nhalf_width = 0.1\n')
    assumed = load_tolerances(path, paper_lens)
    assert assumed.left_out == ["element 1 roll_x_deg (of the mount)"]
    assert assumed.missing(paper_lens) == [
        "radius of surface 1",
        "irregularity of surface 1",
        "centring of surface 1",
        "radius of surface 2",
        "irregularity of surface 2",
        "centring of surface 2",
        "thickness of element 1",
    ]


def test_what_the_sheet_says_beside_it_stays(paper_lens: Lens, study: Path) -> None:
    own = DrawingTolerances.model_validate({"diameter_mm": 0.05, "left": {"coating": "AR 532 nm"}})
    drawing, _ = drawing_as_stated(
        paper_lens, DrawingOptions(tolerances=(own,)), load_tolerances(study, paper_lens)
    )
    texts = said(drawing.sheets[0])
    assert "AR 532 nm" in texts
    assert any(text.endswith("±0.05") and text.startswith("Ø") for text in texts)
    assert "9.7 ±0.03" in texts


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("trials = 3", r"holds no \[\[perturbation\]\] tables"),
        ('[[perturbation]]\ntarget = "lens"', "perturbation 1: parameter: Field required"),
        (STUDY.replace('"surface 2"', '"surface 3"'), r"'surface 3': .*2 surfaces and 1 element"),
        (STUDY.replace("0.0012", "-1.0"), "perturbation 7: half_width: "),
    ],
)
def test_other_files_are_refused(paper_lens: Lens, study: Path, text: str, message: str) -> None:
    study.write_text(text)
    with pytest.raises(DesignError, match=message):
        load_tolerances(study, paper_lens)
