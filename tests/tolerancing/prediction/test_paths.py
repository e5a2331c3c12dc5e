"""Derivatives of optical paths, held against paths that are made stationary by brute force."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import DESIGNS

from lensdesign import Lens, load_design
from lensdesign.raytrace.bundles import PupilSamples
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.derivatives import nominal_paths
from tolerancing.prediction.motions import pair_weights, second_by_pairs
from tolerancing.prediction.paths import ParameterLayout, Paths
from tolerancing.prediction.system import _SystemParameters, amounts_of, changes_of

PARAMETERS = [
    ("lens", "decenter_x_mm", 0.02),
    ("lens", "tilt_x_deg", 0.2),
    ("surface 2", "tilt_y_deg", 0.1),
    ("surface 1", "radius_mm", 0.1),
    ("surface 2", "conic", 0.01),
    ("surface 1", "thickness_mm", 0.05),
    ("surface 1", "index", 0.001),
    ("object", "working_distance_mm", 0.05),
    ("object", "decenter_y_mm", 0.01),
    ("sensor", "tilt_x_deg", 0.2),
    ("light", "wavelength_um", 0.001),
]
POINTS = PupilSamples(np.array([[0.0, 0.0], [0.9, 0.1], [-0.3, -0.7]]), np.full(3, 1.0 / 3.0))


def parameters() -> list[PerturbedParameter]:
    return [PerturbedParameter(target=target, parameter=name) for target, name, _ in PARAMETERS]


@pytest.fixture(scope="module")
def paths(lens: Lens) -> Paths:
    return nominal_paths(lens, [(0.3, 1.0)], POINTS, 0.532, 3.0)


def shortest(lens: Lens, paths: Paths, values: np.ndarray) -> np.ndarray:
    """Stationary paths of each ray through the perturbed lens, from its numbers alone."""
    numbers = _SystemParameters(lens, parameters(), 0.0, 0.532).at(values[None])[0]
    found = []
    for ray in range(len(paths.objects_mm)):

        def path(w: np.ndarray, ray: int = ray) -> Any:
            return _path(paths, numbers, ray, w)

        def slope(w: np.ndarray, ray: int = ray) -> np.ndarray:
            step = 1e-30j
            return np.array(
                [_path(paths, numbers, ray, w + step * axis).imag / 1e-30 for axis in np.eye(len(w))]
            )

        w = paths.heights_mm[ray].ravel().copy()
        for _ in range(6):  # a root of the slope, which need not be a minimum
            hessian = np.array([(slope(w + 1e-5 * a) - slope(w - 1e-5 * a)) / 2e-5 for a in np.eye(len(w))])
            w = w - np.linalg.solve(hessian, slope(w))
        assert np.max(np.abs(slope(w))) < 1e-10
        found.append(path(w))
    return np.array(found)


def _path(paths: Paths, numbers: np.ndarray, ray: int, w: np.ndarray) -> Any:
    """Optical path over points on the surfaces of a perturbed lens."""
    layout = paths.layout
    points = [paths.objects_mm[ray] + numbers[layout.pose(0)][9:]]
    for k, shape in enumerate(paths.shapes):
        x, y = w[2 * k], w[2 * k + 1]
        sag = type(shape).sag_and_gradient(numbers[layout.of_shape(k)], x, y)[0]
        points.append(_placed(numbers[layout.pose(k + 1)], np.array([x, y, sag])))
    flat = np.array([*paths.sensors_mm[ray, :2], 0.0])
    sensor = _placed(numbers[layout.pose(layout.surfaces + 1)], flat)
    points.append(sensor + np.array([0.0, 0.0, paths.sensors_mm[ray, 2]]))
    steps = np.diff(np.array(points), axis=0)
    lengths = np.sqrt(np.sum(steps * steps, axis=1))
    return numbers[layout.waves] * np.sum(numbers[layout.indices] * lengths)


def by_both(pairs: np.ndarray, d: int) -> np.ndarray:
    """Symmetric matrices from their upper triangles."""
    i, j = np.triu_indices(d)
    found = np.zeros((len(pairs), d, d))
    found[:, i, j] = found[:, j, i] = pairs
    return found


def _placed(pose: np.ndarray, own: np.ndarray) -> np.ndarray:
    return np.asarray(pose[:9].reshape(3, 3) @ own + pose[9:])


def test_paths_of_the_nominal_lens_are_stationary(lens: Lens, paths: Paths) -> None:
    np.testing.assert_allclose(shortest(lens, paths, np.zeros(len(PARAMETERS))), paths.path_mm, atol=1e-12)


@settings(max_examples=15, deadline=None)
@given(shares=st.lists(st.floats(-1.0, 1.0), min_size=len(PARAMETERS), max_size=len(PARAMETERS)))
def test_two_orders_leave_the_third(lens: Lens, paths: Paths, shares: list[float]) -> None:
    """What they leave over falls with the cube of the perturbation."""
    sizes = np.array([size for *_, size in PARAMETERS])
    changes = changes_of(lens, parameters(), sizes, 0.0, 0.532)
    first = paths.by_parameters @ changes.first
    second = by_both(second_by_pairs(paths, pair_weights(changes)), len(PARAMETERS))
    left = []
    for part in (1.0, 0.5):
        values = part * np.array(shares) * sizes
        predicted = first @ values + 0.5 * np.einsum("nij,i,j->n", second, values, values)
        left.append(np.max(np.abs(shortest(lens, paths, values) - paths.path_mm - predicted)))
    assert left[0] < 2e-5
    assert left[1] <= left[0] / 6.0 + 1e-9


def test_a_thicker_plate_and_a_longer_wavelength_are_told_in_closed_form() -> None:
    """On the axis of a plate the path changes by n - 1 times the thickness that it gains."""
    lens = Lens.model_validate(
        {
            "wavelengths_um": [0.5],
            "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.3, "working_distance_mm": 10.0},
            "sensor": {"pixel_pitch_um": 3.0, "pixels": [1000, 1000], "plane_distances_mm": [5.0]},
            "surface": [{"thickness_mm": 2.0, "material": 1.6, "semi_diameter_mm": 4.0, "stop": True}, {}],
        }
    )
    axis = PupilSamples(np.zeros((1, 2)), np.ones(1))
    paths = nominal_paths(lens, [(0.0, 0.0)], axis, 0.5, 5.0)
    asked = [
        PerturbedParameter(target="surface 1", parameter="thickness_mm"),
        PerturbedParameter(target="surface 1", parameter="index"),
        PerturbedParameter(target="object", parameter="working_distance_mm"),
        PerturbedParameter(target="light", parameter="wavelength_um"),
    ]
    changes = changes_of(lens, asked, np.array([0.01, 0.001, 0.1, 0.001]), 0.0, 0.5)
    total = 10.0 + 1.6 * 2.0 + 5.0
    np.testing.assert_allclose(
        paths.by_parameters @ changes.first, [[0.6, 2.0, 1.0, -total / 0.5]], rtol=1e-6
    )
    second = by_both(second_by_pairs(paths, pair_weights(changes)), len(asked))[0]
    assert second[0, 1] == pytest.approx(1.0, rel=1e-6)
    assert second[2, 3] == pytest.approx(-1.0 / 0.5, rel=1e-6)
    assert second[3, 3] == pytest.approx(2.0 * total / 0.5**2, rel=1e-4)
    assert second[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_numbers_have_places_of_their_own() -> None:
    layout = ParameterLayout((2, 4))
    taken: list[int] = []
    for part in (
        *(layout.pose(k) for k in range(4)),
        *(layout.of_shape(k) for k in range(2)),
        layout.indices,
    ):
        taken += range(part.start, part.stop)
    assert [*taken, layout.waves] == list(range(layout.size))


def test_a_radius_bends_its_curvature() -> None:
    lens = load_design(DESIGNS / "paper_singlet.toml")
    radius = lens.surfaces[0].radius_mm
    assert radius is not None
    asked = [PerturbedParameter(target="surface 1", parameter="radius_mm")]
    changes = changes_of(lens, asked, np.array([0.01]), 0.0, 0.532)
    place = changes.layout.of_shape(0).start
    assert changes.first[place, 0] == pytest.approx(-1.0 / radius**2, rel=1e-6)
    assert changes.second[0, place] == pytest.approx(2.0 / radius**3, rel=1e-4)


def test_amounts_of_irregularities_are_those_of_their_figures() -> None:
    lens = load_design(DESIGNS / "paper_singlet.toml")
    asked = [
        PerturbedParameter(target="surface 1", parameter="irregularity_pv_waves"),
        PerturbedParameter(target="surface 1", parameter="conic"),
    ]
    changes = changes_of(lens, asked, np.array([0.1, 0.01]), 0.0, 0.532)
    shapes = np.zeros((2, 11))
    shapes[:, 1] = 1.0
    batch = PerturbationBatch(tuple(asked), np.array([[0.3, 0.01], [0.6, 0.0]]), 0.0, {0: shapes})
    amounts = amounts_of(batch)
    assert changes.count == 12
    np.testing.assert_allclose(amounts[:, -1], [0.01, 0.0])
    np.testing.assert_allclose(amounts[1, :11], 2.0 * amounts[0, :11])
    assert amounts[0, 1] > 0.0
    assert not np.any(np.delete(amounts[0, :11], 1))
