"""Chart of the largest spread angle against field height, with the limit of Eq. 2, for every wavelength."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from lensdesign.analysis.matching import spread_limit_sine
from lensdesign.analysis.spread import largest_spread
from lensdesign.lens.lens import Lens
from lensdesign.tracing.paths import FIELD_COLORS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "os^Dv"


def spread_figure(lens: Lens) -> Figure:
    """Largest spread angle of each field height over the whole stop, and the sensor's limit (Eq. 2).

    A solid line and a dashed limit in one colour for each wavelength, the longest first. Where the pixels
    resolve every angle there is no limit to draw.

    Parameters
    ----------
    lens
        Any lens.

    Raises
    ------
    DesignError
        If no ray passes at one of the wavelengths.
    """
    figure = white_figure((7.6, 4.6))
    axes = figure.add_subplot()
    wavelengths = sorted(lens.wavelengths_um, reverse=True)
    largest = 0.0
    for number, (wavelength, color) in enumerate(zip(wavelengths, _colors(len(wavelengths)), strict=True)):
        spread = largest_spread(lens, wavelength)
        sine = spread_limit_sine(wavelength, lens.sensor.pixel_pitch_um)
        axes.plot(
            spread.field_heights_mm,
            spread.per_field_deg,
            marker=MARKERS[number % len(MARKERS)],
            color=color,
            clip_on=False,
            zorder=3,
            ms=3.5,
            lw=1.4,
            label=f"{wavelength:.4g} µm: up to {spread.spread_deg:.3f}°",
        )
        limit = math.degrees(math.asin(sine)) if sine < 1.0 else 0.0
        largest = max(largest, spread.spread_deg, limit)
        if sine < 1.0:
            axes.axhline(limit, color=color, ls="--", lw=1.2, label=f"limit {limit:.3f}°")
    axes.set_xlim(0.0, lens.half_field_mm)
    axes.set_ylim(0.0, 1.12 * largest)
    axes.grid(color="#E4E4E4", lw=0.6)
    axes.set_axisbelow(True)
    label_axes(axes, "field height (mm)", "largest spread angle (deg)")
    figure.suptitle(f"Spread behind the lens; pixels of {lens.sensor.pixel_pitch_um:g} µm", fontsize=10)
    figure.legend(
        loc="outside lower center", ncols=max(2, min(3, len(wavelengths))), frameon=False, fontsize=9
    )
    return figure


def white_figure(size_inches: tuple[float, float]) -> Figure:
    """An empty figure that lays itself out."""
    from matplotlib.figure import Figure

    return Figure(figsize=size_inches, layout="constrained", facecolor="white")


def label_axes(axes: Axes, x: str, y: str) -> None:
    """Names of both axes, and ticks that point inside."""
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8, direction="in")


def _colors(count: int) -> Sequence[str | tuple[float, ...]]:
    """Red to blue for up to three wavelengths, else shades of one scale."""
    if count == 1:
        return FIELD_COLORS[2:]
    if count <= len(FIELD_COLORS):
        return (*FIELD_COLORS[: count - 1], FIELD_COLORS[2])
    from matplotlib import colormaps

    return [colormaps["viridis"](i / (count - 1)) for i in range(count)]
