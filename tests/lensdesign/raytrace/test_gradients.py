"""Exact derivatives of rays, against complex-step differentiation of the plain NumPy trace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_trace import trace_numpy

import lensdesign
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.gradients import (
    Variable,
    _differentiate,
    _traced_variables,
    at_wavelengths,
    gradient_traces,
)

PLANES = np.array([2.0, 22.0])
STEP = 1e-30


@pytest.fixture(scope="module")
def lens() -> lensdesign.Lens:
    """A meniscus before a positive lens: conics, an asphere, four surfaces."""
    return lensdesign.Lens.model_validate(
        {
            "wavelengths_um": [0.532],
            "object": {"field_diameter_mm": 2.0, "numerical_aperture": 0.35, "working_distance_mm": 12.0},
            "sensor": {"pixel_pitch_um": 3.2, "pixels": [9344, 7000], "plane_distances_mm": [2.0, 22.0]},
            "surface": [
                {
                    "radius_mm": -40.0,
                    "conic": 0.3,
                    "thickness_mm": 3.0,
                    "material": 1.6,
                    "semi_diameter_mm": 6.0,
                    "stop": True,
                },
                {"radius_mm": -18.0, "asphere": [1e-5, -2e-7], "thickness_mm": 0.4, "semi_diameter_mm": 7.0},
                {"thickness_mm": 5.0, "material": 1.5, "semi_diameter_mm": 8.0},
                {"radius_mm": -13.0, "conic": -0.8, "semi_diameter_mm": 8.0},
            ],
        }
    )


VARIABLES = (
    Variable("curvature", 0),
    Variable("curvature", 2),
    Variable("conic", 0),
    Variable("conic", 3),
    Variable("asphere_4", 1),
    Variable("asphere_6", 1),
    Variable("thickness", 0),
    Variable("thickness", 2),
    Variable("working_distance"),
    Variable("log_field"),
)


@pytest.fixture(scope="module")
def forbes_lens(lens) -> lensdesign.Lens:
    """The same with two Forbes aspheres."""
    front, second, third, last = lens.surfaces
    keys = {"asphere": (), "conic": 0.0, "normalization_radius_mm": 7.0}
    front = front.replaced(**{**keys, "conic": 0.3}, shape="Qcon", q_mm=(0.02, -0.004, 0.001))
    second = second.replaced(**keys, shape="Qbfs", q_mm=(0.03, 0.002))
    return lens.replaced(surfaces=(front, second, third, last))


FORBES_VARIABLES = (
    Variable("curvature", 0),
    Variable("q_2_mm", 0),
    Variable("conic", 0),
    Variable("q_0_mm", 0),
    Variable("thickness", 0),
    Variable("curvature", 1),
    Variable("q_0_mm", 1),
    Variable("q_1_mm", 1),
    Variable("working_distance"),
)


def stepped(system, object_z, variable):
    """The system with an imaginary step of one variable, and the object plane's z."""
    vertex, shapes = system.vertex.astype(complex), list(system.shapes)
    if variable.is_shape_term:
        shapes[variable.surface] = shapes[variable.surface].moved(variable.kind, 1j * STEP)
    elif variable.kind == "thickness":
        vertex[0, variable.surface + 1 :, 2] += 1j * STEP
    elif variable.kind == "working_distance":
        object_z = object_z - 1j * STEP
    return replace(system, vertex=vertex, shapes=tuple(shapes)), object_z


