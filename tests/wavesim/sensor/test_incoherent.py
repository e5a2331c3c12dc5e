"""Sums over mutually incoherent modes of the light."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.scene.source import SourceMode
from wavesim.sensor.incoherent import added_modes


def test_the_fraction_beyond_the_limit_is_that_of_the_energy() -> None:
    """A faint crossed component with a wide spectrum hardly counts."""
    modes = [SourceMode(1.0, (0.0, 0.0), 0.5, component=index) for index in range(2)]
    planes = {"mode_0": (np.full((3, 4), 2.0), 0.01), "mode_1": (np.full((3, 4), 0.002), 0.5)}
    ((intensity, beyond),) = added_modes(modes, lambda mode, prefix: iter([planes[prefix]]))
    assert intensity == pytest.approx(np.full((3, 4), 2.002))
    assert beyond == pytest.approx((2.0 * 0.01 + 0.002 * 0.5) / 2.002)


def test_dark_planes_have_nothing_beyond_the_limit() -> None:
    mode = SourceMode(1.0, (0.0, 0.0), 0.5)
    ((_, beyond),) = added_modes([mode], lambda mode, prefix: iter([(np.zeros((2, 2)), 0.0)]))
    assert beyond == 0.0
