"""The style of all pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import matplotlib.style
import pytest
from matplotlib.colors import to_hex

from lensdesign import load_design
from lensdesign.plots.charts import spread_figure
from lensdesign.plots.layout import layout_figure
from lensdesign.plots.plots import spot_figure
from lensdesign.plots.style import INK, SERIES, in_style, styled, styled_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lensdesign.lens.lens import Lens

PAPER = load_design(Path("designs/paper_singlet.toml"))


@pytest.fixture(autouse=True)
def chosen_backend() -> None:
    """Matplotlib chooses a backend at the first look, which would be a change of the style."""
    mpl.use("agg")


@pytest.mark.parametrize("draw", [spread_figure, layout_figure, spot_figure])
def test_pictures_have_the_style_and_leave_that_of_others_alone(draw: Callable[[Lens], Figure]) -> None:
    before = mpl.rcParams.copy()
    figure = draw(PAPER)
    assert mpl.rcParams == before
    assert {to_hex(axes.xaxis.label.get_color()) for axes in figure.axes} == {INK}
    assert not any(axes.spines["top"].get_visible() for axes in figure.axes)


def test_the_style_sheet_is_one_for_figures_of_others() -> None:
    with mpl.style.context("lensdesign.plots.transferlens"):
        by_name = mpl.rcParams.copy()
    with styled():
        assert mpl.rcParams == by_name
    assert [entry["color"] for entry in by_name["axes.prop_cycle"]] == list(SERIES)


def test_a_change_holds_within_its_context_only() -> None:
    with styled({"axes.grid": True}):
        assert mpl.rcParams["axes.grid"] is True
    assert mpl.rcParams["axes.grid"] is False


def test_a_function_in_style_returns_what_it_drew() -> None:
    @in_style
    def draw(width: float) -> Figure:
        """Draw nothing."""
        return styled_figure(width, 2.0)

    assert draw(3.0).get_figwidth() == 3.0
    assert draw.__doc__ == "Draw nothing."
