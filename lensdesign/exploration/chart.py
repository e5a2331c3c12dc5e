"""A front as a picture, and as a page on which each lens tells its name and values."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lensdesign.common.text import visible
from lensdesign.errors import atomic_path
from lensdesign.exploration.front import ExploredPoint, front_of
from lensdesign.exploration.objectives import Axis, Objective
from lensdesign.plots.charts import INK, label_axes, white_figure
from lensdesign.plots.plots import write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = ("#0B6E99", "#B5651D", "#4B7F52", "#7D4E9E", "#8A8A8A", "#B23A63")
WIDTH, HEIGHT, MARGIN = 860, 520, 96
TICKS = 6


def front_figure(explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> Figure:
    """The front over its first and last objective, glass by glass; lenses behind it are pale.

    Parameters
    ----------
    explored
        Ends of searches.
    axes
        What was weighed.
    """
    figure = white_figure((7.6, 4.8))
    plot = figure.add_subplot()
    across, up = axes[0].objective, axes[-1].objective
    front = {one.key for one in front_of(explored, axes)}
    lenses = [one for one in explored if one.lens is not None]
    for number, glasses in enumerate(dict.fromkeys(one.glasses for one in lenses)):
        color = COLORS[number % len(COLORS)]
        for on, alpha, label in ((False, 0.25, None), (True, 1.0, visible(glasses))):
            own = [one for one in lenses if one.glasses == glasses and (one.key in front) == on]
            at = np.array([[one.values[o.column] for o in (across, up)] for one in own]).reshape(-1, 2)
            plot.plot(*at.T, "o", color=color, alpha=alpha, ms=5.0, label=label if len(own) else None)
    plot.grid(color="#E4E4E4", lw=0.6)
    plot.set_axisbelow(True)
    label_axes(plot, named(across), named(up))
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    figure.suptitle("Lenses of which none is better in everything", fontsize=10.0, color=INK)
    return figure


def named(objective: Objective) -> str:
    """An objective in words, with its unit and which way is better."""
    words = {"na": "numerical aperture", "as_built_rms": "as-built rms"}
    name = words.get(objective.name, objective.name.replace("_", " "))
    unit = f" ({objective.unit})" if objective.unit else ""
    return f"{name}{unit}, {'more' if objective.larger_is_better else 'less'} is better"


def write_charts(folder: Path, explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> list[Path]:
    """Write ``front.png`` and ``front.html`` into a folder."""
    files = [folder / "front.png", folder / "front.html"]
    write_figure(front_figure(explored, axes), files[0])
    with atomic_path(files[1]) as temporary:
        temporary.write_text(front_page(explored, axes), encoding="utf-8")
    return files


def front_page(explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> str:
    """A page without scripts: circles that tell their lens where the pointer rests, and a table below."""
    columns = [axis.objective.column for axis in axes]
    across, up = columns[0], columns[-1]
    lenses = [one for one in explored if one.lens is not None]
    front = {one.key for one in front_of(explored, axes)}
    glasses = list(dict.fromkeys(one.glasses for one in lenses))
    x = _Scale([one.values[across] for one in lenses], MARGIN, WIDTH - 20)
    y = _Scale([one.values[up] for one in lenses], HEIGHT - MARGIN, 20)
    parts = [*x.lines(vertical=True), *y.lines(vertical=False)]
    for one in sorted(lenses, key=lambda one: one.key in front):
        said = html.escape("\n".join([visible(one.key), *(f"{c} = {one.values[c]:.5g}" for c in columns)]))
        color = COLORS[glasses.index(one.glasses) % len(COLORS)]
        shade = 1.0 if one.key in front else 0.25
        parts.append(
            f'<circle cx="{x(one.values[across]):.1f}" cy="{y(one.values[up]):.1f}" r="6" fill="{color}" '
            f'fill-opacity="{shade}"><title>{said}</title></circle>'
        )
    names = [named(axis.objective) for axis in (axes[0], axes[-1])]
    parts.append(
        f'<text x="{WIDTH / 2}" y="{HEIGHT - 40}" text-anchor="middle">{html.escape(names[0])}</text>'
    )
    parts.append(
        f'<text transform="translate(18 {(HEIGHT - MARGIN + 20) / 2}) rotate(-90)" text-anchor="middle">'
        f"{html.escape(names[1])}</text>"
    )
    key = " ".join(
        f'<span style="color:{COLORS[n % len(COLORS)]}">&#9679;</span> {html.escape(visible(g))}'
        for n, g in enumerate(glasses)
    )
    rows = "".join(
        "<tr><td>"
        + "</td><td>".join([html.escape(visible(one.key)), *(f"{one.values[c]:.5g}" for c in columns)])
        + "</td></tr>"
        for one in front_of(explored, axes)
    )
    head = "".join(f"<th>{html.escape(c)}</th>" for c in ["lens", *columns])
    return _PAGE.format(width=WIDTH, height=HEIGHT, parts="\n".join(parts), key=key, head=head, rows=rows)


class _Scale:
    """From values to places on the page, with lines at round values."""

    def __init__(self, values: Sequence[float], first: float, last: float) -> None:
        low, high = min(values), max(values)
        room = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
        self.low, self.high, self.first, self.last = low - room, high + room, first, last

    def __call__(self, value: float) -> float:
        return self.first + (self.last - self.first) * (value - self.low) / (self.high - self.low)

    def lines(self, vertical: bool) -> list[str]:
        """Grid lines with their values."""
        from matplotlib.ticker import MaxNLocator

        found = []
        for value in MaxNLocator(TICKS).tick_values(self.low, self.high):
            if not self.low <= value <= self.high:
                continue
            at = self(value)
            ends = (at, 20, at, HEIGHT - MARGIN) if vertical else (MARGIN, at, WIDTH - 20, at)
            found.append('<line x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}"/>'.format(*ends))
            place = (at, HEIGHT - MARGIN + 18) if vertical else (MARGIN - 8, at + 4)
            anchor = "middle" if vertical else "end"
            found.append(
                f'<text x="{place[0]:.1f}" y="{place[1]:.1f}" text-anchor="{anchor}">{value:.6g}</text>'
            )
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
<h1>Lenses of which none is better in everything</h1>
<p>{key}; pale ones lie behind the front. Rest the pointer on a lens for its name and values.</p>
<svg viewBox="0 0 {width} {height}" role="img" aria-label="front">
{parts}
</svg>
<table><tr>{head}</tr>{rows}</table>
</body></html>
"""
