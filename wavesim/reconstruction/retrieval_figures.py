"""Figures of phase retrieval: its convergence (Fig. 10), and results from different starts (Fig. 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.text import visible
from lensdesign.errors import InputError
from lensdesign.plots.style import SERIES, in_style, styled_figure
from wavesim.fields.field import Field
from wavesim.reconstruction.phase_retrieval import Retrieved, agreement

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@in_style
def convergence_figure(
    runs: Mapping[str, Retrieved], title: str = "Convergence of phase retrieval"
) -> Figure:
    """Draw 1 minus the correlation of amplitudes (A6), and the residual at the first plane.

    Both are on logarithmic axes over the iterations, because a correlation near 1 hardly changes. A dot marks
    the iteration at which a run stagnated.

    Parameters
    ----------
    runs
        Results of :func:`wavesim.retrieve`, by the name of their start.
    title
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    InputError
        If there are no runs.
    """
    if not runs:
        raise InputError("runs: must contain at least one run")
    figure = styled_figure(10.0, 4.0)
    figure.suptitle(visible(title), parse_math=False)
    curves = {
        "1 − CC (A6)": lambda run: 1.0 - np.asarray(run.correlation),
        "relative residual, first plane": lambda run: np.asarray(run.residual_curve),
    }
    for axes, (label, curve) in zip(figure.subplots(1, 2), curves.items(), strict=True):
        for (name, run), colour in zip(runs.items(), cycle(SERIES), strict=False):
            values = np.maximum(curve(run), 1e-16)
            iterations = np.arange(len(values))
            axes.semilogy(iterations, values, color=colour, label=name)
            if run.stagnated_at is not None:
                axes.plot(run.stagnated_at, values[run.stagnated_at], "o", color=colour)
        axes.set_xlabel("iteration")
        axes.set_ylabel(label)
        axes.grid(True, which="both")
    figure.axes[0].legend()
    return figure


@in_style
def starts_figure(
    objects: Mapping[str, Field],
    correlations: Mapping[str, float] | None = None,
    title: str = "Phase retrieval from different starts",
) -> Figure:
    """Draw amplitude and phase of the object that each start leads to, with a common scale of amplitude.

    Parameters
    ----------
    objects
        Reconstructed objects on one plane grid, by the name of their start.
    correlations
        CC (A6) of each start, written above its picture. The title states the agreement of all starts. If it
        is low, a high CC does not prove that a result is correct.
    title
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    InputError
        If there are no objects, or their grids differ or are lines.
    """
    fields = list(objects.values())
    if not fields or any(f.grid != fields[0].grid or f.grid.is_line for f in fields):
        raise InputError("objects: must be one or more fields on the same plane grid")
    agreed = f"; agreement of all starts {agreement(fields):.4f}" if len(fields) > 1 else ""
    figure = styled_figure(3.5 * len(fields), 6.8)
    figure.suptitle(visible(title) + agreed, parse_math=False)
    brightest = max(float(np.percentile(np.abs(f.values), 99.9)) for f in fields)
    for column, (name, field) in enumerate(objects.items()):
        correlation = "" if correlations is None else f"\nCC {correlations[name]:.6f}"
        for row, (values, settings) in enumerate(_pictures(field, brightest)):
            axes = figure.add_subplot(2, len(fields), row * len(fields) + column + 1)
            picture = axes.imshow(values, extent=_extent_um(field), origin="lower", **settings)
            axes.set_xlabel("x (µm)")
            if row == 0:
                axes.set_title(name + correlation)
            if column == 0:
                axes.set_ylabel("y (µm)")
            if column == len(fields) - 1:
                figure.colorbar(picture, ax=axes, label=("amplitude", "phase (rad)")[row], shrink=0.8)
    return figure


def _pictures(field: Field, brightest: float) -> Sequence[tuple[Array, dict[str, Any]]]:
    """Return amplitude and phase, with their arguments of imshow."""
    return (
        (np.abs(field.values), {"cmap": "gray", "vmin": 0.0, "vmax": brightest}),
        (np.angle(field.values), {"cmap": "twilight", "vmin": -np.pi, "vmax": np.pi}),
    )


def _extent_um(field: Field) -> tuple[float, float, float, float]:
    (half_y, half_x), (x, y) = field.grid.half_widths_mm, field.grid.centre_mm
    left, right, low, high = (1e3 * edge for edge in (x - half_x, x + half_x, y - half_y, y + half_y))
    return left, right, low, high
