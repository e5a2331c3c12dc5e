"""Objects: areas and widths in closed form, the chart's layout, band limits, pictures; what is refused."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.coverage import Rectangle, disc_coverage, half_plane_coverage, rectangle_coverage
from wavesim.fields.field import Grid, relative_error
from wavesim.targets.bars import bar_rectangles
from wavesim.targets.patterns import (
    band_limit,
    phase_pads,
    phase_target,
    picture_target,
    read_grey,
    siemens_star,
)
from wavesim.targets.phantom import tissue_phantom
from wavesim.targets.usaf import (
    UsafElement,
    chart_outline,
    usaf_chart,
    usaf_elements,
    usaf_elements_within,
    usaf_line_width_um,
)

GRID = Grid((200, 240), 1e-3, -1.0, (0.3, -0.2))

places = st.floats(-0.09, 0.09)


def overlap(one: Rectangle, other: Rectangle) -> bool:
    return (
        one.left_mm < other.right_mm
        and other.left_mm < one.right_mm
        and one.low_mm < other.high_mm
        and other.low_mm < one.high_mm
    )


@given(places, places, places, places)
@settings(max_examples=50, deadline=None)
def test_a_rectangle_keeps_its_area_and_middle(a: float, b: float, c: float, d: float) -> None:
    x0, y0 = GRID.centre_mm
    shape = Rectangle(x0 + min(a, b), x0 + max(a, b), y0 + min(c, d), y0 + max(c, d))
    covered = rectangle_coverage(GRID, [shape])
    assert covered.sum() * GRID.cell == pytest.approx(shape.area_mm2, abs=1e-12)
    assert covered.min() >= 0.0
    assert covered.max() <= 1.0 + 1e-12
    if shape.area_mm2 > 1e-6:
        # Linear moments of the covered part lie within its cells, and are exact for whole cells.
        middle = (covered.sum(axis=0) @ GRID.x_mm) / covered.sum()
        assert middle == pytest.approx(0.5 * (shape.left_mm + shape.right_mm), abs=0.5 * GRID.pitch_mm)


def test_an_edge_across_cells_leaves_their_covered_part() -> None:
    grid = Grid((4, 4), 1.0, -1.0)
    covered = rectangle_coverage(grid, [Rectangle(-1.25, 0.5, -2.0, 0.1)])
    expected = np.outer([1.0, 1.0, 0.1, 0.0], [0.25, 1.0, 0.5, 0.0])
    np.testing.assert_allclose(covered, expected, atol=1e-15)


@given(st.floats(0.4, 9.9))
@settings(max_examples=40, deadline=None)
def test_a_disc_keeps_its_area_and_symmetry(radius: float) -> None:
    covered = disc_coverage(Grid((20, 21), 1.0, -1.0), radius)
    assert covered.sum() == pytest.approx(math.pi * radius**2, rel=1e-12)
    np.testing.assert_allclose(covered, covered[::-1, ::-1], atol=1e-12)


def test_a_disc_agrees_with_fine_samples_cell_by_cell() -> None:
    radius, fine = 3.3, 400
    covered = disc_coverage(Grid((8, 8), 1.0, -1.0), radius)
    at = (np.arange(8 * fine) + 0.5) / fine - 4.0
    inside = np.hypot(at[:, None], at) < radius
    sampled = inside.reshape(8, fine, 8, fine).mean(axis=(1, 3))
    np.testing.assert_allclose(covered, sampled, atol=2e-4)


@given(st.floats(-1.0, 1.0), st.floats(0.0, 2.0 * math.pi))
@settings(max_examples=40, deadline=None)
def test_a_half_plane_agrees_with_fine_samples(distance: float, turn: float) -> None:
    at = (np.arange(500) + 0.5) / 500 - 0.5
    sides = distance + at * math.cos(turn) + at[:, None] * math.sin(turn) > 0.0
    covered = half_plane_coverage(*(np.array([v]) for v in (distance, math.cos(turn), math.sin(turn))))
    assert covered[0] == pytest.approx(sides.mean(), abs=3e-3)


@pytest.mark.parametrize(
    ("group", "element", "width_um"),
    [(4, 1, 31.25), (7, 6, 2.19), (9, 1, 0.977), (9, 2, 0.870), (10, 6, 0.274)],
)
def test_line_widths_are_those_of_the_standard_table(group: int, element: int, width_um: float) -> None:
    assert usaf_line_width_um(group, element) == pytest.approx(width_um, rel=2e-3)


def test_the_whole_chart_has_six_elements_a_group_that_lie_apart() -> None:
    elements = usaf_elements()
    assert [(one.group, one.element) for one in elements] == list(
        itertools.product(range(4, 11), range(1, 7))
    )
    for one, other in itertools.combinations(elements, 2):
        wide = 1e-3 * min(one.line_width_um, other.line_width_um)
        a = one.outline
        grown = Rectangle(a.left_mm - wide, a.right_mm + wide, a.low_mm - wide, a.high_mm + wide)
        assert not overlap(grown, other.outline), (one, other)


@pytest.mark.parametrize("groups", [range(4, 11), (5,), (7, 8), (10,)])
def test_charts_are_centred_where_asked(groups: tuple[int, ...]) -> None:
    outline = chart_outline(usaf_elements(groups, (0.5, -0.25)))
    assert outline.left_mm + outline.right_mm == pytest.approx(1.0, abs=1e-12)
    assert outline.low_mm + outline.high_mm == pytest.approx(-0.5, abs=1e-12)


def test_groups_are_nested_four_times_smaller() -> None:
    outer, inner = (chart_outline(usaf_elements(groups)) for groups in ((4, 5), (6, 7)))
    assert outer.right_mm - outer.left_mm == pytest.approx(4.0 * (inner.right_mm - inner.left_mm))
    whole = chart_outline(usaf_elements(range(4, 11)))
    assert whole.area_mm2 == pytest.approx(outer.area_mm2)


def test_an_element_has_two_sets_of_three_bars_five_widths_long() -> None:
    element = UsafElement(6, 3, (0.1, 0.2))
    width = 1e-3 * element.line_width_um
    for way in ("x", "y"):
        bars, gaps = element.bars(way), element.gaps(way)
        assert (len(bars), len(gaps)) == (3, 2)
        for shape in (*bars, *gaps):
            assert shape.area_mm2 == pytest.approx(5.0 * width**2)
            outline = element.outline
            assert outline.left_mm - 1e-12 <= shape.left_mm < shape.right_mm <= outline.right_mm + 1e-12
            assert outline.low_mm - 1e-12 <= shape.low_mm < shape.high_mm <= outline.high_mm + 1e-12
        first, last = ("left_mm", "right_mm") if way == "x" else ("low_mm", "high_mm")
        assert getattr(bars[2], last) - getattr(bars[0], first) == pytest.approx(5.0 * width)
        assert getattr(gaps[0], first) == pytest.approx(getattr(bars[0], last))


def test_both_grounds_of_the_chart_are_complements_with_the_bars_area() -> None:
    grid = Grid((500, 500), 0.45e-3, -1.0)
    elements = usaf_elements_within(grid, 0.21)
    bright, dark = (usaf_chart(grid, elements, ground) for ground in ("bright", "dark"))
    np.testing.assert_allclose(bright + dark, 1.0, atol=1e-12)
    area = sum(2 * 3 * 5.0 * (1e-3 * one.line_width_um) ** 2 for one in elements)
    assert dark.real.sum() * grid.cell == pytest.approx(area, rel=1e-12)
    for one in elements[:6]:
        x, y = one.set_centre_mm("x")
        row, column = (int(np.argmin(abs(axis - v))) for axis, v in ((grid.y_mm, y), (grid.x_mm, x)))
        assert dark[row, column] == pytest.approx(1.0)


def test_a_patch_takes_the_groups_that_fit_and_the_lines_that_its_grid_shows() -> None:
    grid = Grid((900, 900), 0.4256e-3, -1.0, (0.0, 1.0))
    elements = usaf_elements_within(grid, 0.26)
    assert elements[0].group == 6
    assert (elements[-1].group, elements[-1].element) == (9, 2)
    assert usaf_elements_within(Grid((900, 900), 0.4256e-3, -1.0), 0.83)[0].group == 4
    with pytest.raises(InputError, match="group 10"):
        usaf_elements_within(grid, 0.001)
    with pytest.raises(SamplingError, match=r"lines of 7\.812 µm"):
        usaf_elements_within(Grid((90, 90), 4.0e-3, -1.0), 0.26)


def test_a_chart_finer_than_its_grid_is_refused() -> None:
    with pytest.raises(SamplingError, match=r"group 9, element 6\).*0\.5481 µm.*2 samples"):
        usaf_chart(Grid((900, 900), 0.4e-3, -1.0), usaf_elements((8, 9)))
    with pytest.raises(InputError, match="larger grid"):
        usaf_chart(Grid((100, 100), 0.4e-3, -1.0), usaf_elements((6,)))
    with pytest.raises(InputError, match="one element"):
        usaf_chart(GRID, ())


@pytest.mark.parametrize("groups", [(), (3, 4), (10, 11), (4, 6)])
def test_groups_that_are_no_neighbours_of_the_chart_are_refused(groups: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="4 to 10"):
        usaf_elements(groups)


def test_a_siemens_star_has_half_its_ring_and_turns_into_its_complement() -> None:
    grid = Grid((401, 401), 1e-3, -1.0)
    star = siemens_star(grid, 18, 0.18, 0.03).real
    assert star.sum() * grid.cell == pytest.approx(0.5 * math.pi * (0.18**2 - 0.03**2), rel=1e-4)
    np.testing.assert_allclose(star, star[:, ::-1], atol=1e-9)
    # With an odd number of spokes per quarter turn the quarter-turned star is its complement in the ring.
    ring = disc_coverage(grid, 0.18) - disc_coverage(grid, 0.03)
    turned = np.rot90(star)
    np.testing.assert_allclose(star + turned, ring, atol=1e-9)


def test_siemens_spokes_agree_with_fine_samples() -> None:
    grid, fine = Grid((60, 60), 1e-3, -1.0), 40
    star = siemens_star(grid, 5, 0.027, 0.006).real
    at = ((np.arange(60 * fine) + 0.5) / fine - 30.0) * 1e-3
    radius, angle = np.hypot(at[:, None], at), np.arctan2(at[:, None], at)
    bright = (np.cos(5 * angle) > 0.0) & (radius < 0.027) & (radius > 0.006)
    sampled = bright.reshape(60, fine, 60, fine).mean(axis=(1, 3))
    assert np.sqrt(np.mean((star - sampled) ** 2)) < 5e-3


def test_binary_phase_pads_have_their_phase_and_sharp_edges() -> None:
    target = phase_target(GRID, 12.0, 2.0, 4)
    for pad, phase in phase_pads(12.0, 2.0, 4, GRID.centre_mm):
        column = int(np.argmin(abs(GRID.x_mm - 0.5 * (pad.left_mm + pad.right_mm))))
        assert target[100, column] == pytest.approx(np.exp(1j * phase))
    assert phase_pads(12.0, 2.0, 4)[1][1] == pytest.approx(1.0)
    missing = (target - 1.0).sum() * GRID.cell
    expected = sum((np.exp(1j * phase) - 1.0) * pad.area_mm2 for pad, phase in phase_pads(12.0, 2.0, 4))
    assert missing == pytest.approx(expected)


def test_smooth_phase_pads_are_clear_and_have_a_quarter_of_the_phase_on_average() -> None:
    target = phase_target(GRID, 40.0, 2.0, 2, "smooth")
    np.testing.assert_allclose(abs(target), 1.0, atol=1e-12)
    volume = np.angle(target).sum() * GRID.cell
    assert volume == pytest.approx(0.25 * (1.0 + 2.0) * 0.04**2, rel=1e-6)
    with pytest.raises(SamplingError, match="more than pi"):
        phase_target(GRID, 10.0, 11.0, 1, "smooth")


def test_a_band_limit_leaves_only_the_aperture_and_is_a_projection() -> None:
    grid = Grid((256, 256), 0.4e-3, -1.0)
    chart = rectangle_coverage(grid, bar_rectangles(2e-3, 5, "x", grid.centre_mm, 18e-3)).astype(complex)
    limited = band_limit(chart, grid, 0.532, 0.3)
    cycles = np.fft.fftfreq(256, grid.pitch_mm)
    beyond = np.hypot(cycles[:, None], cycles) > 1e3 * 0.3 / 0.532 * (1 + 1e-9)
    spectrum = abs(np.fft.fft2(limited))
    assert spectrum[beyond].max() < 1e-9 * spectrum.max()
    np.testing.assert_allclose(band_limit(limited, grid, 0.532, 0.3), limited, atol=1e-12)
    lost = np.sum(abs(chart) ** 2) - np.sum(abs(limited) ** 2)
    assert lost == pytest.approx(np.sum(abs(chart - limited) ** 2))
    with pytest.raises(SamplingError, match=r"numerical_aperture = 0.7: .*0.38 µm"):
        band_limit(chart, grid, 0.532, 0.7)


def test_a_phantom_comes_from_its_seed_and_is_passive_and_band_limited() -> None:
    grid = Grid((300, 300), 0.4e-3, -1.0)
    phantom = tissue_phantom(grid, 7, 0.532, 0.4)
    np.testing.assert_array_equal(phantom, tissue_phantom(grid, 7, 0.532, 0.4))
    border = np.concatenate([phantom[0], phantom[-1], phantom[:, 0], phantom[:, -1]])
    np.testing.assert_allclose(border, border.mean(), atol=0.02)
    assert np.linalg.norm(phantom - tissue_phantom(grid, 8, 0.532, 0.4)) > 0.1 * np.linalg.norm(phantom)
    assert abs(phantom).max() <= 1.0
    assert abs(phantom).std() > 0.05
    assert np.angle(phantom).std() > 0.05
    assert phantom.dtype == np.complex64
    np.testing.assert_allclose(band_limit(phantom, grid, 0.532, 0.4), phantom, atol=2e-6)


def test_a_phantom_is_the_same_on_a_finer_grid() -> None:
    coarse = tissue_phantom(Grid((240, 240), 0.6e-3, -1.0), 3, 0.532, 0.4)
    fine = tissue_phantom(Grid((720, 720), 0.2e-3, -1.0), 3, 0.532, 0.4)[1::3, 1::3]
    assert relative_error(coarse, fine) < 2e-4


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255.0), (np.uint16, 65535.0)])
def test_a_picture_is_read_at_its_scale(tmp_path: Path, suffix: str, dtype: type, full: float) -> None:
    grey: np.ndarray = np.random.default_rng(1).integers(0, int(full), (30, 40), endpoint=True).astype(dtype)
    path = tmp_path / f"object.{suffix}"
    Image.fromarray(grey).save(path)
    shown = picture_target(path, Grid((30, 40), 2e-3, -1.0), 2.0, "amplitude")
    np.testing.assert_allclose(shown, grey / full, atol=1e-12)
    shown = picture_target(path, Grid((30, 40), 2e-3, -1.0), 2.0, "intensity")
    np.testing.assert_allclose(abs(shown) ** 2, grey / full, atol=1e-12)
    shown = picture_target(path, Grid((32, 40), 2e-3, -1.0), 2.0, "phase", 1.5)
    np.testing.assert_allclose(np.angle(shown[1:-1]), 1.5 * grey / full, atol=1e-12)
    np.testing.assert_allclose(shown[[0, -1]], 1.0)
    finer = picture_target(path, Grid((100, 130), 0.7e-3, -1.0), 2.0, "amplitude")
    assert finer.real.sum() * 0.7e-3**2 == pytest.approx(grey.sum() / full * 2e-3**2)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P"])
def test_colours_count_by_their_luma(tmp_path: Path, mode: str) -> None:
    picture = Image.new("RGB", (4, 3), (255, 0, 0))
    picture.putpixel((1, 2), (0, 255, 0))
    picture.convert(mode).save(tmp_path / "colours.png")
    grey = read_grey(tmp_path / "colours.png")
    expected = np.full((3, 4), 0.299)
    expected[2, 1] = 0.587
    np.testing.assert_allclose(grey, expected, atol=0.5 / 255.0)


def test_finer_pixels_are_averaged_on_request(tmp_path: Path) -> None:
    grey: np.ndarray = np.random.default_rng(2).integers(0, 255, (60, 60), endpoint=True).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "fine.png")
    grid = Grid((20, 20), 3e-3, -1.0)
    shown = picture_target(tmp_path / "fine.png", grid, 1.0, "amplitude", finer="average")
    np.testing.assert_allclose(shown, grey.reshape(20, 3, 20, 3).mean(axis=(1, 3)) / 255.0, atol=1e-12)


def test_pictures_that_are_none_are_refused(tmp_path: Path) -> None:
    grid = Grid((64, 64), 1e-3, -1.0)
    (tmp_path / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\n no picture")
    with pytest.raises(InputError, match="cannot read the picture"):
        picture_target(tmp_path / "bad.png", grid, 2.0)
    Image.fromarray(np.full((20, 20), 9, np.uint16)).save(tmp_path / "cut.tif")
    (tmp_path / "cut.tif").write_bytes((tmp_path / "cut.tif").read_bytes()[:300])
    with pytest.raises(InputError, match=r"picture .*cut.tif: is cut short"):
        picture_target(tmp_path / "cut.tif", grid, 2.0)
    Image.new("RGBA", (20, 20), (255, 255, 255, 9)).save(tmp_path / "clear.png")
    with pytest.raises(InputError, match="a PNG, colours, samples of 8 bits, with transparency; must be"):
        picture_target(tmp_path / "clear.png", grid, 2.0)
    pages = [Image.new("L", (20, 20), shade) for shade in (0, 9)]
    pages[0].save(tmp_path / "two.tif", save_all=True, append_images=pages[1:])
    with pytest.raises(InputError, match=r"two\.tif: contains 2 pictures"):
        picture_target(tmp_path / "two.tif", grid, 2.0)
    pages[0].save(tmp_path / "good.png")
    with pytest.raises(SamplingError, match=r"pixel_um = 0\.5: finer"):
        picture_target(tmp_path / "good.png", grid, 0.5)
    with pytest.raises(InputError, match="larger grid"):
        picture_target(tmp_path / "good.png", grid, 4.0)
    with pytest.raises(InputError, match="pixel_um"):
        picture_target(tmp_path / "good.png", grid, math.nan)


def test_objects_that_no_grid_can_hold_are_refused() -> None:
    line = Grid((100,), 1e-3, -1.0)
    for make in (
        lambda grid: siemens_star(grid, 8, 0.04, 0.01),
        lambda grid: phase_target(grid, 5.0, 1.0),
        lambda grid: tissue_phantom(grid, 1, 0.532, 0.2),
        lambda grid: usaf_elements_within(grid, 0.1),
    ):
        with pytest.raises(InputError, match="must be a plane"):
            make(line)
    with pytest.raises(SamplingError, match="spokes' inner ends"):
        siemens_star(GRID, 36, 0.09, 0.01)
    with pytest.raises(SamplingError, match="phase pads"):
        phase_target(GRID, 1.0, 1.0)
    with pytest.raises(SamplingError, match="fibres"):
        tissue_phantom(GRID, 1, 0.532, 0.2)
    with pytest.raises(InputError, match="seed"):
        tissue_phantom(GRID, -1, 0.532, 0.2)
    for bad in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError):
            phase_target(GRID, bad, 1.0)
