"""Means over the squares of pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.lens.lens import Sensor
from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.field import Field, Grid
from wavesim.fields.plane_waves import PlaneWaves
from wavesim.fields.propagator import propagator_to
from wavesim.fields.tilted_planes import TiltedPropagator
from wavesim.forward import bands
from wavesim.forward.pixel_means import LinePixelMeans, PixelMeans, tilt_changes
from wavesim.runtime.threads import for_blocks
from wavesim.sensor.sensor import light_on_pixels

PITCH = 3.2e-3
GRID = Grid((48, 40), PITCH, 1.0)
SHAPES = [(48, 40), (33, 70), (2, 5), (1, 6), (1, 1)]


def field(seed: int = 1) -> Field:
    """Speckle that fills nine tenths of the pixels' band, in a soft window."""
    rng = np.random.default_rng(seed)
    spectrum = rng.standard_normal(GRID.shape) + 1j * rng.standard_normal(GRID.shape)
    for axis, count in enumerate(GRID.shape):
        inside = np.abs(np.fft.fftfreq(count)) < 0.45
        spectrum *= inside.reshape((-1, 1) if axis == 0 else (1, -1))
    values = np.fft.ifft2(spectrum)
    edge = [np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in GRID.shape]
    return Field(GRID, values * np.outer(*edge), 0.532)


