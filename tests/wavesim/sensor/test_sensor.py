"""The sensor against closed forms: pixel integrals, noise of each kind, clipping, and back to intensity."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import erf

from lensdesign.errors import InputError
from lensdesign.lens.lens import Sensor
from wavesim.fields.field import Field, Grid
from wavesim.fields.propagator import propagate
from wavesim.sensor.camera_noise import Electronics, SaturationWarning, expose, exposure_for, plane_seeds
from wavesim.sensor.frames import Frame, FrameSettings
from wavesim.sensor.merged_exposures import estimate_intensity
from wavesim.sensor.pixel_integration import means_over_pixels
from wavesim.sensor.sensor import Camera, FootprintWarning, light_on_pixels, on_sensor, sensor_grid
from wavesim.targets.illumination import plane_wave

PITCH_UM = 3.2
SENSOR = Sensor(pixel_pitch_um=PITCH_UM, pixels=(48, 40), plane_distances_mm=(3.0,))
WAIST_MM = 0.02
Z_MM = 15.0


def gaussian(
    grid: Grid, centre_mm: tuple[float, float] = (0.004, -0.003), tilt_per_mm: float = 20.0
) -> Field:
    """A beam whose intensity is exp(-2 r^2 / w^2), running askew."""
    y, x = grid.y_mm[:, None] - centre_mm[1], grid.x_mm - centre_mm[0]
    values = np.exp(-(x**2 + y**2) / WAIST_MM**2 + 2j * np.pi * tilt_per_mm * x)
    return Field(grid, values, 0.532)


def mean_gaussian(centre_mm: tuple[float, float], width: float) -> np.ndarray:
    """Its exact means over squares of pixels, from the error function."""
    grid = sensor_grid(SENSOR, Z_MM)
    half = 0.5 * width * grid.pitch_mm
    scale = math.sqrt(2.0) / WAIST_MM

    def along(at: np.ndarray) -> np.ndarray:
        if half == 0.0:
            return np.exp(-((scale * at) ** 2))
        high, low = erf(scale * (at + half)), erf(scale * (at - half))
        return math.sqrt(math.pi) / (4.0 * scale * half) * (high - low)

    return along(grid.y_mm - centre_mm[1])[:, None] * along(grid.x_mm - centre_mm[0])


def uniform(mean: float, count: int = 400) -> np.ndarray:
    return np.full((count, count), mean)


def quiet(**changes: Any) -> Electronics:
    """A sensor without read noise, one electron per count, 16 bits, and room to spare."""
    values: dict[str, Any] = {
        "full_well_electrons": 60_000.0,
        "read_noise_electrons": 0.0,
        "bits": 16,
        "offset_counts": 0.0,
        "gain_electrons_per_count": 1.0,
    }
    return Electronics(**(values | changes))


@pytest.mark.parametrize("width", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("oversampling", [2, 3, 4])
def test_pixels_integrate_a_gaussian_as_the_error_function_says(width: float, oversampling: int) -> None:
    field = gaussian(sensor_grid(SENSOR, Z_MM, oversampling))
    got = light_on_pixels(field, SENSOR, fill_factor=width, oversampling=oversampling)
    assert abs(got - mean_gaussian((0.004, -0.003), width)).max() < 2e-9


@given(oversampling=st.integers(2, 6), pixels=st.integers(2, 12), width=st.floats(0.0, 1.0), data=st.data())
def test_pixels_pass_a_cosine_by_their_mtf(
    oversampling: int, pixels: int, width: float, data: st.DataObject
) -> None:
    """Also one beyond the pixels' Nyquist frequency, which is seen as a lower one."""
    order = data.draw(st.integers(0, oversampling * pixels - 1))
    cycles_per_pixel = 0.5 * order / pixels
    fine = (np.arange(oversampling * pixels) + 0.5) / oversampling
    middle = np.arange(pixels) + 0.5
    got = means_over_pixels(np.cos(2 * np.pi * cycles_per_pixel * fine)[None], oversampling, width)[0]
    mtf = np.sinc(cycles_per_pixel * width)
    np.testing.assert_allclose(got, mtf * np.cos(2 * np.pi * cycles_per_pixel * middle), atol=1e-12)


@pytest.mark.parametrize("oversampling", [2, 3])
def test_full_pixels_lose_no_light(oversampling: int) -> None:
    field = gaussian(sensor_grid(SENSOR, Z_MM, oversampling))
    got = light_on_pixels(field, SENSOR, oversampling=oversampling)
    assert got.sum() * (1e-3 * PITCH_UM) ** 2 == pytest.approx(field.energy, rel=1e-12)


