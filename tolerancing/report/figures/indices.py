"""Bar chart of variance-based indices for each merit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lensdesign.plots.style import SERIES, styled_figure
from tolerancing.report.figures.style import axis_label, chart_style, merit_label
from tolerancing.statistics.indices import VarianceIndices

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def indices_figure(found: VarianceIndices) -> Figure:
    """Draw the first-order and total index of each perturbation as two bars, in one panel for each merit."""
    perturbations, merits = found.study.perturbations, found.study.merits
    with chart_style():
        figure = styled_figure(6.4, len(merits) * (0.9 + 0.28 * len(perturbations)))
        for k, axis in enumerate(figure.subplots(len(merits), squeeze=False)[:, 0]):
            order = np.argsort(found.total[:, k], kind="stable")
            positions = np.arange(len(order))
            own = (
                ("total", found.total, found.total_half_width, 0.2),
                ("first order", found.first, found.first_half_width, -0.2),
            )
            for number, (label, values, half, shift) in enumerate(own):
                axis.barh(
                    positions + shift, np.nan_to_num(values[order, k]), 0.36, color=SERIES[1 - number],
                    xerr=np.nan_to_num(half[order, k]), error_kw={"linewidth": 0.7}, label=label,
                )  # fmt: skip
            axis.set_yticks(positions, [axis_label(perturbations[i]) for i in order.tolist()])
            axis.set_title(merit_label(merits[k]))
            axis.set_xlabel("fraction of the variance")
            axis.set_xlim(left=0.0)
        figure.legend(*axis.get_legend_handles_labels(), loc="outside right upper")
    return figure
