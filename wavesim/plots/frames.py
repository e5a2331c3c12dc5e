"""Figures of frames, of residuals, and of curves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign.common.atomic_files import atomic_path
from lensdesign.plots.saving import save_figure
from wavesim.metrics.result_quality import plane_metrics
from wavesim.plots.panels import AS_SAMPLED, colour_bar, for_screen, panel_row, scale_bar, title_figure
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Array, Measurement
from wavesim.sensor.merged_exposures import fixed_variance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 160


def save(figure: Figure, path: Path, dpi: int | None = None) -> None:
    """Write a figure to a picture file. Default resolution: `DPI` dots per inch."""
    form = path.suffix.lower().removeprefix(".")
    with atomic_path(path) as temporary:
        save_figure(figure, temporary, form, dpi or DPI)


def frames_figure(frames: Sequence[Frame], title: str = "") -> Figure:
    """Draw the electrons in the pixels of frames, on a logarithmic scale from the noise of a dark pixel.

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
        counts, pitch_um = for_screen(frame.counts, settings.pixel_pitch_um)
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
    return figure


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
        cell.set_title(text, fontsize=11)
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
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.6 * len(curves), 4.0), layout="constrained")
    title_figure(figure, title, 11.0)
    for cell, (label, (x, y, x_label)) in zip(
        figure.subplots(1, len(curves), squeeze=False)[0], curves.items(), strict=True
    ):
        cell.plot(x, y, color="#1f5fa8", lw=1.8, marker="o" if len(x) <= 40 else None, ms=3.5)
        cell.set(xlabel=x_label, ylabel=label)
        if np.min(y) > 0.0 and np.max(y) > 10.0 * np.min(y):
            cell.set_yscale("log")
        cell.grid(alpha=0.3, which="both")
        cell.spines[["top", "right"]].set_visible(False)
    return figure
