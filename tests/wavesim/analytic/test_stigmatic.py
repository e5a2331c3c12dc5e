"""The stigmatic lens: equal optical paths by ray tracing, ray density, and energy."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from lensdesign import RayTrace, trace
from lensdesign.errors import InputError
from wavesim.analytic.registry import AnalyticCase
from wavesim.analytic.stigmatic import NUMERICAL_APERTURE, focal_length_mm, point_field, stigmatic_scene

SINES = np.linspace(-0.499, 0.499, 801)


def rays(case: AnalyticCase) -> RayTrace:
    scene = case.scene
    direction = np.stack([np.zeros_like(SINES), SINES, np.sqrt(1.0 - SINES**2)], axis=-1)
    start = np.tile([0.0, 0.0, scene.object_grid.z_mm], (len(SINES), 1))
    plane = scene.exit_grid.z_mm
    return trace(scene.lens, start, direction, wavelength_um=scene.wavelength_um, plane_z_mm=plane)


def test_all_optical_paths_are_equal_at_the_full_aperture_and_give_the_phase() -> None:
    case = stigmatic_scene()
    found = rays(case)
    assert np.all(found.status == 0)
    assert np.ptp(found.opl) < 1e-11
    assert np.max(np.abs(found.direction[:, 1])) < 1e-13
    assert 2.0 * case.scene.lens.stop_semi_diameter_mm == 16.5
    assert np.max(found.position[:, 1]) == pytest.approx(8.25, rel=5e-3)
    lit = np.abs(case.exact.values) > 0.0
    phase = np.angle(case.exact.values[lit] * np.exp(-1j * case.scene.wavenumber_per_mm * found.opl[0]))
    assert np.max(np.abs(phase + 0.25 * np.pi)) < 1e-5


def test_amplitude_follows_the_ray_density() -> None:
    case = stigmatic_scene()
    height = rays(case).position[:, 1]
    spectrum = np.cos(0.5 * np.pi * SINES / NUMERICAL_APERTURE) ** 2
    # Flux between rays: |u|^2 dy = (2 pi / k) |A|^2 cos(theta) dp.
    density = spectrum**2 * np.sqrt(1.0 - SINES**2) / np.gradient(height, SINES, edge_order=2)
    expected = np.sqrt(2.0 * np.pi / case.scene.wavenumber_per_mm * density)
    found = np.interp(height, case.exact.grid.y_mm, np.abs(case.exact.values))
    assert np.max(np.abs(found - expected)) < 2e-5 * np.max(expected)


def test_object_is_the_sum_of_its_plane_waves() -> None:
    k = 2e3 * math.pi / 0.532
    for y in (0.0, 0.0007, 0.004):

        def wave(sine: float, y: float = y) -> float:
            return math.cos(math.pi * sine) ** 2 * math.cos(k * sine * y)

        expected = quad(wave, -0.5, 0.5, limit=200)[0]
        assert point_field(np.array([y]), k, 0.5)[0] == pytest.approx(expected, abs=1e-10)


def test_exit_field_carries_the_flux_of_the_object_field() -> None:
    case = stigmatic_scene()
    k = case.scene.wavenumber_per_mm
    across = 2.0 * np.pi * np.fft.fftfreq(case.object_field.grid.shape[0], case.object_field.grid.pitch_mm)
    cosine = np.sqrt(np.clip(1.0 - (across / k) ** 2, 0.0, None))
    spectrum = np.abs(np.fft.fft(case.object_field.values)) ** 2
    share = float(np.sum(cosine * spectrum) / np.sum(spectrum))
    assert case.exact.energy == pytest.approx(share * case.object_field.energy, rel=1e-5)


def test_all_is_in_proportion_and_the_uncertainty_falls_with_size() -> None:
    small, large = stigmatic_scene(0.33), stigmatic_scene(3.3)
    assert small.uncertainty == pytest.approx(10.0 * large.uncertainty)
    assert focal_length_mm(3.3, 1.5195, 0.5) == pytest.approx(10.0 * focal_length_mm(0.33, 1.5195, 0.5))
    assert stigmatic_scene().uncertainty < 1e-4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.05,), r"semi_diameter_mm = 0.05.* 200 wavelengths, 0.1064 mm"),
        ((math.nan,), "semi_diameter_mm = nan"),
        ((8.25, 0.0), "wavelength_um = 0.0"),
    ],
)
def test_unusable_values_are_refused(arguments: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        stigmatic_scene(*arguments)
