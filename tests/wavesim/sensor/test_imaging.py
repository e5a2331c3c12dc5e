"""An object through a lens in one call, on a bench that is not as designed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.poses import Pose, SurfacePerturbation
from wavesim.engines.with_ghost import WithGhost
from wavesim.fields.field import Field
from wavesim.metrics.ghosts import GhostPlane, ghost_in_residuals
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState
from wavesim.sensor.imaging import Imaged, image
from wavesim.sensor.merged_exposures import estimate_intensity
from wavesim.sensor.sensor import interference_on_pixels, light_on_pixels
from wavesim.sensor.windows import footprint_mm, light_window
from wavesim.targets.patch import lit

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
SETTINGS: dict[str, Any] = {
    "patch_mm": 0.03,
    "engine": "eikonal",
    "error": 0.3,
    "noise": False,
    "pixels": 140,
}


def seen(state: SystemState | Pose | None = None, **changes: Any) -> Imaged:
    return image(LENS, "star", state=state, **SETTINGS | changes)


def pictures(imaged: Imaged) -> list[np.ndarray]:
    return [estimate_intensity(frame)[0] for frame in imaged.frames]


@pytest.fixture(scope="module")
def nominal() -> Imaged:
    return seen()


def test_a_pose_is_that_of_the_settings(nominal: Imaged) -> None:
    one, other = seen(Pose(decenter_x_mm=0.004)), seen(decenter_x_mm=0.004)
    for a, b, c in zip(one.frames, other.frames, nominal.frames, strict=True):
        assert np.array_equal(a.counts, b.counts)
        assert not np.array_equal(a.counts, c.counts)
    with pytest.raises(InputError, match=r"state: .*decenter"):
        seen(Pose(), decenter_x_mm=0.004)


def test_a_sensor_beside_its_place_sees_the_light_beside_its_middle(nominal: Imaged) -> None:
    pixel_mm = 1e-3 * LENS.sensor.pixel_pitch_um
    moved = seen(SystemState(sensor_shift_mm=(3 * pixel_mm, 0.0, 0.0)))
    for shown, expected in zip(pictures(moved), pictures(nominal), strict=True):
        here, there = shown[:, :-3], expected[:, 3:]
        assert np.linalg.norm(here - there) < 0.03 * np.linalg.norm(there)


def test_planes_are_where_the_placement_says_and_frames_say_what_the_stage_does() -> None:
    one = seen(SystemState(plane_distance_errors_mm=(0.0, 0.004)))
    other = seen(stage_error_mm=(0.0, 0.004))
    for a, b in zip(one.frames, other.frames, strict=True):
        assert a.settings == b.settings
        assert np.array_equal(a.counts, b.counts)


def test_object_surface_light_and_tilt_change_the_frames(nominal: Imaged) -> None:
    for changed in (
        SystemState(object_shift_mm=(0.002, 0.0, 0.0)),
        SystemState(surface_perturbations={1: SurfacePerturbation(radius_mm=0.01)}),
        SystemState(wavelength_um=0.56),
        SystemState(sensor_tilt_deg=(0.0, 5.0)),
    ):
        for one, other in zip(pictures(seen(changed)), pictures(nominal), strict=True):
            assert one.shape == other.shape
            assert np.linalg.norm(one - other) > 1e-3 * np.linalg.norm(other)


def test_settings_of_a_bench_are_the_bench(nominal: Imaged) -> None:
    """Light, lens, shifts of planes and backgrounds: the same frames from options and from a bench."""
    changes = {
        "light_error_deg": (0.2, 0.0),
        "light_amplitude": "10:0.1",
        "plane_shift_um": ((0, 0), (3.2, 0)),
    }
    options = seen(**changes, plane_background=(0.0, 0.05), working_distance_error_mm=0.002)
    bench = SystemState(
        object_shift_mm=(0.0, 0.0, -0.002),
        light=LightErrors((0.2, 0.0), {(1, 0): 0.1}),
        plane_shifts_um=((0.0, 0.0), (3.2, 0.0)),
        plane_backgrounds=(0.0, 0.05),
    )
    for one, other in zip(options.frames, seen(bench).frames, strict=True):
        assert np.array_equal(one.counts, other.counts)
    with pytest.raises(InputError, match=r"state: .*errors of light"):
        seen(bench, light_amplitude="10:0.1")


FINE: dict[str, Any] = {"bits": 16, "full_well_electrons": 1e7}
"""Counts so fine that faint light is not lost in them."""


def test_a_background_is_a_share_of_what_a_plane_records() -> None:
    clear, lit = pictures(seen(**FINE)), pictures(seen(plane_background=(0.0, 0.2), **FINE))
    assert np.array_equal(clear[0], lit[0])
    extra = lit[1] - clear[1]
    assert extra.mean() == pytest.approx(0.2 * lit[1].mean(), rel=0.02)
    assert extra.std() < 0.1 * extra.mean()


def test_a_background_may_be_uneven() -> None:
    slopes = (0.04, -0.02)
    even, uneven = (
        pictures(seen(plane_background=(0.1,), background_slope=pairs, **FINE))[1]
        for pairs in ((), ((0.0, 0.0), slopes))
    )
    extra = (uneven - even) / even.mean()
    across, down = (
        np.polyfit(np.linspace(-1.0, 1.0, even.shape[1 - axis]), extra.mean(axis=axis), 1)[0]
        for axis in (0, 1)
    )
    assert (across, down) == pytest.approx(slopes, rel=0.05)


def test_vibration_blurs_as_a_normal_distribution() -> None:
    """The spectrum of the picture falls as exp(-2 (pi s f)^2) for the standard deviation s."""
    pitch_um, vibration_um = LENS.sensor.pixel_pitch_um, 1.5
    sharp, blurred = (pictures(seen(vibration_um=um, **FINE))[1] for um in (0.0, vibration_um))
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=1e-3)
    cycles = np.hypot(np.fft.fftfreq(sharp.shape[0])[:, None], np.fft.fftfreq(sharp.shape[1])) / pitch_um
    spectra = [
        np.fft.fft2(picture * np.outer(*map(np.hanning, picture.shape))) for picture in (sharp, blurred)
    ]
    # Waves of 8 to 20 pixels, which no aliases reach.
    some = (cycles > 1.0 / (20.0 * pitch_um)) & (cycles < 1.0 / (8.0 * pitch_um))
    expected = np.exp(-2.0 * (np.pi * vibration_um * cycles[some]) ** 2)
    found = np.vdot(spectra[0][some] * expected, spectra[1][some]) / np.vdot(
        spectra[0][some] * expected, spectra[0][some] * expected
    )
    assert found.real == pytest.approx(1.0, abs=0.02)
    ratio = np.linalg.norm(spectra[1][some] - spectra[0][some] * expected) / np.linalg.norm(spectra[1][some])
    assert ratio < 0.1


def test_a_wide_source_adds_intensities_of_tilted_light(nominal: Imaged) -> None:
    """As much light as before, but neither the coherent picture nor that of one direction."""
    wide = pictures(seen(source_deg=1.0))[1]
    modes = Source(1.0).modes(LENS.wavelengths_um[0])
    alone = [pictures(seen(SystemState(light=LightErrors(mode.tilt_deg))))[1] for mode in modes[:2]]
    coherent = pictures(nominal)[1]
    assert np.linalg.norm(wide - coherent) > 0.02 * np.linalg.norm(coherent)
    assert wide.sum() == pytest.approx(coherent.sum(), rel=0.01)
    assert all(np.linalg.norm(wide - one) > 0.02 * np.linalg.norm(wide) for one in alone)


def test_a_band_of_wavelengths_adds_their_intensities(nominal: Imaged) -> None:
    coloured, single = pictures(seen(bandwidth_nm=100.0))[1], pictures(nominal)[1]
    assert 0.003 < np.linalg.norm(coloured - single) / np.linalg.norm(single) < 0.6
    assert coloured.sum() == pytest.approx(single.sum(), rel=0.02)


def test_an_engine_is_chosen_for_each_wavelength_of_a_band(nominal: Imaged) -> None:
    """The band changes the picture as much as with an engine that is named."""

    def change(coloured: Imaged, single: Imaged) -> float:
        one, other = pictures(coloured)[1], pictures(single)[1]
        return float(np.linalg.norm(one - other) / np.linalg.norm(other))

    chosen = change(seen(bandwidth_nm=50.0, engine="auto"), seen(engine="auto"))
    assert chosen == pytest.approx(change(seen(bandwidth_nm=50.0), nominal), rel=0.2)


def test_tiles_of_a_whole_field_record_on_upright_planes_alone() -> None:
    with pytest.raises(InputError, match="sensor_tilt_deg: must be 0 with engine hierarchical"):
        seen(SystemState(sensor_tilt_deg=(1.0, 0.0)), engine="hierarchical")


def test_a_ghost_is_found_in_what_frames_with_one_record(nominal: Imaged) -> None:
    """Its share, and its phase as rays have it, from the first plane's light less the modelled one."""
    share = 0.0018
    ghosted = seen(ghost=share)
    engine = ghosted.engine
    assert isinstance(engine, WithGhost)
    transmission = ghosted.target.transmission
    light = lit(ghosted.patch, ghosted.settings)
    behind = light.with_values(light.values * transmission.values)
    direct, ghost = engine.straight.forward(behind), engine.ghosts[0].forward(behind)
    distance_mm = LENS.sensor.plane_distances_mm[0]
    window = light_window(ghosted.sensor, footprint_mm(LENS, ghosted.patch, distance_mm))
    model, with_it = (light_on_pixels(field, window) for field in (direct, engine.forward(behind)))
    amplitude = np.sqrt(model)
    sigma = np.full(model.shape, 1e-4 * amplitude.max())
    product = interference_on_pixels(direct, ghost, window)
    found = ghost_in_residuals([GhostPlane(np.sqrt(with_it) - amplitude, sigma, amplitude, product)])
    assert found.amplitude == pytest.approx(np.sqrt(share), rel=0.1)
    assert found.significance > 5.0
    for shown, without in zip(pictures(ghosted), pictures(nominal), strict=True):
        changed = np.linalg.norm(shown - without) / np.linalg.norm(without)
        assert 2e-3 < changed < 2.0 * np.sqrt(share)


