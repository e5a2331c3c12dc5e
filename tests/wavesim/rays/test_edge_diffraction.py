"""The aperture's edge, against wave optics through an aperture in free space and Fresnel's own figures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign import Lens, Pose, scaled
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.rays import edge_diffraction
from wavesim.rays.edge_diffraction import Edge, fresnel_edge, light_edge
from wavesim.rays.ray_bundles import open_pupil
from wavesim.scene.scene import Scene

WAVELENGTH_UM, FRONT_MM, BEHIND_MM, STOP_MM = 0.5, 0.3, 0.2, 0.06


def aperture(dimensions: int, samples: int = 3, pitch_mm: float = 4e-4) -> Scene:
    """A hole in free space."""
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.02, numerical_aperture=0.19, working_distance_mm=FRONT_MM),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(BEHIND_MM,)),
        surfaces=(Surface(semi_diameter_mm=STOP_MM, stop=True),),
    )
    start = Grid((samples,) * dimensions, pitch_mm, -FRONT_MM, (0.0, 0.004))
    return Scene(lens, start, Grid((260,) * dimensions, 1e-3, BEHIND_MM), WAVELENGTH_UM)


def through_the_hole(scene: Scene, place: tuple[int, ...]) -> np.ndarray:
    """Field of one object sample behind the hole: a spherical (cylindrical) wave, cut, and free space."""
    k, d = scene.wavenumber_per_mm, len(scene.object_grid.shape)
    hole = Grid((460,) * d, 2.9e-4, 0.0)
    y = hole.y_mm - scene.object_grid.y_mm[place[0]]
    r2, from_axis = y**2 + FRONT_MM**2, hole.y_mm**2
    if d == 2:
        r2 = r2[:, None] + (hole.x_mm - scene.object_grid.x_mm[place[1]]) ** 2
        from_axis = from_axis[:, None] + hole.x_mm**2
    r = np.sqrt(r2)
    # Rayleigh's first integral, far from the source.
    wave = (1e3 / WAVELENGTH_UM) ** (0.5 * d) * np.exp(1j * (k * r - 0.25 * math.pi * d)) * FRONT_MM
    wave *= scene.object_grid.cell / r ** (1.0 + 0.5 * d)
    cut = np.where(from_axis <= STOP_MM**2, wave, 0.0)
    return np.asarray(FreeSpacePropagator(hole, scene.exit_grid, WAVELENGTH_UM, 1.0).forward(cut))


def test_fresnel_integral() -> None:
    assert fresnel_edge(np.array([0.0]))[0] == pytest.approx(0.5)
    assert fresnel_edge(np.array([40.0]))[0] == pytest.approx(1.0, abs=0.01)
    x = np.linspace(-3.0, 3.0, 50)
    np.testing.assert_allclose(fresnel_edge(x) + fresnel_edge(-x), 1.0, atol=1e-14)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_detour_in_free_space(dimensions: int) -> None:
    scene = aperture(dimensions)
    pupil = open_pupil(scene, (0.0, 0.0), BEHIND_MM)
    edge = light_edge(scene, (0.0, 0.0), pupil, BEHIND_MM)
    # About the axis, by the second derivatives of both ways.
    cosine = FRONT_MM / math.hypot(FRONT_MM, STOP_MM)
    before, behind = FRONT_MM / cosine**3, BEHIND_MM / cosine**3
    expected = STOP_MM * math.sqrt(0.5 * scene.wavenumber_per_mm * (1.0 / before + 1.0 / behind))
    np.testing.assert_allclose(edge.rate, expected, rtol=2e-3)
    assert not edge.conjugate.any()


@pytest.mark.parametrize(("dimensions", "allowed"), [(1, 0.025), (2, 0.045)])
def test_light_of_a_point_behind_a_hole(dimensions: int, allowed: float) -> None:
    """A sharp edge errs by 0.17 and 0.24 here; tiles are of one sample, whose light needs hardly any grid."""
    scene = aperture(dimensions)
    place = (1,) * dimensions
    values = np.zeros(scene.object_grid.shape, complex)
    values[place] = 1.0
    engine = FlatTiles(scene, tile_width_mm=scene.object_grid.pitch_mm)
    found = engine.forward(Field(scene.object_grid, values, WAVELENGTH_UM)).values
    exact = through_the_hole(scene, place)
    assert relative_error(found, exact) < allowed


def test_some_arms_tell_of_the_others(paper_lens: Lens, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tilted lens, off the axis; all of them give the same edge."""
    lens = scaled(paper_lens, 1 / 16)
    pose = Pose(tilt_x_deg=0.4, tilt_y_deg=0.2)
    grids = Grid((5, 5), 5e-4, -13.5 / 16), Grid((30, 30), 0.02, 12.7 / 16)
    scene, point = Scene(lens, *grids, 0.532, pose), (0.02, 0.06)
    pupil = open_pupil(scene, point, 12.7 / 16, 360)
    turn = np.random.default_rng(3).uniform(0.0, 2.0 * math.pi, 2000)
    share = np.linspace(0.3, 1.03, 2000)
    stop = pupil.points(share, turn)[:, ::-1]
    some = light_edge(scene, point, pupil, 12.7 / 16)
    monkeypatch.setattr(edge_diffraction, "EVERY", 1)
    whole = light_edge(scene, point, pupil, 12.7 / 16)
    found, expected = (edge.factor(stop, 1e-3, edge.shadow) for edge in (some, whole))
    assert not np.array_equal(found, expected)
    assert relative_error(found[share > 0.9], expected[share > 0.9]) < 5e-5
    # Far inside, where arms follow rays to different depths, polynomials are held to 0.1 radians.
    assert relative_error(found, expected) < 2e-4


def test_only_what_lies_near_the_rim_is_drawn(paper_lens: Lens, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what is left out is 1 indeed."""
    scene = Scene(paper_lens, Grid((40, 40), 5e-4, -13.5, (0.2, 1.1)), Grid((30, 30), 0.5, 12.7), 0.532)
    pupil = open_pupil(scene, (0.2, 1.1), 12.7, 90)
    edge = light_edge(scene, (0.2, 1.1), pupil, 12.7)
    rng = np.random.default_rng(3)
    stop = pupil.points(rng.uniform(0.0, 1.05, 4000), rng.uniform(0.0, 2.0 * math.pi, 4000))[:, ::-1]
    found = edge.factor(stop, 0.05, edge.shadow)
    assert 0.5 < np.mean(found == 1.0) < 0.99
    monkeypatch.setattr(Edge, "_clear_radius", lambda self, most: 0.0)
    np.testing.assert_array_equal(found, edge.factor(stop, 0.05, edge.shadow))
