"""Perturbations: from tables to poses, and trials that depend on nothing but their number."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import DesignError, Pose, SurfacePerturbation
from lensdesign.system import Lens
from tolerancing.distributions import Normal, Uniform
from tolerancing.perturbations import (
    LENS_PARAMETERS,
    SURFACE_PARAMETERS,
    Perturbation,
    PerturbationBatch,
    PerturbedParameter,
    perturbation_from_table,
    realise,
)

SCATTER = [
    Perturbation(target="lens", parameter="tilt_x_deg", distribution=Normal(sigma=0.1)),
    Perturbation(target="surface 2", parameter="radius_mm", distribution=Uniform(half_width=0.02)),
    Perturbation(target="surface 2", parameter="conic", distribution=Normal(sigma=0.001)),
]


@given(seed=st.integers(0, 2**70), trials=st.lists(st.integers(0, 10**6), min_size=1, max_size=6))
def test_a_trial_depends_on_seed_and_number_alone(seed, trials):
    together = realise(SCATTER, seed, trials).values
    alone = [realise(SCATTER, seed, [trial]).values[0] for trial in trials]
    assert np.array_equal(together, alone)


def test_streams_are_those_of_seed_sequences():
    sequence = np.random.SeedSequence(11, spawn_key=(5,))
    draws = np.random.default_rng(sequence).random(3)
    drawn = realise(SCATTER, 11, [5]).values[0]
    expected = [p.distribution.quantile(np.array([u]))[0] for p, u in zip(SCATTER, draws, strict=True)]
    assert drawn.tolist() == expected


def test_seeds_trials_and_perturbations_are_uncorrelated():
    a = realise(SCATTER, 1, range(3000)).values
    b = realise(SCATTER, 2, range(3000)).values
    columns = np.column_stack([a, b, a[np.arange(1, 3001) % 3000]])
    off_diagonal = np.corrcoef(columns.T) - np.eye(9)
    assert np.abs(off_diagonal).max() < 4.0 / np.sqrt(3000)


def test_a_perturbation_added_at_the_end_leaves_the_others_as_they_were():
    assert np.array_equal(
        realise(SCATTER[:2], 4, range(9)).values, realise(SCATTER, 4, range(9)).values[:, :2]
    )


def test_batch_becomes_poses_and_surface_perturbations():
    batch = realise(SCATTER, 1, range(4), pivot_z_mm=4.5)
    tilt, radius, conic = batch.values.T
    assert batch.poses().tilt_x_deg.tolist() == tilt.tolist()
    assert batch.poses().pivot_z_mm == 4.5
    assert batch.pose(2) == Pose(tilt_x_deg=float(tilt[2]), pivot_z_mm=4.5)
    assert list(batch.surface_perturbations()) == [1]
    assert batch.surface_perturbations()[1].conic.tolist() == conic.tolist()
    assert batch.surface_perturbations_of(3) == {
        1: SurfacePerturbation(radius_mm=float(radius[3]), conic=float(conic[3]))
    }
    singles = batch.single_trials()
    assert np.array_equal(np.vstack([single.values for single in singles]), batch.values)


@pytest.mark.parametrize(
    ("target", "parameters"), [("lens", LENS_PARAMETERS), ("surface 1", SURFACE_PARAMETERS)]
)
def test_every_parameter_reaches_its_place(target, parameters):
    for name in parameters:
        parameter = PerturbedParameter(target=target, parameter=name)
        batch = PerturbationBatch((parameter,), np.array([[0.25]]))
        part = batch.pose(0) if target == "lens" else batch.surface_perturbations_of(0)[0]
        assert getattr(part, name) == 0.25
        others = {n: getattr(part, n) for n in parameters if n != name}
        assert set(others.values()) == {0.0}


def test_two_perturbations_of_one_parameter_add_up():
    twice = PerturbedParameter(target="lens", parameter="decenter_x_mm")
    batch = PerturbationBatch((twice, twice), np.array([[0.1, 0.2], [1.0, -1.0]]))
    assert batch.poses().decenter_x_mm.tolist() == pytest.approx([0.3, 0.0])


@pytest.mark.parametrize(
    ("name", "target", "parameter", "column"),
    [
        ({}, "lens", "tilt_y_deg", "lens_tilt_y_deg"),
        ({}, "surface 2", "conic", "surface_2_conic"),
        ({"name": "wedge"}, "surface 1", "tilt_x_deg", "wedge_deg"),
        ({"name": "sag_mm"}, "surface 1", "despace_mm", "sag_mm"),
    ],
)
def test_columns_carry_their_unit(name, target, parameter, column):
    assert PerturbedParameter(**name, target=target, parameter=parameter).column == column


GOOD = {"target": "lens", "parameter": "tilt_x_deg", "distribution": "normal", "sigma": 0.1}


def test_table_is_read_with_its_distribution():
    read = perturbation_from_table(GOOD | {"mean": 0.5}, "here")
    assert read.distribution == Normal(sigma=0.1, mean=0.5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sgma": 1.0}, r"here: sgma: unknown key; allowed: .*target.*sigma"),
        ({"distribution": "norml"}, r"distribution = 'norml'.*allowed: normal, .*did you mean normal"),
        ({"distribution": 3}, r"distribution = 3.*allowed: normal"),
        ({"sigma": -0.1}, r"here: sigma = -0.1: must be greater than 0"),
        ({"sigma": float("inf")}, r"here: sigma = inf: must be a finite number"),
        ({"target": "lense"}, r"'lense' is no target; allowed: lens, surface N"),
        ({"target": "surface 0"}, r"'surface 0' is no target"),
        ({"parameter": "radius_mm"}, r"lens has no such parameter; allowed: decenter_x_mm"),
        ({"parameter": "pivot_z_mm"}, r"lens has no such parameter"),
        ({"name": "Tilt X"}, r"name = 'Tilt X'"),
    ],
)
def test_faults_name_key_value_and_what_is_allowed(change, message):
    with pytest.raises(DesignError, match=message):
        perturbation_from_table(GOOD | change, "here")


@pytest.mark.parametrize("key", ["target", "parameter", "distribution", "sigma"])
def test_missing_keys_are_named(key):
    with pytest.raises(DesignError, match=f"here: {key}: missing key"):
        perturbation_from_table({k: v for k, v in GOOD.items() if k != key}, "here")


@pytest.mark.parametrize(
    ("target", "parameter", "message"),
    [
        ("surface 3", "conic", r"no such surface; allowed: lens, surface 1, surface 2"),
        ("surface 1", "radius_mm", r"surface 1 is a plane"),
        ("surface 2", "thickness_mm", r"last surface"),
        ("surface 2", "index", r"last surface"),
    ],
)
def test_parameters_that_a_lens_does_not_have_are_refused(target, parameter, message):
    lens = Lens.model_validate(
        {
            "wavelengths_um": [0.5],
            "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.2, "working_distance_mm": 10.0},
            "sensor": {"pixel_pitch_um": 3.0, "pixels": [100, 100], "plane_distances_mm": [1.0]},
            "surface": [{"thickness_mm": 3.0, "material": 1.5, "semi_diameter_mm": 2.0}, {"radius_mm": -9.0}],
        }
    )
    with pytest.raises(ValueError, match=message):
        PerturbedParameter(target=target, parameter=parameter).check(lens)
