"""Figure of recording plans: expected error of the object against the number of planes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from lensdesign.plots.style import RED, SERIES, in_style, styled_figure
from wavesim.calibration.planning import EXPLAINED, Plans
from wavesim.plots.panels import title_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@in_style
def plans_figure(found: Plans, title: str = "") -> Figure:
    """Draw the relative error of the object against the number of planes, with a line for each bracket.

    A dot is the error of the trial object with the largest error, and a bar reaches down to the smallest
    error. A dot is filled if the misfit exceeds the noise by a fifth at most. A ring marks the recommended
    plan.

    Parameters
    ----------
    found
        Result of :func:`wavesim.calibration.plan_frames`.
    title
        Title of the figure.
    """
    figure = styled_figure(6.0, 4.2)
    title_figure(figure, title)
    axes = figure.subplots()
    for exposures, colour in zip(dict.fromkeys(p.exposures for p in found.plans), SERIES, strict=False):
        plans = sorted((p for p in found.plans if p.exposures == exposures), key=lambda p: len(p.planes_mm))
        counts, errors = [len(p.planes_mm) for p in plans], [p.error for p in plans]
        label = f"exposures {', '.join(f'{e:g}' for e in exposures)}"
        axes.plot(counts, errors, "-", color=colour, lw=1.0, label=label)
        for plan, count, error in zip(plans, counts, errors, strict=True):
            face = colour if plan.misfit_over_noise <= EXPLAINED else "white"
            least = math.sqrt(max(1.0 - plan.highest_correlation**2, 0.0))
            axes.plot([count, count], [max(least, 1e-4), error], "-", color=colour, lw=2.5, alpha=0.35)
            axes.plot(count, error, "o", color=colour, markerfacecolor=face)
    best = found.recommended
    axes.plot(len(best.planes_mm), best.error, "o", ms=14, mfc="none", color=RED, label="recommended")
    axes.set_yscale("log")
    axes.set_xticks(range(1, found.settings.most_planes + 1))
    axes.set_xlabel("number of planes")
    axes.set_ylabel("relative error of the object")
    axes.grid(True, which="both")
    axes.legend()
    return figure
