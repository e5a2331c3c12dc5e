"""Registration, Strehl ratio, point spread and modulation transfer against closed forms."""

from collections.abc import Callable
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.special import j1

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.field import Orientation
from wavesim.pupil.pupil import (
    PupilGrid,
    ReconstructionPupil,
    mtf,
    psf,
    refocus,
    remove_shift,
    rms_waves,
    strehl,
)

Array = NDArray[np.float64]

WAVELENGTH_UM = 0.532
NA = 0.5


def circular_grid(samples: int = 128, centre: tuple[float, float] = (0.0, 0.0), na: float = NA) -> PupilGrid:
    spacing = 2.0 * na / samples
    offset = (np.arange(samples) - 0.5 * (samples - 1)) * spacing
    inside = np.hypot(*np.meshgrid(offset, offset)) <= na
    return PupilGrid(centre, spacing, inside, WAVELENGTH_UM)


GRID = circular_grid()
OFF_AXIS = circular_grid(centre=(0.05, -0.1))


def make(grid: PupilGrid, opd_mm: Array, valid: NDArray[np.bool_] | None = None) -> ReconstructionPupil:
    return ReconstructionPupil(grid, opd_mm, np.ones(len(grid.index), bool) if valid is None else valid)


def perfect(grid: PupilGrid = GRID) -> ReconstructionPupil:
    return make(grid, np.zeros(len(grid.index)))


def moved_point(grid: PupilGrid, x_um: float, y_um: float, z_um: float) -> Array:
    """Exact path difference of a point source moved in air."""
    return -1e-3 * (grid.cosines @ [x_um, y_um] + z_um * grid.axial_cosine)


def test_grid_lays_columns_along_x_and_rows_along_y() -> None:
    inside = np.zeros((8, 8), bool)
    inside[1, 6] = True
    grid = PupilGrid((0.0, 0.0), 0.1, inside, WAVELENGTH_UM)
    np.testing.assert_allclose(grid.cosines, [[0.25, -0.25]])
    assert grid.half_width == pytest.approx(0.4)
    assert grid.window_um == pytest.approx(5.32)


def test_perfect_pupil_has_an_airy_point_spread() -> None:
    grid = circular_grid(256)
    x, intensity = psf(perfect(grid), half_width_um=2.0, points=201)
    r = np.hypot(*np.meshgrid(x, x))
    v = 2.0 * np.pi * NA * np.maximum(r, 1e-9) / WAVELENGTH_UM
    np.testing.assert_allclose(intensity, (2.0 * j1(v) / v) ** 2, atol=1.5e-3)
    assert intensity.max() == pytest.approx(1.0)


def test_perfect_pupil_has_the_diffraction_limited_mtf() -> None:
    cut_off = 2e3 * NA / WAVELENGTH_UM
    share = np.linspace(0.0, 1.0, 41)
    closed_form = 2.0 / np.pi * (np.arccos(share) - share * np.sqrt(1.0 - share**2))
    for orientation in ("x", "y"):
        values = mtf(perfect(circular_grid(256)), share * cut_off, orientation)
        np.testing.assert_allclose(values, closed_form, atol=2e-3)
    np.testing.assert_array_equal(mtf(perfect(), [1.001 * cut_off, 3.0 * cut_off]), 0.0)


def test_mtf_is_the_fourier_transform_of_the_point_spread() -> None:
    pupil = make(GRID, 2e-4 * GRID.cosines[:, 0] ** 3 / NA**3)
    width = GRID.window_um
    points = 2 * GRID.samples
    x = (np.arange(points) - points / 2) * width / points
    down, across = (np.exp(2j * np.pi / WAVELENGTH_UM * np.outer(x, axis)) for axis in GRID.axes)
    intensity = np.abs(down @ pupil.function @ across.T) ** 2
    profiles: dict[Orientation, Array] = {"x": intensity.sum(axis=0), "y": intensity.sum(axis=1)}
    for orientation, profile in profiles.items():
        for cycles in (3, 20, 60):
            spectrum = np.sum(profile * np.exp(-2j * np.pi * cycles * x / width))
            expected = abs(spectrum) / profile.sum()
            assert mtf(pupil, [1e3 * cycles / width], orientation)[0] == pytest.approx(expected, abs=1e-9)


