"""The cylinder's exact field against 60-digit values, boundary conditions, conservation laws and rays."""

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from places import GOLDEN
from scipy.interpolate import CubicSpline
from scipy.special import hankel1, jv, jvp

from lensdesign import trace
from lensdesign.errors import InputError
from wavesim.analytic.beam import Beam
from wavesim.analytic.cylinder import (
    SCENE_INDEX,
    STOP_ANGLE,
    Cylinder,
    cylinder_scene,
    outgoing_field,
    total_field,
    transmitted_field,
)
from wavesim.fields.field import relative_error

GOLDEN: dict[str, Any] = json.loads((GOLDEN / "cylinder_waves.json").read_text())
WAVELENGTH_UM, INDEX = GOLDEN["wavelength_um"], GOLDEN["index"]
RADII_MM = (0.002, 0.02, 0.1, 0.8)

Array = NDArray[np.float64]


def cylinder(radius_mm: float) -> Cylinder:
    return Cylinder(radius_mm, INDEX, WAVELENGTH_UM)


def beam_for(radius_mm: float) -> Beam:
    return Beam(WAVELENGTH_UM, 0.12, -1.5 * radius_mm)


def test_coefficients_of_the_largest_cylinder_agree_with_60_digits() -> None:
    large = cylinder(GOLDEN["large"]["radius_mm"])
    found = {"full": large.full_coefficients()} | {f"p{p}": large.debye_coefficients(p) for p in range(3)}
    for row in GOLDEN["large"]["orders"]:
        for name, values in found.items():
            assert abs(values[row["order"]] - complex(*row[name])) < 1e-11, (row["order"], name)


def test_fields_of_a_small_cylinder_agree_with_60_digits() -> None:
    small, points = GOLDEN["small"], GOLDEN["small"]["points"]
    rod, beam = cylinder(small["radius_mm"]), Beam(WAVELENGTH_UM, small["spread"], small["waist_z_mm"])
    y, z = (np.array([point[key] for point in points]) for key in ("y_mm", "z_mm"))
    for key, found in (
        ("incident", beam.field(y, z)),
        ("p1", transmitted_field(rod, beam, y, z)),
        ("total", total_field(rod, beam, y, z)),
    ):
        expected = np.array([complex(*point[key]) for point in points])
        assert np.max(np.abs(found - expected)) < 1e-13, key


@pytest.mark.parametrize("radius_mm", [0.002, 0.02, 0.1])
def test_field_and_its_slope_are_continuous_on_the_surface(radius_mm: float) -> None:
    rod, beam = cylinder(radius_mm), beam_for(radius_mm)
    k, scattered, m = beam.wavenumber_per_mm, rod.full_coefficients(), np.arange(rod.orders + 1)
    x, y = k * radius_mm, INDEX * k * radius_mm
    incident = beam.cylinder_waves(rod.orders) * np.where(m == 0, 1.0, 2.0)
    # The interior waves are fixed by the field alone; its slope then has to follow.
    inside = np.zeros_like(incident)
    held = np.abs(jv(m, y)) > 1e-3 / math.sqrt(x)
    inside[held] = ((jv(m, x) + scattered * hankel1(m, x)) / jv(m, y))[held]
    slope_inside = inside * INDEX * jvp(m, y)
    slope_outside = jvp(m, x) + scattered * (0.5 * (hankel1(m - 1, x) - hankel1(m + 1, x)))
    scale = np.max(np.abs(incident * slope_outside))
    assert np.max(np.abs((slope_inside - slope_outside) * incident)[held]) < 1e-10 * scale
    angles = np.linspace(0.0, np.pi, 37)
    outside = total_field(rod, beam, radius_mm * np.sin(angles), radius_mm * np.cos(angles))
    values = (jv(m, x) + scattered * hankel1(m, x)) * incident
    series = np.cos(np.outer(angles, m)) @ values
    assert np.max(np.abs(outside - series)) < 1e-10 * np.max(np.abs(outside))


