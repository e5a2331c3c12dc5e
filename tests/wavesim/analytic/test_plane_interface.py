"""Plane interfaces against Fresnel's continuity conditions, Fourier transforms, and rays."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import trace
from lensdesign.errors import InputError
from wavesim.analytic.plane_interface import beam_scene, plane_scene, plate_scene, transmitted_te
from wavesim.analytic.registry import AnalyticCase
from wavesim.fields.field import Field, relative_error


@given(angle=st.floats(0.0, 1.4), before=st.floats(1.0, 2.5), ratio=st.floats(1.0, 2.0))
def test_transmission_meets_continuity_energy_and_reciprocity(
    angle: float, before: float, ratio: float
) -> None:
    behind = before * ratio
    refracted = math.asin(math.sin(angle) / ratio)
    across, after = before * math.cos(angle), behind * math.cos(refracted)
    passed = float(transmitted_te(before, behind, np.array(angle)))
    reflected = passed - 1.0  # the field is continuous, and so is its slope:
    assert across * (1.0 - reflected) == pytest.approx(after * passed, rel=1e-12)
    assert across * (1.0 - reflected**2) == pytest.approx(after * passed**2, rel=1e-12)
    back = float(transmitted_te(behind, before, np.array(refracted)))
    assert passed / across == pytest.approx(back / after, rel=1e-9)


def by_fourier_transform(case: AnalyticCase, layers: list[tuple[float, float]]) -> np.ndarray:
    """Exit field from the samples of the object field alone."""
    grid, behind = case.scene.object_grid, case.scene.exit_grid
    count, k = 1 << 15, case.scene.wavenumber_per_mm
    across = 2.0 * np.pi * np.fft.fftfreq(count, grid.pitch_mm)
    spectrum = np.fft.fft(case.object_field.values, count) * (np.abs(across) < k)
    sine = np.where(np.abs(across) < k, across / k, 0.0)
    before = 1.0
    for index, thickness in layers:
        spectrum = spectrum * np.exp(1j * k * thickness * np.sqrt(index**2 - sine**2))
        old, new = np.sqrt(before**2 - sine**2), np.sqrt(index**2 - sine**2)
        spectrum = spectrum * 2.0 * old / (old + new)
        before = index
    shift = behind.y_mm[0] - grid.y_mm[0]
    return np.fft.ifft(spectrum * np.exp(1j * across * shift))[: behind.shape[0]]


@pytest.mark.parametrize(
    ("case", "layers"),
    [
        (plane_scene(), [(1.0, 0.1), (1.5195, 0.1)]),
        (plane_scene(50.0, 2.0, 0.05, 0.6, 0.03), [(1.0, 0.05), (2.0, 0.05)]),
        (plate_scene(), [(1.0, 0.1), (1.5195, 0.2), (1.0, 0.1)]),
        (beam_scene(), [(1.0, 0.05), (1.0, 0.05)]),
    ],
)
def test_exit_field_follows_from_the_object_field(
    case: AnalyticCase, layers: list[tuple[float, float]]
) -> None:
    assert relative_error(by_fourier_transform(case, layers), case.exact.values) < 1e-9


@pytest.mark.parametrize("incidence_deg", [0.0, 20.0, 50.0])
@pytest.mark.parametrize("make", [plane_scene, plate_scene])
def test_beam_leaves_where_its_ray_does_with_the_flux_that_fresnel_leaves(
    make: Any, incidence_deg: float
) -> None:
    case = make(incidence_deg=incidence_deg, spread=0.01)
    grids, angle = (case.scene.object_grid, case.scene.exit_grid), math.radians(incidence_deg)
    starts = [[0.0, grids[0].centre_mm[1], grids[0].z_mm]]
    ray = trace(
        case.scene.lens,
        starts,
        [[0.0, math.sin(angle), math.cos(angle)]],
        wavelength_um=case.scene.wavelength_um,
        plane_z_mm=grids[1].z_mm,
    )
    density = np.abs(case.exact.values) ** 2
    centroid = float(np.sum(density * grids[1].y_mm) / np.sum(density))
    assert centroid == pytest.approx(ray.position[0, 1], abs=3e-4)
    flux = [flux_along_z(field) for field in (case.object_field, case.exact)]
    inside = math.asin(math.sin(angle) / 1.5195)
    once = (
        1.0 - (math.sin(angle - inside) / math.sin(angle + inside)) ** 2
        if angle
        else 1.0 - (0.5195 / 2.5195) ** 2
    )
    assert flux[1] / flux[0] == pytest.approx(once if make is plane_scene else once**2, rel=2e-3)


def flux_along_z(field: Field) -> float:
    k = field.wavenumber_per_mm
    across = 2.0 * np.pi * np.fft.fftfreq(field.grid.shape[0], field.grid.pitch_mm)
    cosine = np.sqrt(np.clip(1.0 - (across / k) ** 2, 0.0, None))
    return float(field.index * np.sum(cosine * np.abs(np.fft.fft(field.values)) ** 2) / field.values.size)


def test_free_space_keeps_the_flux() -> None:
    case = beam_scene()
    assert flux_along_z(case.exact) == pytest.approx(flux_along_z(case.object_field), rel=1e-10)


def test_both_grids_hold_the_beam_and_the_stop_cuts_none_of_it() -> None:
    for make in (plane_scene, plate_scene, beam_scene):
        case = make()
        for field in (case.object_field, case.exact):
            assert np.max(np.abs(field.values[[0, -1]])) < 1e-8 * np.max(np.abs(field.values))
        assert case.uncertainty < 1e-5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"index": 0.9}, r"index = 0.9, thickness of 0.1 mm"),
        ({"distance_mm": 0.0}, "thickness of 0.0 mm"),
        ({"distance_mm": math.nan}, "thickness of nan mm"),
        ({"incidence_deg": 80.0}, r"incidence_deg = 80.0 with spread = 0.05 rad.*0 to 55.86°"),
        ({"incidence_deg": -1.0}, "incidence_deg = -1.0"),
        ({"wavelength_um": 0.0}, "wavelength_um = 0.0"),
        ({"spread": 0.3}, "spread = 0.3 rad"),
    ],
)
def test_unusable_values_are_refused(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plane_scene(**arguments)
