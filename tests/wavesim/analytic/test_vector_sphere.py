"""The vector Mie series of a beam against plane waves, Fresnel's formulas, and rays with Jones matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign.lens.coatings.coating import CoatingName
from wavesim.analytic.cylinder import SCENE_INDEX
from wavesim.analytic.sphere import beam_nodes
from wavesim.analytic.vector_sphere import (
    meridional_fields,
    multipoles,
    passed_multipoles,
    vector_sphere_scene,
)
from wavesim.engines.eikonal.engine import FlatTiles

K, SPREAD = 2e3 * math.pi / 0.532, 0.1


def test_multipoles_of_the_beam_are_those_of_its_plane_waves() -> None:
    """Half of a regular wave goes out: at a distance it is the beam, as a sum of plane waves."""
    radius, z = np.linspace(0.0, 0.012, 7), 0.04
    waves = 0.5 * multipoles(K, SPREAD, -0.02, 450)
    outwards, along, around = meridional_fields((waves, waves), K, radius, z)
    angle, weight = beam_nodes(K, SPREAD, 0.1)
    azimuth = 2.0 * math.pi * np.arange(256) / 256
    # Plane waves with the field cos(azimuth) theta - sin(azimuth) phi, at points on both axes.
    theta, phi = np.meshgrid(angle, azimuth, indexing="ij")
    phase = np.exp(1j * K * (z + 0.02) * np.cos(theta)) * weight[:, None] / 256
    x = np.cos(phi) ** 2 * np.cos(theta) + np.sin(phi) ** 2
    for i, r in enumerate(radius):
        on_x, on_y = (np.exp(1j * K * r * np.sin(theta) * f(phi)) for f in (np.cos, np.sin))
        assert abs(np.sum(phase * x * on_x) - outwards[i]) < 1e-12
        assert abs(np.sum(phase * x * on_y) - around[i]) < 1e-12
        assert abs(np.sum(phase * -np.sin(theta) * np.cos(phi) * on_x) - along[i]) < 1e-12


def test_a_sphere_of_index_one_leaves_the_beam_alone() -> None:
    for is_ideal in (False, True):
        magnetic, electric = passed_multipoles(300.0, 1.0, K, SPREAD, -0.03, is_ideal)
        beam = 0.5 * multipoles(K, SPREAD, -0.03, 300)
        assert np.abs(np.stack([magnetic, electric]) - beam).max() < 1e-12 * np.abs(beam).max()


def test_passage_has_the_transmission_of_both_polarizations() -> None:
    """An order n meets the sphere at the angle whose sine is n / x."""
    x = 1200.0
    magnetic, electric = passed_multipoles(x, SCENE_INDEX, K, SPREAD, -0.1, False)
    beam = 0.5 * multipoles(K, SPREAD, -0.1, 1200)
    orders = np.array([20, 300, 600])
    sine = (orders + 0.5) / x
    outside, inside = np.sqrt(1.0 - sine**2), np.sqrt(1.0 - (sine / SCENE_INDEX) ** 2)
    s = ((outside - SCENE_INDEX * inside) / (outside + SCENE_INDEX * inside)) ** 2
    p = ((SCENE_INDEX * outside - inside) / (SCENE_INDEX * outside + inside)) ** 2
    assert np.abs(magnetic / beam)[orders - 1] == pytest.approx(1.0 - s, abs=1e-4)
    assert np.abs(electric / beam)[orders - 1] == pytest.approx(1.0 - p, abs=1e-4)


@pytest.mark.parametrize("coating", ["bare", "ideal"])
def test_rays_carry_both_components_as_the_series_does(coating: CoatingName) -> None:
    case = vector_sphere_scene(coating=coating)
    engine = FlatTiles(case.scene, tile_width_mm=1.0, error=1e-3)
    found = engine.forward_components(case.object_field)
    total = math.sqrt(sum(field.energy for field in case.exact))
    differences = [
        math.sqrt(field.with_values(field.values - exact.values).energy) / total
        for field, exact in zip(found, case.exact, strict=True)
    ]
    assert math.hypot(*differences) < 1e-3
    crossed = math.sqrt(case.exact[1].energy) / total
    assert differences[1] < 1e-4
    if coating == "bare":
        assert crossed > 5.0 * differences[1]


def test_the_crossed_component_vanishes_on_both_axes() -> None:
    case = vector_sphere_scene()
    exact = case.exact
    weight = [np.abs(field.values) for field in exact]
    assert weight[1].max() < 0.01 * weight[0].max()
    middle = exact[1].values.shape[0] // 2
    assert np.abs(exact[1].values[middle]).max() < 0.1 * weight[1].max()