def complex_step(lens, system, fields, pupil, variable, semi):
    """Derivatives of the rays through fixed points of a stop on the first surface."""
    moved, object_z = stepped(system, lens.object_z_mm + 0j, variable)
    origins = np.column_stack([fields, np.full(len(fields), 1.0)]).astype(complex)
    if variable.kind == "log_field":
        origins[:, :2] *= np.exp(1j * STEP)
    origins[:, 2] = object_z
    xy = semi * pupil
    height = moved.shapes[0].sag(*xy.T)
    target = np.column_stack([xy, height])
    ray = target - origins
    ray = ray / np.sqrt(np.sum(ray * ray, axis=-1, keepdims=True))
    result = {}
    for i, distance in enumerate(PLANES):
        plane = moved.vertex[0, -1, 2] + distance
        position, direction, _, status, _, hits = trace_numpy(moved, origins, ray, plane, clip=False)
        assert np.all(status == 0)
        result[f"plane {i}"] = position[:, :2].imag / STEP
    result["cosines"] = direction[:, :2].imag / STEP
    result["heights"] = hits[..., :2].imag / STEP
    return result


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_derivatives_equal_complex_step_to_1e_9(lens, seed):
    assert_derivatives(lens, VARIABLES, seed)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_derivatives_by_terms_that_are_expanded_equal_complex_step(forbes_lens, seed):
    assert_derivatives(forbes_lens, FORBES_VARIABLES, seed)


def assert_derivatives(lens, variables, seed):
    """Rays, with derivatives by the variables, are those of the plain trace with complex steps."""
    rng = np.random.default_rng(seed)
    system = compile_system(lens, 0.532)
    fields, pupil = np.repeat(rng.uniform(-1, 1, (2, 2)), 6, axis=0), rng.uniform(-0.7, 0.7, (12, 2))
    semi = lens.stop_semi_diameter_mm
    got = gradient_traces(system, lens.object_z_mm, PLANES, 0, semi, 0.35, fields, pupil, variables)[0]
    assert got.ok.all()
    for j, variable in enumerate(variables):
        want = complex_step(lens, system, fields, pupil, variable, semi)
        pairs = [
            (got.heights_by[..., j], want["heights"]),
            (got.cosines_by[..., j], want["cosines"]),
            (got.plane_points_by[:, 0, :, j], want["plane 0"]),
            (got.plane_points_by[:, 1, :, j], want["plane 1"]),
        ]
        for mine, reference in pairs:
            scale = max(1.0, np.abs(reference).max())
            np.testing.assert_allclose(mine, reference, rtol=0, atol=1e-9 * scale, err_msg=str(variable))


def test_launch_derivatives_equal_complex_step(lens):
    system = compile_system(lens, 0.532)
    direction = np.array([[0.1, -0.2, np.sqrt(1.0 - 0.05)]])
    origin = np.array([[0.3, 0.1, lens.object_z_mm]])
    raw = _differentiate(system, origin, direction, PLANES, _traced_variables(system, ()))
    for axis in range(2):
        turned = direction.astype(complex)
        turned[0, axis] += 1j * STEP
        turned[0, 2] = np.sqrt(1.0 - turned[0, 0] ** 2 - turned[0, 1] ** 2)
        *_, hits = trace_numpy(system, origin.astype(complex), turned, None, clip=False)
        np.testing.assert_allclose(
            raw.derivatives[0, : system.surfaces, :, axis], hits[0, :, :2].imag / STEP, atol=1e-10
        )


def differences(function, system, object_z, variable, step=1e-6):
    """Central differences, for what complex steps cannot reach (a stop inside the lens)."""
    ends = []
    for sign in (1.0, -1.0):
        vertex, shapes, z = system.vertex.copy(), list(system.shapes), object_z
        if variable.is_shape_term:
            shapes[variable.surface] = shapes[variable.surface].moved(variable.kind, sign * step)
        elif variable.kind == "thickness":
            vertex[0, variable.surface + 1 :, 2] += sign * step
        else:
            z -= sign * step
        ends.append(function(replace(system, vertex=vertex, shapes=tuple(shapes)), z))
    return (ends[0] - ends[1]) / (2.0 * step)