@pytest.mark.parametrize("width", [0.0, 1.0])
def test_any_grid_that_holds_the_field_gives_the_same_light(width: float) -> None:
    field = gaussian(Grid((90, 110), 2.1e-3, Z_MM, (0.002, 0.001)))
    got = light_on_pixels(field, SENSOR, fill_factor=width)
    assert abs(got - mean_gaussian((0.004, -0.003), width)).max() < 1e-7


@pytest.mark.parametrize(("more", "off_um"), [((12, 8), 0.0), ((11, 8), 0.0), ((12, 8), 0.3)])
def test_a_window_of_a_wider_field_sees_what_all_of_it_would(more: tuple[int, int], off_um: float) -> None:
    grid = sensor_grid(SENSOR, Z_MM, 2)
    wide = Grid((grid.shape[0] + more[0], grid.shape[1] + more[1]), grid.pitch_mm, Z_MM, (1e-3 * off_um, 0.0))
    got = light_on_pixels(gaussian(wide), SENSOR)
    assert abs(got - light_on_pixels(gaussian(grid), SENSOR)).max() < 1e-7


def test_point_pixels_take_the_samples_as_they_are() -> None:
    field = gaussian(sensor_grid(SENSOR, Z_MM))
    got = light_on_pixels(field, SENSOR, fill_factor=0.0, oversampling=1)
    np.testing.assert_array_equal(got, abs(field.values) ** 2)


@settings(max_examples=15)
@given(x=st.floats(-9.0, 9.0), y=st.floats(-9.0, 9.0))
def test_a_shifted_sensor_sees_the_light_shifted_the_other_way(x: float, y: float) -> None:
    field = gaussian(sensor_grid(SENSOR, Z_MM, 2))
    got = light_on_pixels(field, SENSOR, shift_um=(x, y))
    assert abs(got - mean_gaussian((0.004 - 1e-3 * x, -0.003 - 1e-3 * y), 1.0)).max() < 1e-7


@pytest.mark.parametrize("error_mm", [-0.3, 0.2])
def test_stage_error_records_the_field_farther_on(error_mm: float) -> None:
    field = gaussian(sensor_grid(SENSOR, Z_MM, 2))
    got = light_on_pixels(field, SENSOR, stage_error_mm=error_mm)
    want = light_on_pixels(propagate(field, error_mm), SENSOR)
    # The beam walks by the sine of its angle; not to move it would be an error of 0.1 and more.
    assert abs(got - want).max() < 1e-6
    assert abs(got - light_on_pixels(field, SENSOR)).max() > 0.05


def test_light_beside_the_sensor_is_told_with_its_share() -> None:
    field = gaussian(Grid((160, 160), 0.5e-3 * PITCH_UM, Z_MM), (0.5e-3 * PITCH_UM * 48, 0.0))
    with pytest.warns(FootprintWarning, match=r"^50 % .* 0\.1536 mm x 0\.128 mm"):
        light_on_pixels(field, SENSOR)


@pytest.mark.parametrize("off_um", [0.0, 200.0])
def test_a_sensor_in_the_dark_is_refused(off_um: float) -> None:
    field = gaussian(sensor_grid(SENSOR, Z_MM, 2))
    field = field if off_um else field.with_values(0.0 * field.values)
    with pytest.raises(InputError, match="no light"):
        light_on_pixels(field, SENSOR, shift_um=(off_um, 0.0))


def test_well_placed_light_is_recorded_without_a_word() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        light = light_on_pixels(gaussian(sensor_grid(SENSOR, Z_MM, 2)), SENSOR)
        (frame,) = Camera(SENSOR, Electronics()).frames(light, 3.0, 0.532, 0)
    assert not np.any(frame.saturated)


@pytest.mark.parametrize("mean", [3.0, 400.0, 9000.0])
def test_shot_noise_has_the_mean_and_variance_of_poisson(mean: float) -> None:
    counts = expose(uniform(mean), 1.0, quiet(), 1).astype(float)
    number = counts.size
    assert counts.mean() == pytest.approx(mean, abs=4.5 * math.sqrt(mean / number))
    spread = math.sqrt((mean + 2.0 * mean**2) / number)  # of a Poisson sample's variance
    assert counts.var() == pytest.approx(mean, abs=4.5 * spread)


def test_read_noise_has_its_variance() -> None:
    """In the dark, with the rounding of 0.5 electrons per count."""
    noisy = quiet(read_noise_electrons=5.0, gain_electrons_per_count=0.5, offset_counts=200.0)
    counts = expose(uniform(0.0), 1.0, noisy, 2) * 0.5
    assert counts.mean() == pytest.approx(100.0, abs=0.06)
    assert counts.var() == pytest.approx(25.0 + 0.25 / 12.0, rel=4.5 * math.sqrt(2.0 / counts.size))


