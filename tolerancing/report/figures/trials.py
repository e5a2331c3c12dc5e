"""Figures of trials: distributions, scatter plots, yield against tolerances, and fidelity of scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.plots.style import BLUE, GREEN, GREY, INK, ORANGE, PAPER, RED, SERIES, styled_figure
from tolerancing.merits.base import Merit
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.report.blocks import Panel
from tolerancing.report.data import ReportData
from tolerancing.report.figures.style import axis_label, chart_style, draw_limit, merit_label
from tolerancing.statistics.summary import MeritSummary
from tolerancing.statistics.yields import Yield

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Indices = NDArray[np.intp]

ALL_LIMITS = "all limits"


def distribution_panel(
    data: ReportData, summary: MeritSummary, column: int, uncompensated: Array | None = None
) -> Panel:
    """Draw histogram and cumulative distribution of one merit, with its limit, nominal value and trials.

    Parameters
    ----------
    data
        Data of the report.
    summary, column
        Summary of the merit, and its index among the study's merits.
    uncompensated
        Scores without refocusing and compensators, which are drawn instead of the merit's scores.
    """
    scores = data.results.scores[:, column] if uncompensated is None else uncompensated
    name = merit_label(summary.merit) + ("" if uncompensated is None else ", not compensated")
    known = scores[np.isfinite(scores)]
    points: dict[str, list[int]] = {}
    with chart_style():
        figure = styled_figure(4.7, 2.7)
        axis = figure.subplots()
        axis.set_title(name, loc="left")
        if len(known):
            _histogram(axis, summary, known, BLUE if uncompensated is None else GREEN)
            points = _rug(axis, data, scores, summary.merit, f"rug-{column}")
        else:
            axis.text(0.5, 0.5, "no scores", ha="center", va="center", transform=axis.transAxes, color=GREY)
    alt = f"Histogram and cumulative distribution of {name} over the trials, with the limit"
    return Panel(figure, alt, points)


def _histogram(axis: Axes, summary: MeritSummary, scores: Array, color: str) -> None:
    merit = summary.merit
    bins = int(np.clip(np.sqrt(len(scores)), 8, 60))
    low, high = float(scores.min()), float(scores.max())
    if high - low <= 1e-9 * max(abs(low), abs(high)):  # all alike
        half = 5e-4 * (abs(high) or 1.0)
        low, high = low - half, high + half
    counts, edges = np.histogram(scores, bins=np.linspace(low, high, bins + 1))
    axis.stairs(counts, edges, fill=True, color=color, alpha=0.55, label="trials")
    low, high = min(edges[0], merit.limit), max(edges[-1], merit.limit)
    pad = 0.03 * (high - low)
    axis.set_xlim(low - pad, high + pad)
    bad = (low - pad, merit.limit) if merit.at_least is not None else (merit.limit, high + pad)
    axis.axvspan(*bad, color=RED, alpha=0.08, linewidth=0)
    draw_limit(axis, merit, horizontal=False)
    if summary.nominal is not None and np.isfinite(summary.nominal):
        axis.axvline(summary.nominal, color=INK, linewidth=1.0, linestyle=":", label="nominal lens")
    axis.set_ylabel("trials")
    axis.set_ylim(-0.06 * axis.get_ylim()[1], 1.35 * axis.get_ylim()[1])
    _cumulative(axis, scores)
    axis.legend(loc="upper left", ncols=2, fontsize=7.0, frameon=True, facecolor=PAPER, edgecolor="none")


def _cumulative(axis: Axes, scores: Array) -> None:
    """Draw the cumulative distribution of scores, in at most 200 steps."""
    levels = np.linspace(0.0, 1.0, min(len(scores), 200) + 1)[1:]
    right = axis.twinx()
    right.step(np.quantile(scores, levels, method="inverted_cdf"), levels, color=ORANGE, where="post", lw=1.2)
    right.set_ylim(-0.06, 1.35)
    right.set_yticks(np.linspace(0.0, 1.0, 6))
    right.set_ylabel("cumulative", color=ORANGE)
    right.grid(visible=False)


def _rug(axis: Axes, data: ReportData, scores: Array, merit: Merit, gid: str) -> dict[str, list[int]]:
    """Draw trials as points along the foot of a histogram."""
    rows = data.drawn[np.isfinite(scores[data.drawn])]
    foot = np.full(len(scores), 0.02)
    return _points(axis, data, scores, foot, rows, merit.passed(scores), gid, axis.get_xaxis_transform())


def _points(
    axis: Axes,
    data: ReportData,
    x: Array,
    y: Array,
    rows: Indices,
    passed: NDArray[np.bool_],
    gid: str,
    transform: Any = None,
) -> dict[str, list[int]]:
    """Draw good and bad trials as points, and return the trial numbers by the gid of each collection."""
    drawn = {}
    own: dict[str, Any] = {} if transform is None else {"transform": transform}
    for kind, color, chosen in (("good", BLUE, passed[rows]), ("bad", RED, ~passed[rows])):
        shown = rows[chosen]
        if len(shown):
            name = f"{gid}-{kind}"
            axis.scatter(x[shown], y[shown], s=5.0, color=color, alpha=0.65, linewidths=0.0, gid=name, **own)
            drawn[name] = data.trial_numbers[shown].tolist()
    return drawn


def scatter_panels(data: ReportData, column: int, most: int) -> list[Panel]:
    """Draw one merit, by its index, against the perturbations with the strongest correlation."""
    correlation, study = data.correlation, data.study
    order = np.argsort(-correlation.strength[column], kind="stable")[:most]
    return [_scatter_panel(data, column, int(k), study.merits[column]) for k in order]


def _scatter_panel(data: ReportData, column: int, k: int, merit: Merit) -> Panel:
    scores, values = data.results.scores[:, column], data.results.values[:, k]
    rows = data.drawn[np.isfinite(scores[data.drawn])]
    correlation, perturbation = data.correlation, data.study.perturbations[k]
    with chart_style({"font.size": 7.5, "axes.titlesize": 7.5, "axes.titleweight": "normal"}):
        figure = styled_figure(2.35, 1.95)
        axis = figure.subplots()
        points = _points(axis, data, values, scores, rows, merit.passed(scores), f"scatter-{column}-{k}")
        draw_limit(axis, merit, horizontal=True, label=False)
        axis.locator_params(axis="x", nbins=4)
        axis.set_xlabel(axis_label(perturbation))
        axis.set_ylabel(merit_label(merit))
        signed, magnitude = correlation.signed[column, k], correlation.magnitude[column, k]
        axis.set_title(f"ρ {signed:+.2f}, of magnitude {magnitude:+.2f}".replace("-", "−"))
    return Panel(figure, f"{merit.column} against {perturbation.column}, trial by trial", points)


@dataclass(frozen=True, eq=False)
class ScaleCurve:
    """Yield of one merit, or of all limits together, over a common factor of all tolerances.

    Attributes
    ----------
    name
        Name in the legend.
    points : tuple of (float, Yield)
        Yields of trials at some factors, in ascending order.
    fractions : ndarray or None
        Yield by the model at each factor of the panel, 0 to 1; None if no model fits the trials.
    """

    name: str
    points: tuple[tuple[float, Yield], ...]
    fractions: Array | None


def scale_panel(scales: Array, curves: Sequence[ScaleCurve]) -> Panel:
    """Draw yield against a common factor of all tolerances: points for trials, lines for models.

    Points of trials without a model are connected by broken lines.
    """
    with chart_style():
        figure = styled_figure(6.2, 3.1)
        axis = figure.subplots()
        for number, curve in enumerate(curves):
            together = curve.name == ALL_LIMITS
            color = INK if together else SERIES[number % len(SERIES)]
            width = 2.0 if together else 1.1
            if curve.fractions is not None:
                axis.plot(scales, 100.0 * curve.fractions, color=color, linewidth=width, label=curve.name)
            factors = [factor for factor, _ in curve.points]
            middle, low, high = (
                np.array([100.0 * getattr(found, key) for _, found in curve.points])
                for key in ("fraction", "low", "high")
            )
            line = "o" if curve.fractions is not None or len(factors) < 2 else "o--"
            axis.errorbar(
                factors, middle, yerr=[middle - low, high - middle], fmt=line, color=color, ms=4.0,
                linewidth=width, capsize=2.5, label=None if curve.fractions is not None else curve.name,
            )  # fmt: skip
        axis.set_xlabel("common factor of all tolerances")
        axis.set_ylabel("yield (%)")
        axis.set_ylim(-3.0, 103.0)
        axis.set_xlim(left=0.0)
        figure.legend(loc="outside right upper")
    return Panel(figure, "Yield against a common factor of all tolerances")


def fidelity_panel(data: ReportData, low: Merit, high: Merit, rows: Indices, scores: Array) -> Panel:
    """Draw high- against low-fidelity scores of the trials that have both.

    Parameters
    ----------
    data
        Data of the report.
    low, high
        The low- and the high-fidelity merit.
    rows, scores
        Row indices of the trials, and their high-fidelity scores.
    """
    column = [m.label for m in data.study.merits].index(low.label)
    x = data.results.scores[:, column]
    y = np.full(len(x), np.nan)
    y[rows] = scores
    both = rows[np.isfinite(x[rows]) & np.isfinite(y[rows])]
    with chart_style():
        figure = styled_figure(3.6, 3.2)
        axis = figure.subplots()
        points = _points(axis, data, x, y, both, high.passed(y), f"fidelity-{high.label}")
        if len(both):
            ends = [min(x[both].min(), y[both].min()), max(x[both].max(), y[both].max())]
            axis.plot(ends, ends, color=GREY, linewidth=0.8, linestyle="--", label="equal")
        axis.axhline(high.limit, color=RED, linewidth=0.9)
        axis.axvline(low.limit, color=RED, linewidth=0.9)
        axis.set_xlabel(merit_label(low))
        axis.set_ylabel(merit_label(high))
        axis.legend(loc="upper left")
    return Panel(figure, f"{high.column} against {low.column}, trial by trial", points)


def bars_panel(perturbations: Sequence[PerturbedParameter], changes: Array, merit: Merit) -> Panel:
    """Draw changes of one merit at both ends of each tolerance, shape (perturbations, 2), as bars."""
    names = [axis_label(perturbation) for perturbation in perturbations]
    with chart_style({"axes.grid.axis": "x"}):
        figure = styled_figure(4.7, 0.9 + 0.24 * len(names))
        axis = figure.subplots()
        positions = np.arange(len(names))
        for offset, color, ends, label in (
            (-0.19, ORANGE, changes[:, 0], "at −T"),
            (0.19, BLUE, changes[:, 1], "at +T"),
        ):
            axis.barh(positions + offset, np.nan_to_num(ends), height=0.36, color=color, label=label)
        axis.axvline(0.0, color=INK, linewidth=0.8)
        axis.set_yticks(positions, names, fontsize=7.5)
        axis.invert_yaxis()
        axis.set_title(merit_label(merit), loc="left")
        axis.set_xlabel("change from the nominal lens")
        axis.locator_params(axis="x", nbins=5)
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=2)
    return Panel(figure, f"Change of {merit.column} at both ends of each tolerance")
