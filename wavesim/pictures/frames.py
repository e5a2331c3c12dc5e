"""Pictures of frames, objects and reconstructions: scale bars in um, colour bars, curves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.text import visible
from lensdesign.errors import atomic_path
from wavesim.camera.exposures import fixed_variance
from wavesim.camera.frames import Frame
from wavesim.camera.recorded import Array as Floats
from wavesim.fields.field import Field

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BAR_SHARE = 0.2
"""Length of a scale bar, as a share of the picture's width, before it is rounded to 1, 2 or 5."""

MOST_DRAWN = 2048
"""Samples along a side of a picture; more would only cost time and memory."""

PHASE_QUANTILE = 0.995
"""Of the modulus of phases, which the colours are to hold."""

CURVE = "#1f5fa8"
DPI = 160

AS_SAMPLED: dict[str, Any] = {"origin": "lower", "interpolation": "antialiased"}
"""Row 0 is that of the smallest y; no smoothing that the data do not have."""


def save(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Write a figure to a picture file."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=dpi)


def frames_figure(frames: Sequence[Frame], title: str = "") -> Figure:
    """Electrons on the pixels of some frames, on a logarithmic scale from the noise of a dark pixel upward.

    Parameters
    ----------
    frames
        One or more; several exposures of a plane stand side by side, planes below each other then.
    title
        Written on top.
    """
    from matplotlib.colors import LogNorm

    planes: dict[float, list[Frame]] = {}
    for frame in frames:
        planes.setdefault(frame.settings.plane_distance_mm, []).append(frame)
    most = max(len(own) for own in planes.values())
    single = most == 1
    figure, axes = _panels(1 if single else len(planes), len(planes) if single else most, title)
    for place in axes.ravel():
        place.set_visible(False)
    placed = [(i, j, frame) for i, own in enumerate(planes.values()) for j, frame in enumerate(own)]
    for i, j, frame in placed:
        place = axes[0, i] if single else axes[i, j]
        place.set_visible(True)
        settings = frame.settings
        gain = settings.gain_electrons_per_count
        counts, pitch_um = _for_screen(frame.counts, settings.pixel_pitch_um)
        electrons = (counts - settings.offset_counts) * gain
        low = max(math.sqrt(fixed_variance(frame)), 1e-3)
        norm = LogNorm(low, max(float(electrons.max()), 10.0 * low))
        shown = np.maximum(electrons, low)
        picture = place.imshow(shown, cmap="inferno", norm=norm, **AS_SAMPLED)
        _colour_bar(figure, picture, place, "electrons")
        shortest = min(one.settings.exposure for one in planes[settings.plane_distance_mm])
        times = "" if single else f", exposure {settings.exposure / shortest:.4g} x"
        place.set_title(f"{settings.plane_distance_mm:g} mm behind the exit vertex{times}")
        _scale_bar(place, shown.shape, pitch_um)
    return figure


def object_figure(transmission: Field, inside: Any, title: str = "") -> Figure:
    """Amplitude of an object's transmission within its field stop, and phase unless it is 0 everywhere.

    Parameters
    ----------
    transmission
        On a plane.
    inside
        Samples within the field stop, of the grid's shape.
    title
        Written on top.
    """
    values, pitch_um = transmission.values, 1e3 * transmission.grid.pitch_mm
    amplitude = np.where(inside, np.abs(values), np.nan)
    brightest = max(float(np.nanquantile(amplitude, 0.999)), 1e-12)
    shown = [(amplitude, "gray", 0.0, brightest, "amplitude transmission")]
    if np.any(values.imag != 0.0):
        # Phase says nothing where there is no light.
        lit = inside & (np.abs(values) > 0.1 * brightest)
        phase = np.where(lit, np.angle(values), np.nan)
        reach = phase_reach(phase)
        shown.append((phase, "twilight" if reach == math.pi else "RdBu_r", -reach, reach, "phase (rad)"))
    figure, axes = _row(len(shown), title)
    for place, (values, colours, low, high, label) in zip(axes, shown, strict=True):
        place.set_facecolor("0.6")
        picture, drawn_pitch_um = _for_screen(values, pitch_um)
        drawn = place.imshow(picture, cmap=colours, vmin=low, vmax=high, **AS_SAMPLED)
        _colour_bar(figure, drawn, place, label)
        _scale_bar(place, picture.shape, drawn_pitch_um)
    return figure


def phase_reach(phase: Array) -> float:
    """Half the range of the colours: half a turn, or less where the phase keeps to less."""
    known = phase[np.isfinite(phase)]
    largest = float(np.quantile(np.abs(known), PHASE_QUANTILE)) if known.size else 0.0
    return math.pi if largest > 0.5 * math.pi else max(1.1 * largest, 0.1)


def residual_figure(
    maps: Sequence[Floats], amplitudes: Sequence[Floats], distances_mm: Sequence[float], pitch_um: float
) -> Figure:
    """Amplitude of the result less the recorded one on every plane, over the recorded root mean square."""
    figure, axes = _row(len(maps), "Amplitude of the result less the recorded one")
    for place, error, amplitude, distance in zip(axes, maps, amplitudes, distances_mm, strict=True):
        shown, drawn_pitch_um = _for_screen(error, pitch_um)
        shown = shown / math.sqrt(float(np.mean(amplitude**2, dtype=float)))
        reach = max(float(np.quantile(np.abs(shown), 0.998)), 1e-6)
        picture = place.imshow(shown, cmap="RdBu_r", vmin=-reach, vmax=reach, **AS_SAMPLED)
        _colour_bar(figure, picture, place, "over the recorded root mean square")
        place.set_title(
            f"{distance:g} mm: {100.0 * float(np.linalg.norm(error) / np.linalg.norm(amplitude)):.3g} % L2"
        )
        _scale_bar(place, shown.shape, drawn_pitch_um)
    return figure


def curves_figure(curves: Mapping[str, tuple[Any, Any, str]], title: str = "") -> Figure:
    """One chart for each curve, side by side.

    Parameters
    ----------
    curves
        By the label of the y axis: x, y, and the label of the x axis. A positive curve that falls by more
        than ten times gets a logarithmic axis.
    title
        Written on top.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.6 * len(curves), 4.0), layout="constrained")
    figure.suptitle(_lines(title), fontsize=11, parse_math=False)
    for place, (label, (x, y, x_label)) in zip(
        figure.subplots(1, len(curves), squeeze=False)[0], curves.items(), strict=True
    ):
        place.plot(x, y, color=CURVE, lw=1.8, marker="o" if len(x) <= 40 else None, ms=3.5)
        place.set(xlabel=x_label, ylabel=label)
        if np.min(y) > 0.0 and np.max(y) > 10.0 * np.min(y):
            place.set_yscale("log")
        place.grid(alpha=0.3, which="both")
        place.spines[["top", "right"]].set_visible(False)
    return figure


def _lines(title: str) -> str:
    """A title whose lines stay lines."""
    return "\n".join(visible(line) for line in title.split("\n"))


def _row(count: int, title: str) -> tuple[Figure, Any]:
    figure, axes = _panels(1, count, title)
    return figure, axes[0]


def _panels(rows: int, columns: int, title: str) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    size = 6.4 * columns, 5.6 * rows + (0.4 if title else 0.0)
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(_lines(title), fontsize=13, parse_math=False)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _for_screen(values: Any, pitch_um: float) -> tuple[Array, float]:
    """Means over squares of samples, so few that no side has more than `MOST_DRAWN`, and their pitch."""
    factor = math.ceil(max(values.shape) / MOST_DRAWN)
    if factor == 1:
        return np.asarray(values, float), pitch_um
    rows, columns = (count // factor for count in values.shape)
    squares = values[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(squares.mean(axis=(1, 3), dtype=float)), factor * pitch_um


def _colour_bar(figure: Figure, picture: Any, axes: Any, label: str) -> None:
    figure.colorbar(picture, ax=axes, fraction=0.046, pad=0.03, label=label)


def _scale_bar(axes: Any, shape: tuple[int, ...], pitch_um: float) -> None:
    """A bar of a round length below the picture, in place of ticks."""
    rows, columns = shape
    length_um = _round_length(BAR_SHARE * columns * pitch_um)
    left, low, length = 0.0, -0.025 * rows, length_um / pitch_um
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    axes.plot([left, left + length], [low, low], color="black", lw=3.0, clip_on=False, solid_capstyle="butt")
    text = f"{length_um:g} µm" if length_um < 1000.0 else f"{1e-3 * length_um:g} mm"
    axes.text(left + length + 0.015 * columns, low, text, va="center", ha="left", fontsize=10)
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5))


def _round_length(length: float) -> float:
    """1, 2 or 5 times a power of ten, not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length * (1.0 + 1e-9))
