"""The exact beam against adaptive integration, the wave equation, and its paraxial limit."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import hankel1e, jv

from lensdesign.errors import InputError
from wavesim.analytic.beam import Beam, superpose

WAVELENGTH_UM = 0.532


def integral(beam: Beam, y: float, z: float) -> complex:
    def wave(angle: float) -> complex:
        path = y * math.sin(angle) + (z - beam.waist_z_mm) * math.cos(angle)
        return np.exp(-0.5 * (angle / beam.spread) ** 2 + 1j * beam.wavenumber_per_mm * path)

    edge = 9.0 * beam.spread
    parts = [
        quad(lambda a, f=f: f(wave(a)), -edge, edge, limit=400, epsabs=1e-13)[0] for f in (np.real, np.imag)
    ]
    return complex(*parts)


@settings(max_examples=15, deadline=None)
@given(
    y=st.floats(-0.02, 0.02),
    z=st.floats(-0.03, 0.03),
    spread=st.floats(0.02, 0.17),
    waist=st.floats(-0.02, 0.02),
)
def test_field_is_the_integral_over_its_plane_waves(y: float, z: float, spread: float, waist: float) -> None:
    beam = Beam(WAVELENGTH_UM, spread, waist)
    assert abs(beam.field(y, z) - integral(beam, y, z)) < 1e-11


def test_narrow_spectrum_gives_the_paraxial_gaussian_beam() -> None:
    beam = Beam(WAVELENGTH_UM, 0.005)
    k, y = beam.wavenumber_per_mm, np.linspace(-0.05, 0.05, 41)
    width = 1.0 / (beam.spread**2) + 1j * k * 2.0
    paraxial = np.sqrt(2.0 * np.pi / width) * np.exp(1j * k * 2.0 - 0.5 * (k * y) ** 2 / width)
    assert np.max(np.abs(beam.field(y, 2.0) - paraxial)) < 2e-4 * np.max(np.abs(paraxial))


@pytest.mark.parametrize("spread", [0.06, 0.12, 0.16])
def test_plane_waves_of_a_complex_source_point_give_its_closed_form(spread: float) -> None:
    """H0 from a line source at z = i b holds the plane waves exp(k b cos(theta)), s^2 = 1 / (k b)."""
    k = 2e3 * math.pi / WAVELENGTH_UM
    rayleigh = 1.0 / (k * spread**2)
    angle, step = np.linspace(-1.55, 1.55, 2401, retstep=True)
    spectrum = np.exp((np.cos(angle) - 1.0) / spread**2) * step / math.pi
    y, z = np.meshgrid(np.linspace(-0.02, 0.02, 41), [0.005, 0.02, 0.04])
    distance = np.sqrt(y**2 + (z - 1j * rayleigh) ** 2)
    closed = hankel1e(0, k * distance) * np.exp(1j * k * distance - 1.0 / spread**2)
    found = superpose(angle, spectrum, k, y, z)
    assert np.max(np.abs(found - closed)) < 1e-11 * np.max(np.abs(closed))


def test_field_far_away_is_as_accurate_as_near_the_waist() -> None:
    beam, y = Beam(WAVELENGTH_UM, 0.12), 10.0 * np.sin([0.0, 0.1, 0.3])
    z = 10.0 * np.cos([0.0, 0.1, 0.3])
    k = beam.wavenumber_per_mm
    angle = np.array([0.0, 0.1, 0.3])
    # Stationary phase with its first correction, (f'' + f / 4) i / (2 k r) for the plane waves' spectrum f.
    spectrum = np.exp(-0.5 * (angle / 0.12) ** 2)
    curvature = spectrum * ((angle / 0.12**2) ** 2 - 1.0 / 0.12**2)
    leading = np.sqrt(2.0 * np.pi / (k * 10.0)) * np.exp(1j * (k * 10.0 - 0.25 * np.pi))
    expected = leading * (spectrum - 0.5j * (curvature + 0.25 * spectrum) / (k * 10.0))
    np.testing.assert_allclose(beam.field(y, z), expected, atol=1e-6 * abs(leading))


def test_cylinder_waves_add_up_to_the_beam() -> None:
    beam = Beam(WAVELENGTH_UM, 0.12, -0.03)
    k, orders = beam.wavenumber_per_mm, np.arange(401)
    waves = beam.cylinder_waves(400) * np.where(orders == 0, 1.0, 2.0)
    for y, z in ((0.0, 0.0), (0.01, 0.005), (-0.004, -0.02), (0.003, 0.024)):
        radius, turn = np.hypot(y, z), np.arctan2(y, z)
        total = np.sum(waves * jv(orders, k * radius) * np.cos(orders * turn))
        assert abs(total - beam.field(y, z)) < 1e-12


def test_amplitude_at_the_edge_of_the_waist_has_fallen_to_nothing() -> None:
    beam = Beam(WAVELENGTH_UM, 0.12)
    assert abs(beam.field(beam.waist_half_width_mm, 0.0)) < 2e-8 * abs(beam.field(0.0, 0.0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0,), "wavelength_um = 0.0"),
        ((math.nan,), "wavelength_um = nan"),
        ((0.5, 0.3), r"spread = 0.3 rad.*0.18"),
        ((0.5, 0.0), "spread = 0.0"),
        ((0.5, 0.1, math.inf), "waist_z_mm = inf"),
    ],
)
def test_unusable_values_are_refused(arguments: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Beam(*arguments)
