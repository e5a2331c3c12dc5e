"""Rays that meet a conic, or miss it, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.even_asphere import EvenAsphere
from lensdesign.lens.shapes.intersection import intersect
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
