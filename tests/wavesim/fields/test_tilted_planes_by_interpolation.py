"""Free space to planes that are tilted a little."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.fields.propagator import propagate, propagator_to
from wavesim.fields.tilted_planes import TiltedPropagator

GRID = Grid((96, 80), 3.2e-3, 1.0)


def speckle() -> Field:
    """Light that fills seven tenths of the pixels' band, in a soft window."""
    rng = np.random.default_rng(1)
    spectrum = rng.standard_normal(GRID.shape) + 1j * rng.standard_normal(GRID.shape)
    for axis, count in enumerate(GRID.shape):
        spectrum *= (np.abs(np.fft.fftfreq(count)) < 0.35).reshape((-1, 1) if axis == 0 else (1, -1))
    edge = [np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 4 for n in GRID.shape]
    return Field(GRID, np.fft.ifft2(spectrum) * np.outer(*edge), 0.532)


@pytest.mark.parametrize("tilt_deg", [(2.0, 0.0), (0.0, -8.0), (2.5, -2.5), (5.0, 1.0)])
def test_light_is_that_on_the_tilted_plane(tilt_deg: tuple[float, float]) -> None:
    """The spectrum, turned, gives it exactly; a phase at each point is left out."""
    light = speckle()
    exact = np.abs(propagate(light, GRID.at(0.0), target_tilt_deg=tilt_deg, check=False).values)
    way = TiltedPropagator(GRID, 0.532, 0.0, np.complex128, tilt_deg)
    found = np.abs(way.forward(np.fft.fft2(light.values)))
    upright = np.linalg.norm(np.abs(light.values) - exact) / np.linalg.norm(exact)
    off = np.linalg.norm(found - exact) / np.linalg.norm(exact)
    assert off < 1e-3
    assert upright > 20.0 * off


def test_the_way_back_is_the_adjoint() -> None:
    rng = np.random.default_rng(2)
    spectrum, values = (rng.standard_normal(GRID.shape) + 1j * rng.standard_normal(GRID.shape) for _ in "ab")
    way = TiltedPropagator(GRID, 0.532, 0.4, np.complex128, (3.0, -2.0), (1e-3, 2e-3))
    forward, adjoint = np.vdot(values, way.forward(spectrum)), np.vdot(way.adjoint(values.copy()), spectrum)
    assert adjoint / GRID.size == pytest.approx(forward, rel=1e-10)


def test_without_a_tilt_it_is_one_plane() -> None:
    for tilt_deg in ((0.0, 0.0), (1e-6, -1e-6)):
        assert propagator_to(GRID, 0.532, 0.0, np.complex64, (0.0, 0.0), tilt_deg).is_identity
    assert isinstance(
        propagator_to(GRID, 0.532, 0.0, np.complex64, (0.0, 0.0), (0.01, 0.0)), TiltedPropagator
    )


@pytest.mark.parametrize(
    ("grid", "tilt_deg", "message"),
    [
        (GRID, (60.0, 0.0), "rad at the sensor's edge"),
        (Grid((64,), 3.2e-3, 1.0), (1.0, 0.0), "meridional line"),
    ],
)
def test_what_is_no_slight_tilt_is_refused(grid: Grid, tilt_deg: tuple[float, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        TiltedPropagator(grid, 0.532, 0.0, np.complex128, tilt_deg)
