"""Scattered light on the pixels: energy, widths, frames of a rough lens, and reconstructions that know it."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from programs import run_program
from scipy.ndimage import gaussian_filter

from lensdesign import SurfacePerturbation, SurfaceRoughness, load_design, save_design, scaled
from lensdesign.analysis.roughness import RoughnessWarning, roughness_report
from lensdesign.errors import InputError
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.imaging import Imaged, image
from wavesim.sensor.measurement import Measurement
from wavesim.sensor.merged_exposures import estimate_intensity
from wavesim.sensor.surface_scatter import (
    Halo,
    halos_on_plane,
    scatter_of_patch,
    scattered_on_pixels,
    with_scattered_light,
    with_stated_scatter,
)

PITCH_UM = 2.0
SMOOTH = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
ROUGHNESS = SurfaceRoughness(rms_nm=20.0, correlation_length_um=1.0)
ROUGH = SMOOTH.with_surface(0, roughness=ROUGHNESS).with_surface(1, roughness=ROUGHNESS)
SETTINGS: dict[str, Any] = {"patch_mm": 0.05, "engine": "eikonal", "error": 0.1}
FINE: dict[str, Any] = {"bits": 16, "full_well_electrons": 1e6}


def point(shape: tuple[int, int] = (101, 121)) -> np.ndarray:
    values = np.zeros(shape)
    values[50, 60] = 1.0
    return values


@given(
    fractions=st.lists(st.floats(0.0, 0.3), min_size=1, max_size=3),
    radius_um=st.floats(0.0, 10.0),
    seed=st.integers(0, 1000),
)
def test_the_energy_of_light_in_the_middle_is_kept(
    fractions: list[float], radius_um: float, seed: int
) -> None:
    light = np.zeros((64, 80))
    light[30:34, 38:44] = np.random.default_rng(seed).random((4, 6))
    halos = [Halo(fraction, 1e-3 * radius_um) for fraction in fractions]
    recorded = with_scattered_light(light, PITCH_UM, halos)
    assert recorded.sum() == pytest.approx(light.sum(), rel=1e-9)
    assert np.all(recorded >= 0.0)
    assert scattered_on_pixels(light, PITCH_UM, halos).sum() == pytest.approx(
        sum(fractions) * light.sum(), rel=1e-9, abs=1e-12
    )


@pytest.mark.parametrize("radius_um", [8.0, 30.0])
def test_the_halo_of_a_point_is_a_gaussian_of_its_radius(radius_um: float) -> None:
    halo = scattered_on_pixels(point(), PITCH_UM, [Halo(1.0, 1e-3 * radius_um)])
    y, x = PITCH_UM * (np.arange(101) - 50), PITCH_UM * (np.arange(121) - 60)
    squared = y[:, None] ** 2 + x**2
    expected = np.exp(-squared / radius_um**2) * PITCH_UM**2 / (math.pi * radius_um**2)
    assert halo == pytest.approx(expected, abs=0.02 * expected.max())
    # The pixels add the variance of a square.
    assert np.sum(halo * squared) == pytest.approx(radius_um**2 + PITCH_UM**2 / 6.0, rel=1e-3)


def test_the_halo_is_the_filter_of_scipy_on_light_of_any_form() -> None:
    light = np.random.default_rng(3).random((90, 70)) ** 4
    radius_um = 14.0
    filtered = gaussian_filter(light, math.sqrt(0.5) * radius_um / PITCH_UM, mode="constant", truncate=9.0)
    found = scattered_on_pixels(light, PITCH_UM, [Halo(0.25, 1e-3 * radius_um)])
    assert found == pytest.approx(0.25 * filtered, abs=2e-3 * filtered.max())


def test_the_mean_of_waves_through_random_screens_is_direct_light_and_halo() -> None:
    """A beam, screens drawn by NumPy, and free space by its Fourier transform: nothing of the model."""
    count, pitch_um, length_um, phase_rad, distance_um, wavelength_um = 256, 2.0, 12.0, 0.15, 4e3, 0.532
    at = pitch_um * (np.arange(count) - count // 2)
    squared = at[:, None] ** 2 + at**2
    beam = np.exp(-squared / 60.0**2)
    f = np.fft.fftfreq(count, pitch_um)
    f_squared = f[:, None] ** 2 + f**2
    spectrum = np.exp(-((math.pi * length_um) ** 2) * f_squared)
    spectrum *= count**2 / spectrum.sum()
    passage = np.exp(-1j * math.pi * wavelength_um * distance_um * f_squared)
    rng = np.random.default_rng(11)

    def behind(phase: np.ndarray) -> np.ndarray:
        return np.abs(np.fft.ifft2(np.fft.fft2(beam * np.exp(1j * phase)) * passage)) ** 2

    direct, mean = behind(np.zeros_like(beam)), np.zeros_like(beam)
    draws = 150
    for _ in range(draws):
        noise = np.fft.fft2(rng.standard_normal(beam.shape))
        mean += behind(phase_rad * np.fft.ifft2(np.sqrt(spectrum) * noise).real) / draws
    radius_mm = 1e-3 * distance_um * wavelength_um / (math.pi * length_um)
    halo = Halo(-math.expm1(-(phase_rad**2)), radius_mm)
    expected = with_scattered_light(direct, pitch_um, [halo])
    outside = squared > 140.0**2  # where there is hardly any direct light
    assert direct[outside].sum() < 0.1 * expected[outside].sum()
    assert mean[outside].sum() == pytest.approx(expected[outside].sum(), rel=0.05)
    widths = [np.sum(light * squared) / np.sum(light) for light in (direct, mean, expected)]
    assert widths[1] - widths[0] == pytest.approx(widths[2] - widths[0], rel=0.05)


def test_a_wide_halo_falls_beside_the_sensor() -> None:
    light = point()
    found = scattered_on_pixels(light, PITCH_UM, [Halo(0.1, 10.0)])
    area_mm2 = 101 * 121 * (1e-3 * PITCH_UM) ** 2
    assert found.sum() == pytest.approx(0.1 * area_mm2 / (math.pi * 10.0**2), rel=1e-3)


def test_single_precision_stays_and_no_halo_changes_nothing() -> None:
    light = point().astype(np.float32)
    assert with_scattered_light(light, PITCH_UM, []) is light
    assert with_scattered_light(light, PITCH_UM, [Halo(0.1, 0.01)]).dtype == np.float32


def test_surfaces_share_the_total_fraction() -> None:
    rougher = ROUGH.with_surface(1, roughness=SurfaceRoughness(rms_nm=40.0, correlation_length_um=2.0))
    report = roughness_report(rougher)
    assert report is not None
    first, second = halos_on_plane(report, 1)
    assert first.fraction + second.fraction == pytest.approx(report.mean_fraction)
    assert second.fraction == pytest.approx(4.0 * first.fraction, rel=0.05)
    assert second.radius_mm == report.surfaces[1].halo_radius_mm[1]
    assert halos_on_plane(None, 0) == ()


def pictures(imaged: Imaged) -> list[np.ndarray]:
    return [estimate_intensity(frame)[0] for frame in imaged.frames]


@pytest.fixture(scope="module")
def smooth() -> Imaged:
    return image(SMOOTH, "usaf", noise=False, **SETTINGS, **FINE)


@pytest.fixture(scope="module")
def rough() -> Imaged:
    return image(ROUGH, "usaf", noise=False, **SETTINGS, **FINE)


def test_frames_of_a_rough_lens_are_direct_light_and_background(smooth: Imaged, rough: Imaged) -> None:
    assert smooth.scattered is None
    assert rough.scattered is not None
    assert rough.scattered.mean_fraction == pytest.approx(0.036, rel=0.02)
    for index, (direct, recorded) in enumerate(zip(pictures(smooth), pictures(rough), strict=True)):
        expected = with_scattered_light(direct, 3.2, halos_on_plane(rough.scattered, index))
        assert np.linalg.norm(recorded - expected) < 1e-3 * np.linalg.norm(expected)
        assert np.linalg.norm(recorded - direct) > 1e-2 * np.linalg.norm(direct)
        assert recorded.sum() == pytest.approx(direct.sum(), rel=0.02)


def test_stated_scatter_is_the_background_of_the_frames(smooth: Imaged, rough: Imaged) -> None:
    planes = recorded_planes(rough.frames)
    stated = with_stated_scatter(planes, 3.2, rough.scattered)
    for index, (direct, plane) in enumerate(zip(pictures(smooth), stated, strict=True)):
        expected = scattered_on_pixels(direct, 3.2, halos_on_plane(rough.scattered, index))
        assert plane.background is not None
        assert np.linalg.norm(plane.background - expected) < 0.05 * np.linalg.norm(expected)
    own = [Measurement(0.0, p.amplitude, background=np.ones_like(p.amplitude)) for p in planes]
    for plane, given_plane in zip(with_stated_scatter(own, 3.2, rough.scattered), own, strict=True):
        assert plane is given_plane
    assert [p.background for p in with_stated_scatter(planes, 3.2, None)] == [None, None]


def test_a_reconstruction_that_knows_the_roughness_explains_the_frames() -> None:
    taken = image(ROUGH, "usaf", **SETTINGS, **FINE)
    truth, own = taken.target.transmission, {"kind": "amplitude", "iterations": 40}
    known, unknown = (
        reconstruct_frames(lens, taken.frames, truth=truth, **own, **SETTINGS) for lens in (ROUGH, SMOOTH)
    )
    correlations = [found.truth["object_correlation"] for found in (known, unknown)]
    assert None not in correlations
    assert known.verdict.over_noise < unknown.verdict.over_noise
    assert correlations[0] > 0.995 > correlations[1]  # type: ignore[operator]


def test_roughness_of_a_state_counts() -> None:
    grid = image(SMOOTH, "usaf", **SETTINGS).patch.grid
    state = SystemState(surface_perturbations={1: SurfacePerturbation(roughness_rms_nm=-20.0)})
    half = scatter_of_patch(ROUGH, grid, 0.532, (0.0625,), state)
    assert half is not None
    assert half.surfaces[1].mean_fraction == 0.0
    assert half.surfaces[0].mean_fraction > 0.01
    unknown = SystemState(surface_perturbations={0: SurfacePerturbation(roughness_rms_nm=1.0)})
    with pytest.raises(InputError, match="surface 1: roughness_rms_nm: the design states no roughness"):
        scatter_of_patch(SMOOTH, grid, 0.532, (0.0625,), unknown)
    assert scatter_of_patch(SMOOTH, grid, 0.532, (0.0625,)) is None


def test_a_halo_that_the_pixels_resolve_is_warned_of() -> None:
    lens = SMOOTH.with_surface(1, roughness=SurfaceRoughness(rms_nm=2.0, correlation_length_um=20.0))
    with pytest.warns(RoughnessWarning, match="surface 2: correlation_length_um = 20: the pixels sample"):
        image(lens, "usaf", **SETTINGS)


def test_commands_simulate_and_reconstruct_a_rough_lens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*arguments: object) -> Any:
        return run_program(monkeypatch, capsys, "wavesim", *arguments)

    save_design(ROUGH, tmp_path / "lens.toml")
    frames, found = tmp_path / "frames", tmp_path / "object"
    patch = ("--patch-mm", 0.05, "--engine", "eikonal", "--error", 0.1)
    shown = run("image", tmp_path / "lens.toml", "-o", frames, *patch)
    assert shown.returncode == 0
    assert re.search(
        r"rough surfaces scatter 3\.5\d % of the light; radius of the halo on the planes: 0", shown.stdout
    )
    summary = json.loads((frames / "image.json").read_text())
    assert summary["scattered_light"]["fraction"] == pytest.approx(0.036, rel=0.02)
    assert len(summary["scattered_light"]["halo_radius_mm"]) == 2
    pictures = sorted(frames.glob("frame_*.tif"))
    design = ("--design", tmp_path / "lens.toml")
    done = run("reconstruct", *pictures, *design, "-o", found, *patch, "--iterations", 5)
    assert done.returncode in (0, 1), done.stderr
    assert (found / "reconstruction.json").exists()


def test_perturbed_roughness_is_a_setting(rough: Imaged) -> None:
    seen = image(ROUGH, "usaf", noise=False, perturb="surface 1: roughness_rms_nm=-20", **SETTINGS, **FINE)
    assert seen.scattered is not None
    assert rough.scattered is not None
    assert seen.scattered.mean_fraction < 0.6 * rough.scattered.mean_fraction
    for one, other in zip(pictures(seen), pictures(rough), strict=True):
        assert np.linalg.norm(one - other) > 1e-3 * np.linalg.norm(other)
