"""Figures of objects: the true object, the reconstructed object, and profiles through both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.plots.style import BLUE, INK, RED, in_style, styled_figure
from wavesim.fields.coverage import Rectangle
from wavesim.fields.field import Field, Orientation
from wavesim.plots.panels import AS_SAMPLED, colour_bar, for_screen, scale_bar, title_figure
from wavesim.targets.region import around, cut_field, holds
from wavesim.targets.usaf import UsafElement

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LIT = 0.1
"""Fraction of the brightest amplitude below which phase is not shown."""

SIDE_INCHES = 5.0


class _Shown(NamedTuple):
    """A picture with its name, values, colour map and range, and the label of its colour bar."""

    name: str
    values: Array
    colours: str
    low: float
    high: float
    bar: str


@in_style
def object_figure(
    transmission: Field,
    inside: Any,
    title: str = "",
    *,
    truth: Field | None = None,
    elements: Sequence[UsafElement] = (),
    profile: UsafElement | None = None,
) -> Figure:
    """Draw the amplitude of an object within its field stop, and its phase unless it is 0 everywhere.

    Parameters
    ----------
    transmission
        Transmission of the object.
    inside
        Whether each sample is within the field stop.
    title
        Title of the figure.
    truth
        True object on the same samples, which is drawn next to the found one, with profiles through both.
    elements
        Elements of a USAF chart, which are labelled (group-element) if they are large enough.
    profile
        Element through whose bars profiles are drawn. Default: profiles through the centre.
    """
    named = {"found": transmission} if truth is None else {"true": truth, "found": transmission}
    rows = _rows(named, inside)
    columns = len(named)
    profiles = truth is not None
    wide = (SIDE_INCHES + 0.8) * columns + (SIDE_INCHES if profiles else 0.0)
    figure = styled_figure(wide, SIDE_INCHES * len(rows) + 0.4)
    title_figure(figure, title)
    grid = figure.add_gridspec(2 * len(rows), columns + profiles)
    for row, pictures in enumerate(rows):
        for column, picture in enumerate(pictures):
            axes = figure.add_subplot(grid[2 * row : 2 * row + 2, column])
            _draw(figure, axes, picture, transmission, elements, columns > 1)
    if profiles:
        half = len(rows)
        orientations: tuple[Orientation, ...] = ("x", "y")
        for k, orientation in enumerate(orientations):
            axes = figure.add_subplot(grid[k * half : (k + 1) * half, -1])
            _draw_profile(axes, named, profile, orientation)
    return figure


@in_style
def layers_figure(
    distances_um: Sequence[float],
    layers: Sequence[Field],
    inside: Any,
    title: str = "",
    *,
    truth: Sequence[Field] = (),
) -> Figure:
    """Draw each layer of an object in a row: amplitude within the field stop, and phase unless it is 0.

    Parameters
    ----------
    distances_um
        Distance of each layer from the object plane.
    layers
        Transmission of each layer.
    inside
        Whether each sample is within the field stop.
    title
        Title of the figure.
    truth
        True layers on the same samples, which are drawn next to the found ones.
    """
    rows = []
    for index, layer in enumerate(layers):
        named = {"found": layer} if not truth else {"true": truth[index], "found": layer}
        rows.append([picture for pictures in _rows(named, inside) for picture in pictures])
    columns = max(map(len, rows))
    figure = styled_figure((SIDE_INCHES + 0.8) * columns, SIDE_INCHES * len(rows) + 0.4)
    title_figure(figure, title)
    grid = figure.add_gridspec(len(rows), columns)
    for row, (distance, pictures) in enumerate(zip(distances_um, rows, strict=True)):
        for column, picture in enumerate(pictures):
            axes = figure.add_subplot(grid[row, column])
            _draw(figure, axes, picture, layers[row], (), False)
            name = f", {picture.name}" if truth else ""
            axes.set_title(f"layer at {distance:g} µm{name}")
    return figure


def _rows(named: dict[str, Field], inside: Any) -> list[list[_Shown]]:
    """Return amplitudes, and phases unless all are 0, on common scales."""
    amplitudes = {name: np.where(inside, np.abs(field.values), np.nan) for name, field in named.items()}
    brightest = max(max(float(np.nanquantile(a, 0.999)) for a in amplitudes.values()), 1e-12)
    bar = "amplitude transmission"
    rows = [[_Shown(name, a, "gray", 0.0, brightest, bar) for name, a in amplitudes.items()]]
    if any(np.any(np.imag(field.values) != 0.0) for field in named.values()):
        phases = {
            name: np.where(amplitudes[name] > LIT * brightest, np.angle(field.values), np.nan)
            for name, field in named.items()
        }
        reach = max(map(phase_reach, phases.values()))
        colours = "twilight" if reach == math.pi else "RdBu_r"
        rows.append([_Shown(n, p, colours, -reach, reach, "phase (rad)") for n, p in phases.items()])
    return rows


def phase_reach(phase: Array) -> float:
    """Return half the colour range of a phase (rad): pi, or less if nearly all phases are smaller."""
    known = phase[np.isfinite(phase)]
    largest = float(np.quantile(np.abs(known), 0.995)) if known.size else 0.0
    return math.pi if largest > 0.5 * math.pi else max(1.1 * largest, 0.1)


def _draw(
    figure: Figure,
    axes: Any,
    shown: _Shown,
    field: Field,
    elements: Sequence[UsafElement],
    several: bool,
) -> None:
    axes.set_facecolor("0.6")
    picture, pitch_um = for_screen(shown.values, 1e3 * field.grid.pitch_mm)
    drawn = axes.imshow(picture, cmap=shown.colours, vmin=shown.low, vmax=shown.high, **AS_SAMPLED)
    colour_bar(figure, drawn, axes, shown.bar)
    scale_bar(axes, picture.shape, pitch_um)
    if several:
        axes.set_title(f"{shown.name} object")
    for element in elements:
        _label_element(axes, element, field, pitch_um)


def _label_element(axes: Any, element: UsafElement, field: Field, pitch_um: float) -> None:
    """Write group and element beside an element, if it is tall enough."""
    grid = field.grid
    points_per_um = 72.0 * 0.8 * SIDE_INCHES / (1e3 * grid.pitch_mm * grid.shape[0])
    label_points = 6.5
    if not holds(grid, element.outline) or 7.0 * element.line_width_um * points_per_um < label_points:
        return
    outline, left = element.outline, element.group % 2 == 0 and element.element > 1
    edge_mm = outline.left_mm if left else outline.right_mm
    x, y = (
        1e3 * (at - first) / pitch_um
        for at, first in ((edge_mm, grid.x_mm[0]), (element.centre_mm[1], grid.y_mm[0]))
    )
    axes.annotate(
        f"{element.group}-{element.element}",
        (x, y),
        xytext=(-3.0 if left else 3.0, 0.0),
        textcoords="offset points",
        ha="right" if left else "left",
        va="center",
        fontsize=label_points,
        color=RED,
    )


def _draw_profile(
    axes: Any, named: dict[str, Field], element: UsafElement | None, orientation: Orientation
) -> None:
    """Draw the amplitude along x or y, through a set of bars or through the centre."""
    # Colour and line style of profiles.
    styles = {"found": (BLUE, "-"), "true": (INK, "--")}
    for name, field in named.items():
        colour, line = styles[name]
        at_um, amplitude = _profile(field, element, orientation)
        axes.plot(at_um, amplitude, color=colour, ls=line, lw=1.6, label=name)
    axes.set(xlabel=f"{orientation} (µm)", ylabel="amplitude transmission")
    axes.set_ylim(0.0, 1.25 * axes.get_ylim()[1])
    location = "through the centre"
    if element is not None:
        location = (
            f"through element {element.group}-{element.element}, line width {element.line_width_um:.3g} µm"
        )
    axes.set_title(f"profile along {orientation} {location}")
    axes.grid(True)
    axes.legend(loc="upper right", ncols=2)


def _profile(field: Field, element: UsafElement | None, orientation: Orientation) -> tuple[Array, Array]:
    """Return coordinates (µm) and amplitudes; for bars the mean over the middle half of their length."""
    across = 0 if orientation == "x" else 1
    rows, columns = field.grid.shape
    if element is None:
        line = field.values[rows // 2] if across == 0 else field.values[:, columns // 2]
        return 1e3 * (field.grid.x_mm, field.grid.y_mm)[across], np.abs(line)
    width_mm = 1e-3 * element.line_width_um
    x, y = element.set_centre_mm(orientation)
    half = (4.0 * width_mm, 1.25 * width_mm) if across == 0 else (1.25 * width_mm, 4.0 * width_mm)
    own = cut_field(field, around(Rectangle(x - half[0], x + half[0], y - half[1], y + half[1]), field.grid))
    return 1e3 * (own.grid.x_mm, own.grid.y_mm)[across], np.abs(own.values).mean(axis=across)
