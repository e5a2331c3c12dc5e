"""Chart of a Pareto front as a picture, and as a page with the name and the values of each lens."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.text import name_with_unit, visible
from lensdesign.exploration.front import ExploredPoint, front_of
from lensdesign.exploration.objectives import Axis, Objective
from lensdesign.plots.charts import label_axes
from lensdesign.plots.plots import write_figure
from lensdesign.plots.style import SERIES, in_style, styled_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, HEIGHT, MARGIN = 860, 520, 96


@in_style
def front_figure(explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> Figure:
    """Plot the front over its first and last objective, by glass; dominated lenses are pale.

    Parameters
    ----------
    explored
        Results of searches.
    axes
        Objectives.
    """
    figure = styled_figure(7.6, 4.8)
    plot = figure.add_subplot()
    abscissa, ordinate = axes[0].objective, axes[-1].objective
    front = {one.key for one in front_of(explored, axes)}
    lenses = [one for one in explored if one.lens is not None]
    for index, glasses in enumerate(dict.fromkeys(one.glasses for one in lenses)):
        color = SERIES[index % len(SERIES)]
        for on_front, alpha, label in ((False, 0.25, None), (True, 1.0, visible(glasses))):
            own = [one for one in lenses if one.glasses == glasses and (one.key in front) == on_front]
            columns = (abscissa.column, ordinate.column)
            points = np.array([[one.values[c] for c in columns] for one in own]).reshape(-1, 2)
            plot.plot(*points.T, "o", color=color, alpha=alpha, ms=5.0, label=label if len(own) else None)
    plot.grid(True)
    label_axes(plot, axis_label(abscissa), axis_label(ordinate))
    figure.legend(loc="outside lower center", ncols=4)
    figure.suptitle("Pareto front")
    return figure


def axis_label(objective: Objective) -> str:
    """Return an objective in words, with its unit and the better direction."""
    words = {"na": "numerical aperture", "as_built_rms": "as-built rms"}
    name = words.get(objective.name, objective.name.replace("_", " "))
    better = "larger" if objective.larger_is_better else "smaller"
    return f"{name_with_unit(name, objective.unit)}, {better} is better"


def write_charts(folder: Path, explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> list[Path]:
    """Write ``front.png`` and ``front.html`` into a folder."""
    files = [folder / "front.png", folder / "front.html"]
    write_figure(front_figure(explored, axes), files[0])
    with atomic_path(files[1]) as temporary:
        temporary.write_text(front_page(explored, axes), encoding="utf-8")
    return files


def front_page(explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> str:
    """Return an HTML page without scripts: a chart with a tooltip for each lens, and a table."""
    columns = [axis.objective.column for axis in axes]
    across, up = columns[0], columns[-1]
    lenses = [one for one in explored if one.lens is not None]
    front = {one.key for one in front_of(explored, axes)}
    glasses = list(dict.fromkeys(one.glasses for one in lenses))
    x = _Scale([one.values[across] for one in lenses], MARGIN, WIDTH - 20)
    y = _Scale([one.values[up] for one in lenses], HEIGHT - MARGIN, 20)
    elements = [*x.lines(vertical=True), *y.lines(vertical=False)]
    for one in sorted(lenses, key=lambda one: one.key in front):
        tooltip = html.escape("\n".join([visible(one.key), *(f"{c} = {one.values[c]:.5g}" for c in columns)]))
        color = SERIES[glasses.index(one.glasses) % len(SERIES)]
        shade = 1.0 if one.key in front else 0.25
        elements.append(
            f'<circle cx="{x(one.values[across]):.1f}" cy="{y(one.values[up]):.1f}" r="6" fill="{color}" '
            f'fill-opacity="{shade}"><title>{tooltip}</title></circle>'
        )
    names = [axis_label(axis.objective) for axis in (axes[0], axes[-1])]
    elements.append(
        f'<text x="{WIDTH / 2}" y="{HEIGHT - 40}" text-anchor="middle">{html.escape(names[0])}</text>'
    )
    elements.append(
        f'<text transform="translate(18 {(HEIGHT - MARGIN + 20) / 2}) rotate(-90)" text-anchor="middle">'
        f"{html.escape(names[1])}</text>"
    )
    key = " ".join(
        f'<span style="color:{SERIES[n % len(SERIES)]}">&#9679;</span> {html.escape(visible(g))}'
        for n, g in enumerate(glasses)
    )
    rows = "".join(
        "<tr><td>"
        + "</td><td>".join([html.escape(visible(one.key)), *(f"{one.values[c]:.5g}" for c in columns)])
        + "</td></tr>"
        for one in front_of(explored, axes)
    )
    head = "".join(f"<th>{html.escape(c)}</th>" for c in ["lens", *columns])
    return _PAGE.format(
        width=WIDTH, height=HEIGHT, elements="\n".join(elements), key=key, head=head, rows=rows
    )


class _Scale:
    """Linear scale from values to page coordinates, with grid lines at round values."""

    def __init__(self, values: Sequence[float], first: float, last: float) -> None:
        low, high = min(values), max(values)
        margin = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
        self.low, self.high, self.first, self.last = low - margin, high + margin, first, last

    def __call__(self, value: float) -> float:
        return self.first + (self.last - self.first) * (value - self.low) / (self.high - self.low)

    def lines(self, vertical: bool) -> list[str]:
        """Return grid lines with their values as SVG elements."""
        from matplotlib.ticker import MaxNLocator

        found = []
        for value in MaxNLocator(6).tick_values(self.low, self.high):
            if not self.low <= value <= self.high:
                continue
            position = self(value)
            ends = (
                (position, 20, position, HEIGHT - MARGIN)
                if vertical
                else (MARGIN, position, WIDTH - 20, position)
            )
            found.append('<line x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}"/>'.format(*ends))
            tx, ty = (position, HEIGHT - MARGIN + 18) if vertical else (MARGIN - 8, position + 4)
            anchor = "middle" if vertical else "end"
            found.append(f'<text x="{tx:.1f}" y="{ty:.1f}" text-anchor="{anchor}">{value:.6g}</text>')
        return found


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Front</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 14px system-ui, sans-serif; margin: 2rem auto; max-width: 900px; padding: 0 1rem; }}
svg {{ width: 100%; height: auto; }} svg text {{ font-size: 12px; fill: currentColor; }}
svg line {{ stroke: currentColor; stroke-opacity: 0.15; }}
circle:hover {{ stroke: currentColor; stroke-width: 2; }}
table {{ border-collapse: collapse; margin-top: 1rem; }} td, th {{ padding: 2px 12px; text-align: right; }}
td:first-child, th:first-child {{ text-align: left; }} tr:nth-child(even) td {{ background: #8881; }}
</style></head><body>
<h1>Pareto front</h1>
<p>{key}; pale lenses are dominated by others. Rest the pointer on a lens for its name and values.</p>
<svg viewBox="0 0 {width} {height}" role="img" aria-label="front">
{elements}
</svg>
<table><tr>{head}</tr>{rows}</table>
</body></html>
"""