def speckle(shape: tuple[int, ...], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A spectrum that fills the band, and a number for each pixel."""
    random = np.random.default_rng(seed)
    return random.standard_normal(shape) + 1j * random.standard_normal(shape), random.random(shape)


def densely(spectrum: np.ndarray) -> np.ndarray:
    """Two samples a pixel along each axis: in its middle, and at its upper edge."""
    for axis, count in enumerate(spectrum.shape):
        few = np.moveaxis(spectrum, axis, 0)
        wide = np.zeros((2 * count, *few.shape[1:]), spectrum.dtype)
        wide[np.round(count * np.fft.fftfreq(count)).astype(int)] = few
        spectrum = 2.0 * np.moveaxis(np.fft.ifft(wide, axis=0), 0, axis)
    return spectrum


def means_of(pixels: PixelMeans, fine: np.ndarray) -> np.ndarray:
    """Means over the squares of samples as `densely` gives them: in NumPy's words."""
    for axis in range(fine.ndim):
        along = np.moveaxis(fine, axis, 0)
        total = pixels.taps[0] * along[::2]
        for away, tap in enumerate(pixels.taps[1:], start=1):
            half, behind, before = along[away % 2 :: 2], away // 2, away - away // 2
            total = total + tap * (np.roll(half, -behind, 0) + np.roll(half, before, 0))
        fine = np.moveaxis(total, 0, axis)
    return fine


def spread(pixels: PixelMeans, values: np.ndarray) -> np.ndarray:
    """The adjoint of the means of fine samples, such that means remain: in NumPy's words."""
    for axis in (1, 0):
        shape = list(values.shape)
        shape[axis] *= 2
        fine = np.zeros(shape, values.dtype)
        halves = np.moveaxis(fine, axis, 0)[::2], np.moveaxis(fine, axis, 0)[1::2]
        along = np.moveaxis(values, axis, 0)
        halves[0][...] = pixels.taps[0] * along
        for away, tap in enumerate(pixels.taps[1:], start=1):
            behind, before = away // 2, away - away // 2
            halves[away % 2][...] += tap * (np.roll(along, behind, 0) + np.roll(along, -before, 0))
        values = 2.0 * fine
    return values


def coarsely(fine: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Spectrum of fine samples within the pixels' band: the adjoint of `densely`."""
    spectrum = np.fft.fft2(fine)
    kept = [np.round(n * np.fft.fftfreq(n)).astype(int) for n in shape]
    return 0.25 * spectrum[np.ix_(*kept)]


@pytest.mark.parametrize("fill_factor", [0.3, 0.7, 1.0])
def test_means_are_those_of_the_sensor(fill_factor: float) -> None:
    """The sensor's means come from a cosine series, by another way."""
    one = field()
    sensor = Sensor(pixel_pitch_um=1e3 * PITCH, pixels=(40, 48), plane_distances_mm=(1.0,))
    expected = light_on_pixels(one, sensor, fill_factor=fill_factor, oversampling=4)
    pixels = PixelMeans(GRID, fill_factor)
    propagator = TransferFunction(GRID, 0.532, 0.0, np.complex128)
    means = pixels.intensity(pixels.propagate(np.fft.fft2(one.values), propagator))
    off = np.linalg.norm(means - expected) / np.linalg.norm(expected)
    at_points = np.linalg.norm(np.abs(one.values) ** 2 - expected) / np.linalg.norm(expected)
    assert off < 0.01
    assert off < 0.3 * at_points


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("fill_factor", [0.3, 1.0])
@pytest.mark.parametrize("distance_mm", [0.0, 0.4])
def test_means_in_blocks_are_those_of_all_fine_samples(
    shape: tuple[int, int], fill_factor: float, distance_mm: float
) -> None:
    grid = Grid(shape, PITCH, 1.0)
    pixels, propagator = (
        PixelMeans(grid, fill_factor),
        TransferFunction(grid, 0.532, distance_mm, np.complex128),
    )
    spectrum, _ = speckle(shape, 2)
    factor = PlaneWaves.of(grid, 0.532).transfer_function(distance_mm)
    fine = densely(spectrum * factor)
    found = pixels.intensity(pixels.propagate(spectrum, propagator))
    means = np.maximum(means_of(pixels, np.abs(fine) ** 2), 0.0)
    np.testing.assert_allclose(found, means, atol=1e-14 * np.ptp(np.abs(fine) ** 2))
    other, _ = speckle(shape, 5)
    product = (fine.conj() * densely(other * factor)).real
    found = pixels.products(pixels.propagate(spectrum, propagator), pixels.propagate(other, propagator))
    np.testing.assert_allclose(found, means_of(pixels, product), atol=1e-13 * np.abs(product).max())


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_the_way_back_in_blocks_is_that_of_all_fine_samples(shape: tuple[int, int], dtype: np.dtype) -> None:
    grid = Grid(shape, PITCH, 1.0)
    pixels, propagator = PixelMeans(grid, 1.0), TransferFunction(grid, 0.532, 0.4, dtype)
    spectrum, change = speckle(shape, 3)
    total = np.ones(shape, dtype)
    there = spectrum.astype(dtype)
    pixels.add_adjoint(
        pixels.propagate(there, propagator), change.astype(total.real.dtype), propagator, total
    )
    factor = PlaneWaves.of(grid, 0.532).transfer_function(0.4)
    fine = densely(spectrum * factor) * spread(pixels, change)
    expected = 1.0 + coarsely(fine, shape) * factor.conj()
    np.testing.assert_allclose(total, expected, atol=20.0 * np.finfo(dtype).eps * np.abs(expected).max())


@pytest.mark.parametrize("count", [1, 3, 6, 41])
@pytest.mark.parametrize("distance_mm", [0.0, 0.4])
def test_a_line_has_the_means_and_the_changes_of_a_plane_with_one_row(count, distance_mm) -> None:
    grid = Grid((1, count), PITCH, 1.0)
    propagator = TransferFunction(grid, 0.532, distance_mm, np.complex128)
    spectrum, factor = speckle((1, count), 7)
    found = []
    for pixels in (LinePixelMeans(Grid((count,), PITCH, 1.0), 0.9, 0.2), PixelMeans(grid, 0.9, 0.2)):
        change, added = np.zeros_like(spectrum), np.zeros_like(spectrum)
        means = pixels.intensity(pixels.propagate(spectrum, propagator))
        pixels.add_adjoint(pixels.propagate(spectrum, propagator), factor, propagator, added)

        def halved(values: np.ndarray, first: int) -> float:
            values *= 0.5
            return float(values.sum())

        results = pixels.apply_change(pixels.propagate(spectrum, propagator), halved, propagator, change)
        found.append((means, added, change, sum(results)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12 * np.abs(spectrum).max() ** 3)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.01, 1.0), st.integers(0, 100))
def test_the_way_back_is_the_adjoint(height: int, width: int, fill_factor: float, seed: int) -> None:
    """Means are a quadratic form of the spectrum, which its own derivative gives again."""
    grid = Grid((height, width), PITCH, 1.0)
    pixels, propagator = PixelMeans(grid, fill_factor), TransferFunction(grid, 0.532, 0.4, np.complex128)
    spectrum, change = speckle(grid.shape, seed)
    # So bright in the middle of the band that no mean is held at 0.
    spectrum[0, 0] += 100.0 * grid.size
    met = np.sum(change * pixels.intensity(pixels.propagate(spectrum, propagator)))
    total = np.zeros_like(spectrum)
    pixels.add_adjoint(pixels.propagate(spectrum, propagator), change, propagator, total)
    assert np.vdot(spectrum, total) / grid.size == pytest.approx(met, rel=1e-10)


def test_the_way_back_from_a_tilted_sensor_is_the_adjoint() -> None:
    pixels = PixelMeans(GRID, 0.8)
    propagator = TiltedPropagator(GRID, 0.532, 0.4, np.complex128, (3.0, -2.0), (1e-3, 2e-3))
    spectrum, change = speckle(GRID.shape, 6)
    spectrum[0, 0] += 100.0 * GRID.size
    met = np.sum(change * pixels.intensity(pixels.propagate(spectrum, propagator)))
    total = np.ones_like(spectrum)
    pixels.add_adjoint(pixels.propagate(spectrum, propagator), change, propagator, total)
    assert np.vdot(spectrum, total - 1.0) / GRID.size == pytest.approx(met, rel=1e-10)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (0.8, -0.5)])
