"""Costs of tolerances: the reciprocal law, derivatives, gaps, and who pays for what."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import DESIGNS

from lensdesign.errors import InputError
from tolerancing.cost import cost_of, load_costs
from tolerancing.cost.table import RELATIVE
from tolerancing.perturbations.distributions import Uniform
from tolerancing.perturbations.parameters import Perturbation
from tolerancing.study.files import load_study

LOADED = load_study(DESIGNS / "paper_tolerances.toml")
TABLE = load_costs()


def line(cost, column):
    (found,) = (own for own in cost.lines if own.perturbation == column)
    return found


def test_the_papers_tolerances_are_priced_as_the_law_says():
    cost = cost_of(LOADED.study, LOADED.lens, TABLE)
    radius = line(cost, "surface_2_radius_mm")
    assert radius.process == "polished_glass"
    assert radius.tolerance == pytest.approx(100.0 * 0.008 / 12.0)
    assert radius.cost == pytest.approx(0.17 * 0.2 / radius.tolerance)
    thickness = line(cost, "surface_1_thickness_mm")
    assert thickness.cost == pytest.approx(0.17 * 0.15 / 0.015)
    # Both directions together are one tolerance.
    (two_sigma,) = {p.tolerance for p in LOADED.study.perturbations if p.parameter == "decenter_x_mm"}
    across = [line(cost, f"lens_decenter_{axis}_mm") for axis in "xy"]
    assert sum(own.cost for own in across) == pytest.approx(0.25 * 0.1 / two_sigma)
    assert {own.process for own in across} == {"turned_mount"}
    conic = line(cost, "surface_2_conic")
    assert conic.tolerance == pytest.approx(1e3 * 0.0006 * 10.0**4 / (8.0 * 12.0**3))
    assert cost.total == pytest.approx(1.0 + sum(own.cost for own in cost.lines))


def test_terms_of_a_forbes_asphere_are_tolerances_of_form():
    keys = {"shape": "Qcon", "normalization_radius_mm": 10.0, "q_mm": (0.02,)}
    lens = LOADED.lens.with_surface(1, **keys)
    term = Perturbation(target="surface 2", parameter="q_0_mm", distribution=Uniform(half_width=0.0003))
    own = line(cost_of(LOADED.study.replaced(perturbations=(term,)), lens, TABLE), "surface_2_q_0_mm")
    assert own.process == "polished_glass"
    assert own.tolerance == pytest.approx(0.3)


@given(st.lists(st.floats(1e-4, 1.0), min_size=12, max_size=12))
def test_the_gradient_is_that_of_differences_and_looser_is_cheaper(tolerances):
    base = cost_of(LOADED.study, LOADED.lens, TABLE, tolerances)
    values = np.array(tolerances)
    for k in range(len(values)):
        near = [
            cost_of(LOADED.study, LOADED.lens, TABLE, values + s * 1e-5 * values * (np.arange(12) == k))
            for s in (1, -1)
        ]
        slope = (near[0].total - near[1].total) / (2e-5 * values[k])
        assert slope == pytest.approx(base.gradient[k], rel=1e-4)
    assert cost_of(LOADED.study, LOADED.lens, TABLE, 2.0 * values).total < base.total


def test_an_element_has_the_process_that_is_asked_for():
    moulded = TABLE.with_processes({1: "moulded_plastic"})
    found = cost_of(LOADED.study, LOADED.lens, moulded)
    assert line(found, "surface_1_thickness_mm").process == "moulded_plastic"
    assert line(found, "surface_1_thickness_mm").cost == pytest.approx(0.17 * 0.025 / 0.015)
    with pytest.raises(InputError, match=r"'cast'.*polished_glass"):
        TABLE.with_processes({None: "cast"})


def test_gaps_are_all_named(tmp_path):
    text = RELATIVE.read_text().replace("thickness_mm = { reference = 0.15, share = 0.17 }\n", "", 1)
    (tmp_path / "costs.toml").write_text(text.replace("form_um = { reference = 1.0, share = 0.34 }\n", "", 1))
    with pytest.raises(InputError) as refused:
        cost_of(LOADED.study, LOADED.lens, load_costs(tmp_path / "costs.toml"))
    assert "process.polished_glass has no thickness_mm, for surface_1_thickness_mm" in str(refused.value)
    assert "process.polished_glass has no form_um, for surface_2_conic" in str(refused.value)


@pytest.mark.parametrize("tolerances", [[1.0], [0.0] * 12, [np.nan] * 12])
def test_what_is_no_tolerance_is_refused(tolerances):
    with pytest.raises(InputError, match=r"each perturbation.*above 0"):
        cost_of(LOADED.study, LOADED.lens, TABLE, tolerances)


def test_what_nobody_makes_costs_nothing():
    light = LOADED.study.perturbations[0].model_copy(update={"target": "light", "parameter": "wavelength_um"})
    study = LOADED.study.model_copy(update={"perturbations": (light,)})
    cost = cost_of(study, LOADED.lens, TABLE)
    assert cost.total == 1.0
    assert cost.gradient.tolist() == [0.0]