@pytest.mark.parametrize("gain", [0.7, 2.5, 40.0])
def test_rounding_has_a_twelfth_of_a_count_squared(gain: float) -> None:
    electrons = np.random.default_rng(5).uniform(0.0, 40_000.0, (1, 200_000))
    frame = frame_of(
        expose(electrons, 1.0, quiet(gain_electrons_per_count=gain, offset_counts=7.0), None), gain
    )
    error = estimate_intensity(frame)[0] - electrons
    assert abs(error).max() <= 0.5 * gain * (1.0 + 1e-9)
    assert error.var() == pytest.approx(gain**2 / 12.0, rel=4.5 * math.sqrt(0.8 / electrons.size))


def frame_of(counts: np.ndarray, gain: float, **changes: Any) -> Frame:
    values: dict[str, Any] = {
        "pixel_pitch_um": PITCH_UM,
        "plane_distance_mm": 3.0,
        "wavelength_um": 0.532,
        "exposure": 1.0,
        "bits": 16,
        "offset_counts": 7.0,
        "gain_electrons_per_count": gain,
    }
    return Frame(counts, FrameSettings(**(values | changes)))


@pytest.mark.parametrize("brightest", [200.0, 8000.0])
def test_the_stated_variance_is_that_of_the_error(brightest: float) -> None:
    big = Sensor(pixel_pitch_um=PITCH_UM, pixels=(300, 260), plane_distances_mm=(3.0,))
    field = gaussian(sensor_grid(big, Z_MM, 2))
    field = field.with_values(field.values + 0.2)
    electronics = Electronics(read_noise_electrons=3.0)
    truth = light_on_pixels(Field(field.grid, field.values, 0.532), big)
    camera = Camera(big, electronics, peak_fill=brightest / 10_000.0)
    (frame,) = camera.frames(truth, 3.0, 0.532, 3)
    intensity, variance = estimate_intensity(frame)
    assert not frame.saturated.any()
    squares = (intensity - truth) ** 2 / variance
    # Where few electrons fall, the variance is estimated from the same count: still unbiased within this.
    assert (intensity - truth).mean() == pytest.approx(0.0, abs=4.5 * math.sqrt(variance.mean() / truth.size))
    assert squares.mean() == pytest.approx(1.0, abs=0.25 if brightest < 1000.0 else 0.03)


def test_the_brightest_pixel_gets_its_electrons() -> None:
    light = light_on_pixels(gaussian(sensor_grid(SENSOR, Z_MM, 2)), SENSOR)
    electronics = Electronics(full_well_electrons=10_000.0)
    (frame,) = Camera(SENSOR, electronics, peak_fill=0.75).frames(light, 3.0, 0.532, None)
    assert estimate_intensity(frame)[0].max() * frame.settings.exposure == pytest.approx(
        7500.0, abs=0.5 * electronics.gain
    )
    assert frame.settings.exposure == exposure_for(light, 7500.0)


def test_full_well_takes_all_counts_when_no_gain_is_given() -> None:
    counts = expose(np.array([[0.0, 10_000.0]]), 1.0, Electronics(), None)
    np.testing.assert_array_equal(counts, [[64, 4095]])


@pytest.mark.parametrize("changes", [{"full_well_electrons": 900.0}, {"bits": 9}])
def test_saturated_pixels_are_counted_and_known_in_the_frame(changes: dict[str, float]) -> None:
    """At full well, or at the top count of a gain that does not reach it."""
    values = {"full_well_electrons": 4000.0, "gain_electrons_per_count": 2.0, "offset_counts": 60.0}
    electronics = quiet(**(values | changes))
    light = np.array([[100.0, 880.0, 1100.0], [3999.0, 5000.0, 1e30]])
    with pytest.warns(SaturationWarning, match=r"^4 of 6 pixels"):
        counts = expose(light, 1.0, electronics, None)
    said = {"bits": electronics.bits, "saturation_counts": electronics.saturation_counts}
    frame = frame_of(counts, 2.0, offset_counts=60.0, **said)
    np.testing.assert_array_equal(frame.saturated, light > 900.0)
    assert np.all(np.isinf(estimate_intensity(frame)[1]) == frame.saturated)


def test_every_pixel_clipped_at_full_well_is_marked_in_spite_of_read_noise() -> None:
    electronics = Electronics(read_noise_electrons=5.0, gain_electrons_per_count=4.0)
    with pytest.warns(SaturationWarning, match=r"^10000 of 10000"):
        counts = expose(uniform(20_000.0, 100), 1.0, electronics, 4)
    marked = (counts >= electronics.saturation_counts).mean()
    assert marked > 0.997
    assert counts.min() < counts.max()


def test_light_without_end_saturates_under_noise() -> None:
    with pytest.warns(SaturationWarning, match=r"^1 of 2 pixels"):
        counts = expose(np.array([[5.0, 1e300]]), 1.0, Electronics(read_noise_electrons=0.0), 6)
    assert counts[0, 1] == 4095


