"""Transfer functions between the samples of parallel planes."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.fields import angular_spectrum
from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import PlaneWaves


@pytest.mark.parametrize("shape", [(6, 5), (1, 8), (7,), (8,)])
@pytest.mark.parametrize("pitch_mm", [3.2e-3, 3e-4])
@pytest.mark.parametrize("distance_mm", [0.0, 0.7, -2.0])
def test_a_quarter_of_the_factor_is_the_whole(
    shape: tuple[int, ...], pitch_mm: float, distance_mm: float
) -> None:
    """Also where the grid holds waves that decay."""
    random = np.random.default_rng(3)
    spectrum = random.random(shape) + 1j * random.random(shape)
    grid = Grid(shape, pitch_mm, 1.0)
    factor = PlaneWaves.of(grid, 0.532).transfer_function(distance_mm)
    way = TransferFunction(grid, 0.532, distance_mm, np.complex128)
    np.testing.assert_allclose(way.times(spectrum.copy()), spectrum * factor, atol=1e-12)
    np.testing.assert_allclose(way.times(spectrum.copy(), adjoint=True), spectrum * factor.conj(), atol=1e-12)
    assert way.factor.size <= (1 + shape[0] // 2) * (1 + shape[-1] // 2)
    assert way.is_identity == bool(np.all(factor == 1.0))


@pytest.mark.parametrize("shape", [(6, 5), (5, 6), (1, 8)])
@pytest.mark.parametrize("pitch_mm", [3.2e-3, 3e-4])
@pytest.mark.parametrize("distance_mm", [0.0, 0.7])
@pytest.mark.parametrize("shift_mm", [(0.0, 0.0), (1e-3, -2e-3)])
@pytest.mark.parametrize("adjoint", [False, True])
def test_a_field_in_blocks_is_propagated_as_its_spectrum_is(
    monkeypatch: pytest.MonkeyPatch,
    shape: tuple[int, ...],
    pitch_mm: float,
    distance_mm: float,
    shift_mm: tuple[float, float],
    adjoint: bool,
) -> None:
    monkeypatch.setattr(angular_spectrum, "rows_in", lambda bytes_of_row: 2)
    monkeypatch.setattr(angular_spectrum, "COLUMNS", 2)
    random = np.random.default_rng(3)
    field = random.random(shape) + 1j * random.random(shape)
    propagator = TransferFunction(Grid(shape, pitch_mm, 1.0), 0.532, distance_mm, np.complex128, shift_mm)
    expected = np.fft.ifft2(propagator.times(np.fft.fft2(field), adjoint=adjoint))
    found = propagator.propagate(field, np.empty_like(field), adjoint=adjoint)
    np.testing.assert_allclose(found, expected, atol=1e-14)
    np.testing.assert_array_equal(propagator.propagate(field, field, adjoint=adjoint), found)


def test_no_distance_is_no_way() -> None:
    assert TransferFunction(Grid((6, 5), 3.2e-3, 1.0), 0.532, 0.0, np.complex64).is_identity
    assert not TransferFunction(Grid((6, 5), 2e-4, 1.0), 0.532, 0.0, np.complex64).is_identity
