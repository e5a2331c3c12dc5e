"""Charts of error against cost, and failure maps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.text import visible
from lensdesign.plots.style import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    OCHRE,
    ORANGE,
    VIOLET,
    in_style,
    styled_figure,
)
from wavesim.metrics.comparison import Measured, families
from wavesim.metrics.failures import REFUSED, WARNED, FailureMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLES = (
    (BLUE, "o"),
    ("#38a3c9", "p"),
    (GREEN, "s"),
    (ORANGE, "D"),
    (VIOLET, "^"),
    (GREY, "P"),
    (FAINT, "X"),
    ("#b03a6b", "v"),
    (OCHRE, "<"),
)
"""Colour and marker of each family, in order of appearance."""


@in_style
def comparison_figure(rows: Sequence[Measured], title: str) -> Figure:
    """Draw error against time and against memory for each scene, with the Pareto front of each chart.

    Parameters
    ----------
    rows
        Result of :func:`wavesim.metrics.comparison.compare`.
    title
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Figure with one row of charts for each scene.
    """
    scenes = list(dict.fromkeys(row.scene for row in rows))
    figure = styled_figure(11.0, 3.6 * len(scenes) + 0.8)
    figure.suptitle(visible(title), parse_math=False)
    axes = figure.subplots(len(scenes), 2, squeeze=False)
    styles, legend = _styles(rows), dict[str, Any]()
    for pair, scene in zip(axes, scenes, strict=True):
        done = [row for row in rows if row.scene == scene and math.isfinite(row.relative_error)]
        _draw(
            pair[0],
            done,
            lambda r: r.seconds,
            lambda r: r.fastest,
            "seconds for each run, without set-up",
            styles,
        )
        _draw(pair[1], done, lambda r: r.peak_mb, lambda r: r.smallest, "peak memory (MB)", styles)
        pair[0].set_title(visible(scene), loc="left", parse_math=False)
        legend |= dict(zip(*pair[0].get_legend_handles_labels()[::-1], strict=True))
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=5)
    return figure


def _styles(rows: Sequence[Measured]) -> dict[str, tuple[str, str, bool]]:
    """Return colour and marker of each family, and whether it is drawn hollow."""
    found: dict[str, tuple[str, str, bool]] = {}
    # Families whose names end like this have the style of the previous family, but hollow.
    second_styles = ("mean", "staircase")
    for family, _ in families(rows):
        second = family.endswith(second_styles)
        number = sum(not dashed for *_, dashed in found.values()) - second
        found[family] = (*STYLES[number % len(STYLES)], second)
    return found


def _draw(
    axes: Any,
    rows: list[Measured],
    cost: Callable[[Measured], float],
    leads: Callable[[Measured], bool],
    label: str,
    styles: dict[str, tuple[str, str, bool]],
) -> None:
    front = sorted((row for row in rows if leads(row)), key=cost)
    axes.plot(
        [cost(r) for r in front],
        [r.relative_error for r in front],
        color="#f2c14e",
        lw=7,
        alpha=0.55,
        solid_capstyle="round",
        zorder=1,
        label="Pareto front",
    )
    for family, members in families(rows):
        colour, marker, second = styles[family]
        axes.plot(
            [cost(r) for r in members],
            [r.relative_error for r in members],
            color=colour,
            marker=marker,
            markerfacecolor="white" if second else colour,
            ls="none",
            ms=6,
            label=family,
        )
    if rows:
        known = rows[0].uncertainty
        axes.axhline(known, color="0.4", ls=":", lw=1.2, zorder=0, label="uncertainty of the reference field")
    axes.set(xscale="log", yscale="log", xlabel=label, ylabel="relative error of the exit field (L2)")
    _mark_few_decades(axes)
    axes.grid(True, which="major")


def _mark_few_decades(axes: Any) -> None:
    """Label ticks between decades if the axis spans few decades."""
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axes.get_xlim()
    few = high < 300.0 * low
    axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axes.xaxis.set_minor_formatter("{x:g}" if few else NullFormatter())
    if few:
        axes.xaxis.set_major_formatter("{x:g}")


@in_style
def failure_figure(maps: Sequence[FailureMap], title: str) -> Figure:
    """Draw maps of errors, with lines at the limits of warning (dashed) and refusal (solid).

    Parameters
    ----------
    maps
        Results of :func:`wavesim.metrics.failures.failure_maps`.
    title
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Figure with one map for each method.
    """
    from matplotlib.lines import Line2D

    columns = 2
    lines = math.ceil(len(maps) / columns)
    figure = styled_figure(11.0, 3.8 * lines + 0.8)
    figure.suptitle(visible(title), parse_math=False)
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    handles = [Line2D([], [], color="black", ls=style, lw=2) for style in ("--", "-")]
    words = ["limit above which a warning is given", "limit above which the method refuses"]
    figure.legend(handles, words, loc="outside lower center", ncols=2)
    picture: Any = None
    for place, found in zip(axes, maps, strict=False):
        picture = _draw_map(place, found)
    for place in axes[len(maps) :]:
        place.set_visible(False)
    figure.colorbar(picture, ax=list(axes), shrink=0.6, label="log10 of the relative error of the exit field")
    return figure


def _draw_map(axes: Any, found: FailureMap) -> Any:
    low, high = -4.0, 0.5
    shown = np.log10(np.maximum(found.error, 10.0**low))
    picture = axes.imshow(
        np.ma.masked_invalid(shown),
        origin="lower",
        aspect="auto",
        cmap="YlOrRd",
        vmin=low,
        vmax=high,
    )
    axes.set_facecolor("0.85")
    for j in range(len(found.y)):
        for i in range(len(found.x)):
            known = math.isfinite(found.error[j, i])
            text = f"{found.error[j, i]:.1g}" if known else "refused"
            is_dark = known and shown[j, i] > -0.6
            axes.text(i, j, text, ha="center", va="center", fontsize=8, color="white" if is_dark else "black")
    for level, style in ((WARNED, "--"), (REFUSED, "-")):
        _outline(axes, found.guard >= level, style)
    axes.set_xticks(range(len(found.x)), [f"{v:g}" for v in found.x])
    axes.set_yticks(range(len(found.y)), [f"{v:g}" for v in found.y])
    axes.set(xlabel=found.x_label, ylabel=found.y_label)
    always = ", warning everywhere" if np.all(found.guard >= WARNED) else ""
    axes.set_title(found.method + always, loc="left")
    return picture


def _outline(axes: Any, inside: Any, style: str) -> None:
    """Draw lines between cells where a condition holds and cells where it does not."""
    rows, columns = inside.shape
    for j in range(rows):
        for i in range(columns):
            if i + 1 < columns and inside[j, i] != inside[j, i + 1]:
                axes.plot([i + 0.5, i + 0.5], [j - 0.5, j + 0.5], color="black", ls=style, lw=2)
            if j + 1 < rows and inside[j, i] != inside[j + 1, i]:
                axes.plot([i - 0.5, i + 0.5], [j + 0.5, j + 0.5], color="black", ls=style, lw=2)
