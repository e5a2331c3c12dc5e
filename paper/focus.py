"""Where a chart is sharp: Eqs. 5 and 6 on the field behind it."""

from __future__ import annotations

from collections.abc import Sequence

from wavesim import Field, propagate, refocus_field
from wavesim.reconstruction.refocusing import Refocusing
from wavesim.targets.region import around, cut_field, soft_rim, widened
from wavesim.targets.usaf import UsafElement, chart_outline

LOOKED_MM, STEP_MM = 0.012, 1e-3
RIM_MM = 0.02


def focused(behind: Field, elements: Sequence[UsafElement]) -> tuple[Refocusing, Field]:
    """The curve of SVFG about where a field is, and the field where the chart in it is sharpest."""
    found = refocus_field(_of_chart(behind, elements), (-LOOKED_MM, LOOKED_MM), STEP_MM)
    return found, propagate(behind, found.distance_mm, check=False)


def _of_chart(field: Field, elements: Sequence[UsafElement]) -> Field:
    """The chart and some room, faded out: a sharp rim would add its own fringes to SVFG."""
    chart = around(chart_outline(elements), field.grid)
    wider = widened(chart, field.grid, RIM_MM)
    cut = cut_field(field, wider)
    return cut.with_values(cut.values * soft_rim(chart, wider))
