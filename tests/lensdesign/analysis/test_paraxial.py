"""Cardinal points against the lensmaker's equation and against real rays near the axis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from random_lenses import lenses, numbers, signed

from lensdesign import Lens, ObjectSpace, Sensor, Surface
from lensdesign.analysis.paraxial import first_order
from lensdesign.raytrace.rays import trace


def singlet(r1: float | None, r2: float | None, thickness: float, n: float) -> Lens:
    """A singlet in air."""
    return Lens(
        wavelengths_um=(0.5,),
        object=ObjectSpace(field_diameter_mm=1.0, numerical_aperture=0.1, working_distance_mm=10.0),
        sensor=Sensor(pixel_pitch_um=3.2, pixels=(1000, 1000), plane_distances_mm=(3.0,)),
        surfaces=(
            Surface(radius_mm=r1, thickness_mm=thickness, material=n, semi_diameter_mm=0.1),
            Surface(radius_mm=r2),
        ),
    )


@given(r1=signed(5.0, 100.0), r2=signed(5.0, 100.0), t=numbers(0.1, 20.0), n=numbers(1.1, 2.5))
def test_singlets_obey_the_lensmakers_equation(r1: float, r2: float, t: float, n: float) -> None:
    power = (n - 1.0) * (1 / r1 - 1 / r2 + (n - 1.0) * t / (n * r1 * r2))
    assume(abs(power) > 1e-5)
    f, found = 1.0 / power, first_order(singlet(r1, r2, t, n))
    assert found.efl_mm == pytest.approx(f, rel=1e-9)
    assert found.bfl_mm == pytest.approx(f * (1.0 - (n - 1.0) * t / (n * r1)), rel=1e-8, abs=1e-8)
    assert found.ffl_mm == pytest.approx(-f * (1.0 + (n - 1.0) * t / (n * r2)), rel=1e-8, abs=1e-8)
    assert found.front_principal_z_mm == pytest.approx(-f * (n - 1.0) * t / (n * r2), rel=1e-8, abs=1e-8)
    assert found.rear_principal_z_mm == pytest.approx(t - f * (n - 1.0) * t / (n * r1), rel=1e-8, abs=1e-7)


def test_a_ball_lens_and_the_paper_lens(paper_lens: Lens) -> None:
    ball = first_order(singlet(5.0, -5.0, 10.0, 1.5))
    assert ball.efl_mm == pytest.approx(7.5)
    assert ball.bfl_mm == pytest.approx(2.5)
    assert (ball.front_principal_z_mm, ball.rear_principal_z_mm) == pytest.approx((5.0, 5.0))
    found = first_order(paper_lens)
    assert found.bfl_mm - found.efl_mm == pytest.approx(found.rear_principal_z_mm - 9.7)


@pytest.mark.parametrize("radius", [None, 10.0])
def test_an_afocal_lens_has_no_focus(radius: float | None) -> None:
    n, t = 1.5, 15.0
    second = None if radius is None else radius - (n - 1.0) * t / n
    found = first_order(singlet(radius, second, t, n))
    assert math.isinf(found.efl_mm) or abs(found.efl_mm) > 1e12


@settings(max_examples=60)
@given(lens=lenses())
def test_rays_near_the_axis_meet_in_the_focal_points(lens: Lens) -> None:
    """In air or a medium behind the lens."""
    found = first_order(lens, 0.6)
    assume(abs(found.efl_mm) < 1e3 and abs(found.bfl_mm) < 1e3)
    height = 1e-5
    rays = trace(lens, [[height, 0.0, -5.0]], [[0.0, 0.0, 1.0]], 0.6, clip=False)
    slope = rays.direction[0, 0] / rays.direction[0, 2]
    assert slope == pytest.approx(-height / found.efl_mm, rel=1e-6)
    at_focus = rays.position[0, 0] + slope * (lens.exit_vertex_z_mm + found.bfl_mm - rays.position[0, 2])
    assert abs(at_focus) < 1e-6 * height
    tilt = 1e-6 / (1.0 + abs(found.ffl_mm))
    direction = np.array([[tilt, 0.0, 1.0]]) / math.hypot(tilt, 1.0)
    rays = trace(lens, [[0.0, 0.0, found.ffl_mm]], direction, 0.6, clip=False)
    assert abs(rays.direction[0, 0]) < 1e-6 * tilt
