"""Metrics of reconstructions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.field import Field, Grid
from wavesim.metrics.contrast import (
    bar_contrast,
    element_contrasts,
    object_correlation,
    resolved_elements,
    smallest_resolved_element,
)
from wavesim.metrics.similarity import psnr_db, ssim
from wavesim.targets.patterns import band_limit
from wavesim.targets.usaf import UsafElement, usaf_chart, usaf_elements

GRID = Grid((400, 400), 2.5e-4, 0.0)
ELEMENTS = usaf_elements((8, 9))
WAVELENGTH = 0.532


def light() -> Field:
    return Field(GRID, np.ones(GRID.shape, complex), WAVELENGTH)


@pytest.mark.parametrize("ground", ["bright", "dark"])
def test_a_perfect_chart_has_contrast_1(ground) -> None:
    element = UsafElement(8, 1, (1.3e-3, -0.7e-3))
    found = bar_contrast(usaf_chart(GRID, [element], ground), GRID, element, ground)
    for one in (found.x, found.y):
        assert one.contrast == pytest.approx(1.0)
        assert one.weakest_contrast == pytest.approx(1.0)
        assert abs(one.across_um).max() <= 4.5 * element.line_width_um
        bar = abs(one.across_um) < 0.3 * element.line_width_um
        assert np.all(one.intensity[bar] == pytest.approx(float(ground == "dark")))
    assert found.resolved()


@settings(max_examples=20)
@given(st.floats(0.0, 1.0), st.floats(0.05, 1.0))
def test_contrast_is_michelsons_of_known_levels(dark: float, bright: float) -> None:
    element = UsafElement(8, 2, (0.0, 0.0))
    chart = usaf_chart(GRID, [element], "dark").real
    found = bar_contrast(dark + (bright - dark) * chart, GRID, element, "dark")
    expected = (bright - dark) / (bright + dark)
    assert found.contrast == pytest.approx(expected, abs=1e-9)
    assert found.resolved(0.2) == (expected >= 0.2)


def test_of_a_complex_amplitude_the_intensity_counts() -> None:
    element = UsafElement(8, 2, (0.0, 0.0))
    amplitude = 0.5 + 0.5 * usaf_chart(GRID, [element], "dark")
    found = bar_contrast(amplitude * np.exp(1.3j), GRID, element, "dark")
    assert found.contrast == pytest.approx((1.0 - 0.25) / (1.0 + 0.25))


def test_reversed_contrast_is_not_resolution() -> None:
    element = UsafElement(8, 1, (0.0, 0.0))
    chart = usaf_chart(GRID, [element], "dark").real
    assert bar_contrast(1.0 - chart, GRID, element, "dark").contrast == pytest.approx(-1.0)
    assert not bar_contrast(1.0 - chart, GRID, element, "dark").resolved()


def test_two_bars_in_place_of_three_are_not_resolution() -> None:
    element = UsafElement(8, 1, (0.0, 0.0))
    chart = usaf_chart(GRID, [element], "dark").real
    left = element.bars("x")[0]
    missing = (GRID.x_mm > left.left_mm - 1e-3) & (GRID.x_mm < left.right_mm + 1e-3)
    chart[:, missing] = 0.0
    found = bar_contrast(chart, GRID, element, "dark")
    assert found.x.contrast > 0.9
    assert math.isnan(found.x.weakest_contrast) or found.x.weakest_contrast <= 0.0
    assert not found.resolved()
    assert found.y.weakest_contrast == pytest.approx(1.0)


def test_one_orientation_alone_is_not_resolution() -> None:
    element = UsafElement(8, 1, (0.0, 0.0))
    chart = usaf_chart(GRID, [element], "dark").real
    chart[:, GRID.x_mm > 0.0] = 0.5
    found = bar_contrast(chart, GRID, element, "dark")
    assert found.x.contrast == pytest.approx(1.0)
    assert found.y.contrast == pytest.approx(0.0)
    assert not found.resolved()


@pytest.mark.parametrize("ground", ["bright", "dark"])
def test_the_aperture_decides_what_is_resolved(ground) -> None:
    """Coherent light resolves periods above wavelength / NA, and no finer ones."""
    chart = usaf_chart(GRID, ELEMENTS, ground)
    seen = {}
    for aperture in (0.5, 0.25):
        limited = band_limit(chart, GRID, WAVELENGTH, aperture)
        contrasts = element_contrasts(limited, GRID, ELEMENTS, ground)
        widths = [one.element.line_width_um for one in contrasts]
        assert widths == sorted(widths, reverse=True)
        finest = smallest_resolved_element(contrasts)
        assert finest is not None
        seen[aperture] = finest.line_width_um
        kept = resolved_elements(contrasts)
        assert [one.element for one in kept] == [one.element for one in contrasts[: len(kept)]]
    assert seen[0.5] < 1.0
    assert 0.5 * WAVELENGTH / 0.25 * 0.9 < seen[0.25] < 1.5


def test_false_resolution_beyond_a_failure_does_not_count() -> None:
    elements = usaf_elements((8,))
    chart = usaf_chart(GRID, elements, "dark").real
    spoiled = elements[2]
    around = spoiled.outline
    rows = (GRID.y_mm > around.low_mm) & (GRID.y_mm < around.high_mm)
    columns = (GRID.x_mm > around.left_mm) & (GRID.x_mm < around.right_mm)
    chart[np.ix_(rows, columns)] = 1.0
    finest = smallest_resolved_element(element_contrasts(chart, GRID, elements, "dark"))
    assert finest == elements[1]


def test_nothing_resolved_is_none_not_an_error() -> None:
    for picture in (np.zeros(GRID.shape), np.full(GRID.shape, np.nan), np.ones(GRID.shape)):
        contrasts = element_contrasts(picture, GRID, ELEMENTS[:3])
        assert smallest_resolved_element(contrasts) is None
        assert not contrasts[0].resolved()


def test_correlation_forgets_the_illumination() -> None:
    rng = np.random.default_rng(1)
    lit = light().with_values(np.exp(1j * 0.2 * rng.standard_normal(GRID.shape)))
    object_ = lit.with_values(lit.values * (1.0 - 0.1 * usaf_chart(GRID, ELEMENTS, "dark")))
    wrong = lit.with_values(lit.values * (1.0 - 0.1 * rng.random(GRID.shape)))
    assert object_correlation(object_, object_, lit) == pytest.approx(1.0)
    assert object_correlation(wrong, object_, lit) < 0.05
    factor = lit.with_values(3j * object_.values - 0.7 * lit.values)
    assert object_correlation(factor, object_, lit) == pytest.approx(1.0)
    assert math.isnan(object_correlation(lit, object_, lit))


def test_correlation_counts_the_support_alone() -> None:
    rng = np.random.default_rng(2)
    inside = np.hypot(GRID.y_mm[:, None], GRID.x_mm) < 0.03
    lit = light().with_values(inside.astype(complex))
    truth = lit.with_values(usaf_chart(GRID, ELEMENTS, "bright"))
    found = lit.with_values(np.where(inside, truth.values, rng.random(GRID.shape)))
    assert object_correlation(found, truth, lit) == pytest.approx(1.0)
    assert object_correlation(found, truth, lit, np.ones_like(inside)) < 0.999


def test_psnr_and_ssim() -> None:
    truth = usaf_chart(GRID, ELEMENTS, "bright").real
    assert psnr_db(truth, truth) == math.inf
    assert ssim(truth, truth) == pytest.approx(1.0)
    assert psnr_db(truth + 0.1, truth) == pytest.approx(20.0)
    assert psnr_db(5.0 * truth + 0.5, 5.0 * truth, full_scale=5.0) == pytest.approx(20.0)
    half = np.zeros(GRID.shape, bool)
    half[:200] = True
    assert psnr_db(np.where(half, truth, 9.0), truth, support=half) == math.inf
    blurred = np.abs(band_limit(truth.astype(complex), GRID, WAVELENGTH, 0.1))
    finer = np.abs(band_limit(truth.astype(complex), GRID, WAVELENGTH, 0.4))
    assert ssim(blurred, truth) < ssim(finer, truth) < 1.0


def test_ssim_of_constants_is_its_luminance_term() -> None:
    a, b, c = 0.4, 0.7, (0.01 * 1.0) ** 2
    found = ssim(np.full((20, 20), a), np.full((20, 20), b))
    assert found == pytest.approx((2 * a * b + c) / (a * a + b * b + c))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: bar_contrast(np.ones((3, 3)), GRID, ELEMENTS[0]), "shape"),
        (lambda: bar_contrast(-np.ones(GRID.shape), GRID, ELEMENTS[0]), "negative"),
        (lambda: bar_contrast(np.ones(GRID.shape), GRID, ELEMENTS[0], "grey"), "ground = 'grey'"),
        (lambda: bar_contrast(np.ones(GRID.shape), GRID, UsafElement(4, 1, (0.0, 0.0))), "larger grid"),
        (lambda: element_contrasts(np.ones(GRID.shape), GRID, []), "one element"),
        (lambda: resolved_elements([], 1.5), "threshold = 1.5"),
        (lambda: object_correlation(light(), light(), light(), np.zeros(GRID.shape, bool)), "dark"),
        (lambda: psnr_db(np.ones((3, 3)), np.ones((4, 4))), "shapes"),
        (lambda: psnr_db(np.full((3, 3), np.nan), np.ones((3, 3))), "finite"),
        (lambda: psnr_db(np.ones((3, 3)), np.ones((3, 3)), full_scale=0.0), "full_scale"),
        (lambda: ssim(np.ones((3, 3)), np.ones((3, 3))), "11 x 11"),
    ],
)
def test_refused(call, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()


def test_lines_too_fine_for_the_grid_are_refused() -> None:
    with pytest.raises(SamplingError, match="group 10, element 5"):
        bar_contrast(np.ones(GRID.shape), GRID, UsafElement(10, 5, (0.0, 0.0)))


@pytest.mark.parametrize("rows", [512, 517, 1030])
def test_pictures_in_blocks_are_pictures_whole(rows: int) -> None:
    from skimage.metrics import structural_similarity

    rng = np.random.default_rng(rows)
    truth = rng.random((rows, 40))
    found = truth + 0.2 * rng.normal(size=truth.shape)
    inside = rng.random(truth.shape) < 0.7
    _, similarity = structural_similarity(
        truth, found, data_range=1.0, gaussian_weights=True, use_sample_covariance=False, full=True
    )
    assert ssim(found, truth, support=inside) == pytest.approx(float(similarity[inside].mean()), rel=1e-12)


def test_correlation_in_blocks_is_that_of_the_whole() -> None:
    rng = np.random.default_rng(1)
    grid = Grid((1100, 30), 1e-3, -10.0)
    light, found, truth = (
        Field(grid, rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape), 0.5) for _ in range(3)
    )
    found = found.with_values(found.values + truth.values + 3.0 * light.values)
    everywhere, known = np.ones(grid.shape, bool), light.values.ravel()
    sides = [
        one - known * np.vdot(known, one) / np.vdot(known, known)
        for one in (found.values.ravel(), truth.values.ravel())
    ]
    expected = abs(np.vdot(*sides)) / np.linalg.norm(sides[0]) / np.linalg.norm(sides[1])
    assert object_correlation(found, truth, light, everywhere) == pytest.approx(expected, rel=1e-12)
