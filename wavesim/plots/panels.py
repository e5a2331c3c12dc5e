"""Common elements of figures of frames and objects: panels, colour bars, and scale bars in µm."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.text import round_number_below, visible
from lensdesign.plots.style import styled_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_DRAWN = 2048
"""Most samples along a side of a picture; more would only cost time and memory."""

AS_SAMPLED: dict[str, Any] = {"origin": "lower", "interpolation": "antialiased"}
"""Row 0 has the smallest y, and samples are not smoothed."""


def title_figure(figure: Figure, title: str, size: float = 10.0) -> None:
    """Set a title, and break lines that are wider than the figure. Control characters are made visible."""
    width = figure.get_figwidth() - 0.3
    lines = [piece for line in title.split("\n") for piece in _broken(visible(line), size, width)]
    figure.suptitle("\n".join(lines), fontsize=size, parse_math=False)


def _broken(line: str, size: float, width: float) -> list[str]:
    """Break a line between words into lines of at most a width (inches)."""
    from lensdesign.plots.charts import text_inches

    first, *words = line.split(" ")
    lines = [first]
    for word in words:
        longer = f"{lines[-1]} {word}"
        if text_inches(longer, size)[0] <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def panel_row(count: int, title: str, rows: int = 1) -> tuple[Figure, Any]:
    """Return a figure, and its axes in an array of rows."""
    figure = styled_figure(5.7 * count, 5.0 * rows + (0.4 if title else 0.0))
    title_figure(figure, title)
    return figure, figure.subplots(rows, count, squeeze=False)


def for_screen(values: Any, pitch_um: float) -> tuple[Array, float]:
    """Reduce values by means over squares to at most `MOST_DRAWN` samples a side. Also return their pitch."""
    factor = math.ceil(max(values.shape) / MOST_DRAWN)
    if factor == 1:
        return np.asarray(values, float), pitch_um
    rows, columns = (count // factor for count in values.shape)
    squares = values[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(squares.mean(axis=(1, 3), dtype=float)), factor * pitch_um


def colour_bar(figure: Figure, picture: Any, axes: Any, label: str) -> None:
    """Draw a colour bar beside its picture."""
    figure.colorbar(picture, ax=axes, fraction=0.046, pad=0.03, label=label)


def scale_bar(axes: Any, shape: tuple[int, ...], pitch_um: float) -> None:
    """Draw a scale bar of a round length, about a fifth of the width, below the picture instead of ticks."""
    rows, columns = shape
    length_um = round_number_below(0.2 * columns * pitch_um)
    left, low, length = 0.0, -0.025 * rows, length_um / pitch_um
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    axes.plot([left, left + length], [low, low], color="black", lw=3.0, clip_on=False, solid_capstyle="butt")
    text = f"{length_um:g} µm" if length_um < 1000.0 else f"{1e-3 * length_um:g} mm"
    axes.text(left + length + 0.015 * columns, low, text, va="center", ha="left")
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5))