def test_slope_of_the_total_field_follows_from_the_waves_inside() -> None:
    """Regular waves inside that agree with the field at r = a agree with its slope, by finite differences."""
    rod, beam = cylinder(0.002), beam_for(0.002)
    angle, m, step = np.linspace(0.0, np.pi, 80), np.arange(55), 5e-4 * 0.002
    radius = 0.002 + step * np.arange(7.0)
    rings = total_field(rod, beam, np.outer(radius, np.sin(angle)), np.outer(radius, np.cos(angle)))
    slope = np.array([-49 / 20, 6.0, -15 / 2, 20 / 3, -15 / 4, 6 / 5, -1 / 6]) @ rings / step
    angular, k = np.cos(np.outer(angle, m)), INDEX * beam.wavenumber_per_mm
    waves = np.linalg.lstsq(angular, rings[0], rcond=1e-13)[0]
    inside = angular @ (waves * k * jvp(m, k * 0.002) / jv(m, k * 0.002))
    assert np.linalg.norm(angular @ waves - rings[0]) < 1e-12 * np.linalg.norm(rings[0])
    assert np.linalg.norm(inside - slope) < 1e-9 * np.linalg.norm(slope)


@settings(max_examples=25, deadline=None)
@given(size=st.floats(0.5, 3000.0), index=st.floats(1.0, 2.5))
def test_no_order_gains_or_loses_energy(size: float, index: float) -> None:
    rod = Cylinder(size * 1e-3 * WAVELENGTH_UM / (2.0 * math.pi), index, WAVELENGTH_UM)
    assert np.max(np.abs(np.abs(1.0 + 2.0 * rod.full_coefficients()) - 1.0)) < 1e-12
    through, returned = rod.debye_coefficients(1), rod.debye_coefficients(0)
    crossed = np.abs(1.0 + 2.0 * returned) ** 2 + 2.0 * np.abs(through)
    assert np.max(np.abs(crossed - 1.0)) < 1e-10


@pytest.mark.parametrize("radius_mm", RADII_MM)
def test_full_series_is_unitary_and_the_closed_sum_of_all_passages(radius_mm: float) -> None:
    rod = cylinder(radius_mm)
    full = rod.full_coefficients()
    assert np.max(np.abs(np.abs(1.0 + 2.0 * full) - 1.0)) < 1e-12
    first, second = rod.debye_coefficients(1), rod.debye_coefficients(2)
    kept = second / np.where(first == 0.0, 1.0, first)
    closed = rod.debye_coefficients(0) + first / (1.0 - kept)
    held = np.abs(first) > 1e-12
    assert np.max(np.abs(closed - full)[held]) < 1e-10


@pytest.mark.parametrize("radius_mm", [0.01, 0.1])
def test_passages_add_up_to_the_full_field(radius_mm: float) -> None:
    rod, beam = cylinder(radius_mm), beam_for(radius_mm)
    y = np.linspace(-0.7, 0.7, 101) * radius_mm
    z = np.full_like(y, 1.1 * radius_mm)
    total = total_field(rod, beam, y, z)
    coefficients = rod.debye_coefficients(0)
    errors = []
    for p in range(1, 13):
        coefficients = coefficients + rod.debye_coefficients(p)
        partial = beam.field(y, z) + outgoing_field(rod, beam, coefficients, y, z)
        errors.append(relative_error(partial, total))
    # Even p come back; p = 3 is the first to follow behind, two reflections of 4 % (of the flux) down.
    assert 0.03 < errors[0] < 0.05
    assert errors[3] < 2e-3
    assert errors[-1] < 1e-6


@pytest.mark.parametrize(("radius_mm", "allowed"), [(0.1, 7.5e-4), (0.2, 3.8e-4), (0.8, 9.5e-5)])
def test_single_passage_is_what_rays_predict(radius_mm: float, allowed: float) -> None:
    """Energy along ray tubes and optical path; what is left falls in proportion to wavelength over radius."""
    case = cylinder_scene(radius_mm)
    grid = case.exact.grid
    assert relative_error(field_by_rays(radius_mm, grid.y_mm), case.exact.values) < allowed


