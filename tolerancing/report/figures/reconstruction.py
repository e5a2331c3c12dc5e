"""Figures of reconstruction merits: correlation and contrast against a perturbation, by field point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lensdesign.plots.style import GREY, PAPER, RED, SERIES, styled_figure
from tolerancing.merits.reconstruction.merit import Reconstruction
from tolerancing.perturbations.parameters import Perturbation
from tolerancing.report.blocks import Panel
from tolerancing.report.data import ReportData
from tolerancing.report.figures.style import chart_style, figure_text, series_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from lensdesign.common.arrays import Array


def reconstruction_panel(
    data: ReportData, merits: Sequence[Reconstruction], perturbation: Perturbation
) -> Panel:
    """Draw every merit over one perturbation, with trials as points, and their medians and sweeps as lines.

    Parameters
    ----------
    data
        Data of the report.
    merits
        Reconstruction merits; those of the same kind share their axes.
    perturbation
        Perturbation of the study.
    """
    figures = list(dict.fromkeys(_title(merit) for merit in merits))
    locations = list(dict.fromkeys(merit.points for merit in merits))
    with chart_style():
        figure = styled_figure(4.7 * len(figures), 3.1)
        axes = figure.subplots(1, len(figures), squeeze=False, sharey=False)[0]
        for title, axis in zip(figures, axes, strict=True):
            own = [merit for merit in merits if _title(merit) == title]
            for merit in own:
                _draw(axis, data, merit, perturbation, SERIES[locations.index(merit.points) % len(SERIES)])
            for limit in dict.fromkeys(merit.limit for merit in own):
                axis.axhline(limit, color=RED, linewidth=0.9, linestyle=":")
            axis.set_title(figure_text(title), loc="left")
            axis.set_xlabel(_axis_text(perturbation))
            _set_range(axis, own[0])
            if perturbation.is_setting:
                _set_slices(axis, perturbation)
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=len(locations))
    text = " and ".join(figures)
    return Panel(figure, f"{text} over {perturbation.column}, by field point")


def _title(merit: Reconstruction) -> str:
    if merit.figure == "contrast":
        return f"contrast of {merit.evaluated_width_um:g} µm lines"
    return merit.figure.replace("_", " ")


def _axis_text(perturbation: Perturbation) -> str:
    return "slices of each surface" if perturbation.is_setting else series_label(perturbation)


def _location_text(merit: Reconstruction) -> str:
    heights = [y for _, y in merit.points]
    if len(heights) > 1:
        return "the worst of " + ", ".join(f"{y:g}" for y in heights) + " mm"
    return f"{heights[0]:g} mm off the axis" if heights[0] else "on the axis"


def _draw(
    axis: Axes, data: ReportData, merit: Reconstruction, perturbation: Perturbation, color: str
) -> None:
    study, results = data.study, data.results
    column, row = study.perturbations.index(perturbation), study.merits.index(merit)
    x, y = results.values[:, column], results.scores[:, row]
    known = np.isfinite(y)
    x, y = x[known], y[known]
    name = _location_text(merit)
    if len(x):
        # Trials of one number of slices are spread by 3 % to either side, so that they do not overlap.
        shown = x * (1.0 + 0.03 * _even_spread(len(x))) if perturbation.is_setting else x
        axis.plot(shown, y, "o", color=color, ms=4.0, alpha=0.55, mew=0.0, label=f"{name}, trials")
        middles, medians = _medians(x, y, perturbation.is_setting)
        axis.plot(middles, medians, "--", color=color, lw=1.3, label=f"{name}, medians of trials")
    swept = _swept(data, merit, perturbation)
    if swept is not None:
        axis.plot(*swept, "s-", color=color, ms=4.0, mfc=PAPER, lw=1.3, label=f"{name}, all else nominal")


def _even_spread(count: int) -> Array:
    """Return evenly spaced numbers from -1 to 1, which are the same in every report."""
    return np.asarray(np.linspace(-1.0, 1.0, count)) if count > 1 else np.zeros(count)


def _medians(x: Array, y: Array, single_values: bool) -> tuple[list[float], list[float]]:
    """Return medians of the scores for single values, or for five groups of equally many trials."""
    if single_values:
        groups = [np.flatnonzero(x == value) for value in np.unique(x)]
    else:
        groups = [group for group in np.array_split(np.argsort(x, kind="stable"), 5) if len(group)]
    return [float(np.median(x[g])) for g in groups], [float(np.median(y[g])) for g in groups]


def _swept(
    data: ReportData, merit: Reconstruction, perturbation: Perturbation
) -> tuple[list[float], list[float]] | None:
    """Return values and scores of a sweep of the same parameter that scores the merit, if there is one."""
    for sweep in data.study.sweeps:
        same = (sweep.target, sweep.parameter) == (perturbation.target, perturbation.parameter)
        if same and merit.label in sweep.merits:
            steps = data.steps_of(sweep.label)
            points = [
                (float(s.coordinates[sweep.parameter]), s.scores.get(merit.label, np.nan)) for s in steps
            ]
            ordered = sorted(points)
            return ([p[0] for p in ordered], [p[1] for p in ordered]) if ordered else None
    return None


def _set_range(axis: Axes, merit: Reconstruction) -> None:
    low, _ = axis.get_ylim()
    axis.set_ylim(min(low, -0.02) if merit.figure == "contrast" else min(max(low, 0.0), 0.9), 1.03)
    if axis.get_ylim()[0] < 0.0:
        axis.axhline(0.0, color=GREY, linewidth=0.7)


def _set_slices(axis: Axes, perturbation: Perturbation) -> None:
    levels = [float(level) for level in getattr(perturbation.distribution, "levels", ())]
    axis.set_xscale("log")
    axis.set_xticks(levels, [f"{level:g}" for level in levels])
    axis.minorticks_off()
