"""Frames of free space: the field, the drift, the scale of distances and the exposures behind them."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from places import GOLDEN

from lensdesign.errors import InputError
from wavesim.calibration import free_space
from wavesim.calibration.free_space import (
    DEFAULT_FRAME_SETTINGS,
    FreeSpaceField,
    HeldDistancesWarning,
    NotExplainedWarning,
    descend,
    reconstruct_free_space,
    scale_deviation,
    stack_of,
)
from wavesim.sensor.colour_filters import ColourFilters
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import AssumedWarning, Frame, FrameSettings, read_frame

PITCH_UM, WAVELENGTH_UM, PIXELS, WIDE = 0.4, 0.5, 96, 192
SCALE, DRIFT = 1.04, (0.01, -0.006)
PLANES_UM, GAINS = (10.0, 25.0, 45.0, 70.0), (1.0, 0.9, 1.1, 0.95)


def object_field() -> np.ndarray:
    """Grains of phase and amplitude, no finer than the light carries."""
    random = np.random.default_rng(3)
    cycles = np.fft.fftfreq(WIDE)
    soft = np.exp(-((np.hypot(cycles[:, None], cycles) / 0.1) ** 2))
    grains = [np.fft.ifft2(np.fft.fft2(random.standard_normal((WIDE, WIDE))) * soft).real for _ in range(2)]
    phase, absorbed = (part / part.std() for part in grains)
    return np.exp(0.5j * phase - 0.1 * absorbed)


def recorded_amplitude(z_um: float) -> np.ndarray:
    """On the stage's plane, by plane waves one after the other, on twice the frames' width."""
    cycles = np.fft.fftfreq(WIDE, PITCH_UM)
    x, y = cycles[None, :], cycles[:, None]
    along = 2 * np.pi * SCALE * z_um * np.sqrt(WAVELENGTH_UM**-2 - x**2 - y**2)
    beside = 2 * np.pi * z_um * (x * DRIFT[0] + y * DRIFT[1])
    field = np.fft.ifft2(np.fft.fft2(object_field()) * np.exp(1j * (along + beside)))
    middle = slice((WIDE - PIXELS) // 2, (WIDE + PIXELS) // 2)
    return np.abs(field)[middle, middle]


def frame(z_um: float, gain: float = 1.0) -> Frame:
    electrons = 4000.0 * (gain * recorded_amplitude(z_um)) ** 2
    counts = np.random.default_rng(int(z_um)).poisson(electrons).astype(np.uint16)
    settings = {"pixel_pitch_um": PITCH_UM, "wavelength_um": WAVELENGTH_UM, "plane_distance_mm": 1e-3 * z_um}
    return Frame(counts, FrameSettings(**settings, **DEFAULT_FRAME_SETTINGS))


def alike(found: FreeSpaceField, z_um: float) -> float:
    """Correlation of a predicted amplitude and the true one, away from the border."""
    inner = slice(16, -16)
    modelled, true = found.amplitude(1e-3 * z_um)[inner, inner], recorded_amplitude(z_um)[inner, inner]
    return float(np.corrcoef(modelled.flat, true.flat)[0, 1])


@pytest.mark.filterwarnings("ignore::wavesim.calibration.free_space.NotExplainedWarning")
def test_a_stack_tells_its_drift_its_scale_and_its_exposures_and_predicts_other_planes() -> None:
    frames = [frame(z, 1.0 / gain) for z, gain in zip(PLANES_UM, GAINS, strict=True)]
    found = reconstruct_free_space(frames, calibrates=True, iterations=60)
    assert found.distance_scale == pytest.approx(SCALE, abs=0.01)
    np.testing.assert_allclose(found.drift, DRIFT, atol=1e-3)
    np.testing.assert_allclose(found.gains / np.mean(found.gains), GAINS / np.mean(GAINS), atol=0.01)
    assert found.misfit[-1] < 1.1 * found.stack.noise
    assert alike(found, 35.0) > 0.998
    assert alike(found, 0.0) > 0.98

    at_stated_planes = reconstruct_free_space(frames, iterations=60)
    assert at_stated_planes.distance_scale == pytest.approx(1.0)
    assert at_stated_planes.drift == pytest.approx((0.0, 0.0))
    assert alike(at_stated_planes, 35.0) < 0.99


def weak_frame(z_um: float, phase_rad: float, absorbs: bool = False, noise: bool = True) -> Frame:
    """Frame of a disc with a soft edge, of weak phase or absorption, in the middle of even light."""
    position = PITCH_UM * (np.arange(WIDE) - WIDE / 2)
    disc = 1.0 / (1.0 + np.exp((np.hypot(position[:, None], position) - 8.0) / 0.8))
    cycles = np.fft.fftfreq(WIDE, PITCH_UM)
    along = 2 * np.pi * z_um * np.sqrt(WAVELENGTH_UM**-2 - cycles[:, None] ** 2 - cycles**2)
    spectrum = np.fft.fft2(np.exp((-1.0 if absorbs else 1.0j) * phase_rad * disc))
    field = np.fft.ifft2(spectrum * np.exp(1j * along))
    middle = slice((WIDE - PIXELS) // 2, (WIDE + PIXELS) // 2)
    electrons = 4000.0 * np.abs(field[middle, middle]) ** 2
    counts = np.random.default_rng(50 + int(z_um)).poisson(electrons) if noise else np.rint(electrons)
    settings = {"pixel_pitch_um": PITCH_UM, "wavelength_um": WAVELENGTH_UM, "plane_distance_mm": 1e-3 * z_um}
    return Frame(counts.astype(np.uint16), FrameSettings(**settings, **DEFAULT_FRAME_SETTINGS))


@pytest.mark.parametrize(
    ("planes_um", "phase_rad", "absorbs"),
    [
        ((0.0, 2.0, 4.0), 0.1, False),
        ((-5.0, 0.0, 5.0), 0.1, False),
        ((0.0, 10.0), 0.5, False),
        ((0.0, 40.0), 0.5, True),
    ],
)
def test_distances_that_frames_do_not_determine_stay_as_stated(
    planes_um: tuple[float, ...], phase_rad: float, absorbs: bool
) -> None:
    """Phase and defocus of a weak object have the same effect; exposures are found nevertheless."""
    frames = [weak_frame(z, phase_rad, absorbs) for z in planes_um]
    dimmer = frames[-1].settings.replaced(exposure=1.1)
    frames[-1] = Frame(frames[-1].counts, dimmer)
    with pytest.warns(HeldDistancesWarning, match="stay as stated"):
        found = reconstruct_free_space(frames, calibrates=True, iterations=30)
    assert not found.seeks_distances
    assert found.distance_scale == pytest.approx(1.0)
    np.testing.assert_allclose(1e3 * found.stack.distances_mm, planes_um, atol=1e-9)
    assert found.gains[-1] / found.gains[0] == pytest.approx(np.sqrt(1.1), abs=0.005)


def test_distances_out_of_the_range_of_the_search_stay_as_stated_and_the_reason_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(free_space, "SCALES", (0.8, 1.02))
    monkeypatch.setattr(free_space, "best_scale", lambda stack: SCALE)
    with pytest.warns(HeldDistancesWarning, match=r"0\.8 to 1\.02"):
        found = reconstruct_free_space([frame(z) for z in PLANES_UM], calibrates=True, iterations=10)
    assert found.scale_deviation is not None
    assert found.scale_deviation < 0.005
    assert found.distance_scale == pytest.approx(1.0)


def test_the_deviation_of_the_scale_grows_as_the_object_becomes_weaker() -> None:
    """In inverse proportion to the phase or more, since noise hides more of its band."""

    def deviation(phase_rad: float) -> float:
        frames = [weak_frame(z, phase_rad) for z in (10.0, 30.0, 80.0)]
        recorded = recorded_planes(frames)
        planes = [replace(one, distance_mm=1e-3 * z) for one, z in zip(recorded, (10, 30, 80), strict=True)]
        stack = stack_of(planes, 1e-3 * PITCH_UM, WAVELENGTH_UM)
        field, _, _ = descend(stack, 40, calibrates=False)
        return scale_deviation(stack, field)

    assert deviation(0.1) > 4.0 * deviation(0.5)


def test_even_frames_have_no_correlation_and_go_into_json() -> None:
    """A phase object in focus, without noise."""
    even, others = weak_frame(0.0, 0.5, noise=False), [weak_frame(z, 0.5, noise=False) for z in (10.0, 30.0)]
    assert np.ptp(even.counts) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = reconstruct_free_space([even, *others], calibrates=True, iterations=5)
        blank = [Frame(even.counts, one.settings) for one in others]
        nothing = reconstruct_free_space(blank, iterations=3)
    assert found.correlations[0] is None
    assert found.correlations[1] is not None
    assert nothing.correlations == (None, None)
    for one in (found, nothing):
        json.dumps(one.as_dict(), allow_nan=False)


def real_frames(*planes_um: int) -> list[Frame]:
    folder = GOLDEN / "through_focus"
    given = {"pixel_pitch_um": 0.32, "wavelength_um": 0.532, **DEFAULT_FRAME_SETTINGS}
    return [read_frame(folder / f"z_{z:+04d}_um.png", plane_distance_mm=1e-3 * z, **given) for z in planes_um]


@pytest.mark.filterwarnings("ignore::wavesim.calibration.free_space.NotExplainedWarning")
def test_a_real_series_predicts_a_plane_that_it_was_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(free_space, "SCALES", (0.94, 1.07))
    found = reconstruct_free_space(real_frames(10, 30, 80), calibrates=True, iterations=100)
    assert found.distance_scale == pytest.approx(1.0, abs=0.03)
    assert found.drift == pytest.approx((0.003, -0.006), abs=0.002)
    predicted = found.amplitude(0.05)[32:-32, 32:-32]
    stated = np.sqrt(real_frames(50)[0].counts.astype(float))[32:-32, 32:-32]
    assert np.corrcoef(predicted.flat, stated.flat)[0, 1] > 0.84


def test_frames_of_one_plane_are_refused() -> None:
    with pytest.raises(InputError, match="two planes or more"):
        reconstruct_free_space([frame(10.0)])


def test_frames_of_several_wavelengths_are_refused() -> None:
    colours = ColourFilters.monochrome((WAVELENGTH_UM, 0.6))
    frames = [frame(z_um) for z_um in PLANES_UM[:2]]
    coloured = [Frame(one.counts, one.settings.replaced(colours=colours)) for one in frames]
    with pytest.raises(InputError, match=r"0\.5, 0\.6 µm were recorded at once"):
        reconstruct_free_space(coloured)


def test_frames_of_another_wavelength_are_told_not_to_be_explained() -> None:
    frames = [frame(z) for z in PLANES_UM]
    wrong = [Frame(one.counts, one.settings.model_copy(update={"wavelength_um": 0.9})) for one in frames]
    with pytest.warns(NotExplainedWarning, match="within their noise"):
        reconstruct_free_space(wrong, iterations=40)


@pytest.mark.parametrize(
    ("values", "words"),
    [({"iterations": 0}, "iterations = 0"), ({"aperture": 1.5}, "numerical_aperture = 1.5")],
)
def test_values_of_no_use_are_refused(values: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        reconstruct_free_space([frame(10.0), frame(25.0)], **values)  # type: ignore[arg-type]


def test_a_png_says_nothing_of_its_counts(tmp_path: Path) -> None:
    Image.fromarray(frame(10.0).counts).save(tmp_path / "frame.png")
    given = {"pixel_pitch_um": 0.4, "wavelength_um": 0.5, "plane_distance_mm": 0.01}
    with pytest.warns(AssumedWarning, match="exposure = 1"):
        assert read_frame(tmp_path / "frame.png", DEFAULT_FRAME_SETTINGS, **given).settings.bits == 16
