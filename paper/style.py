"""One style for all pictures of the page: that of the reports, with bars of lengths and of colours."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.plots.saving import save_figure
from lensdesign.plots.style import BLUE, GLASS, GREEN, GREY, INK, ORANGE, RED, SERIES, VIOLET, styled_figure
from tolerancing.report.figures.style import chart_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "BLUE",
    "GLASS",
    "GREEN",
    "GREY",
    "INK",
    "ORANGE",
    "RED",
    "SERIES",
    "VIOLET",
    "chart_style",
    "faint_panel",
    "panel",
    "scale_bar",
    "styled_figure",
    "write_picture",
]

DOTS_PER_INCH = (110, 90, 75, 60)
"""The first with which a picture is small enough."""

COLOURS, LARGEST_BYTES = 256, 140_000
FAINTEST = 1e-7
"""Over the brightest: what lies below is drawn as that."""


def panel(
    figure: Figure,
    axes: Axes,
    values: Array,
    width: float,
    unit: str,
    label: str,
    colours: str = "gray",
    **more: Any,
) -> None:
    """A picture with its scale bar and its colour bar.

    Parameters
    ----------
    figure, axes
        Where it is drawn.
    values
        Samples; row 0 is that of the smallest y.
    width
        Of the whole row of samples, in `unit`, for the scale bar.
    unit
        Of lengths.
    label
        Of the colour bar, with the unit of the values.
    colours, **more
        As :meth:`matplotlib.axes.Axes.imshow` takes them.
    """
    picture = axes.imshow(values, origin="lower", cmap=colours, interpolation="antialiased", **more)
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    bar = figure.colorbar(picture, ax=axes, fraction=0.046, pad=0.03)
    bar.set_label(label)
    bar.outline.set_visible(False)
    scale_bar(axes, values.shape, width, unit)


def faint_panel(
    figure: Figure, axes: Axes, values: Array, width_mm: float, quantity: str, share: float
) -> None:
    """A picture by powers of ten, so that faint light shows.

    Parameters
    ----------
    figure, axes
        Where it is drawn.
    values
        Intensities or amplitudes.
    width_mm
        As of :func:`panel`.
    quantity
        What they are.
    share
        Per cent of the samples that may be darker than the darkest colour.
    """
    shown = np.log10(np.maximum(values / values.max(), FAINTEST))
    low, label = float(np.percentile(shown, share)), f"{quantity}, powers of ten"
    panel(figure, axes, shown, width_mm, "mm", label, "inferno", vmin=low, vmax=0.0)


def scale_bar(axes: Axes, shape: tuple[int, ...], width: float, unit: str) -> None:
    """A bar of 1, 2 or 5 times a power of ten below a picture."""
    rows, columns = shape
    asked = 0.25 * width
    power = 10.0 ** math.floor(math.log10(asked))
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= asked)
    end, low = columns * length / width, -0.5 - 0.03 * rows
    axes.plot([0.0, end], [low, low], color=INK, lw=2.5, clip_on=False, solid_capstyle="butt")
    axes.text(end + 0.02 * columns, low, f"{length:g} {unit}", va="center", ha="left", fontsize=8)
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5))


def write_picture(figure: Figure, path: Path) -> None:
    """Write a PNG in few colours, so that it stays small; the same figure gives the same file."""
    for dots in DOTS_PER_INCH:
        packed = _packed(figure, dots)
        if len(packed) <= LARGEST_BYTES:
            break
    with atomic_path(path) as temporary:
        temporary.write_bytes(packed)


def _packed(figure: Figure, dots_per_inch: int) -> bytes:
    from PIL import Image

    drawn, packed = BytesIO(), BytesIO()
    with chart_style():
        save_figure(figure, drawn, "png", dots_per_inch)
    picture = Image.open(drawn).convert("RGB")
    few = picture.quantize(COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    few.save(packed, "PNG", optimize=True)
    return packed.getvalue()