def test_changes_with_the_tilt_are_those_of_the_light_on_pixels(
    axis: int, tilt_deg: tuple[float, float]
) -> None:
    pixels, spectrum, small = PixelMeans(GRID, 1.0), np.fft.fft2(field().values), 1e-2

    def propagator(step: float) -> TransferFunction | TiltedPropagator:
        tilt = [tilt_deg[n] + step * (n == axis) for n in range(2)]
        return propagator_to(GRID, 0.532, 0.4, np.complex128, (0.0, 0.0), (tilt[0], tilt[1]))

    ahead, behind = (
        pixels.intensity(pixels.propagate(spectrum, propagator(step))) for step in (small, -small)
    )
    slope = (ahead - behind) / (2.0 * small)
    change = tilt_changes(pixels, spectrum, propagator(0.0), 0.532)[axis]
    found = 2.0 * pixels.products(pixels.propagate(spectrum, propagator(0.0)), change)
    off = np.linalg.norm(found - slope) / np.linalg.norm(slope)
    assert off < 5e-3


def test_a_point_is_a_pixel_of_no_width() -> None:
    pixels, (spectrum, _) = PixelMeans(GRID, 0.0), speckle(GRID.shape, 4)
    found = pixels.intensity(pixels.propagate(spectrum, TransferFunction(GRID, 0.532, 0.0, np.complex128)))
    assert pixels.taps == [1.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(found, np.abs(np.fft.ifft2(spectrum)) ** 2, atol=1e-14)


def test_dense_samples_hold_the_coarse_ones() -> None:
    one = field()
    spectrum = np.fft.fft2(one.values)
    fine = densely(spectrum)
    np.testing.assert_allclose(fine[::2, ::2], one.values, atol=1e-12)
    np.testing.assert_allclose(coarsely(fine, GRID.shape), spectrum, atol=1e-10)


def test_means_and_spread_of_an_even_field_are_even() -> None:
    pixels = PixelMeans(GRID, 1.0)
    fine, coarse = (np.random.default_rng(2).random([k * n for n in GRID.shape]) for k in (2, 1))
    assert np.vdot(means_of(pixels, fine), coarse) == pytest.approx(
        0.25 * np.vdot(fine, spread(pixels, coarse))
    )
    assert spread(pixels, np.ones(GRID.shape)).mean() == pytest.approx(1.0)
    np.testing.assert_allclose(means_of(pixels, np.ones([2 * n for n in GRID.shape])), 1.0)


@pytest.mark.parametrize("shape", [*SHAPES, (300, 6)])
@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (3.0, -2.0)])
@pytest.mark.parametrize("band", [7, 128])
def test_one_pass_equals_means_and_adjoint(
    shape: tuple[int, int], tilt_deg: tuple[float, float], band: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bands may be narrower than the neighbourhood of a pixel, or as high as the plane."""
    monkeypatch.setattr(bands, "BAND", band)
    monkeypatch.setattr(bands, "NEW_ROWS", 1 + band % 5)
    grid = Grid(shape, PITCH, 1.0)
    pixels, propagator = (
        PixelMeans(grid, 0.8),
        propagator_to(grid, 0.532, 0.4, np.complex128, (1e-3, 2e-3), tilt_deg),
    )
    spectrum, wanted = speckle(shape, 7)

    def change(means: np.ndarray, first: int) -> float:
        means /= wanted[first : first + len(means)] + means
        return float(np.sum(means))

    expected, total = np.ones_like(spectrum), np.ones_like(spectrum)
    means = pixels.intensity(pixels.propagate(spectrum, propagator))
    expected_sum = change(means, 0)
    pixels.add_adjoint(pixels.propagate(spectrum, propagator), means, propagator, expected)
    assert sum(
        pixels.apply_change(pixels.propagate(spectrum, propagator), change, propagator, total)
    ) == pytest.approx(expected_sum)
    np.testing.assert_allclose(total, expected, atol=1e-13 * np.abs(expected).max())


def test_one_pass_does_not_depend_on_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Results are added in one order, so that they agree to the last bit."""
    shape = (520, 40)
    pixels = PixelMeans(Grid(shape, PITCH, 1.0), 1.0)
    propagator = TransferFunction(pixels.grid, 0.532, 0.4, np.complex64)
    spectrum = speckle(shape, 8)[0].astype(np.complex64)

    def found() -> tuple[list[float], np.ndarray]:
        total = np.zeros_like(spectrum)
        sums = pixels.apply_change(
            pixels.propagate(spectrum, propagator), lambda means, first: float(means.sum()), propagator, total
        )
        return sums, total

    several = found()
    monkeypatch.setattr(bands, "for_blocks", lambda work, count, block: for_blocks(work, count, block, 1))
    alone = found()
    assert several[0] == alone[0]
    np.testing.assert_array_equal(several[1], alone[1])


@pytest.mark.parametrize("fill_factor", [0.0, 0.8])
def test_a_blurred_picture_is_that_of_a_sensor_that_vibrates(fill_factor: float) -> None:
    """Against the cosine series of simulated pixels, which has the exact transfer function."""
    light, blur = field(), 0.3
    sensor = Sensor(pixel_pitch_um=1e3 * PITCH, pixels=(40, 48), plane_distances_mm=(1.0,))
    blur_um = 1e3 * blur * PITCH
    expected = light_on_pixels(light, sensor, fill_factor=fill_factor, oversampling=4, blur_um=blur_um)
    pixels = PixelMeans(GRID, fill_factor, blur)
    identity = TransferFunction(GRID, 0.532, 0.0, np.complex128)
    found = pixels.intensity(pixels.propagate(np.fft.fft2(light.values), identity))
    sharp = light_on_pixels(light, sensor, fill_factor=fill_factor, oversampling=4)
    assert np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(expected)
    assert np.linalg.norm(sharp - expected) > 0.1 * np.linalg.norm(expected)
