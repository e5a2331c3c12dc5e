"""Compensators beside perturbations: what one takes of the other."""

from __future__ import annotations

import numpy as np
import pytest
from places import DESIGNS
from scipy.optimize import lsq_linear

from lensdesign import load_design
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.compensation import Compensation, bounded_least_squares, less_model
from tolerancing.prediction.derivatives import FieldDifferentials, differentials

SIZES = np.array([0.01, 0.05])


@pytest.fixture(scope="module")
def field() -> FieldDifferentials:
    lens = load_design(DESIGNS / "paper_singlet.toml")
    moved = [PerturbedParameter(target="lens", parameter=name) for name in ("decenter_x_mm", "tilt_y_deg")]
    return differentials(lens, moved, SIZES, [(0.0, 1.0)]).fields[0]


def test_a_compensator_undoes_what_it_is_itself(field: FieldDifferentials) -> None:
    compensation = Compensation(5.0 * SIZES, (field,), (field,))
    amounts = SIZES * np.random.default_rng(0).normal(size=(20, 2))
    values = compensation.values(amounts)
    np.testing.assert_allclose(values, amounts, atol=1e-3 * SIZES[0])
    left = less_model(field, field).waves(np.concatenate([amounts, values], axis=1))
    assert np.max(np.abs(left)) < 1e-3 * np.max(np.abs(field.waves(amounts)))
    np.testing.assert_allclose(compensation.following(2)[2:], np.eye(2), atol=1e-2)


def test_it_ends_at_its_limit(field: FieldDifferentials) -> None:
    compensation = Compensation(0.1 * SIZES, (field,), (field,))
    values = compensation.values(np.array([SIZES, -SIZES]))
    np.testing.assert_allclose(values, [0.1 * SIZES, -0.1 * SIZES])


def test_without_compensators_nothing_is_taken(field: FieldDifferentials) -> None:
    none = Compensation(np.zeros(0), (), ())
    assert none.values(np.ones((3, 2))).shape == (3, 0)
    np.testing.assert_array_equal(none.following(2), np.eye(2))


def test_bounded_values_are_those_of_an_established_solver() -> None:
    generator = np.random.default_rng(0)
    for count in (1, 2, 5):
        root = generator.normal(size=(2 * count, count))
        matrix = root.T @ root + 3.0 * np.ones((count, count))
        wanted = generator.normal(scale=2.0 * np.trace(matrix) / count, size=(60, count))
        values, free = bounded_least_squares(matrix, wanted)
        triangle = np.linalg.cholesky(matrix)
        for own, goal in zip(values, wanted, strict=True):
            known = lsq_linear(triangle.T, np.linalg.solve(triangle, goal), (-1.0, 1.0), method="bvls")
            np.testing.assert_allclose(own, known.x, atol=1e-9)
        np.testing.assert_array_equal(free, np.abs(values) < 1.0)
        assert 0.1 < np.mean(free) < 0.9
