"""Figures as picture files: the dots that Matplotlib's own way of saving gives."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from lensdesign.plots.saving import save_figure
from lensdesign.plots.style import styled


def figure(layout: str | None) -> Figure:
    """A picture with its bar beside a chart, and a legend outside of both."""
    drawn = Figure(figsize=(5.0, 2.4), layout=layout)
    left, right = drawn.subplots(1, 2)
    shown = left.imshow(np.arange(12.0).reshape(3, 4), interpolation="antialiased")
    drawn.colorbar(shown, ax=left, label="height (mm)")
    right.semilogy([1.0, 2.0, 3.0], [1e-3, 1.0, 1e4], label="a line")
    drawn.suptitle("a title\nof two lines")
    drawn.legend(loc="outside lower center" if layout else "lower center")
    return drawn


@pytest.mark.parametrize("layout", ["constrained", None])
@pytest.mark.parametrize("dots_per_inch", [60, 110])
def test_a_png_has_the_dots_that_matplotlib_gives(layout: str | None, dots_per_inch: int) -> None:
    ours, theirs = BytesIO(), BytesIO()
    with styled():
        drawn = figure(layout)
    save_figure(drawn, ours, "png", dots_per_inch)
    with styled():
        figure(layout).savefig(theirs, format="png", dpi=dots_per_inch)
    found, expected = Image.open(ours), Image.open(theirs)
    assert (found.mode, expected.mode) == ("RGB", "RGBA")
    assert np.array_equal(np.asarray(found), np.asarray(expected)[..., :3])
    assert found.info["dpi"] == pytest.approx((dots_per_inch, dots_per_inch), rel=1e-3)


def test_a_figure_is_left_as_it_was() -> None:
    drawn, once = figure("constrained"), figure("constrained")
    before, layout = drawn.dpi, drawn.get_layout_engine()
    save_figure(drawn, BytesIO(), "png", 60)
    assert drawn.dpi == before
    assert drawn.get_layout_engine() is layout
    save_figure(drawn, BytesIO(), "png", 110)
    save_figure(once, BytesIO(), "png", 110)
    for one, other in zip(drawn.axes, once.axes, strict=True):
        assert one.get_position().bounds == pytest.approx(other.get_position().bounds, abs=0.01)


@pytest.mark.parametrize("form", ["svg", "pdf"])
def test_other_forms_are_those_of_matplotlib(form: str, tmp_path: Path) -> None:
    save_figure(figure("constrained"), tmp_path / "file", form, 60)
    assert (tmp_path / "file").read_bytes()[:5] == {"svg": b"<?xml", "pdf": b"%PDF-"}[form]


@pytest.mark.parametrize("form", ["png", "jpg"])
def test_a_figure_with_very_many_panels_has_fewer_dots_per_inch(form: str) -> None:
    file = BytesIO()
    save_figure(Figure(figsize=(2.0, 900.0)), file, form, 180)
    width, height = Image.open(file).size
    assert 31_900 < height <= 32_000
    assert width == pytest.approx(height / 450, abs=1)
