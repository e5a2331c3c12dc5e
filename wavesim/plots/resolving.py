"""Figures of the resolving test: contrast against line width for several engines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from lensdesign.errors import InputError
from lensdesign.plots.style import GREY, SERIES, in_style, styled_figure
from wavesim.metrics.resolving import Resolved
from wavesim.plots.panels import title_figure
from wavesim.targets.bars import RESOLVED_CONTRAST

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@in_style
def resolving_figure(
    results: Sequence[Resolved], title: str = "", threshold: float = RESOLVED_CONTRAST
) -> Figure:
    """Draw the contrast of refocused lines against their width.

    There is one chart for each field point, with one curve for each engine. A dot is filled if the lines are
    resolved: the contrast reaches the threshold, every bar is brighter than every gap, and all wider lines
    are resolved, too. A dotted vertical line marks the smallest resolved width, which the legend states.

    Parameters
    ----------
    results
        Results of :func:`wavesim.resolve` for one or several engines and field points.
    title
        Title of the figure.
    threshold
        Smallest contrast of resolved lines.

    Raises
    ------
    InputError
        If there are no results.
    """
    if not results:
        raise InputError("results: must contain at least one result")
    heights = list(dict.fromkeys(result.field_mm for result in results))
    labels = list(dict.fromkeys(engine_label(result) for result in results))
    figure = styled_figure(5.4 * len(heights) + 0.6, 5.0)
    title_figure(figure, title)
    lowest = min(line.contrast for result in results for line in result.lines)
    charts = figure.subplots(1, len(heights), squeeze=False, sharex=True, sharey=True)[0]
    for axes, height in zip(charts, heights, strict=True):
        here = [result for result in results if result.field_mm == height]
        for result in here:
            _draw(axes, result, labels.index(engine_label(result)), threshold, len(here))
        _dress(axes, here[0], threshold)
        axes.set_ylim(min(-0.15, lowest - 0.05), 1.05)
        axes.set_title(f"field height {height:g} mm", loc="left")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13))
    charts[0].set_ylabel("contrast of the intensity, refocused")
    return figure


def engine_label(result: Resolved) -> str:
    """Return the name of an engine, with the settings that distinguish it from others of its kind."""
    if result.engine == "slices":
        settings = result.settings
        return f"{settings['slices']} slices, {settings['compensation']} compensation"
    return result.engine


def _draw(axes: Any, result: Resolved, number: int, threshold: float, curves: int) -> None:
    markers = ("D", "s", "o", "^", "P", "X")
    colour, marker = SERIES[number % len(SERIES)], markers[number % len(markers)]
    lines = sorted(result.lines, key=lambda one: one.line_width_um)
    widths, contrasts = [one.line_width_um for one in lines], [one.contrast for one in lines]
    # Curves of engines that agree coincide, so lower curves are drawn wider.
    wide = 1.6 + 1.6 * max(0, curves - 1 - number)
    axes.plot(widths, contrasts, color=colour, lw=wide, alpha=0.75, zorder=2)
    smallest = result.smallest_resolved_um(threshold)
    inside = [w for w in widths if smallest is not None and w >= smallest]
    for chosen, face in ((inside, colour), ([w for w in widths if w not in inside], "white")):
        axes.plot(
            chosen,
            [contrasts[widths.index(w)] for w in chosen],
            ls="none",
            marker=marker,
            ms=6.0,
            color=colour,
            markerfacecolor=face,
            zorder=3,
        )
    found = "none resolved" if smallest is None else f"down to {smallest:.3g} µm"
    axes.plot([], [], color=colour, marker=marker, lw=1.6, label=f"{engine_label(result)}: {found}")
    if smallest is not None:
        at = contrasts[widths.index(smallest)]
        axes.plot([smallest, smallest], [0.0, at], color=colour, ls=":", lw=1.8, zorder=1)


def _dress(axes: Any, result: Resolved, threshold: float) -> None:
    from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullLocator

    axes.axhline(0.0, color="0.4", lw=0.8)
    axes.axhline(threshold, color="0.4", lw=1.0, ls="--")
    limit_um = result.passed_um
    widths = sorted(one.line_width_um for one in result.lines)
    if 0.9 * widths[0] <= limit_um <= widths[-1]:
        axes.axvline(limit_um, color=GREY, lw=1.0, ls="-.")
        at_top = {"xycoords": ("data", "axes fraction"), "ha": "left", "va": "bottom", "color": GREY}
        axes.annotate(f" diffraction limit {limit_um:.3g} µm", (limit_um, 0.01), **at_top)
    at_edge = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom", "color": "0.3"}
    axes.annotate(f"threshold {threshold:g}", (0.98, threshold), **at_edge)
    ticks = [t for t in (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0) if _near(t, widths)]
    axes.set(xscale="log", xlabel="line width (µm)")
    if len(ticks) > 1:
        axes.xaxis.set_major_locator(FixedLocator(ticks))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.grid(True)


def _near(tick: float, widths: Sequence[float]) -> bool:
    return 0.9 * widths[0] <= tick <= 1.1 * widths[-1]
