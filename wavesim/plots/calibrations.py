"""Figure of a calibration: misfits and parameters of the tested benches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lensdesign.common.text import name_with_unit, number_with_unit, words_and_unit
from lensdesign.plots.style import BLUE, GREY, ORANGE, in_style, styled_figure
from wavesim.calibration.calibration_result import Calibrated

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@in_style
def calibration_figure(found: Calibrated, noise: float | None = None) -> Figure:
    """Draw misfit and parameters of all tested benches.

    Parameters
    ----------
    found
        Result of the calibration.
    noise
        Misfit that noise alone causes, drawn as a dashed line.
    """
    if found.typical is not None:
        figure = styled_figure(8.0, 2.8 + 0.26 * len(found.parameters))
        above, below = figure.subplots(2, height_ratios=[1.0, 0.12 * len(found.parameters) + 0.2])
        _draw_misfits(above, found, noise)
        _draw_values(below, found)
        return figure
    rows = 1 + (len(found.parameters) + 1) // 2
    figure = styled_figure(8.0, 2.0 * rows)
    cells = figure.add_gridspec(rows, 2)
    above = figure.add_subplot(cells[0, :])
    _draw_misfits(above, found, noise)
    steps = np.arange(1, len(found.trail) + 1)
    for k, name in enumerate(found.parameters):
        axes = figure.add_subplot(cells[1 + k // 2, k % 2], sharex=above)
        label, unit, factor = _label_and_unit(name)
        axes.plot(steps, [factor * values[k] for values, _ in found.trail], ".-", color=BLUE, lw=0.8)
        value = factor * found.values[k]
        axes.axhline(value, color=ORANGE, lw=0.8)
        axes.set_ylabel(name_with_unit(label, unit))
        axes.set_title(number_with_unit(f"estimate: {value:.3f}", unit), fontsize=9, color=ORANGE)
        axes.grid(True)
        axes.set_xlabel("tested bench" if k >= len(found.parameters) - 2 else "")
    return figure


def _draw_misfits(axes: Axes, found: Calibrated, noise: float | None) -> None:
    misfits = np.array([misfit for _, misfit in found.trail])
    axes.plot(np.arange(1, len(misfits) + 1), misfits, ".-", color=BLUE, lw=0.8)
    axes.set_yscale("log" if misfits.max() > 5.0 * misfits.min() else "linear")
    axes.set_ylabel("misfit of amplitudes")
    axes.set_xlabel("tested bench")
    axes.grid(True)
    if noise is not None:
        axes.axhline(noise, color=GREY, lw=0.8, ls="--")
        axes.annotate(
            "noise alone", (1.0, noise), xycoords=("axes fraction", "data"), xytext=(-4, 3),
            textcoords="offset points", ha="right", color=GREY, fontsize=8,
        )  # fmt: skip


def _draw_values(axes: Axes, found: Calibrated) -> None:
    """Draw each parameter over its typical size, with its standard deviation; grey if undetermined."""
    assert found.typical is not None
    rows = np.arange(len(found.parameters))[::-1]
    typical, deviations = np.array(found.typical), found.deviations or (None,) * len(rows)
    for row, name, value, deviation, usual in zip(
        rows, found.parameters, found.values, deviations, typical, strict=True
    ):
        color = GREY if name in found.poorly_determined else ORANGE
        bar = None if deviation is None else deviation / usual
        axes.errorbar(value / usual, row, xerr=bar, fmt="o", ms=3.5, lw=1.0, capsize=2, color=color)
        _, unit, factor = _label_and_unit(name)
        uncertainty = "" if deviation is None else f" ± {factor * deviation:.2g}"
        text = number_with_unit(f"{factor * value:.3g}{uncertainty}", unit)
        axes.annotate(
            text, (1.0, row), xycoords=("axes fraction", "data"), xytext=(4, 0), textcoords="offset points",
            va="center", fontsize=7.5, color=color, annotation_clip=False,
        )  # fmt: skip
    axes.set_yticks(rows, [_label_and_unit(name)[0] for name in found.parameters], fontsize=7.5)
    axes.set_ylim(-0.7, len(rows) - 0.3)
    axes.axvline(0.0, color="black", lw=0.6)
    bars = "; error bars: standard deviation; grey: not determined by the frames"
    axes.set_xlabel("value / typical size" + bars * (found.deviations is not None))
    axes.grid(True)


def _label_and_unit(name: str) -> tuple[str, str, float]:
    """Return a parameter's label, its unit, and the factor that converts its value to this unit."""
    words, unit = words_and_unit(name)
    return (words, "um", 1e3) if unit == "mm" else (words, unit, 1.0)
