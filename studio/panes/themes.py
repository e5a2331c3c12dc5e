"""Themes of the charts, for light and dark backgrounds."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal

import panel as pn

from studio.panes.tabs import Tabs

Theme = Literal["light", "dark"]

COLORS = {
    "light": {
        "ink": "#1d2327",
        "faint": "#5f6a73",
        "line": "#dde1e4",
        "paper": "#ffffff",
        "glass": "#cfe3ee",
        "edge": "#3e5361",
        "bad": "#c62828",
        "accent": "#00796b",
        "near": "#8f5400",
    },
    "dark": {
        "ink": "#d7dde3",
        "faint": "#97a2ac",
        "line": "#2c333a",
        "paper": "#1a1e22",
        "glass": "#26404e",
        "edge": "#9fc3d6",
        "bad": "#ff6b5e",
        "accent": "#4cc2b0",
        "near": "#e0a23c",
    },
}

FIELDS = {"light": ("#c2410c", "#00805d", "#0069b4"), "dark": ("#ff8a4c", "#2fbf93", "#59b0f0")}
"""Colours of three fields."""

WAVES = {
    "light": ("#2166ac", "#67a9cf", "#d1e5f0", "#eceff1", "#fddbc7", "#ef8a62", "#b2182b"),
    "dark": ("#7cc4ff", "#4a8fc7", "#2f567a", "#2b3238", "#743d2f", "#c76a4a", "#ffa982"),
}
"""Colours of path differences from negative to positive, to be interpolated."""

INTENSITY = {
    "light": ("#ffffff", "#d3ecd9", "#7fcdbb", "#2c7fb8", "#1b3a76", "#0b1736"),
    "dark": ("#14171a", "#1b3a5c", "#2a7f96", "#55c0a0", "#d9e58a", "#fffbe0"),
}
"""Colours of intensities from dark to bright, to be interpolated."""


def chart(name: str, *, height: int, x: str = "", y: str = "", **more: Any) -> Any:
    """Return an empty Bokeh figure without colours; :class:`ThemedChart` gives it those of a theme.

    Screen readers know it by its name.

    A box drawn with the mouse is enlarged, and a double click shows everything again.
    """
    from bokeh.models import BoxZoomTool, CustomJS, ResetTool
    from bokeh.plotting import figure

    plot = figure(
        name=name,
        height=height,
        sizing_mode="stretch_width",
        margin=0,
        toolbar_location=None,
        tools="",
        min_border=2,
        output_backend="canvas",
        x_axis_label=x or None,
        y_axis_label=y or None,
        **more,
    )
    plot.add_tools(BoxZoomTool(match_aspect=bool(more.get("match_aspect"))), ResetTool())
    plot.js_on_event("doubletap", CustomJS(args={"plot": plot}, code="plot.reset.emit()"))
    plot.outline_line_color = None
    return plot


def hover(plot: Any, renderers: list[Any], *tooltips: tuple[str, str], **more: Any) -> None:
    """Show values of a chart's renderers under the pointer."""
    from bokeh.models import HoverTool

    plot.add_tools(HoverTool(renderers=renderers, tooltips=list(tooltips), **more))


def color_bar(plot: Any, mapper: Any, title: str) -> Any:
    """Add a bar with the values of a chart's colours, and return it."""
    from bokeh.models import BasicTicker, ColorBar

    bar = ColorBar(
        color_mapper=mapper,
        ticker=BasicTicker(desired_num_ticks=5),
        title=title,
        width=8,
        padding=4,
        label_standoff=4,
        title_standoff=4,
        border_line_color=None,
        background_fill_alpha=0.0,
        major_tick_line_color=None,
        major_label_text_font_size="10px",
        title_text_font_size="10px",
        title_text_font_style="normal",
    )
    plot.add_layout(bar, "right")
    return bar


