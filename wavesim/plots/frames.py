"""Figures of frames, of residuals, and of curves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.atomic_files import atomic_path
from lensdesign.plots.saving import save_figure
from lensdesign.plots.style import in_style, styled_figure
from wavesim.metrics.result_quality import plane_metrics
from wavesim.plots.panels import AS_SAMPLED, colour_bar, for_screen, panel_row, scale_bar, title_figure
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Array, Measurement
from wavesim.sensor.merged_exposures import fixed_variance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 180

SHOWN_LIGHT, LARGEST_CROP = 0.999, 0.7
"""Fraction of the light in the shown part of frames, and the largest part of their area that is cut out."""

WHOLE = (slice(None), slice(None))


def save(figure: Figure, path: Path, dpi: int | None = None) -> None:
    """Write a figure to a picture file. Default resolution: `DPI` dots per inch."""
    form = path.suffix.lower().removeprefix(".")
    with atomic_path(path) as temporary:
        save_figure(figure, temporary, form, dpi or DPI)


@in_style
def frames_figure(frames: Sequence[Frame], title: str = "") -> Figure:
    """Draw the electrons in the pixels of frames, on a logarithmic scale from the noise of a dark pixel.

    Where the light covers a part of the frames, this part is drawn, with the whole frame in a corner.

    Parameters
    ----------
    frames
        One or more frames. With several exposures, each plane is a row, with its exposures side by side.
    title
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    from matplotlib.colors import LogNorm

    shown_region = _light_region(frames)
    planes: dict[float, list[Frame]] = {}
    for frame in frames:
        planes.setdefault(frame.settings.plane_distance_mm, []).append(frame)
    most = max(len(own) for own in planes.values())
    single = most == 1
    figure, axes = panel_row(len(planes) if single else most, title, 1 if single else len(planes))
    for cell in axes.ravel():
        cell.set_visible(False)
    placed = [(i, j, frame) for i, own in enumerate(planes.values()) for j, frame in enumerate(own)]
    for i, j, frame in placed:
        cell = axes[0, i] if single else axes[i, j]
        cell.set_visible(True)
        settings = frame.settings
        gain = settings.gain_electrons_per_count
        counts, pitch_um = for_screen(frame.counts[shown_region], settings.pixel_pitch_um)
        electrons = (counts - settings.offset_counts) * gain
        low = max(math.sqrt(fixed_variance(frame)), 1e-3)
        norm = LogNorm(low, max(float(electrons.max()), 10.0 * low))
        shown = np.maximum(electrons, low)
        picture = cell.imshow(shown, cmap="inferno", norm=norm, **AS_SAMPLED)
        colour_bar(figure, picture, cell, "electrons")
        shortest = min(one.settings.exposure for one in planes[settings.plane_distance_mm])
        times = "" if single else f", exposure {settings.exposure / shortest:.4g} x"
        cell.set_title(f"{settings.plane_distance_mm:g} mm behind the exit vertex{times}")
        scale_bar(cell, shown.shape, pitch_um)
        if shown_region != WHOLE:
            _draw_whole_frame(cell, frame, shown_region, norm)
    return figure


def _light_region(frames: Sequence[Frame]) -> tuple[slice, slice]:
    """Return the rows and columns that hold `SHOWN_LIGHT` of the light of every frame, with a margin.

    It is the whole frame if frames differ in size, or if little would be cut off.
    """
    rows, columns = frames[0].counts.shape
    if any(frame.counts.shape != (rows, columns) for frame in frames):
        return WHOLE
    ends = []
    for axis, count in ((1, rows), (0, columns)):
        lows, highs = [], []
        for frame in frames:
            gain = frame.settings.gain_electrons_per_count
            light = gain * np.sum(frame.counts, axis=axis, dtype=float)
            # The darkest rows have offset and stray light only, and others differ from them by noise.
            dark, pixels = float(np.quantile(light, 0.05)), frame.counts.shape[axis]
            offset = gain * frame.settings.offset_counts * pixels
            noise = math.sqrt(pixels * fixed_variance(frame) + max(dark - offset, 0.0))
            light = np.maximum(light - dark - 4.0 * noise, 0.0)
            if not np.any(light):
                return WHOLE
            total = np.cumsum(light) / float(light.sum())
            outside = 0.5 * (1.0 - SHOWN_LIGHT)
            lows.append(int(np.searchsorted(total, outside)))
            highs.append(int(np.searchsorted(total, 1.0 - outside)) + 1)
        margin = math.ceil(0.05 * count)
        ends.append((max(min(lows) - margin, 0), min(max(highs) + margin, count)))
    (top, bottom), (left, right) = ends
    if (bottom - top) * (right - left) > LARGEST_CROP * rows * columns:
        return WHOLE
    return slice(top, bottom), slice(left, right)


