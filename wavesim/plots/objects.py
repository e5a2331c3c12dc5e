"""Pictures of objects: the true one, the one that was found, and profiles through both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.fields.coverage import Rectangle
from wavesim.fields.field import Field, Orientation
from wavesim.plots.panels import AS_SAMPLED, colour_bar, for_screen, scale_bar, title_figure
from wavesim.targets.region import around, cut_field, holds
from wavesim.targets.usaf import UsafElement

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PHASE_QUANTILE = 0.995
"""Of the modulus of phases, which the colours are to hold."""

LIT = 0.1
"""Of the brightest amplitude, below which phase says nothing."""

SIDE_INCHES = 5.6
LABEL_POINTS = 6.5
LABELS = "#D8404A"
STYLES = {"found": ("#1f5fa8", "-"), "true": ("#333333", "--")}
"""Colour and line of profiles."""


class _Shown(NamedTuple):
    """One picture: what it is of, values, colours with their range, and the name of their bar."""

    name: str
    values: Array
    colours: str
    low: float
    high: float
    bar: str


def object_figure(
    transmission: Field,
    inside: Any,
    title: str = "",
    *,
    truth: Field | None = None,
    elements: Sequence[UsafElement] = (),
    profile: UsafElement | None = None,
) -> Figure:
    """Amplitude of an object's transmission within its field stop, and phase unless it is 0 everywhere.

    Parameters
    ----------
    transmission
        On a plane.
    inside
        Samples within the field stop, of the grid's shape.
    title
        Written on top.
    truth
        The true object on the same samples, which then stands beside it, with profiles through both.
    elements
        Of a USAF chart, which get their numbers (group-element) where there is room.
    profile
        Element through whose bars profiles are drawn; left out: they run through the middle.
    """
    from matplotlib.figure import Figure

    named = {"found": transmission} if truth is None else {"true": truth, "found": transmission}
    rows = _rows(named, inside)
    columns = len(named)
    profiles = truth is not None
    wide = (SIDE_INCHES + 0.8) * columns + (SIDE_INCHES if profiles else 0.0)
    figure = Figure(figsize=(wide, SIDE_INCHES * len(rows) + 0.4), layout="constrained")
    title_figure(figure, title)
    grid = figure.add_gridspec(2 * len(rows), columns + profiles)
    for row, pictures in enumerate(rows):
        for column, picture in enumerate(pictures):
            place = figure.add_subplot(grid[2 * row : 2 * row + 2, column])
            _draw(figure, place, picture, transmission, elements, columns > 1)
    if profiles:
        half = len(rows)
        ways: tuple[Orientation, ...] = ("x", "y")
        for number, way in enumerate(ways):
            place = figure.add_subplot(grid[number * half : (number + 1) * half, -1])
            _draw_profile(place, named, profile, way)
    return figure


def _rows(named: dict[str, Field], inside: Any) -> list[list[_Shown]]:
    """Amplitudes, and phases below them unless all are 0, in common scales."""
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
    """Half the range of the colours: half a turn, or less where the phase keeps to less."""
    known = phase[np.isfinite(phase)]
    largest = float(np.quantile(np.abs(known), PHASE_QUANTILE)) if known.size else 0.0
    return math.pi if largest > 0.5 * math.pi else max(1.1 * largest, 0.1)


def _draw(
    figure: Figure,
    place: Any,
    shown: _Shown,
    field: Field,
    elements: Sequence[UsafElement],
    several: bool,
) -> None:
    place.set_facecolor("0.6")
    picture, pitch_um = for_screen(shown.values, 1e3 * field.grid.pitch_mm)
    drawn = place.imshow(picture, cmap=shown.colours, vmin=shown.low, vmax=shown.high, **AS_SAMPLED)
    colour_bar(figure, drawn, place, shown.bar)
    scale_bar(place, picture.shape, pitch_um)
    if several:
        place.set_title(f"{shown.name} object", fontsize=11)
    for element in elements:
        _number(place, element, field, pitch_um)


def _number(place: Any, element: UsafElement, field: Field, pitch_um: float) -> None:
    """Group and element beside the element, away from its column's neighbours, if it is tall enough."""
    grid = field.grid
    points_per_um = 72.0 * 0.8 * SIDE_INCHES / (1e3 * grid.pitch_mm * grid.shape[0])
    if not holds(grid, element.outline) or 7.0 * element.line_width_um * points_per_um < LABEL_POINTS:
        return
    outline, left = element.outline, element.group % 2 == 0 and element.element > 1
    edge_mm = outline.left_mm if left else outline.right_mm
    x, y = (
        1e3 * (at - first) / pitch_um
        for at, first in ((edge_mm, grid.x_mm[0]), (element.centre_mm[1], grid.y_mm[0]))
    )
    place.annotate(
        f"{element.group}-{element.element}",
        (x, y),
        xytext=(-3.0 if left else 3.0, 0.0),
        textcoords="offset points",
        ha="right" if left else "left",
        va="center",
        fontsize=LABEL_POINTS,
        color=LABELS,
    )


def _draw_profile(place: Any, named: dict[str, Field], element: UsafElement | None, way: Orientation) -> None:
    """Amplitude along x or y: through the set of bars that follow each other that way, or the middle."""
    for name, field in named.items():
        colour, line = STYLES[name]
        at_um, amplitude = _profile(field, element, way)
        place.plot(at_um, amplitude, color=colour, ls=line, lw=1.6, label=name)
    place.set(xlabel=f"{way} (µm)", ylabel="amplitude transmission")
    place.set_ylim(0.0, 1.25 * place.get_ylim()[1])
    where = "through the middle"
    if element is not None:
        where = f"of {element.group}-{element.element}: lines of {element.line_width_um:.3g} µm"
    place.set_title(f"profile along {way} {where}", fontsize=10)
    place.grid(alpha=0.3)
    place.legend(frameon=False, loc="upper right", ncols=2)


def _profile(field: Field, element: UsafElement | None, way: Orientation) -> tuple[Array, Array]:
    """Places in µm and amplitudes; of bars the mean over the middle half of their length."""
    across = 0 if way == "x" else 1
    rows, columns = field.grid.shape
    if element is None:
        line = field.values[rows // 2] if across == 0 else field.values[:, columns // 2]
        return 1e3 * (field.grid.x_mm, field.grid.y_mm)[across], np.abs(line)
    width_mm = 1e-3 * element.line_width_um
    x, y = element.set_centre_mm(way)
    half = (4.0 * width_mm, 1.25 * width_mm) if across == 0 else (1.25 * width_mm, 4.0 * width_mm)
    own = cut_field(field, around(Rectangle(x - half[0], x + half[0], y - half[1], y + half[1]), field.grid))
    return 1e3 * (own.grid.x_mm, own.grid.y_mm)[across], np.abs(own.values).mean(axis=across)
