"""Objects of layers against a closed form and an independent computation, and their adjoint."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.targets.layers import LayerStack

WAVELENGTH_UM = 0.532


def even_light(grid: Grid, radius_mm: float = np.inf) -> Field:
    inside = np.hypot(grid.x_mm, grid.y_mm[:, None]) < radius_mm
    return Field(grid, inside.astype(complex), WAVELENGTH_UM)


def stack_of(light: Field, distances_um: tuple[float, ...]) -> LayerStack:
    return LayerStack(light.grid, light, distances_um, np.abs(light.values))


def random_layers(grid: Grid, count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [
        rng.uniform(0.2, 1.0, grid.shape) * np.exp(1j * rng.normal(size=grid.shape)) for _ in range(count)
    ]


def test_a_grating_repeats_itself_on_a_second_grating_at_the_talbot_distance() -> None:
    """Behind a grating light has copies of its amplitude, and copies shifted by half a period."""
    grid = Grid((256, 256), 4e-4, -1.0)
    period_um = 3.2
    wavenumber = 2.0 * np.pi / WAVELENGTH_UM
    axial = np.sqrt(wavenumber**2 - (2.0 * np.pi / period_um) ** 2)
    talbot_um = 2.0 * np.pi / (wavenumber - axial)
    wave = np.cos(2.0 * np.pi * 1e3 * grid.x_mm / period_um) * np.ones((256, 1))
    grating, shifted = 0.6 + 0.3 * wave, 0.6 - 0.3 * wave
    # A smooth border of the light sends no light into the middle.
    light = Field(grid, np.exp(-((grid.radius_squared_mm2() / 0.036**2) ** 6)) + 0j, WAVELENGTH_UM)
    middle = np.ix_(*2 * [np.abs(grid.x_mm) < 0.015])

    def behind(distance_um: float) -> np.ndarray:
        stack = LayerStack(grid, light, (-distance_um, 0.0), np.ones(grid.shape))
        return np.abs(stack.forward([grating, grating]).behind)[middle]

    assert behind(talbot_um) == pytest.approx(grating[middle] ** 2, abs=5e-3)
    assert behind(0.5 * talbot_um) == pytest.approx((grating * shifted)[middle], abs=5e-3)


def test_layers_agree_with_an_independent_padded_angular_spectrum() -> None:
    grid = Grid((48, 48), 4e-4, -1.0)
    light = even_light(grid, 0.006)
    layers = random_layers(grid, 3)
    stack = stack_of(light, (-25.0, -5.0, 4.0))
    field, inside = light.values, light.values != 0.0
    frequencies = np.fft.fftfreq(1024, 1e3 * grid.pitch_mm)
    squared = 1.0 / WAVELENGTH_UM**2 - frequencies[:, None] ** 2 - frequencies**2
    along_z = 2.0 * np.pi * np.sqrt(np.maximum(squared, 0.0))
    for layer, step_um in zip(layers, (20.0, 9.0, -4.0), strict=True):
        padded = np.zeros((1024, 1024), complex)
        padded[:48, :48] = np.where(inside, field, 0.0) * layer
        spectrum = np.fft.fft2(padded) * np.exp(1j * step_um * along_z) * (squared > 0.0)
        field = np.fft.ifft2(spectrum)[:48, :48]
    found = stack.forward(layers).behind
    # The package omits waves that would alias; the independent spectrum has a period of twenty windows.
    assert np.linalg.norm(found - field) < 0.02 * np.linalg.norm(field)


def test_the_adjoint_is_that_of_the_derivative() -> None:
    grid = Grid((40, 40), 4e-4, -1.0)
    stack = stack_of(even_light(grid, 0.006), (-20.0, -8.0, 3.0))
    layers, directions = random_layers(grid, 3), random_layers(grid, 3, seed=1)
    change = random_layers(grid, 1, seed=2)[0]
    step = 1e-5
    ahead, behind = (
        stack.forward([a + sign * step * b for a, b in zip(layers, directions, strict=True)]).behind
        for sign in (1.0, -1.0)
    )
    gradients = stack.adjoint(change, layers, stack.forward(layers))
    by_adjoint = sum(np.vdot(g, d) for g, d in zip(gradients, directions, strict=True))
    assert by_adjoint == pytest.approx(np.vdot(change, (ahead - behind) / (2.0 * step)), rel=1e-6)


@pytest.mark.parametrize("distances_um", [(0.0, -20.0), (5.0, 5.0), (), (np.nan, 1.0)])
def test_layers_out_of_order_are_refused(distances_um: tuple[float, ...]) -> None:
    grid = Grid((16, 16), 4e-4, -1.0)
    with pytest.raises(InputError, match="layers_um"):
        stack_of(even_light(grid), distances_um)


def test_light_that_leaves_the_patch_before_the_object_plane_gives_a_warning() -> None:
    grid = Grid((48, 48), 4e-4, -1.0)
    layers = random_layers(grid, 2)
    with pytest.warns(SamplingWarning, match="larger patch_mm"):
        stack_of(even_light(grid, 0.009), (-40.0, -20.0)).check_lost_light(layers)
