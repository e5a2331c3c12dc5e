"""Chart of the largest spread angle against field height, with the limit of Eq. 2, for every wavelength."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from lensdesign.analysis.exit_beam import largest_spread_angle
from lensdesign.analysis.space_bandwidth import sensor_spread_sine
from lensdesign.common.text import visible
from lensdesign.lens.lens import Lens
from lensdesign.plots.style import INK, RED, in_style, styled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TITLE_POINTS = 10.0


@in_style
def spread_figure(lens: Lens) -> Figure:
    """Plot the largest spread angle of each field height over the whole stop, and the sensor's limit (Eq. 2).

    Each wavelength has a solid line and a dashed limit in one colour, the longest wavelength first. Values
    beyond a limit are ringed. No limit is drawn if the pixels resolve every angle.

    Parameters
    ----------
    lens
        The lens.

    Raises
    ------
    DesignError
        If no ray passes at one of the wavelengths.
    """
    figure = styled_figure(7.6, 4.6)
    axes = figure.add_subplot()
    wavelengths = sorted(lens.wavelengths_um, reverse=True)
    largest, beyond = 0.0, []
    markers = "os^Dv"
    for index, (wavelength, color) in enumerate(zip(wavelengths, _colors(len(wavelengths)), strict=True)):
        spread = largest_spread_angle(lens, wavelength)
        sine = sensor_spread_sine(lens, wavelength)
        axes.plot(
            spread.field_heights_mm,
            spread.per_field_deg,
            marker=markers[index % len(markers)],
            color=color,
            zorder=3,
            label=f"{wavelength:.4g} µm: up to {spread.spread_deg:.3f}°",
        )
        limit = math.degrees(math.asin(sine)) if sine < 1.0 else 0.0
        largest = max(largest, spread.spread_deg, limit)
        if sine < 1.0:
            axes.axhline(limit, color=color, ls="--", lw=1.2, label=f"limit {limit:.3f}°")
            heights = zip(spread.field_heights_mm, spread.per_field_deg, strict=True)
            beyond += [point for point in heights if point[1] > limit]
    if beyond:
        rings: dict[str, Any] = {"color": RED, "ms": 9.0, "mew": 1.4, "mfc": "none", "zorder": 4}
        axes.plot(*zip(*beyond, strict=True), "o", label="beyond the limit", **rings)
    axes.set_xlim(-0.03 * lens.half_field_mm, 1.03 * lens.half_field_mm)
    axes.set_ylim(0.0, 1.12 * largest)
    axes.grid(True)
    label_axes(axes, "field height (mm)", "largest spread angle (°)")
    title_figure(figure, lens, f"Spread behind the lens; pixels of {lens.sensor.pixel_pitch_um:g} µm")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def lens_name(lens: Lens, inches: float) -> str:
    """Return a lens's title on one line, truncated to a width in inches."""
    name = visible(lens.title or "Lens")
    while text_inches(name, TITLE_POINTS)[0] > inches - 0.3 and len(name) > 1:
        name = f"{name.removesuffix('…')[:-1]}…"
    return name


def title_figure(figure: Figure, lens: Lens, text: str = "") -> None:
    """Set the title of a figure: the title of the lens, and a text below it."""
    title = f"{lens_name(lens, figure.get_figwidth())}\n{text}".strip()
    figure.suptitle(title, fontsize=TITLE_POINTS, parse_math=False)


@cache
def _renderer() -> Any:
    from matplotlib.backends.backend_agg import RendererAgg

    return RendererAgg(8, 8, 72.0)


def text_inches(text: str, points: float, is_math: bool = False) -> tuple[float, float]:
    """Return width and height of one line of text in inches."""
    from matplotlib.font_manager import FontProperties

    width, height, _ = _renderer().get_text_width_height_descent(text, FontProperties(size=points), is_math)
    return width / 72.0, height / 72.0


def label_axes(axes: Axes, x: str, y: str) -> None:
    """Label both axes, and let ticks point inside."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.tick_params(direction="in")


def _colors(count: int) -> Sequence[str | tuple[float, ...]]:
    """Return colours of one scale from red to blue that differ from those of field heights."""
    if count == 1:
        return [INK]
    from matplotlib import colormaps

    return [colormaps["plasma"](0.7 - 0.65 * i / (count - 1)) for i in range(count)]