def test_point_spread_keeps_the_energy_of_the_pupil() -> None:
    grid = circular_grid(64)
    rng = np.random.default_rng(1)
    pupil = make(grid, 1e-4 * rng.standard_normal(len(grid.index)) * 0.2)
    step = grid.window_um / grid.samples
    half = 0.5 * (grid.window_um - step)
    _, intensity = psf(pupil, half, points=grid.samples)
    assert intensity.mean() == pytest.approx(1.0 / len(grid.index), rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(x=st.floats(-30.0, 30.0), y=st.floats(-30.0, 30.0), z=st.floats(-50.0, 50.0))
def test_a_moved_point_is_found_back(x: float, y: float, z: float) -> None:
    for grid in (GRID, OFF_AXIS):
        result = refocus(make(grid, 0.123 + moved_point(grid, x, y, z)))
        np.testing.assert_allclose(result.shift_um, [x, y], atol=1e-6)
        assert result.refocus_um == pytest.approx(z, abs=1e-6)
        assert result.piston_um == pytest.approx(123.0, abs=1e-5)
        assert rms_waves(result.pupil) < 1e-8
        assert strehl(result.pupil) == pytest.approx(1.0)


def test_removing_the_shift_leaves_the_focus_alone() -> None:
    result = remove_shift(make(GRID, moved_point(GRID, 3.0, -2.0, 4.0)))
    expected = make(GRID, moved_point(GRID, 0.0, 0.0, 4.0))
    np.testing.assert_allclose(result.shift_um, [3.0, -2.0], atol=1e-9)
    assert result.refocus_um == 0.0
    np.testing.assert_allclose(result.pupil.opd_waves, expected.opd_waves, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(x=st.floats(-2.0, 2.0), y=st.floats(-2.0, 2.0))
def test_the_point_spread_of_a_moved_point_stands_where_the_point_is(x: float, y: float) -> None:
    coordinates, intensity = psf(make(GRID, moved_point(GRID, x, y, 0.0)), 3.0, points=121)
    row, column = np.unravel_index(np.argmax(intensity), intensity.shape)
    assert coordinates[column] == pytest.approx(x, abs=0.026)
    assert coordinates[row] == pytest.approx(y, abs=0.026)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=5), st.floats(0.0, 0.04))
def test_strehl_ratio_of_small_aberrations(coefficients: list[float], sigma: float) -> None:
    u, v = OFF_AXIS.cosines[:, 0] - 0.05, OFF_AXIS.cosines[:, 1] + 0.1
    shape = np.array(coefficients) @ [u**3, v * u**2, u * v, u**2 - v**2, u**4]
    spread = shape.std()
    waves = shape * (sigma / spread) if spread > 1e-9 else 0.0 * shape
    pupil = make(OFF_AXIS, waves * WAVELENGTH_UM * 1e-3)
    assert strehl(pupil) == pytest.approx(np.exp(-((2.0 * np.pi * rms_waves(pupil)) ** 2)), abs=2e-3)
    if spread > 1e-9:
        assert rms_waves(pupil) == pytest.approx(sigma, abs=1e-12)


def test_samples_that_are_not_valid_count_for_nothing() -> None:
    valid = GRID.cosines[:, 0] < 0.3
    opd = moved_point(GRID, 2.0, 1.0, -3.0) + 1e-5 * GRID.cosines[:, 1] ** 3
    spoiled = np.where(valid, opd, np.nan)
    exact = refocus(make(GRID, moved_point(GRID, 2.0, 1.0, -3.0), valid))
    np.testing.assert_allclose(exact.shift_um, [2.0, 1.0], atol=1e-6)
    assert exact.refocus_um == pytest.approx(-3.0, abs=1e-6)
    clean, other = refocus(make(GRID, opd, valid)), refocus(make(GRID, spoiled, valid))
    np.testing.assert_array_equal(clean.shift_um, other.shift_um)
    assert strehl(clean.pupil) == strehl(other.pupil)
    assert rms_waves(clean.pupil) == rms_waves(other.pupil)
    assert other.pupil.throughput == pytest.approx(valid.mean())
    assert np.count_nonzero(other.pupil.function) == valid.sum()


def test_a_phase_too_steep_for_the_grid_is_refused() -> None:
    limit_um = 0.5 * GRID.window_um
    strehl(make(GRID, moved_point(GRID, 0.99 * limit_um, 0.0, 0.0)))
    steep = make(GRID, moved_point(GRID, 0.0, 1.01 * limit_um, 0.0))
    for measure in (strehl, lambda p: psf(p, 1.0), lambda p: mtf(p, [100.0])):
        with pytest.raises(SamplingError, match="raise samples = 128"):
            measure(steep)
    assert strehl(remove_shift(steep).pupil) == pytest.approx(1.0)


def test_a_window_wider_than_the_period_is_refused() -> None:
    psf(perfect(), 0.499 * GRID.window_um, points=3)
    with pytest.raises(SamplingError, match="at least 141"):
        psf(perfect(), 0.55 * GRID.window_um, points=3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: mtf(perfect(), [-1.0]), "not negative"),
        (lambda: mtf(perfect(), [np.nan]), "finite"),
        (lambda: mtf(perfect(), [1.0], cast(Orientation, "z")), "orientation = 'z'"),
        (lambda: psf(perfect(), 0.0), "half_width_um = 0"),
        (lambda: psf(perfect(), 1.0, points=1), "points = 1"),
        (lambda: make(GRID, np.zeros(3)), "shapes"),
        (lambda: make(GRID, np.zeros(len(GRID.index)), np.zeros(len(GRID.index), bool)), "no ray"),
        (lambda: make(GRID, np.full(len(GRID.index), np.nan)), "not finite"),
        (lambda: refocus(make(GRID, np.zeros(len(GRID.index)), np.arange(len(GRID.index)) < 6)), "only 6"),
    ],
)
def test_bad_input_is_named(call: Callable, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()