@pytest.mark.parametrize("gain", [4.0, 100.0])
def test_rounding_counts_in_the_stated_variance(gain: float) -> None:
    """Also where a count is many electrons, so that rounding is the larger part."""
    light = np.random.default_rng(9).uniform(0.0, 3000.0, (300, 300))
    frame = frame_of(expose(light, 1.0, quiet(gain_electrons_per_count=gain, offset_counts=7.0), 8), gain)
    intensity, variance = estimate_intensity(frame)
    assert np.mean((intensity - light) ** 2) == pytest.approx(variance.mean(), rel=0.03)


def test_seeds_repeat_noise_and_planes_do_not_share_it() -> None:
    light = uniform(500.0, 200)
    first, second = plane_seeds(7, 2)
    a, b = (expose(light, 1.0, quiet(), seed).astype(float) for seed in (first, second))
    np.testing.assert_array_equal(a, expose(light, 1.0, quiet(), plane_seeds(7, 2)[0]))
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4.5 / math.sqrt(light.size)
    assert plane_seeds(None, 2) == [None, None]


def test_the_frame_says_how_it_was_recorded() -> None:
    light = light_on_pixels(gaussian(sensor_grid(SENSOR, Z_MM, 2)), SENSOR, stage_error_mm=0.01)
    (frame,) = Camera(SENSOR, Electronics(), (0.5,)).frames(light, 3.0, 0.532, 5)
    said, exposure = frame.settings, 0.5 * exposure_for(light, 8000.0)
    assert (said.plane_distance_mm, said.wavelength_um, said.pixel_pitch_um) == (3.0, 0.532, PITCH_UM)
    assert (said.bits, said.offset_counts, said.exposure) == (12, 64.0, exposure)
    assert frame.counts.shape == (40, 48)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"oversampling": 1}, "oversampling = 1"),
        ({"oversampling": 2.5}, "oversampling = 2.5"),
        ({"fill_factor": 1.5}, "fill_factor = 1.5"),
        ({"fill_factor": math.nan}, "fill_factor = nan"),
        ({"shift_um": (math.nan, 0.0)}, "shift_um"),
        ({"stage_error_mm": math.inf}, "stage_error_mm = inf"),
    ],
)
def test_bad_settings_are_named(changes: dict[str, object], words: str) -> None:
    field = gaussian(sensor_grid(SENSOR, Z_MM, 2))
    with pytest.raises(InputError, match=words):
        light_on_pixels(field, SENSOR, **changes)  # type: ignore[arg-type]


def test_bad_light_is_refused() -> None:
    field = gaussian(sensor_grid(SENSOR, Z_MM, 2))
    with pytest.raises(InputError, match="not finite"):
        light_on_pixels(field.with_values(field.values * np.nan), SENSOR)
    with pytest.raises(InputError, match="meridional line"):
        light_on_pixels(Field(Grid((8,), 1e-3, 0.0), np.ones(8), 0.5), SENSOR)
    with pytest.raises(InputError, match="finite and not negative"):
        expose(np.array([[-1.0]]), 1.0, quiet(), None)
    with pytest.raises(InputError, match="brightest_electrons = 0"):
        exposure_for(uniform(1.0, 2), 0.0)
    with pytest.raises(InputError, match="no light to expose for"):
        exposure_for(uniform(0.0, 2), 1.0)
    with pytest.raises(InputError, match="seed = -1"):
        expose(uniform(1.0, 2), 1.0, quiet(), -1)
    with pytest.raises(InputError, match=r"offset_counts = .* 4 bits"):
        expose(uniform(1.0, 2), 1.0, Electronics(bits=4), None)
    with pytest.raises(InputError, match="plane_distance_mm"):
        Camera(SENSOR, Electronics()).frames(light_on_pixels(field, SENSOR), math.nan, 0.532, None)


def test_sensor_turns_about_its_own_middle() -> None:
    """The spot of a leaning beam widens with the angle at which it falls on the turned sensor."""
    grid = Grid((256, 256), 1.6e-3, 0.2, (0.004, 0.0))
    x, y = grid.x_mm - grid.centre_mm[0], grid.y_mm[:, None]
    spot = plane_wave(grid, 0.532, tilt_x_deg=4.0)
    spot = spot.with_values(spot.values * np.exp(-(x**2 + y**2) / 0.06**2))

    def width(field: Field) -> float:
        power = np.abs(field.values) ** 2
        assert field.grid.centre_mm == (0.0, 0.0)
        return float(np.sqrt((power.sum(axis=0) * field.grid.x_mm**2).sum() / power.sum()))

    wider = width(on_sensor(spot, (0.0, 10.0))) / width(on_sensor(spot))
    expected = np.cos(np.radians(4.0)) / np.cos(np.radians(4.0) - np.radians(10.0))
    assert wider == pytest.approx(expected, rel=2e-3)
