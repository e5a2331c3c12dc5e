"""Style, labels and common elements of a tolerance report's figures."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError
from lensdesign.plots.saving import save_figure
from tolerancing.merits.base import Merit
from tolerancing.merits.line_pairs import LinePairContrast
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.report.blocks import in_micrometres, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


BLUE, ORANGE, GREEN, RED, GREY = "#2a6f97", "#e07a1f", "#4c956c", "#c1121f", "#6c757d"
VIOLET, OCHRE = "#7b2d8b", "#b08900"
SERIES = (BLUE, ORANGE, GREEN, VIOLET, OCHRE, GREY)
INK, TICKS, EDGE, GRID, PAPER = "#343a40", "#495057", "#adb5bd", "#e9ecef", "#ffffff"

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "text.color": INK,
    "axes.edgecolor": EDGE,
    "axes.facecolor": "none",
    "axes.linewidth": 0.8,
    "axes.labelcolor": INK,
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "xtick.color": TICKS,
    "ytick.color": TICKS,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
}


_MICROMETRES = re.compile(r"(?<![A-Za-z0-9])(\d+(?:p\d+)?)um(?![A-Za-z0-9])")
"""Lengths in names of columns, such as 0p775um."""


def _length(match: re.Match[str]) -> str:
    return f"{match[1].replace('p', '.')} µm"


def styled(changes: Mapping[str, Any] | None = None) -> AbstractContextManager[None]:
    """Return a context in which figures have the report's style, with some changes."""
    import matplotlib as mpl

    parameters: Any = {**STYLE, **(changes or {})}
    return mpl.rc_context(parameters)


def styled_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size (inches) that is not attached to a window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", facecolor=PAPER)


def figure_format(path: str | os.PathLike[str]) -> str:
    """Return the picture format that a file's suffix selects.

    Raises
    ------
    InputError
        If the suffix is not .png, .svg or .pdf.
    """
    allowed = (".png", ".svg", ".pdf")
    suffix = Path(path).suffix
    if suffix not in allowed:
        raise InputError(f"cannot write {path}: the suffix must be one of {', '.join(allowed)}")
    return suffix[1:]


def write_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure in the format that the path's suffix selects.

    Raises
    ------
    InputError
        If the suffix is unknown, or the file cannot be written.
    """
    kind = figure_format(path)
    with atomic_path(Path(path)) as temporary:
        save_figure(figure, temporary, kind, 150)


def figure_text(text: str) -> str:
    """Return text that matplotlib draws literally, without mathematics and control characters."""
    return plain(text).replace("$", r"\$")


def axis_label(parameter: PerturbedParameter) -> str:
    """Return the label of a perturbation's axis with its unit."""
    return _labelled(parameter.column, parameter.unit)


def merit_label(merit: Merit) -> str:
    """Return the label of a merit's axis with its unit."""
    return _labelled(merit.column, merit.unit)


def series_label(parameter: PerturbedParameter) -> str:
    """Return the label of a swept parameter with its unit."""
    name = f"{parameter.target} {parameter.quantity}"
    return in_micrometres(f"{name} ({parameter.unit})" if parameter.unit else name)


def contrast_label(merit: LinePairContrast) -> str:
    """Return a label with the line width and whether it is refocused."""
    return f"{merit.line_width_um:g} µm lines, {'refocused' if merit.refocus else 'not refocused'}"


def draw_limit(axis: Axes, merit: Merit, horizontal: bool, label: bool = True) -> None:
    """Draw the limit of a merit as a line across the axes."""
    draw = axis.axhline if horizontal else axis.axvline
    text = figure_text(in_micrometres(f"limit: {merit.limit_text}")) if label else None
    draw(merit.limit, color=RED, linewidth=1.1, label=text)


def _labelled(column: str, unit: str) -> str:
    name = _MICROMETRES.sub(_length, column.removesuffix(f"_{unit}")).replace("_", " ")
    return figure_text(in_micrometres(f"{name} ({unit})" if unit else name))
