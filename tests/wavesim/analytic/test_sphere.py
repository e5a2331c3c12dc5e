"""The sphere's field against direct sums, matching by linear equations, conservation laws and rays."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import eval_legendre, j0, spherical_jn, spherical_yn

from lensdesign import trace
from lensdesign.errors import InputError
from wavesim.analytic.cylinder import SCENE_INDEX, matched_orders
from wavesim.analytic.sphere import (
    beam_field,
    outgoing_field,
    passage_phases,
    riccati_functions,
    sphere_scene,
    spherical_waves,
)

WAVELENGTH_UM, SPREAD = 0.532, 0.12
K = 2e3 * math.pi / WAVELENGTH_UM


def test_beam_is_the_integral_over_its_plane_waves() -> None:
    for radius, distance in ((0.0, 0.0), (0.004, 0.03), (0.001, 0.1)):

        def wave(angle: float, radius: float = radius, distance: float = distance) -> complex:
            weight = math.exp(-0.5 * (angle / SPREAD) ** 2) * math.sin(angle)
            return weight * j0(K * radius * math.sin(angle)) * np.exp(1j * K * distance * math.cos(angle))

        expected = sum(
            unit * quad(lambda a, part=part: part(wave(a)), 0.0, 1.1, limit=900, epsabs=1e-14)[0]
            for unit, part in ((1.0, np.real), (1j, np.imag))
        )
        assert abs(beam_field(K, SPREAD, np.array([radius]), distance)[0] - expected) < 1e-12


def test_spherical_waves_add_up_to_the_beam() -> None:
    order, waves = np.arange(301), spherical_waves(K, SPREAD, -0.03, 300)
    for radius, z in ((0.001, 0.0), (0.003, 0.005), (0.002, -0.02), (0.01, -0.004)):
        distance = math.hypot(radius, z)
        total = np.sum(waves * spherical_jn(order, K * distance) * eval_legendre(order, z / distance))
        assert abs(total - beam_field(K, SPREAD, np.array([radius]), z + 0.03)[0]) < 1e-14


@pytest.mark.parametrize("size", [3.0, 60.0, 900.0])
def test_all_passages_together_match_field_and_slope_on_the_surface(size: float) -> None:
    n, orders = SCENE_INDEX, math.ceil(size)
    x, y = size, SCENE_INDEX * size
    returned, through, kept = matched_orders(
        n, riccati_functions(orders, x), riccati_functions(orders, y), -4.0 * n
    )
    scattered = returned + 0.5 * through / (1.0 - kept)
    for order in range(0, orders, max(1, orders // 25)):
        h, dh = (
            spherical_jn(order, x, slope) + 1j * spherical_yn(order, x, slope) for slope in (False, True)
        )
        system = np.array([[h, -spherical_jn(order, y)], [dh, -n * spherical_jn(order, y, True)]])
        right = -np.array([spherical_jn(order, x), spherical_jn(order, x, True)])
        assert abs(np.linalg.solve(system, right)[0] - scattered[order]) < 1e-10, order
    assert np.max(np.abs(np.abs(1.0 + 2.0 * scattered) - 1.0)) < 1e-11


def test_a_sphere_of_index_one_leaves_the_beam_alone() -> None:
    size = K * 0.02
    phases = passage_phases(size, 1.0)
    assert np.max(np.abs(phases - 1.0)) < 1e-12
    radius = np.linspace(0.0, 0.015, 40)
    waves = spherical_waves(K, SPREAD, -0.03, len(phases) - 1)
    # Half of a regular wave goes out, behind the sphere the whole beam.
    passed = 0.5 * outgoing_field(waves, K, radius, 0.022)
    expected = beam_field(K, SPREAD, radius, 0.052)
    assert np.max(np.abs(passed - expected)) < 1e-6 * np.max(np.abs(expected))


def test_scene_keeps_the_flux_and_is_the_direct_sum() -> None:
    case = sphere_scene(0.05, spread=SPREAD)
    grid, a = case.exact.grid, 0.05
    angle = np.linspace(0.0, 1.1, 20001)
    # |u|^2 counts without the cosine; behind the sphere the beam is nearly along the axis.
    weight = np.exp(-((angle / SPREAD) ** 2)) * np.sin(angle)
    inclined = np.sum(weight * np.cos(angle)) / np.sum(weight)
    assert case.exact.energy / case.object_field.energy == pytest.approx(inclined, rel=5e-3)
    phases = passage_phases(K * a, SCENE_INDEX)
    waves = 0.5 * phases * spherical_waves(K, SPREAD, -1.5 * a, len(phases) - 1)
    row = grid.shape[0] // 2 + 7
    direct = outgoing_field(waves, K, np.hypot(grid.x_mm, grid.y_mm[row]), 1.1 * a)
    assert np.max(np.abs(direct - case.exact.values[row])) < 1e-11 * np.max(np.abs(direct))


def test_phase_on_the_axis_is_the_optical_path() -> None:
    """No focus lies between: all is the path, and the phase of a point source."""
    phases = {}
    for radius_mm in (0.05, 0.1):
        case = sphere_scene(radius_mm, spread=SPREAD)
        path = trace(
            case.scene.lens,
            [[0.0, 0.0, -0.5 * radius_mm]],
            [[0.0, 0.0, 1.0]],
            wavelength_um=WAVELENGTH_UM,
            plane_z_mm=2.1 * radius_mm,
        ).opl[0]
        grid = case.exact.grid
        middle = case.exact.values[grid.shape[0] // 2, grid.shape[1] // 2]
        phases[radius_mm] = np.angle(middle * np.exp(-1j * K * path) * 1j)
    # Of a point source, -i exp(i k r) / (k r); what is left falls with wavelength over radius.
    assert abs(phases[0.05]) < 0.1
    assert abs(phases[0.1]) < 0.6 * abs(phases[0.05])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"radius_mm": 0.004}, r"radius_mm = 0.004.*0.00798 to 0.2128 mm"),
        ({"radius_mm": 0.3}, "radius_mm = 0.3"),
        ({"radius_mm": math.nan}, "radius_mm = nan"),
        ({"wavelength_um": -1.0}, "wavelength_um = -1.0"),
        ({"spread": 0.2}, r"spread = 0.2 rad.*0.05 to 0.13"),
    ],
)
def test_unusable_values_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        sphere_scene(**arguments)
