"""Studies of scaled lenses: a perturbed lens of the new size is the scaled copy of a perturbed lens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import DESIGNS
from programs import Command, run_program

from lensdesign import InputError, load_design, save_design, scaled
from tolerancing import load_study
from tolerancing.perturbations.parameters import PARAMETERS, Perturbation, PerturbedParameter
from tolerancing.prediction.ray_prediction import predict_rays
from tolerancing.prediction.wavefront_prediction import drawn_batch
from tolerancing.study.files import study_by_name, study_from_tables
from tolerancing.study.scaling import scaling_of, study_of_scaled_lens, write_scaled_study

LENS = load_design(DESIGNS / "moulded_pair.toml")
KINDS = (
    ("lens", "decenter_y_mm", 0.01),
    ("lens", "tilt_x_deg", 0.1),
    ("object", "working_distance_mm", 0.01),
    ("surface 1", "radius_mm", 0.01),
    ("surface 1", "radius_percent", 0.1),
    ("surface 1", "radius_fringes", 2.0),
    ("surface 2", "conic", 0.01),
    ("surface 2", "asphere_4", 1e-5),
    ("surface 2", "tir_y_mm", 0.005),
    ("surface 2", "irregularity_pv_waves", 0.5),
    ("surface 1", "index", 0.001),
    ("surface 1", "thickness_mm", 0.01),
    ("element 1", "edge_difference_y_mm", 0.005),
    ("element 2", "roll_x_deg", 0.1),
    ("element 2", "despace_mm", 0.01),
)


def study_of(*kinds):
    tables = {
        "design": "lens.toml",
        "trials": 20,
        "seed": 1,
        "perturbation": [
            {
                "target": target,
                "parameter": name,
                "distribution": "uniform",
                "half_width": half,
                "mean": 0.1 * half,
            }
            for target, name, half in kinds
        ],
        "merit": [
            {"kind": "largest_spread_deg", "at_most": 6.0},
            {
                "kind": "footprint_radius_mm",
                "at_most": 4.5,
                "plane_distance_mm": 2.0,
                "field_points_mm": [[0.0, 0.5]],
            },
        ],
    }
    return study_from_tables(tables, "here")


@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_rays_of_a_scaled_lens_are_scaled(factor: float) -> None:
    study = study_of(*KINDS)
    twin = study_of_scaled_lens(study, factor, "twin.toml")
    spread, footprint = predict_rays(LENS, study, drawn_batch(study), checked=False)
    other_spread, other_footprint = predict_rays(scaled(LENS, factor), twin, drawn_batch(twin), checked=False)
    assert other_spread.nominal == pytest.approx(spread.nominal, rel=1e-6)
    np.testing.assert_allclose(other_spread.alone, spread.alone, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(other_footprint.alone, factor * footprint.alone, rtol=1e-4, atol=1e-7 * factor)
    assert np.count_nonzero(spread.alone) > 10
    assert twin.all_merits[1].at_most == pytest.approx(factor * 4.5)
    assert twin.all_merits[1].plane_distance_mm == pytest.approx(factor * 2.0)
    assert twin.sampling.plane_distance_mm == pytest.approx(factor * study.sampling.plane_distance_mm)


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-2, 1e2), st.sampled_from(["precision", "moulded_plastic"]))
def test_scaling_back_gives_the_study(factor: float, grade: str) -> None:
    study = study_by_name(grade, LENS)
    back = study_of_scaled_lens(study_of_scaled_lens(study, factor, "a.toml"), 1.0 / factor, study.design)
    for one, other in zip(study.perturbations, back.perturbations, strict=True):
        assert (one.column, one.tolerance) == (other.column, pytest.approx(other.tolerance, rel=1e-12))
        assert one.distribution.centre == pytest.approx(other.distribution.centre, rel=1e-12)


def test_every_parameter_has_a_power() -> None:
    for target, names in PARAMETERS.items():
        item = (
            target
            if target in ("lens", "object", "sensor", "light", "environment", "reconstruction")
            else f"{target} 1"
        )
        for name in names:
            power = scaling_of(PerturbedParameter(target=item, parameter=name))
            known = {"_mm": 1, "fringes": 1, "waves": 1, "_deg": 0, "percent": 0, "_c": 0, "_um": 0}
            ends = [value for end, value in known.items() if name.endswith(end)]
            assert power == (
                ends[0] if ends else 0 if "asphere" not in name else 1 - int(name.rpartition("_")[2])
            )


def test_line_widths_and_patches_stay_and_points_scale() -> None:
    loaded = load_study(DESIGNS / "paper_reconstruction_study.toml")
    twin = study_of_scaled_lens(loaded.study, 0.25, "twin.toml")
    for one, other in zip(loaded.study.all_merits, twin.all_merits, strict=True):
        assert (one.line_widths_um, one.region_mm) == (other.line_widths_um, other.region_mm)
        np.testing.assert_allclose(other.field_points_mm, 0.25 * np.array(one.field_points_mm))
        np.testing.assert_allclose(other.planes_mm, 0.25 * np.array(one.planes_mm))


def test_measured_deviations_are_refused(tmp_path: Path) -> None:
    (tmp_path / "measured.csv").write_text("value\n0.01\n-0.02\n0.03\n")
    (tmp_path / "lens.toml").write_text((DESIGNS / "moulded_pair.toml").read_text())
    text = (
        'design = "lens.toml"\ntrials = 20\nseed = 1\n[[merit]]\nkind = "largest_spread_deg"\nat_most = 6.0\n'
    )
    text += '[[perturbation]]\ntarget = "lens"\nparameter = "decenter_y_mm"\ndistribution = "empirical"\n'
    (tmp_path / "study.toml").write_text(text + 'file = "measured.csv"\ncolumn = "value"\n')
    study = load_study(tmp_path / "study.toml").study
    assert isinstance(study.perturbations[0], Perturbation)
    with pytest.raises(InputError, match=r"measured in measured\.csv"):
        study_of_scaled_lens(study, 0.5, "twin.toml")
    with pytest.raises(InputError, match=r"measured\.csv relative to"):
        write_scaled_study(study, tmp_path, 1.0, LENS, tmp_path / "other" / "twin.toml")


def test_the_command_writes_the_study_beside_the_design(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def run(*arguments: object) -> Command:
        return run_program(monkeypatch, capsys, "lensdesign", "scale", *arguments)

    paper, twin = DESIGNS / "paper_singlet.toml", tmp_path / "twin.toml"
    code, out, err = run(paper, 0.125, "-o", twin, "--study", DESIGNS / "as_built_tolerances.toml")
    assert (code, err) == (0, "")
    written = tmp_path / "twin_tolerances.toml"
    assert f"wrote {written}" in out
    loaded = load_study(written)
    assert loaded.lens.half_field_mm == pytest.approx(0.1875)
    assert loaded.study.perturbations[0].tolerance == pytest.approx(0.125 * 0.016)
    save_design(load_design(paper), tmp_path / "lens.toml")
    code, out, err = run(tmp_path / "lens.toml", 0.5, "-o", twin, "--study", tmp_path / "none.toml")
    assert (code, out) == (2, "")
    assert "none.toml" in err
