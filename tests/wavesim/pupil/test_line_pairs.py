"""Line pairs: the perfect pupil against an independent convolution, contrast signs, registration."""

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
from wavesim.pupil.line_pairs import (
    line_pair_contrast,
    line_pair_displacement_um,
    line_pair_image,
    line_pair_profile,
    smallest_resolved_line_width_um,
)
from wavesim.pupil.pupil import PupilGrid, ReconstructionPupil

Array = NDArray[np.float64]

WAVELENGTH_UM = 0.532
NA = 0.5


def circular_grid(samples: int = 144, centre: tuple[float, float] = (0.0, 0.0), na: float = NA) -> PupilGrid:
    spacing = 2.0 * na / samples
    offset = (np.arange(samples) - 0.5 * (samples - 1)) * spacing
    inside = np.hypot(*np.meshgrid(offset, offset)) <= na
    return PupilGrid(centre, spacing, inside, WAVELENGTH_UM)


GRID = circular_grid()


def with_waves(waves: Array, grid: PupilGrid = GRID) -> ReconstructionPupil:
    return ReconstructionPupil(grid, waves * WAVELENGTH_UM * 1e-3, np.ones(len(grid.index), bool))


def perfect(grid: PupilGrid = GRID) -> ReconstructionPupil:
    return with_waves(np.zeros(len(grid.index)), grid)


def defocused(z_um: float, grid: PupilGrid = GRID) -> ReconstructionPupil:
    return with_waves(-z_um * grid.axial_cosine / WAVELENGTH_UM, grid)


def coma(waves_at_rim: float) -> ReconstructionPupil:
    rho = GRID.cosines / NA
    return with_waves(waves_at_rim * np.sum(rho**2, axis=1) * rho[:, 0])


def convolved_intensity(x_um: float, width_um: float, bars: int) -> float:
    """Coherent image at (x, 0) by convolving the bars with the amplitude point spread."""
    step = 0.02
    length = (2 * bars - 1) * width_um
    cells = np.arange(0.5 * step, length, step) - 0.5 * length
    bright = np.min(np.abs(cells[:, None] - 2.0 * width_um * (np.arange(bars) - 0.5 * (bars - 1))), axis=1)
    across = cells[bright < 0.5 * width_um]
    r = np.hypot(x_um - across[:, None], cells[None])
    spread = NA / WAVELENGTH_UM * j1(2.0 * np.pi * NA * r / WAVELENGTH_UM) / r
    return float(np.sum(spread) * step**2) ** 2


@pytest.mark.parametrize(("width", "bars"), [(1.5, 5), (0.8, 5), (0.6, 3)])
def test_perfect_image_is_the_convolution_with_the_amplitude_spread(width: float, bars: int) -> None:
    x, intensity = line_pair_profile(perfect(circular_grid(384)), width, bars=bars, points=241)
    for i in (40, 77, 120, 150, 200):
        assert intensity[i] == pytest.approx(convolved_intensity(x[i] + 1e-4, width, bars), abs=0.02)


def test_perfect_pupil_resolves_lines_down_to_the_coherent_limit() -> None:
    for orientation in ("x", "y"):
        assert line_pair_contrast(perfect(), 1.55, orientation) > 0.95
        assert line_pair_contrast(perfect(), 0.775, orientation) > 0.9
        assert abs(line_pair_contrast(perfect(), 0.45, orientation)) < 0.2
        smallest = smallest_resolved_line_width_um(perfect(), orientation)
        assert smallest == pytest.approx(0.5 * WAVELENGTH_UM / NA, rel=0.12)


def test_contrast_of_many_lines_is_that_of_three_beams() -> None:
    # Between the cut-off and three times it only the orders 0 and +-1 of a grating form the image.
    pupil = perfect(circular_grid(512))
    bright, dark = (0.5 + 2.0 / np.pi) ** 2, (0.5 - 2.0 / np.pi) ** 2
    expected = (bright - dark) / (bright + dark)
    assert line_pair_contrast(pupil, 0.8, bars=31) == pytest.approx(expected, abs=0.01)


def test_a_large_bright_area_has_intensity_one() -> None:
    x, intensity = line_pair_profile(perfect(circular_grid(512)), 20.0, bars=2, points=801)
    middle = np.abs(np.abs(x) - 20.0) < 5.0
    assert intensity[middle].mean() == pytest.approx(1.0, abs=0.02)


def test_contrast_reads_the_profile_at_bars_and_gaps() -> None:
    pupil = coma(0.3)
    place = line_pair_displacement_um(pupil, 1.0)
    x, intensity = line_pair_profile(pupil, 1.0, points=4001)
    bright = np.interp(place + 2.0 * np.arange(-2, 3), x, intensity).mean()
    dark = np.interp(place + 2.0 * np.arange(-1.5, 2.0), x, intensity).mean()
    assert line_pair_contrast(pupil, 1.0) == pytest.approx((bright - dark) / (bright + dark), abs=1e-5)


def test_the_image_holds_the_profile_and_turns_with_the_orientation() -> None:
    pupil = coma(0.4)
    _, picture = line_pair_image(pupil, 0.9, "x", points=101)
    _, profile = line_pair_profile(pupil, 0.9, "x", points=101)
    np.testing.assert_allclose(picture[50], profile, atol=1e-12)
    _, turned = line_pair_image(pupil, 0.9, "y", points=101)
    _, profile = line_pair_profile(pupil, 0.9, "y", points=101)
    np.testing.assert_allclose(turned[:, 50], profile, atol=1e-12)
    assert np.corrcoef(picture.ravel(), turned.ravel())[0, 1] < 0.9


