"""The chart of spread against field height: curves are those of the analysis, limits those of Eq. 2."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from matplotlib.backends.backend_agg import FigureCanvasAgg
from random_lenses import lenses

from lensdesign import Lens
from lensdesign.analysis.exit_beam import largest_spread_angle
from lensdesign.errors import DesignError
from lensdesign.plots.charts import spread_figure


def curves_and_limits(figure: Any) -> tuple[list[Any], list[Any]]:
    (axes,) = figure.axes
    lines = [line for line in axes.lines if line.get_label() != "beyond the limit"]
    dashed = [line.get_linestyle() == "--" for line in lines]
    return (
        [line for line, d in zip(lines, dashed, strict=True) if not d],
        [line for line, d in zip(lines, dashed, strict=True) if d],
    )


def test_the_papers_lens_crosses_its_limit_at_the_edge_of_the_field(paper_lens: Lens) -> None:
    (curve,), (limit,) = curves_and_limits(spread_figure(paper_lens))
    height, angle = np.asarray(curve.get_xydata()).T
    assert height == pytest.approx(np.linspace(0.0, 1.5, 13))
    assert angle[[0, 4, 8]] == pytest.approx([0.498, 1.870, 3.327], abs=5e-4)
    assert angle[-1] == pytest.approx(4.8105, abs=1e-4)
    assert limit.get_ydata() == pytest.approx([4.7682, 4.7682], abs=1e-4)
    assert curve.get_label() == "0.532 µm: up to 4.811°"
    assert limit.get_label() == "limit 4.768°"


def test_what_breaks_the_limit_is_ringed_and_whole_within_the_frame(paper_lens: Lens) -> None:
    figure = spread_figure(paper_lens)
    (axes,) = figure.axes
    FigureCanvasAgg(figure).draw()
    (rings,) = (line for line in axes.lines if line.get_label() == "beyond the limit")
    ((height, angle),) = np.asarray(rings.get_xydata())
    assert (height, angle) == pytest.approx((1.5, 4.8105), abs=1e-4)
    radius = 0.5 * rings.get_markersize() * figure.dpi / 72.0
    x, y = axes.transData.transform((height, angle))
    assert axes.bbox.x1 - x > radius
    assert axes.bbox.y1 - y > radius
    within = paper_lens.replaced(object=paper_lens.object.replaced(field_diameter_mm=2.5))
    assert all(line.get_label() != "beyond the limit" for line in spread_figure(within).axes[0].lines)


def test_every_wavelength_has_its_curve_and_its_limit_in_one_colour(paper_lens: Lens) -> None:
    lens = paper_lens.replaced(wavelengths_um=(0.6328, 0.45, 0.532, 0.589))
    curves, limits = curves_and_limits(spread_figure(lens))
    assert [c.get_label().split(" ")[0] for c in curves] == ["0.6328", "0.589", "0.532", "0.45"]
    for wavelength, curve, limit in zip((0.6328, 0.589, 0.532, 0.45), curves, limits, strict=True):
        assert curve.get_ydata() == pytest.approx(largest_spread_angle(lens, wavelength).per_field_deg)
        assert math.sin(math.radians(limit.get_ydata()[0])) == pytest.approx(wavelength / 6.4)
        assert curve.get_color() == limit.get_color()
    assert len({str(c.get_color()) for c in curves}) == 4


def test_no_limit_is_drawn_where_the_pixels_resolve_every_angle(paper_lens: Lens) -> None:
    sensor = paper_lens.sensor.replaced(pixel_pitch_um=0.25, pixels=(90000, 90000))
    (curve,), limits = curves_and_limits(spread_figure(paper_lens.replaced(sensor=sensor)))
    assert not limits
    assert curve.axes.get_ylim()[1] < 6.0


@given(lens=lenses())
@settings(max_examples=3, deadline=None)
def test_nothing_leaves_the_picture(lens: Lens) -> None:
    try:
        figure = spread_figure(lens)
    except DesignError:
        return
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    page = figure.bbox
    curves, limits = curves_and_limits(figure)
    top = figure.axes[0].get_ylim()[1]
    assert all(np.nanmax(np.asarray(line.get_ydata())) <= top for line in [*curves, *limits])
    for text in figure.legends[0].get_texts():
        box = text.get_window_extent(renderer)
        assert page.x0 <= box.x0 < box.x1 <= page.x1, text.get_text()
