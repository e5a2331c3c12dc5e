"""Objects at several wavelengths."""

from __future__ import annotations

import math

import numpy as np
import pytest

from wavesim.fields.field import Field, Grid
from wavesim.targets.colours import channel_of, film


def test_wavelengths_belong_to_channels() -> None:
    assert [channel_of(one) for one in (0.4, 0.489, 0.5, 0.579, 0.6, 0.7)] == [2, 2, 1, 1, 0, 0]


@pytest.mark.parametrize("wavelength_um", [0.45, 0.635])
def test_a_film_delays_light_by_its_optical_path(wavelength_um: float) -> None:
    shape = Field(Grid((2, 2), 1e-3, 0.0), np.array([[0.0, 0.5], [1.0, 1j]]), 0.532)
    found = film(shape, 0.3, 1.5, wavelength_um)
    phase = 2.0 * math.pi * 0.5 * 0.3 / wavelength_um
    assert found.wavelength_um == wavelength_um
    assert np.abs(found.values) == pytest.approx(np.ones((2, 2)))
    assert np.angle(found.values) == pytest.approx(phase * np.array([[0.0, 0.5], [1.0, 1.0]]), rel=1e-6)
