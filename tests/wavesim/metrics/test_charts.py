"""Charts in results: displacement is not blur, and a limit of samples, aperture, chart or region is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.fft

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.metrics.charts import chart_resolution, register_chart
from wavesim.metrics.result_quality import chart_metrics
from wavesim.targets.patterns import band_limit
from wavesim.targets.region import cut_field, region_grid
from wavesim.targets.usaf import UsafElement, usaf_chart, usaf_elements

GRID = Grid((256, 256), 4e-4, -1.0)
ELEMENTS = usaf_elements((8, 9))
SHOWN = tuple(one for one in ELEMENTS if one.line_width_um >= 0.8)
WAVELENGTH = 0.532


def chart(ground="bright", shift=(0.0, 0.0), grid=GRID, elements=SHOWN) -> Field:
    """A chart displaced by so many samples."""
    dx, dy = (grid.pitch_mm * one for one in shift)
    moved = [replace(one, centre_mm=(one.centre_mm[0] + dx, one.centre_mm[1] + dy)) for one in elements]
    return Field(grid, usaf_chart(grid, moved, ground).astype(np.complex64), WAVELENGTH)


def blurred(field: Field, aperture: float) -> Field:
    return field.with_values(band_limit(field.values, field.grid, WAVELENGTH, aperture))


@pytest.mark.parametrize("ground", ["bright", "dark"])
@pytest.mark.parametrize("shift", [(0.3, 0.0), (1.0, -1.0), (-2.0, 0.4), (0.0, 5.0), (-5.3, 4.6)])
def test_a_displaced_result_resolves_as_much_and_its_displacement_is_stated(ground, shift) -> None:
    elements = [one for one in SHOWN if one.line_width_um > 1.0]
    still, moved = (
        chart_metrics(
            blurred(chart(ground, by, elements=elements), 0.2), elements, ground, 0.5 * WAVELENGTH / 0.2
        )
        for by in ((0.0, 0.0), shift)
    )
    assert still["smallest_resolved"]["line_width_um"] < 1.8
    assert moved["smallest_resolved"] == still["smallest_resolved"]
    figures = moved["displacement"]
    assert (figures["x_samples"], figures["y_samples"]) == pytest.approx(shift, abs=0.05)
    assert figures["x_um"] == pytest.approx(0.4 * shift[0], abs=0.02)
    assert figures["scale"] == 1.0
    assert figures["rotation_deg"] == 0.0


def test_noise_hardly_moves_the_place() -> None:
    random = np.random.default_rng(3)
    noisy = chart("bright", (1.7, -0.6))
    noisy = noisy.with_values(noisy.values + 0.3 * random.standard_normal(GRID.shape).astype(np.float32))
    found = register_chart(noisy, SHOWN, "bright")
    assert found is not None
    assert np.divide(found.displacement_mm, GRID.pitch_mm) == pytest.approx((1.7, -0.6), abs=0.1)


def test_scale_and_rotation_are_stated_too() -> None:
    elements = [one for one in usaf_elements((7, 8)) if one.line_width_um > 1.2]
    grid = Grid((500, 500), 4e-4, -1.0)
    turn = 1.01 * np.exp(0.008j)
    points = [turn * complex(*one.centre_mm) for one in elements]
    moved = [replace(one, centre_mm=(p.real, p.imag)) for one, p in zip(elements, points, strict=True)]
    field = Field(grid, usaf_chart(grid, moved, "dark").astype(np.complex64), WAVELENGTH)
    found = chart_resolution(field, elements, "dark", 0.5)
    assert found.registration is not None
    assert found.registration.scale == pytest.approx(1.01, abs=5e-4)
    assert found.registration.rotation_rad == pytest.approx(0.008, abs=5e-4)
    assert found.finest == elements[-1]


def test_what_is_no_chart_is_not_registered() -> None:
    random = np.random.default_rng(1)
    noise = chart().with_values(random.standard_normal(GRID.shape).astype(np.complex64))
    for field in (noise, chart().with_values(np.ones(GRID.shape, np.complex64))):
        figures = chart_metrics(field, SHOWN, "bright", 0.5)
        assert figures["displacement"] is None
        assert figures["smallest_resolved"] is None
        assert figures["limited_by"] == ["result"]


def test_reversed_bars_are_not_registered_into_contrast() -> None:
    figures = chart_metrics(chart("dark"), SHOWN, "bright", 0.5)
    assert figures["smallest_resolved"] is None
    assert figures["displacement"] is None


def test_the_result_limits() -> None:
    """Blur that no aperture, sample or end of the chart explains."""
    figures = chart_metrics(blurred(chart(), 0.15), SHOWN, "bright", 0.5)
    assert figures["limited_by"] == ["result"]
    assert "are not" in figures["limit"]
    assert "the reconstruction is not the limit" not in figures["limit"]


def test_the_aperture_limits() -> None:
    passed_um = 0.5 * WAVELENGTH / 0.15
    figures = chart_metrics(blurred(chart(), 0.15), SHOWN, "bright", passed_um)
    assert 0.8 * passed_um < figures["smallest_resolved"]["line_width_um"] < 1.2 * passed_um
    assert figures["limited_by"] == ["aperture"]
    assert f"none finer than {passed_um:.3g} µm" in figures["limit"]


def test_the_chart_limits_where_its_finest_element_is_coarser_than_the_aperture() -> None:
    coarse = [one for one in ELEMENTS if one.line_width_um > 1.6]
    figures = chart_metrics(chart(elements=coarse), coarse, "bright", 0.5)
    assert figures["smallest_resolved"]["line_width_um"] == min(one.line_width_um for one in coarse)
    assert figures["limited_by"] == ["chart"]
    assert "the chart has no finer lines" in figures["limit"]


def test_the_last_element_of_all_is_the_charts_limit() -> None:
    grid = Grid((400, 400), 1e-4, -1.0)
    last = [one for one in usaf_elements((10,)) if one.element > 3]
    figures = chart_metrics(chart(grid=grid, elements=last), last, "bright", 0.1)
    assert figures["smallest_resolved"]["element"] == 6
    assert figures["limited_by"] == ["chart"]


def test_the_samples_limit() -> None:
    figures = chart_metrics(chart(), SHOWN, "bright", 0.5)
    assert figures["smallest_resolved"]["line_width_um"] == min(one.line_width_um for one in SHOWN)
    assert figures["limited_by"] == ["sampling"]
    assert figures["sample_um"] == pytest.approx(0.4)
    assert "samples of 0.4 µm" in figures["limit"]
    # Elements that the samples do not show at all are no error either.
    assert chart_metrics(chart(), ELEMENTS, "bright", 0.5)["limited_by"] == ["sampling"]


@pytest.mark.parametrize("size_mm", [(0.028, 0.016), (0.03, 0.03), (0.024, 0.014)])
def test_the_region_limits_a_chart_that_it_cuts_off(size_mm) -> None:
    element = next(one for one in SHOWN if one.line_width_um < 1.9)
    x, y = element.centre_mm
    whole = chart(shift=(1.2, 0.4))
    part = cut_field(whole, region_grid(GRID, (x, y, *size_mm)))
    figures = chart_metrics(part, SHOWN, "bright", 0.5)
    assert figures["elements_outside"] > 0
    assert figures["elements_outside"] + len(figures["elements"]) == len(SHOWN)
    assert figures["smallest_resolved"]["line_width_um"] == element.line_width_um
    assert figures["limited_by"] == ["region"]
    assert "outside the displayed part" in figures["limit"]
    assert figures["displacement"]["x_samples"] == pytest.approx(1.2, abs=0.1)


def test_a_region_beside_the_chart_shows_nothing() -> None:
    part = cut_field(chart(), region_grid(GRID, (0.045, 0.045, 0.008, 0.008)))
    figures = chart_metrics(part, SHOWN, "bright", 0.5)
    assert figures["elements"] == []
    assert figures["smallest_resolved"] is None
    assert figures["limited_by"] == ["region"]


def test_both_orientations_are_stated() -> None:
    """Blur along x alone."""
    values = chart().values
    cycles = scipy.fft.fftfreq(GRID.shape[1], GRID.pitch_mm)
    values = scipy.fft.ifft(scipy.fft.fft(values, axis=1) * (abs(cycles) < 300.0), axis=1)
    figures = chart_metrics(chart().with_values(values.astype(np.complex64)), SHOWN, "bright", 0.5)
    along_x, along_y = (figures[f"smallest_resolved_{way}"]["line_width_um"] for way in "xy")
    assert along_x > 1.5 > along_y
    assert figures["smallest_resolved"]["line_width_um"] == along_x


def test_samples_outside_the_field_stop_do_not_matter() -> None:
    inside = GRID.radius_squared_mm2() <= 0.045**2
    field = chart("bright", (2.0, -1.5))
    field = field.with_values(np.where(inside, field.values, 0.0))
    found = register_chart(field, SHOWN, "bright", inside)
    assert found is not None
    assert np.divide(found.displacement_mm, GRID.pitch_mm) == pytest.approx((2.0, -1.5), abs=0.05)


def test_refused() -> None:
    with pytest.raises(InputError, match="needs one element"):
        chart_resolution(chart(), [], "bright", 0.5)
    with pytest.raises(InputError, match="threshold"):
        chart_resolution(chart(), SHOWN, "bright", 0.5, threshold=1.5)


def test_one_element_alone() -> None:
    element = UsafElement(8, 2, (0.0, 0.0))
    for shift in ((0.0, 0.0), (2.0, -3.0), (0.0, 4.4)):
        figures = chart_metrics(chart("dark", shift, elements=[element]), [element], "dark", 0.5)
        assert figures["smallest_resolved"]["element"] == 2
        assert (figures["displacement"]["x_samples"], figures["displacement"]["y_samples"]) == pytest.approx(
            shift, abs=0.05
        )
