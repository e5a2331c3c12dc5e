"""Batches: deltas of a study become lenses, objects, sensors and light."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import Pose, SurfacePerturbation, trace
from lensdesign.analysis.form_error import pv_rms_waves
from lensdesign.lens.poses import SURFACE_DELTAS
from lensdesign.lens.surface import Surface
from lensdesign.raytrace.bundles import pupil_rings
from tolerancing.merits.pupil import Strehl
from tolerancing.merits.sensor_rays import arriving_rays
from tolerancing.perturbations.batch import PerturbationBatch, batch_of
from tolerancing.perturbations.distributions import Normal, Uniform
from tolerancing.perturbations.parameters import LENS_PARAMETERS, Perturbation, PerturbedParameter
from tolerancing.study.evaluate import sample_perturbations
from tolerancing.study.study import Study

SCATTER = (
    Perturbation(target="lens", parameter="tilt_x_deg", distribution=Normal(sigma=0.1)),
    Perturbation(target="surface 2", parameter="radius_mm", distribution=Uniform(half_width=0.02)),
    Perturbation(target="surface 2", parameter="conic", distribution=Normal(sigma=0.001)),
)


def study_of(perturbations=SCATTER, seed=1, **keys):
    return Study(
        design="design.toml",
        trials=100,
        seed=seed,
        perturbation=perturbations,
        merit=(Strehl(kind="strehl", at_least=0.5),),
        **keys,
    )


def one(target, parameter, *values):
    return PerturbationBatch(
        (PerturbedParameter(target=target, parameter=parameter),), np.array(values)[:, None]
    )


@given(seed=st.integers(0, 2**70), trials=st.lists(st.integers(0, 10**6), min_size=1, max_size=6))
def test_a_trial_depends_on_seed_and_number_alone(seed, trials):
    study = study_of(seed=seed)
    together = sample_perturbations(study, trials).values
    alone = [sample_perturbations(study, [trial]).values[0] for trial in trials]
    assert np.array_equal(together, alone)


def test_streams_are_those_of_seed_sequences():
    draws = np.random.default_rng(np.random.SeedSequence(11, spawn_key=(5,))).random(3)
    drawn = sample_perturbations(study_of(seed=11), [5]).values[0]
    expected = [p.distribution.quantile(np.array([u]))[0] for p, u in zip(SCATTER, draws, strict=True)]
    assert drawn.tolist() == expected


def test_seeds_trials_and_perturbations_are_uncorrelated():
    a = sample_perturbations(study_of(seed=1), range(3000)).values
    b = sample_perturbations(study_of(seed=2), range(3000)).values
    columns = np.column_stack([a, b, a[np.arange(1, 3001) % 3000]])
    off_diagonal = np.corrcoef(columns.T) - np.eye(9)
    assert np.abs(off_diagonal).max() < 4.0 / np.sqrt(3000)


def test_a_perturbation_added_at_the_end_leaves_the_others_as_they_were():
    fewer = sample_perturbations(study_of(SCATTER[:2], seed=4), range(9)).values
    assert np.array_equal(fewer, sample_perturbations(study_of(seed=4), range(9)).values[:, :2])


def test_groups_move_together_and_correlations_show():
    grouped = tuple(p.model_copy(update={"group": "cell"}) for p in SCATTER[:2]) + SCATTER[2:]
    values = sample_perturbations(study_of(grouped), range(200)).values
    ranks = np.argsort(np.argsort(values, axis=0), axis=0)
    assert np.array_equal(ranks[:, 0], ranks[:, 1])
    assert not np.array_equal(ranks[:, 0], ranks[:, 2])
    study = Study.model_validate(
        study_of().model_dump(by_alias=True, exclude={"perturbations", "all_merits"})
        | {
            "perturbation": SCATTER,
            "merit": (Strehl(kind="strehl", at_least=0.5),),
            "correlation": ({"names": ("lens_tilt_x", "surface_2_conic"), "coefficient": 0.9},),
        }
    )
    correlated = sample_perturbations(study, range(2000)).values
    assert np.corrcoef(correlated.T)[0, 2] == pytest.approx(0.9, abs=0.02)
    assert abs(np.corrcoef(correlated.T)[0, 1]) < 0.08


def test_batch_becomes_poses_and_surface_perturbations(paper_lens):
    batch = sample_perturbations(study_of(pivot_z_mm=4.5), range(4))
    tilt, radius, conic = batch.values.T
    assert batch.poses().tilt_x_deg.tolist() == tilt.tolist()
    assert batch.poses().pivot_z_mm == 4.5
    surfaces = batch.surface_perturbations(paper_lens, 0.532)
    assert list(surfaces) == [1]
    assert surfaces[1].conic.tolist() == conic.tolist()
    system = batch.states(paper_lens, 0.532)[3]
    assert system.pose == Pose(tilt_x_deg=float(tilt[3]), pivot_z_mm=4.5)
    assert system.surface_perturbations == {
        1: SurfacePerturbation(radius_mm=float(radius[3]), conic=float(conic[3]))
    }
    assert system.wavelength_um == 0.532
    assert np.array_equal(np.vstack([s.values for s in batch.single_trials()]), batch.values)


@pytest.mark.parametrize("name", LENS_PARAMETERS)
def test_every_parameter_of_the_lens_reaches_its_place(paper_lens, name):
    (system,) = one("lens", name, 0.25).states(paper_lens, 0.532)
    assert system.pose == Pose(**{name: 0.25})


@pytest.mark.parametrize("name", SURFACE_DELTAS)
def test_every_delta_of_a_surface_reaches_its_place(paper_lens, name):
    (system,) = one("surface 1", name, 0.25).states(paper_lens, 0.532)
    assert system.surface_perturbations == {0: SurfacePerturbation(**{name: 0.25})}


def test_parameters_of_a_biconic_reach_its_rays(paper_lens):
    lens = paper_lens.with_surface(1, shape_type="biconic", radius_x_mm=-14.0, conic_x=-1.2)
    designed = lens.with_surface(1, radius_x_mm=-14.0 * 1.01, conic_x=-1.1)
    batch = PerturbationBatch(
        (
            PerturbedParameter(target="surface 2", parameter="radius_x_percent"),
            PerturbedParameter(target="surface 2", parameter="conic_x"),
        ),
        np.array([[0.0, 0.0], [1.0, 0.1]]),
    )
    points = np.array([[2.0, 3.0, -5.0]]), np.array([[0.1, -0.05, 1.0]]) / np.sqrt(1.0125)
    moved = trace(lens, *points, 0.532, surface_perturbations=batch.surface_perturbations(lens, 0.532))
    for k, expected in enumerate((lens, designed)):
        alone = trace(expected, *points, 0.532)
        assert moved.position[k] == pytest.approx(alone.position, abs=1e-12)
        assert moved.opl[k] == pytest.approx(alone.opl, abs=1e-12)
    single = batch.states(lens, 0.532)[1].surface_perturbations[1]
    assert single.shape == pytest.approx({"radius_x_mm": -0.14, "conic_x": 0.1})


def test_object_sensor_and_light_reach_their_places(paper_lens):
    def system(target, name):
        return one(target, name, 0.25).states(paper_lens, 0.532)[0]

    assert system("object", "working_distance_mm").object_shift_mm == (0.0, 0.0, -0.25)
    assert system("object", "decenter_y_mm").object_shift_mm == (0.0, 0.25, 0.0)
    assert system("sensor", "distance_mm").sensor_shift_mm == (0.0, 0.0, 0.25)
    assert system("sensor", "plane_distance_2_mm").sensor_shift_mm == (0.0, 0.0, 0.125)
    assert system("sensor", "decenter_x_mm").sensor_shift_mm == (0.25, 0.0, 0.0)
    assert system("sensor", "tilt_y_deg").sensor_tilt_deg == (0.0, 0.25)
    distances = one("sensor", "plane_distance_2_mm", 0.25, -0.5).plane_distances_mm(paper_lens)
    assert distances.tolist() == [[0.0, 0.25], [0.0, -0.5]]


def test_two_perturbations_of_one_parameter_add_up():
    twice = PerturbedParameter(target="lens", parameter="decenter_x_mm")
    batch = PerturbationBatch((twice, twice), np.array([[0.1, 0.2], [1.0, -1.0]]))
    assert batch.poses().decenter_x_mm.tolist() == pytest.approx([0.3, 0.0])


def test_ways_of_giving_a_radius_agree(paper_lens):
    surface, height = paper_lens.surfaces[1], 1.0
    fringes = one("surface 2", "radius_fringes", 0.01).surface_perturbations(paper_lens, 0.532)[1]
    percent = one("surface 2", "radius_percent", 2.0).surface_perturbations(paper_lens, 0.532)[1]
    assert percent.radius_mm.tolist() == pytest.approx([-0.24])
    # Within the paraxial region one fringe over a semi-diameter h is half a wave of sag at h.
    small = paper_lens.with_surface(1, semi_diameter_mm=height)
    (small_fringes,) = (
        one("surface 2", "radius_fringes", 0.01).surface_perturbations(small, 0.532)[1].radius_mm
    )
    sags = [
        float(Surface(radius_mm=radius, conic=surface.conic).sag_mm(height))
        for radius in (surface.radius_mm, surface.radius_mm + small_fringes)
    ]
    assert sags[1] - sags[0] == pytest.approx(0.01 * 0.5 * 632.8e-6, rel=0.02)
    assert fringes.radius_mm[0] == pytest.approx(small_fringes / surface.semi_diameter_mm**2)
    assert abs(surface.radius_mm + fringes.radius_mm[0]) > abs(surface.radius_mm)


def test_wavelength_and_dispersion_change_indices(paper_lens):
    before, after = (paper_lens.indices(w)[1] for w in (0.532, 0.54))
    shifted = one("light", "wavelength_um", 0.008, 0.0)
    change = shifted.surface_perturbations(paper_lens, 0.532)[0].index
    assert change.tolist() == pytest.approx([after - before, 0.0], abs=1e-15)
    at_d = paper_lens.indices(0.5875618)[1]
    flatter = one("surface 1", "abbe_percent", 25.0).surface_perturbations(paper_lens, 0.532)[0].index
    assert flatter[0] == pytest.approx((before - at_d) * (1.0 / 1.25 - 1.0))
    at_d_itself = one("surface 1", "abbe_percent", 25.0).surface_perturbations(paper_lens, 0.5875618)
    assert at_d_itself[0].index[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("quantity", ["pv", "rms"])
def test_irregularities_have_the_size_that_was_drawn(paper_lens, quantity):
    parameter = PerturbedParameter(target="surface 2", parameter=f"irregularity_{quantity}_waves")
    values = np.array([[0.25], [-0.5], [0.0]])
    batch = batch_of((parameter,), values, 0.0, seed=3, trial_numbers=range(3))
    figure = batch.surface_perturbations(paper_lens, 0.532)[1].figure
    for trial, value in enumerate(values[:, 0]):
        pv, rms = pv_rms_waves(figure.trial(trial), paper_lens.surfaces[1].semi_diameter_mm, "power")
        assert (pv if quantity == "pv" else rms) == pytest.approx(abs(value), rel=0.01, abs=1e-12)
    alone = batch_of((parameter,), values[1:2], 0.0, seed=3, trial_numbers=[1])
    own = alone.surface_perturbations(paper_lens, 0.532)[1].figure
    assert np.array_equal(own.coefficients[0], figure.coefficients[1])


def test_figures_of_one_surface_add_up(paper_lens):
    parameter = PerturbedParameter(target="surface 2", parameter="irregularity_rms_waves")
    both = batch_of((parameter, parameter), np.array([[0.1, 0.2]]), 0.0, seed=3, trial_numbers=[0])
    parts = [both.shapes[0], both.shapes[1]]
    assert not np.array_equal(*parts)
    total = both.surface_perturbations(paper_lens, 0.532)[1].figure.coefficients
    first = PerturbationBatch((parameter,), np.array([[0.1]]), 0.0, {0: parts[0]})
    second = PerturbationBatch((parameter,), np.array([[0.2]]), 0.0, {0: parts[1]})
    singles = [b.surface_perturbations(paper_lens, 0.532)[1].figure.coefficients for b in (first, second)]
    assert total == pytest.approx(singles[0] + singles[1], abs=1e-15)


def test_a_sensor_that_moves_is_a_lens_and_object_that_move_the_other_way(paper_lens):
    pupil = pupil_rings(2, 6, edge=True).points
    shift = one("sensor", "distance_mm", 0.7)
    sensor = arriving_rays(paper_lens, shift, ((0.0, 1.0),), pupil, 0.532)
    both = PerturbationBatch(
        (
            PerturbedParameter(target="lens", parameter="despace_mm"),
            PerturbedParameter(target="object", parameter="working_distance_mm"),
        ),
        np.array([[-0.7, 0.7]]),
    )
    lens = arriving_rays(paper_lens, both, ((0.0, 1.0),), pupil, 0.532)
    assert sensor.position_mm == pytest.approx(lens.position_mm, abs=1e-12)
    assert sensor.direction == pytest.approx(lens.direction, abs=1e-12)


def test_a_tilted_sensor_sees_rays_from_its_own_normal(paper_lens):
    pupil = pupil_rings(2, 6, edge=True).points
    tilted = arriving_rays(paper_lens, one("sensor", "tilt_y_deg", 0.0, 1.5), ((0.0, 0.0),), pupil, 0.532)
    flat, turned = tilted.direction
    angle = np.deg2rad(1.5)
    # The normal of a sensor turned right-handed about y leans towards +x.
    expected = np.cos(angle) * flat[:, 0] - np.sin(angle) * flat[:, 2]
    assert turned[:, 0] == pytest.approx(expected, abs=1e-12)
    # A ray through the middle of the sensor meets it where it did.
    assert np.abs(tilted.position_mm[1] - tilted.position_mm[0]).max() < 0.05
