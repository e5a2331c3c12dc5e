"""Figures of objects at several wavelengths, and of heights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.plots.style import in_style
from wavesim.fields.field import Field
from wavesim.plots.objects import LIT, phase_reach
from wavesim.plots.panels import AS_SAMPLED, colour_bar, for_screen, panel_row, scale_bar
from wavesim.reconstruction.heights import Heights

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@in_style
def colours_figure(
    transmissions: Sequence[Field], inside: Any, title: str = "", *, truth: Sequence[Field] = ()
) -> Figure:
    """Draw the amplitude at each wavelength, the phase unless it is 0, and the true amplitude if given.

    Parameters
    ----------
    transmissions
        Transmission at each wavelength.
    inside
        Whether each sample is within the field stop.
    title
        Title of the figure.
    truth
        True transmissions, in the order of the found ones.
    """
    rows: list[tuple[str, Sequence[Field], Any]] = [("true", truth, np.abs)] if truth else []
    rows.append(("found", transmissions, np.abs))
    has_phase = any(np.any(np.imag(one.values) != 0.0) for one in transmissions)
    if has_phase:
        rows.append(("found", transmissions, np.angle))
    figure, axes = panel_row(len(transmissions), title, len(rows))
    brightest = max(float(np.quantile(np.abs(one.values)[inside], 0.999)) for one in transmissions)
    for row, (name, fields, part) in zip(axes, rows, strict=True):
        is_phase = part is np.angle
        values = [part(one.values) for one in fields]
        shown = [np.where(inside, one, np.nan) for one in values]
        if is_phase:
            lit = [np.abs(one.values) > LIT * brightest for one in fields]
            shown = [np.where(mask, one, np.nan) for mask, one in zip(lit, shown, strict=True)]
        reach = max(map(phase_reach, shown)) if is_phase else brightest
        for axis, one, field in zip(row, shown, fields, strict=True):
            low, colours = (-reach, "RdBu_r") if is_phase else (0.0, "gray")
            label = "phase (rad)" if is_phase else "amplitude transmission"
            _draw(figure, axis, one, field, (colours, low, reach, label))
            axis.set_title(f"{name}, {field.wavelength_um:g} µm")
    return figure


@in_style
def heights_figure(heights: Heights, transmission: Field, inside: Any, title: str = "") -> Figure:
    """Draw heights, their standard deviations, and the samples whose order is ambiguous.

    Parameters
    ----------
    heights
        Heights of samples.
    transmission
        Transmission on the same samples, for their pitch.
    inside
        Whether each sample is within the field stop.
    title
        Title of the figure.
    """
    figure, axes = panel_row(3, title)
    within = heights.height_um[inside]
    low, high = (float(one) for one in np.quantile(within, (0.005, 0.995)))
    deviation_nm = 1e3 * heights.deviation_um
    panels: list[tuple[str, Array, tuple[str, float, float, str]]] = [
        ("height", heights.height_um, ("viridis", low, max(high, low + 1e-6), "height (µm)")),
        (
            "standard deviation",
            deviation_nm,
            ("magma", 0.0, float(np.quantile(deviation_nm[inside], 0.99)), "deviation (nm)"),
        ),
        (
            f"ambiguous order ({100.0 * heights.ambiguous[inside].mean():.2g} %)",
            heights.ambiguous.astype(float),
            ("gray_r", 0.0, 1.0, "1: ambiguous"),
        ),
    ]
    for axis, (name, values, style) in zip(axes[0], panels, strict=True):
        _draw(figure, axis, np.where(inside, values, np.nan), transmission, style)
        axis.set_title(name)
    return figure


def _draw(
    figure: Figure, axes: Any, values: Array, field: Field, style: tuple[str, float, float, str]
) -> None:
    """Draw a picture with a colour bar and a scale bar; the style has colours, range and label."""
    colours, low, high, label = style
    shown, pitch_um = for_screen(values, 1e3 * field.grid.pitch_mm)
    picture = axes.imshow(shown, cmap=colours, vmin=low, vmax=high, **AS_SAMPLED)
    colour_bar(figure, picture, axes, label)
    scale_bar(axes, shown.shape, pitch_um)
