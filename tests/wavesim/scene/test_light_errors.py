"""Errors of the light on the object."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import InputError
from wavesim.fields.field import Field, Grid
from wavesim.scene.light_errors import LightErrors, light_mode
from wavesim.targets.illumination import plane_wave

GRID = Grid((40, 48), 5e-4, -1.0)
LIGHT = Field(GRID, np.ones(GRID.shape, complex), 0.532)


def test_a_tilt_is_that_of_a_tilted_plane_wave() -> None:
    tilted = LightErrors(tilt_deg=(0.7, -1.3)).on(LIGHT)
    assert np.allclose(tilted.values, plane_wave(GRID, 0.532, tilt_x_deg=0.7, tilt_y_deg=-1.3).values)


@pytest.mark.filterwarnings("error")
def test_real_light_gets_a_phase() -> None:
    grid, errors = Grid((6, 8), 1e-3, 0.0), LightErrors(phase_waves={(1, 0): 0.2})
    for dtype, expected in ((np.float32, np.complex64), (np.float64, np.complex128)):
        real = Field(grid, np.full(grid.shape, 2.0, dtype), 0.5)
        found = errors.on(real).values
        assert found.dtype == expected
        np.testing.assert_allclose(found, errors.on(real.with_values(real.values + 0j)).values, rtol=1e-6)


def test_modes_are_legendre_polynomials_over_the_patch() -> None:
    """Even sums over the samples: orthogonal but for the sampling."""
    x = (GRID.x_mm - GRID.centre_mm[0]) / (0.5 * 48 * 5e-4)
    y = (GRID.y_mm - GRID.centre_mm[1]) / (0.5 * 40 * 5e-4)
    assert np.allclose(light_mode((1, 0), GRID.shape), x[None, :] + 0.0 * y[:, None])
    assert np.allclose(light_mode((0, 2), GRID.shape), 1.5 * y[:, None] ** 2 - 0.5 + 0.0 * x[None, :])
    assert np.mean(light_mode((1, 1), GRID.shape) * light_mode((2, 0), GRID.shape)) == pytest.approx(0.0)


def test_amplitude_and_phase_follow_their_modes() -> None:
    light = LightErrors(amplitude={(2, 0): 0.1}, phase_waves={(1, 1): 0.05}).on(LIGHT)
    assert np.allclose(np.abs(light.values), 1.0 + 0.1 * light_mode((2, 0), GRID.shape))
    assert np.allclose(np.angle(light.values), 0.1 * np.pi * light_mode((1, 1), GRID.shape))
    assert LightErrors().on(LIGHT) is LIGHT


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LightErrors(tilt_deg=(90.0, 0.0)), "between -90 and 90"),
        (lambda: LightErrors(amplitude={(0, 0): 0.1}), "not both 0"),
        (lambda: LightErrors(phase_waves={(1, 0): float("nan")}), "finite"),
        (lambda: LightErrors(amplitude={(1, 0): 1.5}).on(LIGHT), "above 0"),
    ],
)
def test_what_is_not_usable_is_refused(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]
