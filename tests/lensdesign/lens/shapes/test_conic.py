"""Conics against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign import Surface
from lensdesign.lens.shapes.conic import Conic

R = np.linspace(0.0, 5.0, 21)


def conic(curvature: float, constant: float) -> Conic:
    return Conic(np.array([curvature, constant]))


def test_sag_of_a_sphere_is_that_of_a_circle() -> None:
    assert np.allclose(conic(1 / 8.0, 0.0).sag(R, 0.0), 8.0 - np.sqrt(64.0 - R**2), rtol=1e-14)
    assert np.allclose(conic(-1 / 8.0, 0.0).sag(0.0, R), np.sqrt(64.0 - R**2) - 8.0, rtol=1e-14)


def test_sag_of_a_paraboloid_is_exact() -> None:
    assert np.allclose(conic(1 / 8.0, -1.0).sag(0.6 * R, 0.8 * R), R**2 / 16.0, rtol=1e-15)


@pytest.mark.parametrize("constant", [-2.3, -0.5, 0.7])
def test_points_of_a_conic_satisfy_its_equation(constant: float) -> None:
    z = conic(0.11, constant).sag(R, 0.0)
    assert np.allclose(R**2 - 2.0 * z / 0.11 + (1.0 + constant) * z**2, 0.0, atol=1e-12)


def test_a_plane_has_no_sag() -> None:
    assert np.all(conic(0.0, 3.0).sag(R, 0.0) == 0.0)


def test_sag_ends_at_the_edge_of_the_conic() -> None:
    ellipsoid = conic(0.1, 0.5)
    edge = ellipsoid.edge_radius_mm
    assert edge == pytest.approx(10.0 / math.sqrt(1.5))
    assert np.isfinite(ellipsoid.sag(0.999 * edge, 0.0))
    assert np.isnan(ellipsoid.sag(1.001 * edge, 0.0))
    assert conic(0.1, -1.0).edge_radius_mm == math.inf
    assert conic(0.0, 2.0).edge_radius_mm == math.inf


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({}, "plane"),
        ({"conic": -1.0, "asphere": (0.0,)}, "plane"),
        ({"radius_mm": 10.0}, "sphere"),
        ({"radius_mm": 10.0, "conic": -1.0, "asphere": (0.0, 0.0)}, "conic"),
        ({"asphere": (1e-5,)}, "even asphere"),
    ],
)
def test_shapes_go_by_their_simplest_name(values: dict, name: str) -> None:
    assert Surface(**values).kind == name
