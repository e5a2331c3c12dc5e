"""Rays that meet a conic, or miss it, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.optimize
from hypothesis import assume, given
from hypothesis import strategies as st

from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.even_asphere import EvenAsphere
from lensdesign.lens.shapes.intersection import Array, intersect
from lensdesign.lens.shapes.registry import code_of, needed_formulas
from lensdesign.raytrace.conic_kernel import conic_distance
from lensdesign.raytrace.kernel import newton
from lensdesign.raytrace.status import Status

AHEAD = np.array([[0.0, 0.0, 1.0]])


def conic(curvature: float, constant: float = 0.0) -> Conic:
    return Conic(np.array([curvature, constant]))


def test_intersection_is_the_one_nearest_the_vertex() -> None:
    position = np.array([[0.0, 1.0, -30.0]])
    distance, hit, _ = intersect(position, AHEAD, conic(0.1))
    assert hit[0]
    assert distance[0] == pytest.approx(40.0 - math.sqrt(99.0), abs=1e-12)
    distance, hit, _ = intersect(position, AHEAD, conic(-0.1))
    assert hit[0]
    assert distance[0] == pytest.approx(20.0 + math.sqrt(99.0), abs=1e-12)


def test_intersection_stays_exact_as_the_curvature_vanishes() -> None:
    position, direction = np.array([[1.0, 2.0, -5.0]]), np.array([[0.6, 0.0, 0.8]])
    for curvature in (0.0, 1e-18, 1e-12, -1e-12):
        distance, hit, _ = intersect(position, direction, conic(curvature, 0.3))
        assert hit[0]
        assert distance[0] == pytest.approx(6.25, abs=1e-9)


def test_rays_beside_a_sphere_and_behind_a_conics_edge_miss() -> None:
    for height in (10.5, 30.0):
        assert not intersect(np.array([[0.0, height, -30.0]]), AHEAD, conic(0.1))[1][0]
    sideways = np.array([[0.0, 1.0, 0.0]])
    assert not intersect(np.array([[0.0, -30.0, 15.0]]), sideways, conic(0.1))[1][0]
    assert not intersect(np.array([[0.0, 0.0, -1.0]]), sideways, conic(0.0))[1][0]


def test_a_ray_that_grazes_a_distant_asphere_reaches_it() -> None:
    """Rounding keeps its Newton steps above 1e-14 of the path, although the point lies on the surface."""
    origin = [358.03130629520695, -3.0377432551279684, 185.7505611768551]
    direction = [-0.885571622257178, 0.010837815430764498, -0.4643764029421377]
    terms = np.array([1.0 / 20.0, 0.3, 1e-4, 1e-6])
    shape = EvenAsphere(terms)
    distance, hit, converged = intersect(np.array([origin]), np.array([direction]), shape)
    assert hit[0]
    assert converged[0]
    x, y, z = np.array(origin) + distance[0] * np.array(direction)
    assert z == pytest.approx(shape.sag_and_slopes(x, y)[0], abs=1e-10)
    start, _ = conic_distance(*origin, *direction, *terms[:2])
    code = code_of(shape)
    formulas = needed_formulas(bytes([code]), len(terms))
    compiled, status = newton(*origin, *direction, start, formulas, code, terms)
    assert status == Status.OK
    assert compiled == pytest.approx(distance[0], abs=1e-9)


def test_newton_ends_when_its_next_step_would_be_rounding() -> None:
    """A ray through a figure of 100 nm needs two or three evaluations, and the derivative one more."""
    calls = 0

    def ripple(x: Array, y: Array) -> tuple[Array, Array, Array]:
        nonlocal calls
        calls += 1
        return 1e-4 * np.sin(3.0 * x), 3e-4 * np.cos(3.0 * x), 0.0 * y

    position, direction = np.array([[1.0, 0.5, -20.0]]), np.array([[0.1, -0.05, math.sqrt(1.0 - 0.0125)]])
    distance, hit, converged = intersect(position, direction, conic(0.1), ripple)
    assert hit[0]
    assert converged[0]
    assert calls <= 4
    x, y, z = position[0] + distance[0] * direction[0]
    assert z == pytest.approx(conic(0.1).sag_and_slopes(x, y)[0] + 1e-4 * math.sin(3.0 * x), abs=1e-14)


@pytest.mark.parametrize("depth_mm", [1e-4, 1e-9, 1e-14])
def test_newton_does_not_end_early_where_two_roots_nearly_meet(depth_mm: float) -> None:
    """Its steps halve there before they shrink quadratically: a ray nearly touches 0.01 r^4 at r = 1 mm."""
    shape = EvenAsphere(np.array([0.0, 0.0, 0.01]))
    direction = np.array([0.0, 1.0, 0.04]) / math.hypot(1.0, 0.04)
    origin = np.array([0.0, 0.0, -0.03 + depth_mm])

    def height(y: float) -> float:
        return -0.03 + depth_mm + 0.04 * y - 0.01 * y**4

    expected = scipy.optimize.brentq(height, 0.7, 1.0, xtol=1e-15, rtol=1e-15) / direction[1]
    # Rounding of the point, over the slope at which the ray meets the surface.
    uncertainty = 1e-15 / (0.04 * (1.0 - (expected * direction[1]) ** 3))
    distance, hit, converged = intersect(origin[None], direction[None], shape)
    assert hit[0]
    assert converged[0]
    assert distance[0] == pytest.approx(expected, abs=uncertainty)
    start, _ = conic_distance(*origin, *direction, *shape.terms[:2])
    assert abs(start - expected) > 0.1
    code = code_of(shape)
    formulas = needed_formulas(bytes([code]), len(shape.terms))
    compiled, status = newton(*origin, *direction, start, formulas, code, shape.terms)
    assert status == Status.OK
    assert compiled == pytest.approx(expected, abs=uncertainty)


@given(
    bits=st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8),
    term=st.sampled_from([0.0, 1e-5, 1e-3, 0.1]),
)
def test_both_tracers_give_a_ray_one_status_and_one_distance(bits: list[float], term: float) -> None:
    """Rays from everywhere in every direction at a strong asphere, many of which graze or miss it."""
    origin = 15.0 * np.array(bits[:3]) - np.array([0.0, 0.0, 10.0])
    direction = np.array(bits[3:6]) + np.array([0.0, 0.0, 1e-3])
    assume(np.linalg.norm(direction) > 1e-2)
    direction /= np.linalg.norm(direction)
    shape = EvenAsphere(np.array([0.15 * bits[6], bits[7], term]))
    start, met = conic_distance(*origin, *direction, *shape.terms[:2])
    assume(met)
    with np.errstate(over="ignore"):
        distance, hit, converged = intersect(origin[None], direction[None], shape)
    code = code_of(shape)
    formulas = needed_formulas(bytes([code]), len(shape.terms))
    compiled, status = newton(*origin, *direction, start, formulas, code, shape.terms)
    assert (status == Status.OK) == (hit[0] and converged[0])
    if status == Status.OK:
        assert compiled == pytest.approx(distance[0], rel=1e-9, abs=1e-9)
