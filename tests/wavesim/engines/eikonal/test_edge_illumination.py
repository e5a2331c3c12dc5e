"""How much of an object's light goes to the rim: closed forms, and the errors that follow it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign import Lens, scaled
from lensdesign.errors import InputError
from lensdesign.lens.scaling import stopped_down
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.fields.field import Field, relative_error
from wavesim.metrics.comparison import random_field, reference_for
from wavesim.scene.patches import patch_scene
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene

APERTURE = 0.35


def scene_of(lens: Lens, patch_mm: float, *, meridional: bool, pitch_um: float | None = None) -> Scene:
    small = stopped_down(scaled(lens, 1 / 32), APERTURE)
    return patch_scene(
        small, patch_mm, plane_distance_mm=0.1, meridional=meridional, object_pitch_um=pitch_um
    )


def beam(scene: Scene, waist_mm: float, sine: float = 0.0) -> Light:
    """A Gaussian beam, tilted about x."""
    grid, k = scene.object_grid, scene.wavenumber_per_mm
    y = grid.y_mm if grid.is_line else grid.y_mm[:, None]
    values = np.exp(-grid.radius_squared_mm2() / waist_mm**2 + 1j * k * sine * y)
    return Light(Field(grid, values, scene.wavelength_um))


def test_even_light_is_1(paper_lens: Lens) -> None:
    scene = scene_of(paper_lens, 0.03, meridional=False)
    light = Light(random_field(scene.object_grid, scene.wavelength_um, APERTURE))
    assert FlatTiles(scene).edge_illumination(light) == pytest.approx(1.0, abs=0.2)
    assert FlatTiles(scene, tile_width_mm=0.01).edge_illumination(light) == pytest.approx(1.0, abs=0.2)


def test_a_slit_sends_what_its_diffraction_does(paper_lens: Lens) -> None:
    """(2 sin(q w / 2) / q)^2 at the rim q = k NA, whose mean is 2 / q^2; in all 2 pi w."""
    scene = scene_of(paper_lens, 0.04, meridional=True, pitch_um=0.1)
    grid, width_mm = scene.object_grid, 0.03
    slit = Light(Field(grid, (np.abs(grid.y_mm) < 0.5 * width_mm).astype(complex), scene.wavelength_um))
    expected = math.sqrt(2.0 / (math.pi * scene.wavenumber_per_mm * APERTURE * width_mm))
    found = FlatTiles(scene, tile_width_mm=0.05, error=0.5).edge_illumination(slit)
    assert found == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("meridional", [True, False])
def test_where_beams_go(paper_lens: Lens, meridional: bool) -> None:
    scene = scene_of(paper_lens, 0.02, meridional=meridional, pitch_um=0.3)
    engine = FlatTiles(scene, error=0.1)
    straight = engine.edge_illumination(beam(scene, 0.004))
    assert straight < 2e-3
    assert engine.edge_illumination(beam(scene, 0.004, APERTURE)) > 1.0
    half = engine.edge_illumination(Light(beam(scene, 0.004).field, even=0.25))
    assert half == pytest.approx(0.5, rel=1e-3)
    dark = Light(Field(scene.object_grid, np.zeros(scene.object_grid.shape), scene.wavelength_um))
    assert engine.edge_illumination(dark) == 1.0
    assert engine.predicted_error(dark) == pytest.approx(engine.predicted_error())


def test_what_is_neglected_follows_the_light(paper_lens: Lens) -> None:
    scene = scene_of(paper_lens, 0.02, meridional=True)
    engine = FlatTiles(scene, error=0.01)
    light = beam(scene, 0.004)
    even, own = (
        {p.description: p for p in parts} for parts in (engine.error_terms(), engine.error_terms_of(light))
    )
    share = engine.edge_illumination(light)
    for what, part in own.items():
        factor = share if part.at_rim else 1.0
        assert part.relative_error == pytest.approx(factor * even[what].relative_error)
    found = engine.forward(light.field)
    exact = reference_for(scene).forward(light.field)
    assert relative_error(found.values, exact.values) < engine.predicted_error(light)
    assert engine.predicted_error(light) < 0.3 * engine.predicted_error()


def test_light_of_another_scene_is_refused(paper_lens: Lens) -> None:
    scene, other = (scene_of(paper_lens, patch, meridional=True) for patch in (0.02, 0.03))
    with pytest.raises(InputError, match="must be the scene's"):
        FlatTiles(scene).predicted_error(beam(other, 0.004))
    with pytest.raises(InputError, match=r"even = 1\.5.*0 to 1"):
        Light(beam(scene, 0.004).field, even=1.5)
