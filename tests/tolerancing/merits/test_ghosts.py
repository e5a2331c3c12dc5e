"""Merit of ghosts: the nominal score is that of the analysis, and a perturbed one that of another design."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Coating, CoatingLayer, CoverGlass, save_design
from lensdesign.analysis import GhostSampling, ghost_paths
from tolerancing import load_study, run_study
from tolerancing.merits import Context, GhostFraction, Sampling
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.store.store import open_store

MERIT = GhostFraction(kind="ghost_fraction", at_most=0.03)


@pytest.fixture(scope="module")
def lens(paper_lens):
    glass = CoverGlass(thickness_mm=0.7, material=1.52, distance_mm=0.5, coating="bare")
    sensor = paper_lens.sensor.replaced(cover_glass=glass, reflectance=0.05)
    bare = tuple(surface.replaced(coating="bare") for surface in paper_lens.surfaces)
    return paper_lens.replaced(surfaces=bare, sensor=sensor)


def scores(lens, targets, values):
    parameters = tuple(PerturbedParameter(target=target, parameter=name) for target, name in targets)
    context = Context(lens, Sampling())
    return MERIT.scores(context, context.perturbed(parameters, np.array(values)))


def total(lens):
    return ghost_paths(lens, sampling=GhostSampling(directions=600)).total()


def with_lengths(lens, working_distance_mm=0.0, planes_mm=0.0):
    sensor, scene = lens.sensor, lens.object
    return lens.replaced(
        object=scene.replaced(working_distance_mm=scene.working_distance_mm + working_distance_mm),
        sensor=sensor.replaced(plane_distances_mm=tuple(z + planes_mm for z in sensor.plane_distances_mm)),
    )


def test_the_nominal_score_is_that_of_the_analysis(lens):
    nominal = scores(lens, [("lens", "decenter_x_mm")], [[0.0]])
    assert nominal == pytest.approx(total(lens), rel=1e-9)
    assert nominal == pytest.approx(ghost_paths(lens).total(), rel=0.01)


def test_perturbed_distances_are_those_of_another_design(lens):
    targets = [
        ("object", "working_distance_mm"),
        ("sensor", "distance_mm"),
        ("sensor", "plane_distance_1_mm"),
        ("lens", "despace_mm"),
    ]
    found = scores(
        lens,
        targets,
        [[0.3, 0.0, 0.0, 0.0], [0.0, 0.3, 0.0, 0.0], [0.0, 0.0, 0.3, 0.0], [0.0, 0.0, 0.0, 0.3]],
    )
    farther = total(with_lengths(lens, planes_mm=0.3))  # the nearest plane has the largest total
    expected = [
        total(with_lengths(lens, working_distance_mm=0.3)),
        farther,
        farther,
        total(with_lengths(lens, working_distance_mm=0.3, planes_mm=-0.3)),
    ]
    assert found == pytest.approx(expected, rel=1e-6)


def test_a_shift_of_the_object_is_the_opposite_one_of_lens_and_sensor(lens):
    targets = [("object", "decenter_y_mm"), ("lens", "decenter_y_mm"), ("sensor", "decenter_y_mm")]
    found = scores(lens, targets, [[0.4, 0.0, 0.0], [0.0, -0.4, -0.4], [0.0, -0.4, 0.0]])
    assert found[0] == pytest.approx(found[1], rel=1e-12)
    assert found[2] != found[1]


def test_errors_of_radii_and_films_count(lens):
    film = Coating(layers=(CoatingLayer(index=1.38, thickness_nm=96.4),))
    coated = lens.with_surface(0, coating=film).with_surface(1, coating=film)
    bent = lens.with_surface(1, radius_mm=-12.2)
    assert scores(lens, [("surface 2", "radius_mm")], [[-0.2]]) == pytest.approx(total(bent), rel=1e-6)
    thicker = coated.with_surface(
        0, coating=Coating(layers=(CoatingLayer(index=1.38, thickness_nm=1.2 * 96.4),))
    )
    found = scores(coated, [("surface 1", "coating_thickness_percent")], [[20.0]])
    assert found == pytest.approx(total(thicker), rel=1e-9)


def test_a_study_of_ghosts_runs(tmp_path, lens):
    save_design(lens, tmp_path / "lens.toml")
    path = tmp_path / "study.toml"
    path.write_text(
        """
design = "lens.toml"
trials = 4
seed = 3
sensitivity = false

[[perturbation]]
target = "sensor"
parameter = "tilt_x_deg"
distribution = "uniform"
half_width = 0.5

[[merit]]
kind = "ghost_fraction"
at_most = 0.03
"""
    )
    run_study(load_study(path), tmp_path / "store", workers=1)
    with open_store(tmp_path / "store") as store:
        found = store.trials().scores[:, 0]
    assert found == pytest.approx(total(lens), rel=0.05)
    assert len(set(found)) == 4