def test_orientations_exchange_with_the_axes_of_the_pupil() -> None:
    pupil = coma(0.6)
    swapped = with_waves(pupil.waves_on_grid.T.ravel()[GRID.index])
    for width in (1.55, 0.775):
        assert line_pair_contrast(pupil, width, "x") == pytest.approx(line_pair_contrast(swapped, width, "y"))
        assert line_pair_contrast(pupil, width, "y") == pytest.approx(line_pair_contrast(swapped, width, "x"))


def test_defocus_reverses_lines_and_refocusing_mends_them() -> None:
    reversed_um = 2.0 * (2.0 * 0.775) ** 2 / WAVELENGTH_UM * 0.5
    contrast = [line_pair_contrast(defocused(z), 0.775) for z in (0.0, 0.5 * reversed_um, reversed_um)]
    assert contrast[0] > 0.9
    assert abs(contrast[1]) < 0.3
    assert contrast[2] < -0.5
    assert smallest_resolved_line_width_um(defocused(reversed_um)) > 0.775


@settings(max_examples=25, deadline=None)
@given(shift=st.floats(-8.0, 8.0), width=st.floats(0.5, 3.0))
def test_a_shifted_target_keeps_its_contrast(shift: float, width: float) -> None:
    moved = with_waves(-(GRID.cosines @ [shift, 0.0]) / WAVELENGTH_UM)
    assert line_pair_displacement_um(moved, width) == pytest.approx(shift, abs=1e-9)
    assert line_pair_contrast(moved, width) == pytest.approx(line_pair_contrast(perfect(), width), abs=1e-9)
    assert line_pair_displacement_um(moved, width, "y") == pytest.approx(0.0, abs=1e-9)


def test_coma_displaces_lines_without_blurring_them() -> None:
    pupil = coma(0.7)
    order = 0.5 * WAVELENGTH_UM / 0.775
    expected = -WAVELENGTH_UM * 0.7 * (order / NA) ** 3 / order
    assert line_pair_displacement_um(pupil, 0.775) == pytest.approx(expected, rel=0.1)
    assert line_pair_contrast(pupil, 0.775) > 0.9


def test_defocus_off_axis_displaces_no_lines() -> None:
    # The light is parallel to the axis for every field point, and so is the direction of focusing.
    grid = circular_grid(centre=(0.0, -0.1))
    assert line_pair_displacement_um(defocused(2.0, grid), 1.55, "y") == pytest.approx(0.0, abs=0.02)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), width=st.floats(0.3, 4.0))
def test_contrast_lies_between_minus_one_and_one(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    u, v = GRID.cosines.T / NA
    pupil = with_waves(rng.normal(size=5) @ [u**2 + v**2, u**3, u * v, v**3, u**4])
    assert -1.0 <= line_pair_contrast(pupil, width) <= 1.0
    assert -1.0 <= line_pair_contrast(pupil, width, "y") <= 1.0


def test_a_coarse_grid_that_is_accepted_gives_the_contrast_of_a_fine_one() -> None:
    width = 0.99 * circular_grid(96).window_um / 13
    for waves in (0.0, 0.8):
        values = []
        for samples in (96, 384):
            grid = circular_grid(samples)
            rho = grid.cosines / NA
            values.append(
                line_pair_contrast(with_waves(waves * np.sum(rho**2, axis=1) * rho[:, 0], grid), width)
            )
        assert values[0] == pytest.approx(values[1], abs=0.01)


def test_a_target_wider_than_the_period_is_refused() -> None:
    width = 1.01 * GRID.window_um / 13
    for call in (line_pair_contrast, line_pair_profile, line_pair_image, line_pair_displacement_um):
        with pytest.raises(SamplingError, match="at least 146"):
            call(perfect(), width)


def test_a_steep_phase_is_refused() -> None:
    with pytest.raises(SamplingError, match="between neighbouring samples"):
        line_pair_contrast(with_waves(-60.0 * GRID.cosines[:, 0] / WAVELENGTH_UM), 1.0)


def test_nothing_resolved_is_said_as_infinity() -> None:
    assert smallest_resolved_line_width_um(defocused(40.0), limit=0.9) == np.inf


def test_light_along_the_axis_must_reach_the_pupil() -> None:
    with pytest.raises(InputError, match="nearer to the axis"):
        line_pair_contrast(perfect(circular_grid(centre=(0.0, 0.9), na=0.05)), 2.0, "y")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: line_pair_contrast(perfect(), 0.0), "line_width_um = 0"),
        (lambda: line_pair_contrast(perfect(), np.nan), "line_width_um = nan"),
        (lambda: line_pair_contrast(perfect(), 1.0, bars=1), "bars = 1"),
        (lambda: line_pair_contrast(perfect(), 1.0, cast(Orientation, "u")), "orientation = 'u'"),
        (lambda: line_pair_image(perfect(), 1.0, points=1), "points = 1"),
        (lambda: smallest_resolved_line_width_um(perfect(), limit=0.0), "limit = 0"),
    ],
)
def test_bad_input_is_named(call: Callable, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()
