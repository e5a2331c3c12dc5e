"""Arguments that are an object or the path of its file."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import InputError, Lens, check_design, load_design, optimize
from lensdesign.common.given import object_of
from tolerancing import inverse, load_study, run_study
from tolerancing.prediction.study_prediction import predict_study
from tolerancing.prediction.wavefront_prediction import predict
from wavesim import choose, image

STUDY = DESIGNS / "as_built_tolerances.toml"


def test_an_object_is_returned_and_a_path_is_read() -> None:
    lens = load_design(DESIGNS / "feasible_singlet.toml")
    assert object_of(lens, Lens, load_design, "lens") is lens
    assert object_of(str(DESIGNS / "feasible_singlet.toml"), Lens, load_design, "lens") == lens


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: check_design(3), "lens: must be a Lens or the path of its file, not .* class int"),
        (lambda: optimize(None), "specification: must be a Specification .* not None"),
        (lambda: optimize(load_design(DESIGNS / "feasible_singlet.toml")), "specification: .* class Lens"),
        (lambda: run_study(load_study(STUDY).study, "a.db"), "loaded: must be a LoadedStudy .* class Study"),
        (lambda: inverse([]), "loaded: must be a LoadedStudy"),
        (lambda: predict_study({}, STUDY), "lens: must be a Lens"),
        (lambda: predict(DESIGNS / "paper_singlet.toml", 1.0), "study: must be a Study .* class float"),
        (lambda: choose(b"scene"), "scene: must be a Lens"),
        (lambda: image(1), "lens: must be a Lens"),
        (lambda: optimize("none.toml"), "cannot read none.toml"),
        (lambda: run_study("none.toml", "a.db"), "cannot read none.toml"),
        (lambda: choose(Path("none.toml")), "cannot read none.toml"),
    ],
)  # fmt: skip
def test_anything_else_is_refused_with_a_sentence(call, named: str) -> None:
    with pytest.raises(InputError, match=named):
        call()


def test_paths_give_what_objects_give(tmp_path: Path) -> None:
    loaded = load_study(STUDY)
    by_path = predict_study(DESIGNS / "paper_singlet.toml", STUDY, quick=True)
    assert by_path.yield_fraction == predict_study(loaded.lens, loaded, quick=True).yield_fraction
    assert run_study(STUDY, tmp_path / "a.db", workers=1, trials=2).trials_run == 2
    tiny = DESIGNS / "phone_lens.toml"
    assert choose(tiny, error=0.5).chosen == choose(load_design(tiny), error=0.5).chosen


def test_indices_out_of_range_say_which_surface_they_are() -> None:
    lens = load_design(DESIGNS / "feasible_singlet.toml")
    with pytest.raises(InputError, match="index = 2: must be from 0 to 1, for surface 1 to surface 2"):
        lens.with_surface(2, thickness_mm=1.0)
