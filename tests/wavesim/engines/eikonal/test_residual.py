"""What tiles leave out, against free space, where it is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign import Lens
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.engines.eikonal.residual import Residual, tile_residual
from wavesim.fields.field import Grid
from wavesim.rays.maps import RayMapError, ray_map
from wavesim.scene.scene import Scene

WAVELENGTH_UM = 0.5
K_PER_MM = 2e3 * math.pi / WAVELENGTH_UM
SPAN_MM = 0.03


def free_space(dimensions: int) -> Scene:
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.1, numerical_aperture=0.4, working_distance_mm=1.0),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(1.0,)),
        surfaces=(Surface(semi_diameter_mm=0.3, stop=True),),
    )
    shape = (20,) * dimensions
    return Scene(lens, Grid(shape, 1e-3, -1.0), Grid(shape, 1e-2, 1.0), WAVELENGTH_UM)


def residual_of(dimensions: int, width_mm: float = 2 * SPAN_MM) -> Residual:
    scene = free_space(dimensions)
    half = 0.5 * width_mm
    spans = np.array([[-half, half]] * dimensions)
    return tile_residual(scene, (0.0, 0.0), spans, ray_map(scene, (0.0, 0.0), 1.0, half))


def exact(sensor_mm: np.ndarray, offset_mm: np.ndarray) -> np.ndarray:
    """R(s, d) between planes 2 mm apart, for points (n, d) and one offset (d,)."""
    far = np.sqrt(4.0 + np.sum((sensor_mm - offset_mm) ** 2, axis=1))
    near = np.sqrt(4.0 + np.sum(sensor_mm**2, axis=1))
    phase = K_PER_MM * (far - near + sensor_mm @ offset_mm / near)
    return (near / far) ** (1.0 + 0.5 * sensor_mm.shape[1]) * np.exp(1j * phase)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_samples_in_free_space(dimensions: int) -> None:
    found = residual_of(dimensions)
    corner = np.exp(found.logarithm.reshape(len(found.weights), -1)[:, 0])
    expected = exact(found.sensor_mm, np.full(dimensions, -SPAN_MM))
    assert np.max(np.abs(corner - expected)) < 2e-3
    assert found.weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_low_rank_reproduces_it_to_the_error_asked_for(dimensions: int) -> None:
    found = residual_of(dimensions)
    terms = found.low_rank(3e-3)
    assert 1 < terms.rank <= 10
    offsets = [np.array([-0.02, 0.007, 0.025])] * dimensions
    factors = terms.tile_factors(offsets).reshape(terms.rank, -1)
    assert terms.sensor_factors is not None
    sensor = terms.sensor_factors.at(found.sensor_mm)
    places = np.stack(np.meshgrid(*offsets, indexing="ij"), axis=-1).reshape(-1, dimensions)
    for i, place in enumerate(places):
        error = np.abs(sensor.T @ factors[:, i] - exact(found.sensor_mm, place)) ** 2
        assert math.sqrt(found.weights @ error) < 2e-2


def test_error_of_the_mean_falls_with_the_area_of_the_tile() -> None:
    wide, narrow = (residual_of(2, width).mean_error() for width in (0.04, 0.02))
    assert wide / narrow == pytest.approx(4.0, rel=0.1)
    found = residual_of(2, 0.02)
    assert found.error_of(found.rank_for(1e-3)) <= 1e-3 < found.error_of(found.rank_for(1e-3) - 1)


def test_mean_term_is_one_factor_over_the_tile() -> None:
    found = residual_of(1, 0.02)
    term = found.mean_term()
    values = term.tile_factors([np.array([0.0, 0.01])])
    assert values.shape == (1, 2)
    assert values[0, 0] == pytest.approx(1.0, abs=1e-6)
    near = np.sqrt(4.0 + found.sensor_mm[:, 0] ** 2)
    curvature = found.weights @ (4.0 / near**3)
    assert np.angle(values[0, 1]) == pytest.approx(0.5 * K_PER_MM * curvature * 1e-4, rel=1e-2)


def test_tiles_too_wide_to_aim_from_are_refused(paper_lens: Lens) -> None:
    scene = Scene(paper_lens, Grid((50, 50), 0.1, -13.5), Grid((50, 50), 0.4, 12.7), 0.532)
    spans = np.array([[-2.0, 2.0]] * 2)
    with pytest.raises(RayMapError, match="make tiles narrower"):
        tile_residual(scene, (0.0, 0.0), spans, ray_map(scene, (0.0, 0.0), 12.7, 2.0))
