"""The picture of a calibration: how the search went."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wavesim.calibration.estimation import Calibrated
from wavesim.camera.mounting import TILTS, values_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINE, BEST, NOISE = "#1f5fa8", "#b3202c", "#666666"


def calibration_figure(found: Calibrated, noise: float | None = None) -> Figure:
    """Misfit and parameters of all mountings tried.

    Parameters
    ----------
    found
        What is drawn.
    noise
        Misfit that noise alone would leave, as a line.
    """
    from matplotlib.figure import Figure

    values = np.array([values_of(mounting, found.parameters) for mounting, _ in found.trail])
    misfits = np.array([misfit for _, misfit in found.trail])
    final = values_of(found.mounting, found.parameters)
    steps = np.arange(1, len(misfits) + 1)
    rows = 1 + (len(found.parameters) + 1) // 2
    figure = Figure(figsize=(8.0, 2.0 * rows), layout="constrained")
    places = figure.add_gridspec(rows, 2)
    axes = [figure.add_subplot(places[0, :])]
    for number in range(len(found.parameters)):
        axes.append(figure.add_subplot(places[1 + number // 2, number % 2], sharex=axes[0]))
    axes[0].plot(steps, misfits, ".-", color=LINE, lw=0.8)
    if misfits.max() > 5.0 * misfits.min():
        axes[0].set_yscale("log")
    axes[0].set_ylabel("misfit of amplitudes")
    if noise is not None:
        axes[0].axhline(noise, color=NOISE, lw=0.8, ls="--")
        axes[0].annotate(
            "noise alone", (1.0, noise), xycoords=("axes fraction", "data"), xytext=(-4, 3),
            textcoords="offset points", ha="right", color=NOISE, fontsize=8,
        )  # fmt: skip
    for place, name, column, value in zip(axes[1:], found.parameters, values.T, final, strict=False):
        unit, factor = ("deg", 1.0) if name in TILTS else ("µm", 1e3)
        place.plot(steps, factor * column, ".-", color=LINE, lw=0.8)
        place.axhline(factor * value, color=BEST, lw=0.8)
        place.set_ylabel(f"{name.rsplit('_', 1)[0].replace('_', ' ')} ({unit})")
        place.set_title(f"found: {factor * value:.3f} {unit}", fontsize=9, color=BEST)
    for place in axes:
        place.grid(alpha=0.25)
    for place in axes[-min(2, len(found.parameters)) :]:
        place.set_xlabel("mounting tried")
    return figure
