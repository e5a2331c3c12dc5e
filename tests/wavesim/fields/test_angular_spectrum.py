"""Free space: the angular spectrum, and the guard of its sampling."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.angular_spectrum import AngularSpectrum
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.fields.propagator import FreeSpacePropagator, propagate
from wavesim.fields.sampling_checks import (
    SamplingWarning,
    check_propagation,
    critical_distance_mm,
    measure_propagation,
    predicted_relative_error,
)

WAVELENGTH_UM = 0.5
WAVES_PER_MM = 1e3 / WAVELENGTH_UM


def _beam(y_mm: np.ndarray, z_mm: float, waist_mm: float) -> np.ndarray:
    """Exact integral over plane waves of a beam with its waist at z = 0, in a world without x."""
    f0 = 1.0 / (np.pi * waist_mm)
    steepest = np.arcsin(min(5.0 * f0 / WAVES_PER_MM, 1.0))
    angle = np.linspace(-steepest, steepest, 4000 if z_mm < 1.0 else 16000)
    f = WAVES_PER_MM * np.sin(angle)
    fz = WAVES_PER_MM * np.cos(angle)
    weight = np.sqrt(np.pi) * waist_mm * np.exp(-((f / f0) ** 2)) * fz * (angle[1] - angle[0])
    return np.exp(2j * np.pi * np.multiply.outer(y_mm, f)) @ (weight * np.exp(2j * np.pi * fz * z_mm))


def _waist_mm(numerical_aperture: float) -> float:
    return 1e-3 * WAVELENGTH_UM / (np.pi * numerical_aperture)


def _beam_field(grid: Grid, waist_mm: float) -> Field:
    return Field(grid, _beam(grid.y_mm, 0.0, waist_mm), WAVELENGTH_UM)


def _random(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def _smooth(grid: Grid, seed: int = 0, part: float = 0.2) -> Field:
    """Random, confined to the middle third of the grid and to a part of the Nyquist band."""
    values = _random(grid.shape, seed)
    for axis, n in enumerate(grid.shape):
        at = (np.arange(n) - 0.5 * (n - 1)) / n
        shape = [1] * len(grid.shape)
        shape[axis] = n
        low = np.exp(-((np.fft.fftfreq(n) / (0.5 * part)) ** 2) * 4.0).reshape(shape)
        values = np.fft.ifft(np.fft.fft(values, axis=axis) * low, axis=axis)
        values = values * np.exp(-((at / 0.09) ** 2)).reshape(shape)
    return Field(grid, values, WAVELENGTH_UM)


@pytest.mark.parametrize("numerical_aperture", [0.1, 0.4])
@pytest.mark.parametrize("distance_mm", [0.01, 0.05, 0.4, 2.0])
def test_beam_beyond_the_paraxial_range(numerical_aperture: float, distance_mm: float) -> None:
    grid = Grid((500,), 0.15e-3 if numerical_aperture > 0.2 else 0.5e-3, 0.0)
    waist = _waist_mm(numerical_aperture)
    result = propagate(_beam_field(grid, waist), distance_mm, check=False)
    assert relative_error(result.values, _beam(grid.y_mm, distance_mm, waist)) < 5e-5
    assert result.grid.z_mm == distance_mm


def test_small_aperture_is_the_rayleigh_sommerfeld_sum() -> None:
    grid, distance = Grid((46, 50), 0.18e-3, 0.0), 6e-3
    y, x = np.meshgrid(grid.y_mm, grid.x_mm, indexing="ij")
    aperture = np.exp(-((((x - 5e-4) ** 2 + y**2) / 2e-3**2) ** 2)) * np.exp(2j * np.pi * 300.0 * y)
    field = Field(grid, aperture, WAVELENGTH_UM)
    k = field.wavenumber_per_mm
    r = np.sqrt((x.ravel()[:, None] - x.ravel()) ** 2 + (y.ravel()[:, None] - y.ravel()) ** 2 + distance**2)
    kernel = distance / (2.0 * np.pi * r**2) * (1.0 / r - 1j * k) * np.exp(1j * k * r)
    exact = (kernel @ aperture.ravel()).reshape(grid.shape) * grid.cell
    assert relative_error(propagate(field, distance, check=False).values, exact) < 1e-7


@pytest.mark.parametrize("shape", [(512,), (120, 128)])
def test_energy_is_conserved_and_the_way_back_is_the_inverse(shape: tuple) -> None:
    field = _smooth(Grid(shape, 1e-3, 0.0))
    there = propagate(field, 0.05)
    assert there.energy == pytest.approx(field.energy, rel=1e-12)
    assert relative_error(propagate(there, -0.05).values, field.values) < 1e-12


@pytest.mark.parametrize("shape", [(301,), (45, 64)])
@pytest.mark.parametrize("distance_mm", [0.0, 0.03, 2.0, -0.4])
@pytest.mark.parametrize("pad", ["auto", "grid", "double"])
@pytest.mark.parametrize("band_limit", [True, False])
def test_adjoint(shape: tuple, distance_mm: float, pad: str, band_limit: bool) -> None:
    here, there = Grid(shape, 1e-3, 0.0, (0.0, 0.01)), (0.0 if len(shape) == 1 else 0.02, 0.05)
    counts = {"auto": "auto", "grid": shape, "double": tuple(2 * n for n in shape)}[pad]
    window = Grid(shape, 1e-3, distance_mm, there)
    passage = FreeSpacePropagator(here, window, WAVELENGTH_UM, 1.4, pad=counts, band_limit=band_limit)
    f, g = _random(shape, 1), _random(shape, 2)
    gone, back = passage.forward(f), passage.adjoint(g)
    size = np.linalg.norm(g) * np.linalg.norm(f)
    assert abs(np.vdot(g, gone) - np.vdot(back, f)) <= 1e-12 * size


@given(st.integers(0, 1000), st.complex_numbers(max_magnitude=5.0), st.floats(-3.0, 3.0))
@settings(max_examples=20)
def test_linear(seed: int, factor: complex, distance_mm: float) -> None:
    grid = Grid((24, 20), 1e-3, 0.0)
    a, b = (Field(grid, _random(grid.shape, seed + i), WAVELENGTH_UM) for i in (0, 1))
    both = propagate(a.with_values(a.values + factor * b.values), distance_mm, check=False).values
    parts = [propagate(f, distance_mm, check=False).values for f in (a, b)]
    np.testing.assert_allclose(both, parts[0] + factor * parts[1], atol=1e-12)


@given(st.integers(0, 1000), st.integers(-20, 20), st.floats(-0.5, 0.5))
@settings(max_examples=20)
def test_shifted_field_or_window(seed: int, samples: int, distance_mm: float) -> None:
    field = _smooth(Grid((160,), 1e-3, 0.0), seed)
    moved = field.with_values(np.roll(field.values, -samples))
    beside = Grid((160,), 1e-3, distance_mm, (0.0, samples * 1e-3))
    window = propagate(field, beside, check=False)
    plain = propagate(moved, distance_mm, check=False)
    np.testing.assert_allclose(window.values, plain.values, atol=1e-7 * abs(field.values).max())


@given(st.integers(0, 1000), st.floats(-0.03, 0.03), st.floats(-0.03, 0.03))
@settings(max_examples=20)
def test_two_steps_are_one(seed: int, first_mm: float, second_mm: float) -> None:
    field = _smooth(Grid((256,), 1e-3, 0.0), seed)
    steps = propagate(propagate(field, first_mm, check=False), second_mm, check=False)
    once = propagate(field, first_mm + second_mm, check=False)
    assert relative_error(steps.values, once.values) < 1e-9


def test_window_far_beside_the_axis_is_part_of_a_wide_one() -> None:
    field = _smooth(Grid((128,), 1e-3, 0.0))
    tilted = field.with_values(field.values * np.exp(2j * np.pi * 300.0 * field.grid.y_mm))
    aside = 2.0 * 300.0 / np.sqrt(WAVES_PER_MM**2 - 300.0**2)
    result = propagate(tilted, Grid((128,), 1e-3, 2.0, (0.0, aside)), check=False)
    wide = Grid((4096,), 1e-3, 0.0)
    values = np.zeros(4096, complex)
    values[1984:2112] = tilted.values
    whole = propagate(Field(wide, values, WAVELENGTH_UM), 2.0, check=False)
    at = np.interp(result.grid.y_mm, wide.y_mm, np.arange(4096.0))
    first = round(at[0])
    on_samples = Grid((128,), 1e-3, 2.0, (0.0, aside - 1e-3 * (at[0] - first)))
    shifted = propagate(tilted, on_samples, check=False)
    assert relative_error(shifted.values, whole.values[first : first + 128]) < 2e-4
    assert result.energy > 0.2 * field.energy


def test_band_limit_is_that_of_matsushima() -> None:
    n, pitch, distance = 1024, 2e-3, 300.0
    here, there = Grid((n,), pitch, 0.0), Grid((n,), pitch, distance)
    kept = abs(AngularSpectrum(here, there, WAVELENGTH_UM, 1.0, (n,), True).factor()) > 0.5
    limit = WAVES_PER_MM / np.hypot(2.0 * distance / (n * pitch), 1.0)
    cycles = abs(np.fft.fftfreq(n, pitch))
    assert (kept == (cycles <= limit)).all()
    assert 0 < kept.sum() < n
    assert (abs(AngularSpectrum(here, there, WAVELENGTH_UM, 1.0, (n,), False).factor()) > 0.5).all()


def test_fade_leaves_less_ripple_than_a_sharp_band_limit() -> None:
    field = _smooth(Grid((256,), 1e-3, 0.0))
    truth = propagate(field, 5.0, pad=(65536,), band_limit=False, check=False).values
    sharp = propagate(field, 5.0, pad=(512,), check=False).values
    assert relative_error(sharp, truth) > 1e-3
    assert relative_error(propagate(field, 5.0, check=False).values, truth) < 1e-7


def test_single_precision_stays_single_over_a_long_path() -> None:
    field = _smooth(Grid((64, 72), 1e-3, 0.0))
    single = propagate(field.with_values(field.values.astype(np.complex64)), 40.0, check=False)
    assert single.values.dtype == np.complex64
    assert relative_error(single.values, propagate(field, 40.0, check=False).values) < 1e-6


def _spoken(field: Field, distance_mm: float, pad: tuple[int, ...] | str = "auto") -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SamplingWarning)
        try:
            check_propagation(field, distance_mm, pad=pad)
        except SamplingError:
            return "refused"
    return "warned" if caught else "silent"


@pytest.mark.parametrize("numerical_aperture", [0.05, 0.15, 0.4])
def test_guard_speaks_before_a_wrap_around_is_seen(numerical_aperture: float) -> None:
    waist = _waist_mm(numerical_aperture)
    grid = Grid((128,), 1e-3 * WAVELENGTH_UM / (6.0 * numerical_aperture), 0.0)
    field = _beam_field(grid, waist)
    critical = critical_distance_mm(grid, WAVELENGTH_UM)
    errors: dict[str, list[float]] = {"silent": [], "warned": [], "refused": []}
    for part in np.geomspace(0.1, 8.0, 12):
        distance = (critical or 0.02) * part
        truth = _beam(grid.y_mm, distance, waist)
        result = propagate(field, distance, pad=grid.shape, check=False).values
        errors[_spoken(field, distance, grid.shape)].append(relative_error(result, truth))
        padded = propagate(field, distance, check=False).values
        assert relative_error(padded, truth) < 1e-3
    assert max(errors["silent"]) < 1e-2
    assert max(errors["refused"]) > 0.2
    assert len(errors["silent"]) >= 3


@pytest.mark.parametrize("numerical_aperture", [0.05, 0.15, 0.4])
def test_guard_speaks_before_a_coarse_pitch_is_seen(numerical_aperture: float) -> None:
    waist = _waist_mm(numerical_aperture)
    silent, worst = 0, 0.0
    for finer in np.linspace(3.5, 0.7, 11):
        grid = Grid((128,), 1e-3 * WAVELENGTH_UM / (2.0 * numerical_aperture * finer), 0.0)
        distance = 2.0 * waist / numerical_aperture
        result = propagate(_beam_field(grid, waist), distance, check=False)
        error = relative_error(result.values, _beam(grid.y_mm, distance, waist))
        spoken = _spoken(_beam_field(grid, waist), distance)
        if spoken == "silent":
            silent += 1
            assert error < 1e-2
        worst = max(worst, error)
    assert silent >= 3
    assert worst > 0.1
    assert spoken == "refused"


def test_guard_says_what_was_exceeded_and_what_to_change() -> None:
    grid = Grid((256,), 1e-3, 0.0)
    fine = Field(grid, _random(grid.shape), WAVELENGTH_UM)
    with pytest.raises(SamplingError, match=r"400 and 500 cycles/mm.* 1 µm"):
        propagate(fine, 1.0)
    field = _beam_field(grid, 2e-3)
    with pytest.raises(SamplingError, match=r"256 samples.* 0\.4\d* mm.*pad='auto'"):
        propagate(field, 3.0, pad=grid.shape)
    with pytest.warns(SamplingWarning, match="% of the field's energy"):
        propagate(field, 3.0)
    tiny = Field(Grid((64,), 0.1e-3, 0.0), _beam(Grid((64,), 0.1e-3, 0.0).y_mm, 0.0, 2e-3), WAVELENGTH_UM)
    ripple = tiny.with_values(tiny.values * np.cos(2.0 * np.pi * 2600.0 * tiny.grid.y_mm))
    with pytest.raises(SamplingError, match=r"evanescent waves.*half a wavelength"):
        propagate(ripple, 1e-6)


def test_guard_is_silent_where_nothing_is_lost() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", SamplingWarning)
        propagate(_smooth(Grid((128, 140), 1e-3, 0.0)), 0.02)
        assert not propagate(Field(Grid((16,), 1e-3, 0.0), np.zeros(16, complex), 0.5), 1.0).values.any()


def test_unusable_input_is_refused() -> None:
    field = _smooth(Grid((64,), 1e-3, 0.0))
    with pytest.raises(InputError, match="z_mm = nan"):
        propagate(field, float("nan"))
    for pad in ((32,), (64, 64)):
        with pytest.raises(InputError, match="pad"):
            propagate(field, 1.0, pad=pad)
    with pytest.raises(InputError, match="not finite"):
        propagate(field.with_values(field.values * np.nan), 1.0)
    with pytest.raises(SamplingError, match=r"1 mm at a pitch of 1 µm needs 268435456 samples.*smaller"):
        propagate(field, 1.0, pad=(2**28,))
    with pytest.raises(InputError, match="same shape and pitch"):
        propagate(field, Grid((64,), 2e-3, 1.0), pad=(128,))


@pytest.mark.parametrize("numerical_aperture", [0.05, 0.3])
def test_predicted_error_follows_the_measured_one(numerical_aperture: float) -> None:
    waist = _waist_mm(numerical_aperture)
    for finer in (0.8, 1.2, 2.0, 3.0):
        grid = Grid((96,), 1e-3 * WAVELENGTH_UM / (2.0 * numerical_aperture * finer), 0.0)
        field = _beam_field(grid, waist)
        for part in (0.2, 0.7, 2.0, 5.0):
            distance = part * 96 * grid.pitch_mm**2 * WAVES_PER_MM
            truth = _beam(grid.y_mm, distance, waist)
            result = propagate(field, distance, pad=grid.shape, check=False).values
            error = relative_error(result, truth)
            predicted = predicted_relative_error(
                grid, WAVELENGTH_UM, numerical_aperture, distance, pad=grid.shape
            )
            if error > 1e-2:
                assert predicted > error / 4.0
            if predicted < 1e-3:
                assert error < 1e-2


def test_measured_parts_of_a_tone() -> None:
    grid = Grid((400,), 1e-3, 0.0)
    tone = Field(grid, np.exp(2j * np.pi * 475.0 * grid.y_mm), WAVELENGTH_UM)
    assert measure_propagation(tone, 0.1).edge == pytest.approx(1.0)
    calm = Field(grid, np.exp(2j * np.pi * 100.0 * grid.y_mm), WAVELENGTH_UM)
    found = measure_propagation(calm, Grid((100,), 6e-3, 0.1))
    assert found.edge < 1e-20
    assert found.coarse == pytest.approx(1.0)