@pytest.mark.parametrize("semi", [5.0, None], ids=["fixed stop", "stop follows the aperture"])
@pytest.mark.parametrize("stop", [0, 3])
def test_rays_keep_their_stop_point_wherever_the_stop_is(lens, stop, semi):
    system = compile_system(lens, 0.532)
    rng = np.random.default_rng(5)
    fields, pupil = np.repeat([[0.0, 0.8]], 8, axis=0), rng.uniform(-0.6, 0.6, (8, 2))
    some = tuple(v for v in VARIABLES if not v.kind.startswith("asphere"))

    def cosines(system, z, points=fields):
        return gradient_traces(system, z, PLANES, stop, semi, 0.35, points, pupil, some)[0].cosines

    got = gradient_traces(system, lens.object_z_mm, PLANES, stop, semi, 0.35, fields, pupil, some)[0]
    expected_stop = got.stop_semi_diameter_mm * pupil
    np.testing.assert_allclose(got.heights[:, stop], expected_stop, atol=1e-9)
    for j, variable in enumerate(some):
        if variable.kind == "log_field":
            ends = (cosines(system, lens.object_z_mm, np.exp(step) * fields) for step in (1e-6, -1e-6))
            reference = np.subtract(*ends) / 2e-6
        else:
            reference = differences(cosines, system, lens.object_z_mm, variable)
        np.testing.assert_allclose(
            got.cosines_by[..., j], reference, atol=2e-7 * max(1, np.abs(reference).max())
        )


def test_stop_of_the_numerical_aperture_is_the_axial_rim_ray(lens):
    got = gradient_traces(
        compile_system(lens, 0.532),
        -12.0,
        PLANES,
        0,
        None,
        0.35,
        np.zeros((1, 2)),
        np.array([[0.0, 1.0]]),
        (),
    )[0]
    height = got.stop_semi_diameter_mm
    rise = float(lens.surfaces[0].sag_mm(height))
    assert height / np.hypot(height, 12.0 + rise) == pytest.approx(0.35, abs=1e-12)


def test_rays_that_fail_are_marked(lens):
    system = compile_system(lens, 0.532)
    pupil = np.array([[0.0, 0.0], [0.0, 30.0]])
    got = gradient_traces(system, -12.0, PLANES, 0, 1.3, 0.35, np.zeros((2, 2)), pupil, VARIABLES)[0]
    assert got.ok.tolist() == [True, False]
    assert np.all(np.isfinite(got.cosines_by))


def test_a_rim_ray_that_misses_marks_every_ray(lens):
    system = compile_system(lens, 0.532)
    got = gradient_traces(
        system, -12.0, PLANES, 3, None, 0.9999, np.zeros((1, 2)), np.array([[0.0, 0.1]]), VARIABLES
    )[0]
    assert not got.ok.any()


@pytest.mark.parametrize("semi", [5.0, None], ids=["fixed stop", "stop follows the aperture"])
@pytest.mark.parametrize("stop", [0, 3])
def test_wavelengths_together_and_without_derivatives_are_those_one_by_one(lens, stop, semi):
    rng = np.random.default_rng(6)
    fields, pupil = rng.uniform(-0.8, 0.8, (40, 2)), rng.uniform(-0.7, 0.7, (40, 2))
    systems = [compile_system(lens, w) for w in (0.465, 0.532, 0.63)]
    rest = (lens.object_z_mm, PLANES, stop, semi, 0.35, fields, pupil)
    together = gradient_traces(at_wavelengths(systems), *rest, VARIABLES)
    bare = gradient_traces(at_wavelengths(systems), *rest, ())
    for system, one, fast in zip(systems, together, bare, strict=True):
        (alone,) = gradient_traces(system, *rest, VARIABLES)
        assert alone.ok.all()
        for name, value in vars(alone).items():
            np.testing.assert_allclose(getattr(one, name), value, rtol=0, atol=1e-13, err_msg=name)
            if "_by" in name:
                assert getattr(fast, name).shape == (*value.shape[:-1], 0)
            else:
                np.testing.assert_allclose(getattr(fast, name), value, rtol=0, atol=1e-11, err_msg=name)


def test_stop_points_beyond_the_edge_of_their_surface_are_marked_without_derivatives(lens):
    system = replace(compile_system(lens, 0.532), trials=None)
    far = 2.0 * lens.surfaces[0].shape.edge_radius_mm
    assert np.isfinite(far)
    pupil = np.array([[0.0, 0.0], [0.0, far]])
    (got,) = gradient_traces(system, -12.0, PLANES, 0, 1.0, 0.35, np.zeros((2, 2)), pupil, ())
    assert got.ok.tolist() == [True, False]
