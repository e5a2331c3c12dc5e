"""Chirp-z sums, and free space onto any window."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.angular_spectrum import AngularSpectrum
from wavesim.fields.chirp_z import ChirpZ, chirp_z_transform
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.fields.plane_waves import Samples
from wavesim.fields.propagator import FreeSpacePropagator, propagate
from wavesim.fields.sampling_checks import SamplingWarning

WAVELENGTH_UM = 0.5


def _random(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def _gaussian_field(grid: Grid, waist_mm: float) -> Field:
    y = grid.y_mm - grid.centre_mm[1]
    squared = y**2 if grid.is_line else y[:, None] ** 2 + (grid.x_mm - grid.centre_mm[0]) ** 2
    return Field(grid, np.exp(-squared / waist_mm**2) + 0j, WAVELENGTH_UM)


@given(
    st.integers(1, 120),
    st.integers(1, 120),
    st.floats(-5.0, 5.0),
    st.floats(-50.0, 50.0),
    st.floats(1e-4, 0.05),
    st.sampled_from([-1, 1]),
)
def test_chirp_z_is_the_direct_sum(n: int, m: int, x0: float, f0: float, step: float, sign: int) -> None:
    source, target = Samples(x0, 0.3, n), Samples(f0, step, m)
    values = _random((n,))
    kernel = np.exp(sign * 2j * np.pi * np.outer(target.points(), source.points()))
    result = chirp_z_transform(values, source, target, sign=sign)
    scale = np.linalg.norm(kernel) * np.linalg.norm(values) / np.sqrt(n)
    # The direct sum rounds its own phases.
    phase = 2.0 * np.pi * np.abs(target.points()).max() * np.abs(source.points()).max()
    assert np.linalg.norm(result - kernel @ values) <= (2e-13 + 1e-15 * phase) * scale


def test_long_chirp_z_is_the_direct_sum_along_any_axis() -> None:
    source, target = Samples(0.37, 0.01, 2000), Samples(-3.1, 0.04, 1501)
    values = _random((2000, 2))
    direct = np.exp(-2j * np.pi * np.outer(target.points(), source.points())) @ values
    assert relative_error(chirp_z_transform(values, source, target, axis=0), direct) < 1e-12
    assert relative_error(chirp_z_transform(values.T, source, target), direct.T) < 1e-12
    single = chirp_z_transform(values.astype(np.complex64), source, target, axis=0)
    assert single.dtype == np.complex64
    assert relative_error(single, direct) < 1e-5


def test_wrong_number_of_values_is_refused() -> None:
    with pytest.raises(InputError, match="5 samples along axis 0: must be 4"):
        chirp_z_transform(_random((5,)), Samples(0.0, 1.0, 4), Samples(0.0, 0.1, 3))


@pytest.mark.parametrize(
    ("shape", "to", "centre"),
    [((200,), (90,), (0.0, 0.02)), ((40, 60), (30, 25), (0.03, -0.01)), ((300,), (400,), (0.0, 0.0))],
)
@pytest.mark.parametrize("distance_mm", [0.08, 3.0, -0.7])
def test_adjoint(shape: tuple, to: tuple, centre: tuple, distance_mm: float) -> None:
    source, target = Grid(shape, 1e-3, 0.0), Grid(to, 1.7e-3, distance_mm, centre)
    passage = FreeSpacePropagator(source, target, WAVELENGTH_UM, 1.3)
    f, g = _random(shape, 1), _random(to, 2)
    there, back = passage.forward(f), passage.adjoint(g)
    left = np.vdot(g, there) * target.cell
    right = np.vdot(back, f) * source.cell
    size = np.linalg.norm(g) * np.linalg.norm(there) * target.cell
    assert abs(left - right) <= 1e-12 * size


@pytest.mark.parametrize("shape", [(400,), (96, 80)])
@pytest.mark.parametrize("distance_mm", [0.02, 0.3, 20.0])
def test_same_grid_is_the_angular_spectrum(shape: tuple, distance_mm: float) -> None:
    field = _gaussian_field(Grid(shape, 1e-3, 0.0), 6e-3)
    ends = (field.grid, field.grid.at(distance_mm), WAVELENGTH_UM, 1.0)
    chirped, padded = ChirpZ(*ends), AngularSpectrum(*ends, "auto", True)
    plain = padded.forward(field.values)
    FreeSpacePropagator(*ends).check(field.values)
    assert relative_error(chirped.forward(field.values), plain) < 5e-5
    smaller = padded if padded.samples <= chirped.widest else chirped
    np.testing.assert_array_equal(
        FreeSpacePropagator(*ends).forward(field.values), smaller.forward(field.values)
    )


@pytest.mark.parametrize("distance_mm", [0.05, 0.5, 40.0])
def test_finer_shifted_window_is_a_beam(distance_mm: float) -> None:
    # A beam of small divergence: its paraxial formula holds to 1e-5.
    waist = 0.02
    grid = Grid((256,), 1.5e-3, 0.0)
    target = Grid((333,), 0.4e-3, distance_mm, (0.0, 0.013))
    result = propagate(_gaussian_field(grid, waist), target)
    k = 2e3 * np.pi / WAVELENGTH_UM
    q = 1.0 + 2j * distance_mm / (k * waist**2)
    exact = np.exp(1j * k * distance_mm - target.y_mm**2 / (waist**2 * q)) / np.sqrt(q)
    assert relative_error(result.values, exact) < 3e-4


def test_samples_of_the_spectrum_do_not_grow_with_the_distance() -> None:
    near, far = Grid((512,), 1e-3, 0.0), Grid((512,), 1e-3, 1000.0)
    assert FreeSpacePropagator(near, far, WAVELENGTH_UM).samples < 512


def test_far_field_is_the_spectrum() -> None:
    grid, distance = Grid((128,), 1e-3, 0.0), 2000.0
    target = Grid((101,), 1.0, distance)
    field = _gaussian_field(grid, 5e-3)
    power = abs(propagate(field, target, coarse_output=True).values) ** 2
    sine = target.y_mm / np.hypot(target.y_mm, distance)
    spectrum = np.exp(-2.0 * (np.pi * 5e-3 * sine / (1e-3 * WAVELENGTH_UM)) ** 2)
    expected = spectrum / (1.0 + (target.y_mm / distance) ** 2) ** 1.5
    np.testing.assert_allclose(power / power.max(), expected, atol=2e-3)


def test_output_too_coarse_is_refused_unless_asked_for() -> None:
    # A diverging beam, whose outer rings need 1 um.
    field = _gaussian_field(Grid((512,), 0.5e-3, 0.0), 1.5e-3)
    target = Grid((64,), 8e-3, 2.0)
    with pytest.raises(SamplingError, match=r"8 µm.*coarse_output=True"):
        propagate(field, target)
    coarse = propagate(field, target, coarse_output=True)
    fine = propagate(field, Grid((1025,), 0.5e-3, 2.0, (0.0, 0.0)))
    np.testing.assert_allclose(
        coarse.values, np.interp(target.y_mm, fine.grid.y_mm, fine.values), atol=2e-3 * abs(fine.values).max()
    )


def test_window_beside_the_light_is_told() -> None:
    field = _gaussian_field(Grid((256,), 1e-3, 0.0), 0.02)
    with pytest.warns(SamplingWarning, match=r"output window, which is centred at \(0.0, 3.0\)"):
        propagate(field, Grid((64,), 1e-3, 0.1, (0.0, 3.0)))


def test_line_onto_a_plane_is_refused() -> None:
    with pytest.raises(InputError, match="both must be lines"):
        propagate(_gaussian_field(Grid((64,), 1e-3, 0.0), 0.01), Grid((8, 8), 1e-3, 1.0))
