"""Values that a study leaves open are derived, and a sheet yields what the study that it stands for does."""

from __future__ import annotations

import tomllib

import pytest
from drawing_checks import lens_of
from places import DESIGNS, GOLDEN

from lensdesign.manufacture.drawing.assumed import AssumedTolerances, load_tolerances
from lensdesign.manufacture.drawing.predicted_yield import MAX_YIELD_LOSS
from lensdesign.manufacture.drawing.sheets import drawing_as_stated
from tolerancing.merits.pupil import ImageShift
from tolerancing.perturbations.grades import starting_study
from tolerancing.prediction.as_drawn_study import as_drawn_study, drawing_indications
from tolerancing.prediction.drawing_yield import LOSS_ALL, DrawingYieldPredictor
from tolerancing.prediction.study_prediction import predict_study
from tolerancing.prediction.wavefront_prediction import drawn_batch
from tolerancing.study.files import LoadedStudy, load_study, study_from_tables

FOLDER = GOLDEN / "designer_b"


@pytest.fixture(scope="module")
def loaded() -> LoadedStudy:
    return load_study(FOLDER / "study_best.toml")


@pytest.fixture(scope="module")
def general(loaded: LoadedStudy):
    """The lens as drawn, and the sheet with general tolerances where the study states none."""
    assumed = load_tolerances(FOLDER / "study_best.toml", loaded.lens)
    _, stated = drawing_as_stated(loaded.lens, None, assumed)
    return stated


def test_general_tolerances_cost_most_of_the_yield(loaded: LoadedStudy, general) -> None:
    """The sheet of the study, with 20 arc minutes on the surface that the study does not tilt."""
    (sheet,) = general.tolerances
    assert sheet.left.centring_arcmin == 20.0
    assert set(sheet.left.general) >= {"centring_arcmin", "irregularity_fringes", "chamfer_mm"}
    assert not {"radius_mm", "rms_irregularity_fringes"} & set(sheet.left.general)
    assert "thickness_mm" not in sheet.general
    predicted_yield = DrawingYieldPredictor(loaded.study, "study").predict(
        loaded.lens, general.lens, general.tolerances
    )
    assert predicted_yield is not None
    assert predicted_yield.study_yield == predict_study(loaded.lens, loaded.study).yield_fraction > 0.98
    assert predicted_yield.as_drawn_yield < 0.5
    for fraction, interval in (
        (predicted_yield.study_yield, predicted_yield.study_interval),
        (predicted_yield.as_drawn_yield, predicted_yield.as_drawn_interval),
    ):
        low, high = interval
        assert low < fraction < high
        assert (
            f"{100.0 * fraction:.1f} % ({100.0 * low:.1f} to {100.0 * high:.1f} %)"
            in predicted_yield.sentence
        )
    worst = [text for text, _ in predicted_yield.losses[:3]]
    assert "centring of surface 1 (±20′)" in worst
    assert "points" in predicted_yield.worst


def test_derived_values_keep_the_yield(loaded: LoadedStudy, general) -> None:
    predictor = DrawingYieldPredictor(loaded.study, "study")
    derived = predictor.derive(general.lens, general.tolerances)
    (as_drawn,), (before,) = derived.tolerances, general.tolerances
    predicted_yield = predictor.predict(loaded.lens, general.lens, derived.tolerances)
    assert predicted_yield is not None
    assert predicted_yield.loss < LOSS_ALL + 0.005 < MAX_YIELD_LOSS
    assert 0.0 < as_drawn.left.centring_arcmin < before.left.centring_arcmin
    assert {"centring_arcmin", "decenter_mm"} <= set(as_drawn.left.derived)
    assert "centring_arcmin" not in as_drawn.left.general
    assert as_drawn.right.decenter_mm is not None  # an asphere whose displacement nobody has limited
    assert as_drawn.index == before.index  # of the study
    assert as_drawn.abbe_percent is not None
    assert set(as_drawn.general) >= {"diameter_mm", "bubbles"}
    assert as_drawn.left.radius_mm == before.left.radius_mm
    assert "centring of surface 1" in derived.notes[0]


def test_nothing_is_derived_where_general_tolerances_cost_nothing(loaded: LoadedStudy, general) -> None:
    """By a limit that any lens keeps."""
    (merit,) = loaded.study.all_merits
    lax = loaded.study.model_copy(update={"all_merits": (merit.model_copy(update={"at_most": 50.0}),)})
    (as_drawn,) = DrawingYieldPredictor(lax, "study").derive(general.lens, general.tolerances).tolerances
    assert as_drawn.left == general.tolerances[0].left.with_derived(decenter_mm=as_drawn.left.decenter_mm)
    assert "inhomogeneity" in as_drawn.general


