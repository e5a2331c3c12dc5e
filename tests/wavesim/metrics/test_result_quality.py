"""Figures of a result: a chart's elements, and which of them the lens itself does not pass."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.fields.field import Field, Grid
from wavesim.metrics.result_quality import chart_metrics
from wavesim.targets.usaf import usaf_chart, usaf_elements_within


@pytest.mark.parametrize(("passed_um", "beyond"), [(0.532, False), (2.0, True)])
def test_lines_finer_than_the_aperture_passes_are_told(passed_um: float, beyond: bool) -> None:
    grid = Grid((400, 400), 4e-4, -1.0)
    elements = usaf_elements_within(grid, 0.12)
    chart = Field(grid, usaf_chart(grid, elements, "bright").astype(np.complex64), 0.532)
    figures = chart_metrics(chart, elements, "bright", passed_um)
    finest = figures["smallest_resolved"]
    assert finest["line_width_um"] == pytest.approx(min(one.line_width_um for one in elements))
    assert finest["beyond_aperture"] is beyond
    assert figures["aperture_passes_um"] == passed_um
