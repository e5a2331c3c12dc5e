"""Sheets as studies: each indication as perturbations, in the place of nothing or beside the study's own."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from places import DESIGNS, GOLDEN

from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances, general_tolerances
from tolerancing.perturbations.distributions.bounded import Uniform
from tolerancing.perturbations.parameters import Perturbation
from tolerancing.prediction.as_drawn_study import as_drawn_study, drawing_indications
from tolerancing.study.files import load_study
from tolerancing.study.study import Study

SHEET = DrawingTolerances.model_validate(
    {
        "left": {"radius_fringes": 3.0, "irregularity_fringes": 0.5, "centring_arcmin": 2.0},
        "right": {
            "radius_mm": 0.01,
            "irregularity_fringes": 1.0,
            "rms_irregularity_fringes": 0.2,
            "centring_arcmin": 1.0,
            "decenter_mm": 0.01,
            "conic": 0.001,
        },
        "thickness_mm": 0.05,
        "index": 0.0005,
        "abbe_percent": 0.5,
        "inhomogeneity": "2;3",
        "fringe_wavelength_um": 0.6328,
    }
)


@pytest.fixture(scope="module")
def paper_study() -> Study:
    return load_study(DESIGNS / "paper_tolerances.toml").study


def only(study: Study, *perturbations: Perturbation) -> Study:
    return study.model_copy(update={"perturbations": perturbations})


def uniform(target: str, parameter: str, half: float, **more: float) -> Perturbation:
    return Perturbation(target=target, parameter=parameter, distribution=Uniform(half_width=half, **more))


def test_each_indication_allows_what_it_says(lens: Lens, paper_study: Study) -> None:
    mount = only(paper_study, uniform("lens", "decenter_x_mm", 0.01))
    items = drawing_indications(lens, mount, [SHEET])
    allowed = {
        (item.kind, item.surface + 1): {d.parameter: d.tolerance for d in item.deviations} for item in items
    }
    index = 1.519473
    expected = {
        # 3 fringe spacings of sag at 8.26 mm: h^2 dR / (2 R^2) = 3 wavelengths / 2
        ("radius", 1): {"radius_mm": 3.0 * 0.6328e-3 * (42.3 / 8.26) ** 2},
        ("radius", 2): {"radius_mm": 0.01},
        # a fringe spacing is half a wave of sag
        ("irregularity", 1): {"irregularity_pv_waves": 0.25},
        ("irregularity", 2): {"irregularity_rms_waves": 0.1},
        ("centring", 1): {"tilt_x_deg": 2.0 / 60.0, "tilt_y_deg": 2.0 / 60.0},
        ("centring", 2): {"tilt_x_deg": 1.0 / 60.0, "tilt_y_deg": 1.0 / 60.0},
        ("decenter", 2): {"decenter_x_mm": 0.01, "decenter_y_mm": 0.01},
        ("conic", 2): {"conic": 0.001},
        ("thickness", 1): {"thickness_mm": 0.05},
        ("index", 1): {"index": 0.0005},
        ("Abbe number", 1): {"abbe_percent": 0.5},
        # class 2 is 5e-6 either way over 9.7 mm of glass
        ("inhomogeneity", 1): {"irregularity_pv_waves": 9.7 * 1e-5 / (index - 1.0) / 0.6328e-3},
    }
    assert allowed.keys() == expected.keys()
    for key, own in expected.items():
        assert allowed[key] == pytest.approx(own, rel=1e-5), key
    assert {item.origin for item in items} == {"sheet"}
    as_drawn = as_drawn_study(lens, mount, items)
    assert as_drawn.study.perturbations[0] == mount.perturbations[0]
    assert as_drawn.items[0] is None
    sizes = {(p.target, p.parameter, p.tolerance) for p in as_drawn.study.perturbations[1:]}
    assert ("surface 1", "tilt_y_deg", pytest.approx(2.0 / 60.0)) in [(*s[:2], s[2]) for s in sizes]
    for p in as_drawn.study.perturbations:
        p.check(lens)
    assert len({p.column for p in as_drawn.study.perturbations}) == len(as_drawn.study.perturbations)


def test_what_a_sheet_leaves_open_is_general(lens: Lens, paper_study: Study) -> None:
    items = drawing_indications(lens, paper_study, [DrawingTolerances(thickness_mm=0.1)])
    by_key = {(item.kind, item.surface + 1): item for item in items}
    assert by_key["centring", 1].origin == "open"
    assert by_key["centring", 1].value == general_tolerances(20.0).left.centring_arcmin
    assert by_key["decenter", 2].origin == "open"
    assert by_key["inhomogeneity", 1].value == 1.0


def test_the_studys_own_perturbations_stay_as_they_are(lens: Lens, paper_study: Study) -> None:
    """The sheet states 2 sigma of the wedge, and the same wedge scatters."""
    stated = SHEET.replaced(right=SHEET.right.replaced(centring_arcmin=0.72))
    items = drawing_indications(lens, paper_study, [stated])
    as_drawn = as_drawn_study(lens, paper_study, items)
    own = as_drawn.study.perturbations[: len(paper_study.perturbations)]
    assert own == paper_study.perturbations
    added = {(p.target, p.parameter) for p in as_drawn.study.perturbations[len(own) :]}
    assert ("surface 1", "tilt_x_deg") in added
    assert ("surface 2", "tilt_x_deg") not in added
    assert ("surface 1", "thickness_mm") not in added


def test_a_tilt_about_one_axis_is_allowed_about_both(lens: Lens, paper_study: Study) -> None:
    study = only(paper_study, uniform("surface 2", "tir_y_mm", 0.005))
    minutes = 60.0 * math.degrees(0.005 / 20.0)
    stated = SHEET.replaced(right=SHEET.right.replaced(centring_arcmin=minutes))
    as_drawn = as_drawn_study(lens, study, drawing_indications(lens, study, [stated]))
    tilts = {
        p.parameter: p.tolerance
        for p in as_drawn.study.perturbations
        if p.target == "surface 2" and p.parameter.startswith(("tilt", "tir"))
    }
    assert tilts == {"tir_y_mm": 0.005, "tilt_y_deg": pytest.approx(minutes / 60.0)}


def test_of_several_the_closest_is_what_the_sheet_holds_parts_to(lens: Lens, paper_study: Study) -> None:
    study = only(
        paper_study, uniform("surface 2", "tilt_x_deg", 0.05), uniform("surface 2", "tilt_y_deg", 0.02)
    )
    stated = SHEET.replaced(right=SHEET.right.replaced(centring_arcmin=1.2))
    as_drawn = as_drawn_study(lens, study, drawing_indications(lens, study, [stated]))
    assert [p.tolerance for p in as_drawn.study.perturbations[:2]] == pytest.approx([0.02, 0.02])


def test_what_is_added_scatters_as_the_study_has_it_elsewhere() -> None:
    loaded = load_study(GOLDEN / "designer_b" / "study_best.toml")
    sheet = SHEET.replaced(left=SHEET.left.replaced(centring_arcmin=3.0))
    as_drawn = as_drawn_study(
        loaded.lens, loaded.study, drawing_indications(loaded.lens, loaded.study, [sheet])
    )
    by = {(p.target, p.parameter): p for p in as_drawn.study.perturbations}
    assert by["surface 1", "tilt_x_deg"].distribution == Uniform(half_width=0.05)
    own = [p for p in as_drawn.study.perturbations if p.name.startswith("inhomogeneity")]
    assert own[0].distribution.mean == own[0].distribution.half_width  # from none, as irregularities


def test_a_measured_distribution_gives_way_to_the_sheet(
    lens: Lens, paper_study: Study, tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text("t\n0.2\n-0.2\n0.1\n")
    (tmp_path / "design.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    text = (
        'design = "design.toml"\ntrials = 4\nseed = 1\n[[perturbation]]\ntarget = "surface 1"\n'
        'parameter = "thickness_mm"\ndistribution = "empirical"\nfile = "a.csv"\ncolumn = "t"\n'
        '[[merit]]\nkind = "strehl"\nat_least = 0.5\n'
    )
    (tmp_path / "study.toml").write_text(text)
    study = load_study(tmp_path / "study.toml").study
    as_drawn = as_drawn_study(lens, study, drawing_indications(lens, study, [SHEET]))
    (own,) = (p for p in as_drawn.study.perturbations if p.parameter == "thickness_mm")
    assert own.distribution == Uniform(half_width=0.05)