def field_by_rays(radius_mm: float, y_mm: Array) -> NDArray[np.complex128]:
    a, n, k = radius_mm, SCENE_INDEX, 2e3 * np.pi / WAVELENGTH_UM

    def rays(angle: Array, height: float) -> tuple[Array, ...]:
        sine = (height * np.cos(angle) + 1.5 * a * np.sin(angle)) / a
        incidence, refraction = np.arcsin(sine), np.arcsin(sine / n)
        polar = 2.0 * refraction - (incidence - angle)
        leaving = angle - 2.0 * (incidence - refraction)
        last = a * (1.1 - np.cos(polar)) / np.cos(leaving)
        first = a * (1.5 - np.cos(incidence - angle)) / np.cos(angle)
        path = first + 2.0 * n * a * np.cos(refraction) + last
        return incidence, refraction, leaving, a * np.sin(polar) + last * np.sin(leaving), path

    angle = np.linspace(-0.536, 0.536, 8001)
    incidence, refraction, leaving, arrival, path = rays(angle, 0.0)
    stretch = np.gradient(arrival, angle, edge_order=2)
    step = 1e-5 * a
    moved = (rays(angle, step)[3] - rays(angle, -step)[3]) / (2.0 * step)
    passed = 4.0 * n * np.cos(incidence) * np.cos(refraction)
    passed = passed / (np.cos(incidence) + n * np.cos(refraction)) ** 2
    spectrum = np.exp(-0.5 * (angle / 0.12) ** 2)
    # The width of the waist adds -(q / k) f'' to a spectrum f(p), with q the mean curvature of the path.
    middle = len(angle) // 2
    curvature = 0.5 * moved[middle] / stretch[middle]
    slope = np.gradient(np.gradient(spectrum / np.cos(angle), np.sin(angle)), np.sin(angle))
    source = spectrum / np.cos(angle) - 1j * curvature / k * slope
    amplitude = source * np.cos(angle) * np.sqrt(2.0 * np.pi / (k * np.cos(leaving) * stretch)) * passed
    result = np.zeros(y_mm.shape, complex)
    inside = np.abs(y_mm) < arrival[-1]
    phase = k * CubicSpline(arrival, path)(y_mm[inside]) - 0.25 * np.pi
    result[inside] = CubicSpline(arrival, amplitude)(y_mm[inside]) * np.exp(1j * phase)
    return result


@pytest.mark.parametrize("radius_mm", [0.01, 0.1])
def test_what_crosses_once_carries_the_flux_that_fresnel_leaves(radius_mm: float) -> None:
    case = cylinder_scene(radius_mm)
    normal = (4.0 * SCENE_INDEX / (1.0 + SCENE_INDEX) ** 2) ** 2
    assert case.exact.energy / case.object_field.energy == pytest.approx(normal, rel=0.01)


def test_a_cylinder_of_index_one_leaves_the_beam_alone() -> None:
    rod, beam = Cylinder(0.05, 1.0, WAVELENGTH_UM), beam_for(0.05)
    y, z = np.linspace(-0.04, 0.04, 51), 0.06
    assert np.max(np.abs(total_field(rod, beam, y, z) - beam.field(y, z))) < 1e-14
    # It is all p = 1, except the waves that tunnel: the beam hardly holds any.
    assert relative_error(transmitted_field(rod, beam, y, z), beam.field(y, z)) < 1e-7


def test_scene_holds_the_beam_and_its_grids_start_and_end_dark() -> None:
    case = cylinder_scene(0.1)
    for field in (case.object_field, case.exact):
        assert np.max(np.abs(field.values[[0, -1]])) < 2e-8 * np.max(np.abs(field.values))
    assert case.scene.object_grid.z_mm == pytest.approx(-0.05)
    assert case.scene.exit_grid.z_mm == pytest.approx(0.21)
    assert case.uncertainty < 1e-4
    rim = np.array([STOP_ANGLE * 0.9999, STOP_ANGLE * 1.0001])
    rays = trace(
        case.scene.lens,
        np.tile([0.0, 0.0, -0.05], (2, 1)),
        np.stack([0.0 * rim, np.sin(rim), np.cos(rim)], axis=-1),
        wavelength_um=WAVELENGTH_UM,
        plane_z_mm=0.21,
    )
    assert rays.ok.tolist() == [True, False]
    assert rays.failed_surface[1] == 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: cylinder_scene(0.004), r"radius_mm = 0.004.* 15 wavelengths"),
        (lambda: cylinder_scene(0.1, spread=0.15), r"spread = 0.15 rad.* 0.13"),
        (lambda: cylinder_scene(-1.0), r"radius_mm = -1.0"),
        (lambda: cylinder_scene(5.0), r"circumference of 5.905e\+04 wavelengths.*0.1 to 20000"),
        (lambda: Cylinder(0.1, 0.9, 0.5), r"index = 0.9.* 1"),
        (lambda: cylinder(0.1).debye_coefficients(-1), r"p = -1.* 0"),
        (lambda: total_field(cylinder(0.1), beam_for(0.1), 0.0, 0.05), "inside the cylinder"),
        (lambda: total_field(cylinder(0.1), Beam(0.6), 0.0, 0.2), r"0.6 µm.*0.532 µm"),
    ],
)
def test_unusable_values_are_refused(call: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()