def _draw_whole_frame(cell: Any, frame: Frame, region: tuple[slice, slice], norm: Any) -> None:
    """Draw the whole frame in a corner of its picture, with the outline of the region that is shown."""
    from matplotlib.patches import Rectangle

    settings, (rows, columns) = frame.settings, region
    counts, pitch_um = for_screen(frame.counts, settings.pixel_pitch_um)
    electrons = (counts - settings.offset_counts) * settings.gain_electrons_per_count
    corner = cell.inset_axes((0.74, 0.74, 0.25, 0.25))
    corner.imshow(np.maximum(electrons, norm.vmin), cmap="inferno", norm=norm, **AS_SAMPLED)
    corner.set(xticks=[], yticks=[])
    corner.spines[:].set(visible=True, color="white")
    scale = settings.pixel_pitch_um / pitch_um
    place, width = (scale * columns.start, scale * rows.start), scale * (columns.stop - columns.start)
    height = scale * (rows.stop - rows.start)
    corner.add_patch(Rectangle(place, width, height, fill=False, ec="white", lw=0.8))


@in_style
def residual_figure(
    maps: Sequence[Array],
    recorded: Sequence[Measurement],
    distances_mm: Sequence[float],
    pitch_um: float,
    title: str = "",
) -> Figure:
    """Draw the amplitude of the result minus the recorded one on each plane, in standard deviations of noise.

    A plane without stated noise is drawn relative to the recorded root mean square. Where a drawn sample is
    the mean of several pixels, it is in standard deviations of that mean.

    Parameters
    ----------
    maps
        Amplitude of the result minus the recorded one, for each plane.
    recorded
        Measurement on each plane.
    distances_mm
        Distance of each plane from the exit vertex (mm).
    pitch_um
        Pixel pitch (um).
    title
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure, (axes,) = panel_row(
        len(maps), f"{title}\nAmplitude of the result minus the recorded amplitude".strip()
    )
    for cell, error, plane, distance in zip(axes, maps, recorded, distances_mm, strict=True):
        shown, drawn_pitch_um, reach, label = _residual(error, plane, pitch_um)
        found = plane_metrics(plane.amplitude, plane.sigma, error)
        text = f"{distance:g} mm behind the exit vertex\nresidual {100.0 * (found['residual'] or 0.0):.3g} %"
        if found["noise"] is not None:
            text += f" of the amplitude (from noise alone: {100.0 * found['noise']:.3g} %)"
        cell.set_facecolor("0.6")
        picture = cell.imshow(shown, cmap="RdBu_r", vmin=-reach, vmax=reach, **AS_SAMPLED)
        colour_bar(figure, picture, cell, label)
        cell.set_title(text)
        scale_bar(cell, shown.shape, drawn_pitch_um)
    return figure


def _residual(error: Array, plane: Measurement, pitch_um: float) -> tuple[Array, float, float, str]:
    """Return the drawn residual, its pitch (µm), the half range of its colours, and its unit."""
    if plane.sigma is None:
        shown, drawn_pitch_um = for_screen(error, pitch_um)
        shown = shown / math.sqrt(float(np.mean(plane.amplitude**2, dtype=float)))
        reach = max(float(np.quantile(np.abs(shown), 0.998)), 1e-6)
        return shown, drawn_pitch_um, reach, "difference / recorded root mean square"
    known = np.isfinite(plane.sigma)
    shown, drawn_pitch_um = for_screen(np.where(known, error / plane.sigma, np.nan), pitch_um)
    return (
        shown * (drawn_pitch_um / pitch_um),
        drawn_pitch_um,
        4.0,
        "difference / standard deviation of the noise",
    )


@in_style
def curves_figure(curves: Mapping[str, tuple[Any, Any, str]], title: str = "") -> Figure:
    """Draw one chart for each curve, side by side.

    Parameters
    ----------
    curves
        x, y, and the label of the x axis, by the label of the y axis. A positive curve that spans more than
        a factor of ten has a logarithmic axis.
    title
        Title of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure = styled_figure(5.0 * len(curves), 3.6)
    title_figure(figure, title)
    for cell, (label, (x, y, x_label)) in zip(
        figure.subplots(1, len(curves), squeeze=False)[0], curves.items(), strict=True
    ):
        cell.plot(x, y, marker="o" if len(x) <= 40 else None)
        cell.set(xlabel=x_label, ylabel=label)
        if np.min(y) > 0.0 and np.max(y) > 10.0 * np.min(y):
            cell.set_yscale("log")
        cell.grid(True, which="both")
    return figure