def test_a_study_of_other_merits_is_not_scored(loaded: LoadedStudy, general) -> None:
    from tolerancing.merits.registry import merit_from_table

    table = {"kind": "throughput", "at_least": 0.5}
    study = loaded.study.model_copy(update={"all_merits": (merit_from_table(table, "here"),)})
    predictor = DrawingYieldPredictor(study, "study")
    assert predictor.derive(general.lens, general.tolerances).tolerances == general.tolerances
    assert predictor.predict(loaded.lens, general.lens, general.tolerances) is None


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """1024 drawn lenses, 32 of which are scored draw by draw."""
    monkeypatch.setattr(
        "tolerancing.prediction.study_prediction.drawn_batch", lambda study: drawn_batch(study, every=8)
    )
    monkeypatch.setattr("tolerancing.prediction.study_prediction.SCORED_DRAWS", 32)
    monkeypatch.setattr("tolerancing.prediction.drawing_yield._losses", lambda *_: [])


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("is_first", [True, False])
def test_a_limit_that_all_lenses_keep_adds_no_loss(loaded: LoadedStudy, general, is_first: bool) -> None:
    """Though it has fewer draws than the others, whether it is the first limit or not."""
    (waves,) = loaded.study.all_merits
    lax, shift = waves.model_copy(update={"at_most": 0.5}), ImageShift(kind="image_shift_um", at_most=1e4)
    alone, both = (
        DrawingYieldPredictor(loaded.study.model_copy(update={"all_merits": merits}), "study").predict(
            loaded.lens, general.lens, general.tolerances
        )
        for merits in ((lax,), (shift, lax) if is_first else (lax, shift))
    )
    assert alone is not None
    assert both is not None
    assert both.loss == alone.loss > MAX_YIELD_LOSS


@pytest.mark.usefixtures("few_draws")
def test_limits_with_few_draws_alone_have_a_loss(loaded: LoadedStudy, general) -> None:
    shift = ImageShift(kind="image_shift_um", at_most=1e4)
    study = loaded.study.model_copy(update={"all_merits": (shift,)})
    found = DrawingYieldPredictor(study, "study").predict(loaded.lens, general.lens, general.tolerances)
    assert found is not None
    assert found.study_yield == found.as_drawn_yield == 1.0
    assert found.loss == 0.0


@pytest.mark.parametrize("grade", ["precision", "iso10110"])
def test_a_graded_study_states_all_that_a_sheet_does(loaded: LoadedStudy, grade: str, tmp_path) -> None:
    """But the homogeneity of the glass, which no perturbation stands for."""
    text = starting_study(loaded.lens, "best.toml", grade)
    (tmp_path / "study.toml").write_text(text)
    study = study_from_tables(tomllib.loads(text), "here")
    assumed = load_tolerances(tmp_path / "study.toml", loaded.lens)
    _, stated = drawing_as_stated(loaded.lens, None, assumed)
    items = drawing_indications(stated.lens, study, stated.tolerances)
    assert {item.kind for item in items if item.origin != "study"} == {"inhomogeneity"}
    assert len(items) == 14
    as_drawn = as_drawn_study(stated.lens, study, items).study.perturbations
    assert as_drawn[: len(study.perturbations)] == study.perturbations
    assert [p.name for p in as_drawn[len(study.perturbations) :]] == [
        "inhomogeneity_of_element_1_irregularity_pv_waves"
    ]


def test_a_cemented_surface_is_scored_once_and_stands_on_both_sheets(loaded: LoadedStudy) -> None:
    glass = {"thickness_mm": 3.0, "material": "N-BK7", "semi_diameter_mm": 5.0}
    lens = lens_of(
        {"radius_mm": 40.0, "stop": True} | glass,
        {"radius_mm": -40.0} | glass | {"material": "N-SF2"},
        {"radius_mm": -200.0, "semi_diameter_mm": 5.0},
    )
    (merit,) = loaded.study.all_merits
    strict = merit.model_copy(update={"at_most": 0.02, "field_points_mm": ((0.0, 0.0),)})
    mount = tuple(p for p in loaded.study.perturbations if p.target == "lens")
    study = loaded.study.model_copy(update={"all_merits": (strict,), "perturbations": mount})
    assumed = AssumedTolerances([{}, {}], [{}, {}, {}])
    _, stated = drawing_as_stated(lens, None, assumed)
    items = drawing_indications(stated.lens, study, stated.tolerances)
    assert len({item.key for item in items}) == len(items)
    assert [item.surface for item in items if item.kind == "centring"] == [0, 1, 2]
    derived = DrawingYieldPredictor(study, "study").derive(stated.lens, stated.tolerances).tolerances
    assert derived[0].right.centring_arcmin == derived[1].left.centring_arcmin
    assert derived[0].right.irregularity_fringes == derived[1].left.irregularity_fringes
    assert derived[0].right.irregularity_fringes < stated.tolerances[0].right.irregularity_fringes
    assert "irregularity_fringes" in derived[1].left.derived


def test_a_wedge_that_the_study_gives_one_surface_is_shared_where_it_must() -> None:
    """Both surfaces are held to the ground edge, and the yield has no room for a second tilt."""
    paper = load_study(DESIGNS / "paper_tolerances.toml")
    strehl = tuple(merit for merit in paper.study.all_merits if merit.kind == "strehl")
    study = paper.study.model_copy(update={"all_merits": strehl})
    _, stated = drawing_as_stated(
        paper.lens, None, load_tolerances(DESIGNS / "paper_tolerances.toml", paper.lens)
    )
    assert stated.tolerances[0].right.centring_arcmin == 0.72
    predictor = DrawingYieldPredictor(study, "study")
    derived = predictor.derive(stated.lens, stated.tolerances)
    (as_drawn,) = derived.tolerances
    assert as_drawn.left.centring_arcmin == as_drawn.right.centring_arcmin < 0.72
    assert "centring_arcmin" in as_drawn.left.derived
    assert "centring_arcmin" in as_drawn.right.derived
    assert derived.notes[0].startswith("derived from the study, whose tilt of one surface is divided")
    predicted_yield = predictor.predict(paper.lens, stated.lens, derived.tolerances)
    assert predicted_yield is not None
    assert predicted_yield.loss < MAX_YIELD_LOSS
