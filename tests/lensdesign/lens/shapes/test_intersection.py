"""Rays that meet a conic, or miss it, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.intersection import intersect

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