def test_a_ghost_that_an_engine_cannot_carry() -> None:
    with pytest.raises(InputError, match="ghost: engine hierarchical"):
        seen(ghost=0.01, engine="hierarchical")


def test_a_single_layer_in_the_object_plane_is_the_object(nominal: Imaged) -> None:
    layered = seen(layers_um=(0.0,))
    assert [layer.name for layer in layered.layers] == ["star"]
    for one, other in zip(pictures(layered), pictures(nominal), strict=True):
        assert np.linalg.norm(one - other) < 1e-3 * np.linalg.norm(other)


def test_tilted_light_shifts_the_shadow_of_a_first_layer_by_distance_times_slope(nominal: Imaged) -> None:
    grid, tilt_deg, distance_um = nominal.patch.grid, 5.0, 20.0
    spot = np.exp(-grid.radius_squared_mm2() / 0.004**2)
    first = Field(grid, spot.astype(complex), nominal.patch.wavelength_um)
    second = first.with_values(np.ones_like(first.values))
    changes = SETTINGS | {"patch_mm": None, "layers_um": (-distance_um, 0.0)}
    taken = image(LENS, (first, second), state=SystemState(light=LightErrors((tilt_deg, 0.0))), **changes)
    light = np.abs(taken.target.transmission.values) ** 2
    centre_um = 1e3 * float(np.sum(light * grid.x_mm) / np.sum(light))
    assert centre_um == pytest.approx(distance_um * np.tan(np.radians(tilt_deg)), rel=0.02)


def test_layers_need_light_of_one_direction_and_wavelength() -> None:
    for changes in (
        {"source_deg": 2.0},
        {"bandwidth_nm": 5.0},
        {"state": SystemState(source=Source(width_deg=2.0))},
    ):
        with pytest.raises(InputError, match="source_deg, bandwidth_nm: must be 0 with layers_um"):
            seen(**changes, layers_um=(-20.0, 0.0))


def test_objects_must_be_as_many_as_layers() -> None:
    with pytest.raises(InputError, match="2 objects for 3 layers"):
        image(LENS, ("star", "empty"), **SETTINGS, layers_um=(-20.0, -10.0, 0.0))


def test_too_large_a_spectrum_is_refused_with_the_engine_that_needs_none() -> None:
    """Behind the full-size lens even a small patch has wide light, which 20 mm of free space cannot carry."""
    lens = load_design("designs/paper_singlet.toml")
    with pytest.raises(SamplingError, match=r"samples of the spectrum .*, or engine hierarchical"):
        image(lens, "usaf", patch_mm=0.1)
