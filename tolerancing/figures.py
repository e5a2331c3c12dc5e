"""Figures of a tolerance report, each by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tolerancing.correlation import RankCorrelation
from tolerancing.perturbations import PerturbedParameter
from tolerancing.pupil_merits import LinePairContrast
from tolerancing.results import StepResults, TrialResults
from tolerancing.study import Study
from tolerancing.summary import MeritSummary
from tolerancing.sweep import Sweep

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BLUE, ORANGE, GREEN, RED, GREY = "#2a6f97", "#e07a1f", "#4c956c", "#c1121f", "#6c757d"
SERIES = (BLUE, ORANGE, GREEN, "#7b2d8b", "#b08900", GREY)
STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.edgecolor": "#adb5bd",
    "axes.linewidth": 0.8,
    "axes.labelcolor": "#343a40",
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "xtick.color": "#495057",
    "ytick.color": "#495057",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9ecef",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "svg.fonttype": "path",
}


def styled(changes: Mapping[str, Any] | None = None) -> AbstractContextManager[None]:
    """The report's style, with some changes, for figures drawn inside a ``with``."""
    import matplotlib as mpl

    parameters: Any = {**STYLE, **(changes or {})}
    return mpl.rc_context(parameters)


def styled_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches, that no window system knows of."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def axis_label(parameter: PerturbedParameter) -> str:
    """Name of a perturbation's axis, with its unit."""
    name = parameter.column.removesuffix(f"_{parameter.unit}").replace("_", " ")
    return f"{name} ({parameter.unit})" if parameter.unit else name


def merit_label(summary: MeritSummary) -> str:
    """Name of a merit's axis, with its unit."""
    merit = summary.merit
    name = merit.column.removesuffix(f"_{merit.unit}").replace("_", " ")
    return f"{name} ({merit.unit})" if merit.unit else name


