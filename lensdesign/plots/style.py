"""Colours and style of all pictures; the style is also a style sheet for figures of your own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Arguments = ParamSpec("Arguments")
Drawn = TypeVar("Drawn")

BLUE, ORANGE, GREEN, RED, GREY = "#2a6f97", "#e07a1f", "#4c956c", "#c1121f", "#6c757d"
VIOLET, OCHRE = "#7b2d8b", "#b08900"
SERIES = (BLUE, ORANGE, GREEN, VIOLET, OCHRE, GREY)
"""Colours of curves, in the order of the style sheet; red is kept for limits and failures."""

INK, TICKS, FAINT, GRID, PAPER = "#343a40", "#495057", "#adb5bd", "#e9ecef", "#ffffff"
GLASS = "#cfe3f1"

STYLE_SHEET = "lensdesign.plots.transferlens"
"""Name by which Matplotlib finds the style sheet of this package."""


def styled(changes: Mapping[str, Any] | None = None) -> AbstractContextManager[None]:
    """Return a context in which Matplotlib draws in the style of this toolkit, with some changes.

    Parameters
    ----------
    changes
        Further settings of Matplotlib, by their names in ``matplotlib.rcParams``.
    """
    from matplotlib.style import context

    further: Any = dict(changes or {})
    return context([STYLE_SHEET, further])


def in_style(draw: Callable[Arguments, Drawn]) -> Callable[Arguments, Drawn]:
    """Return a function that draws in the style of this toolkit."""

    @wraps(draw)
    def drawn(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Drawn:
        with styled():
            return draw(*args, **kwargs)

    return drawn


def styled_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size (inches) that is not attached to a window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", facecolor=PAPER)
