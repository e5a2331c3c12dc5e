"""Parts of cells that shapes cover."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from wavesim.fields.coverage import disc_coverage
from wavesim.fields.field import Grid

GRID = Grid((40, 40), 1e-3, 0.0)


@given(radius_mm=st.floats(0.2e-3, 0.019), x_mm=st.floats(-1e-3, 1e-3), y_mm=st.floats(-1e-3, 1e-3))
@example(radius_mm=0.011172413620681033, x_mm=0.0, y_mm=0.0)  # its square differs by how it is computed
@example(radius_mm=0.014584858455230735, x_mm=0.0, y_mm=0.0)
def test_a_disc_covers_its_area(radius_mm: float, x_mm: float, y_mm: float) -> None:
    covered = disc_coverage(GRID, radius_mm, (x_mm, y_mm))
    assert np.all((covered >= 0.0) & (covered <= 1.0))
    assert covered.sum() * GRID.cell == pytest.approx(math.pi * radius_mm**2, rel=1e-9)
