"""Parts of drawings: the lens in section with its rays, dimensions, boxes and arrows of a flow."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign import Lens
from lensdesign.lens.solid import glass_elements
from lensdesign.raytrace import pupil_fan, ray_paths
from paper.style import BLUE, GLASS, GREY, INK, panel
from wavesim import Field
from wavesim.targets.region import around, cut_field
from wavesim.targets.usaf import UsafElement, chart_outline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def bare(axes: Axes) -> None:
    """No ticks, no frame, no grid."""
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def draw_glass(axes: Axes, lens: Lens) -> None:
    """The lens in section, z to the right."""
    for element in glass_elements(lens):
        upper = element.outline()[:, ::-1]
        axes.fill(
            *np.concatenate([upper, upper[::-1] * [1.0, -1.0]]).T, facecolor=GLASS, edgecolor=INK, lw=0.9
        )


def draw_rays(axes: Axes, lens: Lens, fields: Sequence[tuple[float, str]], count: int = 9) -> None:
    """Meridional fans from points of the object, each a height in mm and a colour, to the last plane."""
    for height_mm, colour in fields:
        paths = ray_paths(lens, (0.0, height_mm), pupil_fan(count).points)
        for path in paths:
            axes.plot(path[:, 2], path[:, 1], color=colour, lw=0.7, alpha=0.9, zorder=1.5)


def draw_chart(
    figure: Figure, axes: Axes, field: Field, elements: Sequence[UsafElement], most: float = 1.4
) -> None:
    """Amplitude of the part of an object in which elements of a chart lie, up to `most`."""
    cut = cut_field(field, around(chart_outline(elements), field.grid))
    width_um = 1e3 * cut.grid.pitch_mm * cut.grid.shape[1]
    panel(figure, axes, np.abs(cut.values), width_um, "µm", "amplitude", vmin=0.0, vmax=most)


def plane_line(axes: Axes, z_mm: float, half_mm: float, **more: Any) -> None:
    """A plane across the axis."""
    style: dict[str, Any] = {"color": INK, "lw": 2.0} | more
    axes.plot([z_mm, z_mm], [-half_mm, half_mm], **style)


def dimension(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str, offset: float = 0.0
) -> None:
    """A double arrow with its length written on it; `offset` moves the text across, in the data's unit."""
    style = {"arrowstyle": "<->", "color": INK, "lw": 0.8, "shrinkA": 0.0, "shrinkB": 0.0}
    axes.annotate("", end, start, arrowprops=style)
    upright = start[0] == end[0]
    x, y = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
    axes.text(
        x + (offset if upright else 0.0),
        y + (0.0 if upright else offset),
        text,
        ha="center",
        va="center",
        rotation=90 if upright else 0,
        fontsize=8,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
    )


def box(
    axes: Axes,
    middle: tuple[float, float],
    size: tuple[float, float],
    text: str,
    colour: str = BLUE,
    question: bool = False,
) -> None:
    """A step of a flow: a box, or a diamond where something is asked."""
    from matplotlib.patches import FancyBboxPatch, Polygon

    (x, y), (width, height) = middle, size
    look: dict[str, Any] = {"facecolor": "white", "edgecolor": colour, "lw": 1.3, "zorder": 2.0}
    if question:
        corners = [(x - width / 2, y), (x, y + height / 2), (x + width / 2, y), (x, y - height / 2)]
        axes.add_patch(Polygon(corners, closed=True, **look))
    else:
        low = (x - width / 2, y - height / 2)
        axes.add_patch(FancyBboxPatch(low, width, height, boxstyle="round,pad=0,rounding_size=0.08", **look))
    axes.text(x, y, text, ha="center", va="center", fontsize=8, zorder=3.0, linespacing=1.35)


def arrow(axes: Axes, points: Sequence[tuple[float, float]], text: str = "") -> None:
    """A way from box to box by some corners, with a word on its first leg."""
    for start, end in pairwise(points[:-1]):
        axes.plot(*zip(start, end, strict=True), color=GREY, lw=1.2, zorder=1.0, solid_capstyle="projecting")
    style = {"arrowstyle": "-|>", "color": GREY, "lw": 1.2, "shrinkA": 0.0, "shrinkB": 0.0}
    axes.annotate("", points[-1], points[-2], arrowprops=style, zorder=1.0)
    if text:
        (x0, y0), (x1, y1) = points[:2]
        label(axes, (0.5 * (x0 + x1), 0.5 * (y0 + y1)), text)


def label(axes: Axes, place: tuple[float, float], text: str) -> None:
    """A word on an arrow."""
    paper = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
    axes.text(*place, text, ha="center", va="center", fontsize=8, color=GREY, bbox=paper, zorder=2.5)
