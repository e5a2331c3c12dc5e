"""Sag, slope, normal and intersection against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_lenses import numbers, signed

from lensdesign.lens import shapes

R = np.linspace(0.0, 5.0, 21)


def test_sag_of_a_sphere_is_that_of_a_circle() -> None:
    assert np.allclose(shapes.sag(R**2, 1 / 8.0, 0.0), 8.0 - np.sqrt(64.0 - R**2), rtol=1e-14)
    assert np.allclose(shapes.sag(R**2, -1 / 8.0, 0.0), np.sqrt(64.0 - R**2) - 8.0, rtol=1e-14)


def test_sag_of_a_paraboloid_is_exact() -> None:
    assert np.allclose(shapes.sag(R**2, 1 / 8.0, -1.0), R**2 / 16.0, rtol=1e-15)


@pytest.mark.parametrize("conic", [-2.3, -0.5, 0.7])
def test_points_of_a_conic_satisfy_its_equation(conic: float) -> None:
    z = shapes.sag(R**2, 0.11, conic)
    assert np.allclose(R**2 - 2.0 * z / 0.11 + (1.0 + conic) * z**2, 0.0, atol=1e-12)


def test_sag_of_a_plane_and_of_asphere_terms() -> None:
    assert np.all(shapes.sag(R**2, 0.0, 3.0) == 0.0)
    assert np.allclose(shapes.sag(R**2, 0.0, 0.0, (1e-3, 2e-5)), 1e-3 * R**4 + 2e-5 * R**6, rtol=1e-14)


def test_sag_ends_at_the_edge_of_the_conic() -> None:
    edge = shapes.edge_radius_mm(0.1, 0.5)
    assert edge == pytest.approx(10.0 / math.sqrt(1.5))
    assert np.isfinite(shapes.sag((0.999 * edge) ** 2, 0.1, 0.5))
    assert np.isnan(shapes.sag((1.001 * edge) ** 2, 0.1, 0.5))
    assert shapes.edge_radius_mm(0.1, -1.0) == math.inf
    assert shapes.edge_radius_mm(0.0, 2.0) == math.inf


@given(r=numbers(0.01, 4.0), curvature=signed(0.0, 0.1), conic=numbers(-3.0, 1.5), a=numbers(-1e-4, 1e-4))
def test_slope_is_the_derivative_of_the_sag(r: float, curvature: float, conic: float, a: float) -> None:
    h = 1e-30
    step = shapes.sag(np.square(r + 1j * h), curvature, conic, (a, 0.1 * a)).imag / h
    assert shapes.sag_slope(r, curvature, conic, (a, 0.1 * a)) == pytest.approx(float(step), abs=1e-13)


@given(curvature=signed(1e-3, 0.1), conic=numbers(-3.0, 1.5), angle=numbers(0.0, 6.3), r=numbers(0.0, 4.0))
def test_normal_is_a_unit_vector_square_to_the_surface(
    curvature: float, conic: float, angle: float, r: float
) -> None:
    x, y = np.array([r * math.cos(angle)]), np.array([r * math.sin(angle)])
    normal = shapes.normal(x, y, curvature, conic, (1e-4,))[0]
    slope = float(shapes.sag_slope(r, curvature, conic, (1e-4,)))
    radial = np.array([math.cos(angle), math.sin(angle), slope])
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-15)
    assert normal @ radial == pytest.approx(0.0, abs=1e-14)
    assert normal[2] > 0.0


@given(
    curvature=signed(0.0, 0.1),
    conic=numbers(-3.0, 1.5),
    terms=st.lists(numbers(-1e-5, 1e-5), max_size=2),
    seed=st.integers(0, 2**32 - 1),
)
def test_intersections_lie_on_the_surface(
    curvature: float, conic: float, terms: list[float], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    position = np.column_stack([rng.uniform(-2, 2, (50, 2)), np.full(50, -10.0)])
    direction = rng.normal(size=(50, 3)) * [0.1, 0.1, 0.0] + [0.0, 0.0, 1.0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance, hit, converged = shapes.intersect(position, direction, curvature, conic, tuple(terms))
    point = (position + distance[:, None] * direction)[hit & converged]
    sag = shapes.sag(point[:, 0] ** 2 + point[:, 1] ** 2, curvature, conic, tuple(terms))
    assert np.count_nonzero(hit & converged) > 25
    assert np.max(np.abs(point[:, 2] - sag)) < 1e-12


def test_intersection_is_the_one_nearest_the_vertex() -> None:
    position, direction = np.array([[0.0, 1.0, -30.0]]), np.array([[0.0, 0.0, 1.0]])
    distance, hit, _ = shapes.intersect(position, direction, 0.1, 0.0)
    assert hit[0]
    assert distance[0] == pytest.approx(40.0 - math.sqrt(99.0), abs=1e-12)
    distance, hit, _ = shapes.intersect(position, direction, -0.1, 0.0)
    assert hit[0]
    assert distance[0] == pytest.approx(20.0 + math.sqrt(99.0), abs=1e-12)


def test_intersection_stays_exact_as_the_curvature_vanishes() -> None:
    position, direction = np.array([[1.0, 2.0, -5.0]]), np.array([[0.6, 0.0, 0.8]])
    for curvature in (0.0, 1e-18, 1e-12, -1e-12):
        distance, hit, _ = shapes.intersect(position, direction, curvature, 0.3)
        assert hit[0]
        assert distance[0] == pytest.approx(6.25, abs=1e-9)


def test_rays_beside_a_sphere_and_behind_a_conics_edge_miss() -> None:
    direction = np.array([[0.0, 0.0, 1.0]])
    for height in (10.5, 30.0):
        assert not shapes.intersect(np.array([[0.0, height, -30.0]]), direction, 0.1, 0.0)[1][0]
    sideways = np.array([[0.0, 1.0, 0.0]])
    assert not shapes.intersect(np.array([[0.0, -30.0, 15.0]]), sideways, 0.1, 0.0)[1][0]
    assert not shapes.intersect(np.array([[0.0, 0.0, -1.0]]), sideways, 0.0, 0.0)[1][0]


@pytest.mark.parametrize(
    ("shape", "name"),
    [
        ((0.0, 0.0, ()), "plane"),
        ((0.0, -1.0, (0.0,)), "plane"),
        ((0.1, 0.0, ()), "sphere"),
        ((0.1, -1.0, (0.0, 0.0)), "conic"),
        ((0.0, 0.0, (1e-5,)), "even asphere"),
    ],
)
def test_shapes_go_by_their_simplest_name(shape: tuple, name: str) -> None:
    assert shapes.surface_kind(*shape) == name