def distributions_figure(merits: Sequence[MeritSummary], scores: Array) -> Figure:
    """Histogram and cumulative distribution of each merit, with its limit and nominal value."""
    with styled():
        columns = min(2, len(merits))
        rows = -(-len(merits) // columns)
        figure = styled_figure(4.7 * columns, 2.5 * rows)
        axes = np.ravel(figure.subplots(rows, columns, squeeze=False))
        for axis, summary, column in zip(axes, merits, scores.T, strict=False):
            _distribution(axis, summary, column[np.isfinite(column)])
        for axis in axes[len(merits) :]:
            axis.set_axis_off()
    return figure


def _distribution(axis: Axes, summary: MeritSummary, scores: Array) -> None:
    merit = summary.merit
    axis.set_title(merit_label(summary), loc="left")
    if not len(scores):
        axis.text(0.5, 0.5, "no scores", ha="center", va="center", transform=axis.transAxes, color=GREY)
        return
    edges = np.histogram_bin_edges(scores, bins=int(np.clip(np.sqrt(len(scores)), 8, 40)))
    axis.hist(scores, bins=edges.tolist(), color=BLUE, alpha=0.55, edgecolor="white", linewidth=0.4)
    axis.set_ylabel("trials")
    low, high = axis.get_xlim()
    low, high = min(low, merit.limit), max(high, merit.limit)
    pad = 0.02 * (high - low)
    axis.set_xlim(low - pad, high + pad)
    bad = (low - pad, merit.limit) if merit.at_least is not None else (merit.limit, high + pad)
    axis.axvspan(*bad, color=RED, alpha=0.07, linewidth=0)
    axis.axvline(merit.limit, color=RED, linewidth=1.3, label=f"limit: {merit.limit_text}")
    if summary.nominal is not None:
        axis.axvline(summary.nominal, color="#343a40", linewidth=1.0, linestyle=":", label="nominal lens")
    cumulative = axis.twinx()
    ordered = np.sort(scores)
    cumulative.step(ordered, np.arange(1, len(ordered) + 1) / len(ordered), color=ORANGE, where="post")
    # Headroom for the legend
    axis.set_ylim(top=1.3 * axis.get_ylim()[1])
    cumulative.set_ylim(0.0, 1.3)
    cumulative.set_yticks(np.linspace(0.0, 1.0, 6))
    cumulative.set_ylabel("cumulative", color=ORANGE)
    cumulative.grid(visible=False)
    axis.legend(loc="upper left", fontsize=7.5)


def scatter_figure(
    study: Study, results: TrialResults, summary: MeritSummary, merit: int, correlation: RankCorrelation
) -> Figure:
    """One merit (by its number) against every perturbation, the strongest first."""
    with styled({"font.size": 7.5, "axes.titlesize": 7.5}):
        order = np.argsort(-correlation.strength[merit], kind="stable")
        columns = min(4, len(order))
        rows = -(-len(order) // columns)
        figure = styled_figure(9.4, 1.75 * rows + 0.2)
        axes = np.ravel(figure.subplots(rows, columns, squeeze=False, sharey=True))
        scores = results.scores[:, merit]
        for axis, k in zip(axes, order, strict=False):
            passed = summary.merit.passed(scores)
            for chosen, color in ((passed, BLUE), (~passed, RED)):
                axis.plot(
                    results.values[chosen, k], scores[chosen], ".", color=color, markersize=2.6, alpha=0.6
                )
            axis.axhline(summary.merit.limit, color=RED, linewidth=0.8)
            axis.set_xlabel(axis_label(study.perturbations[k]))
            signed, magnitude = correlation.signed[merit, k], correlation.magnitude[merit, k]
            axis.set_title(f"ρ {signed:+.2f}   ρ of magnitude {magnitude:+.2f}", fontweight="normal")
        for axis in axes[len(order) :]:
            axis.set_axis_off()
        figure.supylabel(merit_label(summary), fontsize=8.5)
    return figure


def sweep_figure(study: Study, sweep: Sweep, steps: Sequence[StepResults]) -> Figure:
    """Contrast of the line pairs, and the other merits, over a sweep's values."""
    others = [m for m in study.sweep_merits(sweep) if m.label in sweep.merits]
    panels = int(bool(sweep.line_widths_um)) + len(others)
    with styled():
        figure = styled_figure(4.7 * max(2, panels), 2.9)
        axes = list(np.ravel(figure.subplots(1, max(2, panels), squeeze=False)))
        values = [step.value for step in steps]
        if sweep.line_widths_um:
            _contrast_curves(axes.pop(0), sweep, steps, values)
        for axis, merit in zip(axes, others, strict=False):
            axis.plot(values, [s.scores.get(merit.label, np.nan) for s in steps], "o-", color=BLUE, ms=3.5)
            axis.axhline(merit.limit, color=RED, linewidth=1.0, label=f"limit: {merit.limit_text}")
            axis.set_title(merit.column.replace("_", " "), loc="left")
            axis.set_xlabel(axis_label_of_sweep(sweep))
            axis.legend(fontsize=7.5)
        for axis in axes[len(others) :]:
            axis.set_axis_off()
    return figure


def _contrast_curves(axis: Axes, sweep: Sweep, steps: Sequence[StepResults], values: list[float]) -> None:
    colors = dict(zip(sweep.line_widths_um, SERIES * len(sweep.line_widths_um), strict=False))
    for merit in sweep.line_pairs():
        axis.plot(
            values,
            [step.scores.get(merit.label, np.nan) for step in steps],
            "o-" if merit.refocus else "s--",
            color=colors[merit.line_width_um],
            markersize=3.5,
            markerfacecolor=colors[merit.line_width_um] if merit.refocus else "white",
            label=contrast_label(merit),
        )
    axis.set_title("line pair contrast", loc="left")
    axis.set_xlabel(axis_label_of_sweep(sweep))
    axis.set_ylim(min(-0.02, axis.get_ylim()[0]), 1.02)
    axis.legend(fontsize=7.5)


def axis_label_of_sweep(sweep: Sweep) -> str:
    """What a sweep varies, with its unit."""
    name = f"{sweep.target} {sweep.parameter.removesuffix('_' + sweep.unit).replace('_', ' ')}"
    return f"{name} ({sweep.unit})" if sweep.unit else name


def contrast_label(merit: LinePairContrast) -> str:
    """A line width, and whether it was refocused, in words."""
    return f"{merit.line_width_um:g} um lines, {'refocused' if merit.refocus else 'not refocused'}"


def pictures_figure(sweep: Sweep, steps: Sequence[StepResults]) -> Figure:
    """Reconstructed line pairs: a column for each value with pictures, a row for each line width."""
    shown = [step for step in steps if step.pictures]
    merits = sweep.line_pairs()
    columns = len(shown)
    with styled({"axes.grid": False}):
        figure = styled_figure(9.4, 9.4 / max(columns, 3) / 2.05 * len(sweep.line_widths_um) + 0.5)
        parts = figure.subfigures(1, columns, squeeze=False, wspace=0.02)[0]
        for part, step in zip(parts, shown, strict=True):
            part.suptitle(
                f"{sweep.parameter.removesuffix('_' + sweep.unit).replace('_', ' ')} "
                f"{step.value:g} {sweep.unit}",
                fontsize=9.0,
                fontweight="bold",
            )
            axes = part.subplots(len(sweep.line_widths_um), 2, squeeze=False)
            for axis, merit in zip(np.ravel(axes), merits, strict=True):
                _picture(axis, step, merit)
    return figure


def _picture(axis: Axes, step: StepResults, merit: LinePairContrast) -> None:
    axis.set_xticks([])
    axis.set_yticks([])
    for picture in step.pictures:
        if picture.line_width_um == merit.line_width_um and picture.refocused == merit.refocus:
            half = picture.half_width_um
            axis.imshow(
                picture.intensity, cmap="gray", vmin=0.0, origin="lower", extent=(-half, half, -half, half)
            )
    score = step.scores.get(merit.label, np.nan)
    axis.set_title(
        f"{'refocused' if merit.refocus else 'not refocused'}: {score:.2f}",
        fontsize=7.0,
        fontweight="normal",
        pad=2.5,
    )
    if merit.refocus:
        axis.set_ylabel(f"{merit.line_width_um:g} um lines", fontsize=7.5)
