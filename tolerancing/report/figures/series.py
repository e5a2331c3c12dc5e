"""Figures of series: curves of sweeps, maps of grids, slice counts, and plates of line pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lensdesign.plots.style import BLUE, GREY, ORANGE, PAPER, RED, SERIES, styled_figure
from tolerancing.merits.base import Merit
from tolerancing.report.blocks import Panel
from tolerancing.report.figures.style import (
    chart_style,
    contrast_label,
    draw_limit,
    figure_text,
    merit_label,
    series_label,
)
from tolerancing.study.results import Picture, StepResults
from tolerancing.study.slice_counts import SliceCounts
from tolerancing.study.study import Study
from tolerancing.study.sweep import ParameterGrid, Sweep

PLATE_COLUMNS = 6
"""Pictures in a row of a plate."""


def sweep_panels(study: Study, sweep: Sweep, steps: Sequence[StepResults]) -> list[Panel]:
    """Draw the contrast of the line pairs, and each other merit, over the values of a sweep."""
    values = [float(step.coordinates[sweep.parameter]) for step in steps]
    panels = []
    if sweep.line_widths_um:
        panels.append(_contrast_panel(sweep, steps, values))
    for merit in study.all_merits:
        if merit.label in sweep.merits:
            with chart_style():
                figure = styled_figure(4.7, 2.8)
                axis = figure.subplots()
                axis.plot(values, _scores(steps, merit.label), "o-", color=BLUE, ms=3.5)
                draw_limit(axis, merit, horizontal=True)
                axis.set_title(merit_label(merit), loc="left")
                axis.set_xlabel(series_label(sweep))
                axis.legend()
            panels.append(Panel(figure, f"{merit.column} over the sweep {sweep.label}"))
    return panels


def _scores(steps: Sequence[StepResults], label: str) -> list[float]:
    return [step.scores.get(label, np.nan) for step in steps]


def _contrast_panel(sweep: Sweep, steps: Sequence[StepResults], values: list[float]) -> Panel:
    colors = dict(zip(sweep.line_widths_um, SERIES * len(sweep.line_widths_um), strict=False))
    with chart_style():
        figure = styled_figure(4.7, 2.8)
        axis = figure.subplots()
        for merit in sweep.line_pairs():
            axis.plot(
                values,
                _scores(steps, merit.label),
                "o-" if merit.refocus else "s--",
                color=colors[merit.line_width_um],
                markersize=3.5,
                markerfacecolor=colors[merit.line_width_um] if merit.refocus else PAPER,
                label=contrast_label(merit),
            )
        axis.set_title("line pair contrast", loc="left")
        axis.set_xlabel(series_label(sweep))
        axis.set_ylim(min(-0.02, axis.get_ylim()[0]), 1.02)
        axis.legend()
    return Panel(figure, f"Contrast of line pairs over the sweep {sweep.label}")


def grid_panels(study: Study, grid: ParameterGrid, steps: Sequence[StepResults]) -> list[Panel]:
    """Draw a map of each merit over the two parameters of a grid, with the limit as a contour."""
    return [_map_panel(grid, merit, steps) for merit in grid.scored(study.all_merits)]


def _map_panel(grid: ParameterGrid, merit: Merit, steps: Sequence[StepResults]) -> Panel:
    scores = np.full(len(grid), np.nan)
    for step in steps:
        scores[step.step] = step.scores.get(merit.label, np.nan)
    x, y = np.array(grid.x.values), np.array(grid.y.values)
    table = scores.reshape(len(y), len(x))[np.argsort(y)][:, np.argsort(x)]
    x, y = np.sort(x), np.sort(y)
    shown = np.ma.masked_invalid(table)
    with chart_style({"axes.grid": False}):
        figure = styled_figure(4.2, 3.3)
        axis = figure.subplots()
        mesh = axis.pcolormesh(_edges(x), _edges(y), shown, cmap="viridis", rasterized=True)
        figure.colorbar(mesh, ax=axis)
        inside = shown.count() and shown.min() < merit.limit < shown.max()
        if min(table.shape) > 1 and inside and merit.limit != 0.0:
            axis.contour(x, y, shown, levels=[merit.limit], colors=RED, linewidths=1.2)
        title = contrast_label(merit) if merit in grid.line_pairs() else merit_label(merit)
        axis.set_title(title, loc="left")
        axis.set_xlabel(series_label(grid.x))
        axis.set_ylabel(series_label(grid.y))
    return Panel(figure, f"Map of {merit.column} over {grid.x.column} and {grid.y.column}")


def _edges(values: np.ndarray) -> np.ndarray:
    """Return the edges of cells around ascending values."""
    if len(values) == 1:
        half = 0.5 * (abs(float(values[0])) or 1.0)
        return np.array([values[0] - half, values[0] + half])
    middles = 0.5 * (values[1:] + values[:-1])
    return np.concatenate(
        [[1.5 * values[0] - 0.5 * values[1]], middles, [1.5 * values[-1] - 0.5 * values[-2]]]
    )


def slice_panels(series: SliceCounts, steps: Sequence[StepResults]) -> list[Panel]:
    """Draw the contrast of each line width over the number of slices, with that of the eikonal engine."""
    return [_slice_panel(series, width, steps) for width in series.line_widths_um]


def _slice_panel(series: SliceCounts, width_um: float, steps: Sequence[StepResults]) -> Panel:
    name = f"{width_um:g}um".replace(".", "p")
    with chart_style():
        figure = styled_figure(4.7, 2.8)
        axis = figure.subplots()
        for kind, color in zip(series.compensations, (ORANGE, BLUE), strict=False):
            own = sorted(
                (s for s in steps if s.coordinates["compensation"] == kind),
                key=lambda s: float(s.coordinates["slices"]),
            )
            counts = [float(s.coordinates["slices"]) for s in own]
            axis.plot(counts, _scores(own, f"contrast_{name}"), "o-", color=color, ms=3.5, label=kind)
        eikonal = [v for v in _scores(steps, f"contrast_of_eikonal_{name}") if np.isfinite(v)]
        if eikonal:
            axis.axhline(
                float(np.mean(eikonal)), color=GREY, linestyle="--", linewidth=1.1, label="eikonal engine"
            )
        if len(series.slices) > 1:
            axis.set_xscale("log")
        axis.set_title(f"contrast of {width_um:g} µm lines", loc="left")
        axis.set_xlabel("slices of each surface")
        axis.set_ylim(min(-0.02, axis.get_ylim()[0]), 1.05)
        axis.legend()
    return Panel(figure, f"Contrast of {width_um:g} µm lines over the number of slices")


def plate_panel(rows: Mapping[str, Sequence[tuple[str, Picture | None]]], alt: str) -> Panel:
    """Draw pictures of line pairs in named rows, each with its title."""
    columns = max(len(row) for row in rows.values())
    side = 9.4 / PLATE_COLUMNS
    with chart_style({"axes.grid": False}):
        figure = styled_figure(side * columns + 0.2, (side + 0.22) * len(rows))
        axes = figure.subplots(len(rows), columns, squeeze=False)
        for (name, row), line in zip(rows.items(), axes, strict=True):
            line[0].set_ylabel(name, fontsize=7.5)
            for axis, (title, picture) in zip(line, row, strict=True):
                axis.set_xticks([])
                axis.set_yticks([])
                axis.set_title(figure_text(title), fontsize=7.5, fontweight="normal", pad=2.5)
                if picture is not None:
                    half = picture.half_width_um
                    extent = (-half, half, -half, half)
                    axis.imshow(picture.intensity, cmap="gray", vmin=0.0, origin="lower", extent=extent)
    return Panel(figure, alt)
