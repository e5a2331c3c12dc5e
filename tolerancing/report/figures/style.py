"""Style, labels and common elements of a tolerance report's figures."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.text import name_with_unit, words_and_unit
from lensdesign.errors import InputError
from lensdesign.plots.saving import save_figure
from lensdesign.plots.style import RED, styled
from tolerancing.merits.base import Merit
from tolerancing.merits.line_pairs import LinePairContrast
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.report.blocks import plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


CHARTS: dict[str, Any] = {
    "font.size": 8.5,
    "axes.titleweight": "bold",
    "axes.grid": True,
    "axes.spines.top": True,
    "axes.spines.right": True,
    "legend.fontsize": 7.5,
}
"""Charts of a report are small, and most readers read values from them."""


def chart_style(changes: Mapping[str, Any] | None = None) -> AbstractContextManager[None]:
    """Return a context in which figures have the style of the report's charts, with some changes."""
    return styled({**CHARTS, **(changes or {})})


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
    return name_with_unit(name, parameter.unit)


def contrast_label(merit: LinePairContrast) -> str:
    """Return a label with the line width and whether it is refocused."""
    return f"{merit.line_width_um:g} µm lines, {'refocused' if merit.refocus else 'not refocused'}"


def draw_limit(axis: Axes, merit: Merit, horizontal: bool, label: bool = True) -> None:
    """Draw the limit of a merit as a line across the axes."""
    draw = axis.axhline if horizontal else axis.axvline
    text = figure_text(f"limit: {merit.limit_text}") if label else None
    draw(merit.limit, color=RED, linewidth=1.1, label=text)


def _labelled(column: str, unit: str) -> str:
    return figure_text(name_with_unit(words_and_unit(column.removesuffix(f"_{unit}"))[0], unit))