def set_range(span: Any, start: float, end: float) -> None:
    """Set what a chart shows, and what it shows again after a double click.

    A range that the user has enlarged stays until other values are given.
    """
    if (span.reset_start, span.reset_end) != (start, end):
        span.update(start=start, end=end, reset_start=start, reset_end=end)


class ThemedChart(pn.pane.Bokeh):
    """A pane with a chart in the light theme, which :func:`apply_theme` changes.

    Parameters
    ----------
    plot
        Chart of :func:`chart`.
    dress
        Function that applies the colours of a theme to the contents of the chart (default: none). It is
        called at once.
    margin
        Margin around the chart in pixels: all sides, or vertical and horizontal.
    """

    def __init__(
        self,
        plot: Any,
        dress: Callable[[dict[str, str], Theme], None] | None = None,
        margin: int | tuple[int, int] = 0,
    ) -> None:
        super().__init__(plot, sizing_mode="stretch_width", margin=margin)
        self._dress = dress
        self.apply("light")

    def apply(self, theme: Theme) -> None:
        """Apply a theme to axes, background and contents of the chart."""
        plot, colors = self.object, COLORS[theme]
        plot.update(background_fill_color=colors["paper"], border_fill_color=colors["paper"])
        plot.xgrid.grid_line_color = plot.ygrid.grid_line_color = colors["line"]
        for axis in plot.axis:
            axis.update(
                axis_line_color=colors["line"],
                major_tick_line_color=None,
                minor_tick_line_color=None,
                major_label_text_color=colors["faint"],
                axis_label_text_color=colors["faint"],
                major_label_text_font_size="10px",
                axis_label_text_font_size="11px",
                axis_label_text_font_style="normal",
                axis_label_standoff=3,
                major_label_standoff=3,
            )
        for legend in plot.legend:
            legend.update(
                label_text_color=colors["ink"],
                label_text_font_size="10px",
                background_fill_alpha=0.0,
                border_line_color=None,
                padding=2,
                spacing=0,
                glyph_height=18,
            )
        for bar in plot.right:
            if hasattr(bar, "color_mapper"):
                bar.update(major_label_text_color=colors["faint"], title_text_color=colors["faint"])
        if self._dress is not None:
            self._dress(colors, theme)


def apply_theme(view: pn.viewable.Viewable, theme: Theme) -> None:
    """Apply a theme to all charts of a view, including those in tabs that are not shown."""
    charts = {
        pane: None for part in view.select(Tabs) for tab in part.views for pane in tab.select(ThemedChart)
    }
    for pane in charts | dict.fromkeys(view.select(ThemedChart)):
        pane.apply(theme)


def framed(plot: Any) -> Any:
    """Let a chart show a box to scale; return the source of the box's corners, x and y."""
    from bokeh.models import ColumnDataSource

    source = ColumnDataSource({"x": [-1.0, 1.0], "y": [-1.0, 1.0]})
    corners = plot.scatter("x", "y", source=source, alpha=0.0, size=0)
    for span in (plot.x_range, plot.y_range):
        span.update(renderers=[corners], range_padding=0.0)
    return source


def between(stops: tuple[str, ...], count: int = 96) -> list[str]:
    """Return colours interpolated evenly between stops."""
    import numpy as np

    values = np.array([[int(s[i : i + 2], 16) for i in (1, 3, 5)] for s in stops], float)
    positions = np.linspace(0, len(stops) - 1, count)
    mixed = [np.interp(positions, np.arange(len(stops)), values[:, k]) for k in range(3)]
    return [f"#{int(r):02x}{int(g):02x}{int(b):02x}" for r, g, b in zip(*mixed, strict=True)]


def show(box: Any, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Set the box of :func:`framed`, unless it is set already."""
    new = {"x": list(x), "y": list(y)}
    if dict(box.data) != new:
        box.data = new


def stepped(value: float) -> float:
    """Return the next of values that are 3 % apart, so that a range is steady while a slider moves."""
    return 1.03 ** math.ceil(math.log(max(value, 1e-12)) / math.log(1.03))
