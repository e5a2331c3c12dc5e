"""Pictures of objects: to scale, beside the truth, with numbers and profiles."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from wavesim.fields.field import Field, Grid
from wavesim.plots.objects import object_figure
from wavesim.plots.panels import MOST_DRAWN
from wavesim.targets.usaf import UsafElement, usaf_chart, usaf_elements_within


@pytest.mark.parametrize(("samples", "factor"), [(300, 1), (2 * MOST_DRAWN + 5, 3)])
def test_a_picture_has_no_more_samples_than_a_screen(samples: int, factor: int) -> None:
    grid = Grid((samples, samples), 1e-3, -1.0)
    values = np.linspace(0.2, 1.0, samples)[None].repeat(samples, axis=0)
    figure = object_figure(Field(grid, values, 0.532), np.ones(grid.shape, bool))
    axes = figure.axes[0]
    shown = axes.images[0].get_array()
    assert shown is not None
    assert shown.shape == (samples // factor,) * 2
    assert float(shown[0, 0]) == pytest.approx(values[0, :factor].mean())
    bar = next(line for line in axes.lines if line.get_linewidth() == 3.0)
    length_um = float(np.ptp(np.asarray(bar.get_xdata()))) * factor
    (text,) = (t.get_text() for t in axes.texts)
    assert text == (f"{length_um:g} µm" if length_um < 1000.0 else f"{1e-3 * length_um:g} mm")


def test_a_title_keeps_its_lines_and_shows_what_else_is_in_it() -> None:
    grid = Grid((20, 20), 1e-3, -1.0)
    figure = object_figure(Field(grid, np.ones(grid.shape), 0.532), np.ones(grid.shape, bool), "one\ntw\x1bo")
    assert figure.get_suptitle() == "one\ntw\\x1bo"


@pytest.fixture(scope="module")
def chart() -> tuple[Field, np.ndarray, tuple[UsafElement, ...]]:
    """A chart on its samples, those within the field stop, and its elements."""
    grid = Grid((256, 256), 0.5e-3, -1.0)
    elements = usaf_elements_within(grid, 0.085)
    inside = grid.radius_squared_mm2() <= 0.06**2
    return Field(grid, usaf_chart(grid, elements), 0.532), inside, elements


def test_the_truth_stands_beside_what_was_found_with_profiles_through_both(
    chart: tuple[Field, np.ndarray, tuple[UsafElement, ...]],
) -> None:
    true, inside, elements = chart
    found = true.with_values(0.2 + 0.6 * true.values)
    figure = object_figure(found, inside, "lens", truth=true, elements=elements, profile=elements[2])
    pictures = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title() for axes in pictures] == ["true object", "found object"]
    assert {axes.images[0].get_clim() for axes in pictures} == {(0.0, 1.0)}
    for axes, field in zip(pictures, (true, found), strict=True):
        shown = np.ma.filled(axes.images[0].get_array(), np.nan)
        np.testing.assert_allclose(shown[inside], np.abs(field.values)[inside])
    profiles = [axes for axes in figure.axes if axes.get_title().startswith("profile")]
    name = f"{elements[2].group}-{elements[2].element}"
    assert [axes.get_title().split(",")[0] for axes in profiles] == [
        f"profile along {way} through element {name}" for way in "xy"
    ]
    for axes in profiles:
        lines = {line.get_label(): np.asarray(line.get_ydata()) for line in axes.lines}
        np.testing.assert_allclose(lines["found"], 0.2 + 0.6 * lines["true"])
        # Three dark bars with bright gaps between.
        dark = lines["true"] < 0.5
        assert np.count_nonzero(dark[1:] & ~dark[:-1]) == 3


def test_elements_get_their_numbers_where_there_is_room(
    chart: tuple[Field, np.ndarray, tuple[UsafElement, ...]],
) -> None:
    true, inside, elements = chart
    figure = object_figure(true, inside, elements=elements)
    FigureCanvasAgg(figure).draw()
    axes = figure.axes[0]
    numbers = {text.get_text(): text.get_window_extent() for text in axes.texts if "-" in text.get_text()}
    assert {f"{elements[0].group}-{n}" for n in range(1, 7)} <= set(numbers)
    boxes = list(numbers.values())
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    scale = axes.transData.transform([(0.0, 0.0), (1.0, 1.0)])
    for one in elements:
        box = numbers.get(f"{one.group}-{one.element}")
        if box is not None:
            x, y = (0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1))
            at = ((x, y) - scale[0]) / (scale[1] - scale[0]) * true.grid.pitch_mm
            own = one.outline
            assert own.low_mm < at[1] + true.grid.y_mm[0] < own.high_mm
            assert not own.left_mm < at[0] + true.grid.x_mm[0] < own.right_mm


def test_phases_share_a_row_and_profiles_need_no_chart() -> None:
    grid = Grid((64, 64), 1e-3, -1.0)
    phase = np.linspace(-0.4, 0.4, 64)[None].repeat(64, axis=0)
    found = Field(grid, np.exp(1j * phase), 0.532)
    true = found.with_values(np.ones(grid.shape))
    figure = object_figure(found, np.ones(grid.shape, bool), truth=true)
    assert sum(bool(axes.images) for axes in figure.axes) == 4
    assert sum("through the centre" in axes.get_title() for axes in figure.axes) == 2
