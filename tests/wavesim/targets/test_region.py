"""Parts of an object plane."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lensdesign.errors import InputError
from wavesim.fields.coverage import Rectangle
from wavesim.fields.field import Field, Grid
from wavesim.targets.region import (
    LEAST_SAMPLES,
    around,
    cut_field,
    cut_out,
    holds,
    part_of,
    region_grid,
    soft_rim,
    widened,
)

GRID = Grid((90, 120), 0.4e-3, -5.0)
FIELD = Field(GRID, np.add.outer(1j * GRID.y_mm, GRID.x_mm), 0.532)

shares = st.tuples(*(st.floats(-0.5, 0.5) for _ in range(2)), *(st.floats(0.2, 1.0) for _ in range(2)))


def region_of(share: tuple[float, ...]) -> tuple[float, ...]:
    """A region within the grid, of shares of what is left of it."""
    (half_y, half_x), (x, y, width, height) = GRID.half_widths_mm, share
    width, height = 2.0 * half_x * width, 2.0 * half_y * height
    return x * (2.0 * half_x - width), y * (2.0 * half_y - height), width, height


@given(shares)
@example((1e-9, 0.0, 0.5, 1.0))
def test_a_region_holds_what_is_asked_for_and_less_than_a_sample_more(share: tuple[float, ...]) -> None:
    x, y, width, height = region = region_of(share)
    part = region_grid(GRID, region)
    assert holds(part, Rectangle(x - width / 2, x + width / 2, y - height / 2, y + height / 2))
    for size, side in zip(part.shape, (height, width), strict=True):
        assert size * part.pitch_mm < side + 2.0 * part.pitch_mm
    # Values are those of the place that the part's own coordinates tell.
    there = cut_field(FIELD, part)
    np.testing.assert_allclose(there.values, np.add.outer(1j * part.y_mm, part.x_mm), atol=1e-12)


@given(shares, st.floats(0.0, 0.02))
def test_room_about_a_part_has_a_soft_rim_and_leaves_the_part_alone(
    share: tuple[float, ...], margin_mm: float
) -> None:
    part = region_grid(GRID, region_of(share))
    wide = widened(part, GRID, margin_mm)
    rim = soft_rim(part, wide)
    assert rim.shape == wide.shape
    assert np.all(rim[part_of(part, wide)] == 1.0)
    assert np.all((rim > 0.0) & (rim <= 1.0))
    rows, _ = part_of(part, wide)
    if rows.start >= 4:
        assert rim[0].max() < 0.5
        assert np.all(np.diff(rim[: rows.start, wide.shape[1] // 2]) >= 0.0)


@given(shares)
def test_samples_about_a_rectangle_hold_it(share: tuple[float, ...]) -> None:
    x, y, width, height = (0.9 * n for n in region_of(share))
    rectangle = Rectangle(x - width / 2, x + width / 2, y - height / 2, y + height / 2)
    part = around(rectangle, GRID)
    assert holds(part, rectangle)
    part_of(part, GRID)
    assert all(
        n * GRID.pitch_mm < side + 2.1 * GRID.pitch_mm
        for n, side in zip(part.shape, (height, width), strict=True)
    )


def test_a_region_of_a_few_samples_or_beyond_the_plane_is_refused() -> None:
    with pytest.raises(InputError, match=rf"has 6 x 6 samples .* at least {LEAST_SAMPLES} x {LEAST_SAMPLES}"):
        region_grid(GRID, (0.0, 0.0, 2e-3, 2e-3))
    with pytest.raises(InputError, match=r"along x from -0\.024 to"):
        region_grid(GRID, (0.02, 0.0, 0.02, 0.01))


@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 60)),
    where=st.tuples(*[st.floats(0.0, 1.0)] * 4),
    pitch_um=st.floats(0.1, 10.0),
)
def test_a_region_is_where_it_says(shape: tuple[int, int], where: tuple[float, ...], pitch_um: float) -> None:
    rows, columns = shape
    y, x = (pitch_um * (np.arange(n) - 0.5 * (n - 1)) for n in shape)
    width, height = (max(s, 0.01) * n * pitch_um for s, n in zip(where[2:], (columns, rows), strict=True))
    middle_x = (where[0] - 0.5) * (columns * pitch_um - width)
    middle_y = (where[1] - 0.5) * (rows * pitch_um - height)
    region = [1e-3 * n for n in (middle_x, middle_y, width, height)]
    for values, middle, side, axis in (
        (x[None, :] + 0 * y[:, None], middle_x, width, 0),
        (y[:, None] + 0 * x[None, :], middle_y, height, 1),
    ):
        cut, centre_um = cut_out(values, pitch_um, region)
        assert np.mean(cut) == pytest.approx(centre_um[axis], abs=1e-9)
        assert cut.min() - 0.5 * pitch_um <= middle - 0.5 * side + 1e-4 * pitch_um
        assert cut.max() + 0.5 * pitch_um >= middle + 0.5 * side - 1e-4 * pitch_um
        assert np.ptp(cut) <= side + 1.01 * pitch_um


@pytest.mark.parametrize(
    ("region", "words"),
    [
        ((0.0, 0.0, 0.0, 1.0), "sides greater than 0"),
        ((0.0, math.nan, 1.0, 1.0), "must be finite"),
        ((0.016, 0.0, 0.012, 0.01), r"region_mm = 0\.016,0,0\.012,0\.01: .* along x .* -0\.02 to 0\.02 mm"),
        ((0.0, 0.0, 0.01, 0.03), r"along y .* -0\.01 to 0\.01 mm"),
    ],
)
def test_regions_beyond_the_picture_are_refused(region: tuple[float, ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        cut_out(np.zeros((20, 40)), 1.0, region)
