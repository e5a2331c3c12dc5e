"""Surfaces over a grid and rays across them, against spheres, planes and Fresnel's formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import Lens
from lensdesign.errors import InputError
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.surface import Surface
from wavesim.fields.field import Grid
from wavesim.rays.interfaces import crossings, surface_map, transmission
from wavesim.scene.scene import Scene

WAVELENGTH_UM, INDEX = 0.532, 1.5
RADIUS_MM = 5.0


def scene_of(
    radius_mm: float | None, shape: tuple[int, ...] = (11,), **changes: SurfacePerturbation
) -> Scene:
    """One surface to glass, seen from 10 mm in front."""
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.2, numerical_aperture=0.1, working_distance_mm=10.0),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(1.0,)),
        surfaces=(Surface(radius_mm=radius_mm, material=INDEX, semi_diameter_mm=1.5, stop=True),),
    )
    grids = Grid(shape, 1e-3, -10.0), Grid(shape, 1e-3, 2.0)
    perturbed = {0: changes["tilt"]} if "tilt" in changes else {}
    return Scene(lens, *grids, WAVELENGTH_UM, surface_perturbations=perturbed)


@given(tilt_deg=st.floats(-8.0, 8.0), x=st.floats(-1.0, 1.0), y=st.floats(-1.0, 1.0))
def test_tilted_sphere_is_a_sphere_about_another_centre(tilt_deg: float, x: float, y: float) -> None:
    scene = scene_of(RADIUS_MM, tilt=SurfacePerturbation(tilt_x_deg=tilt_deg))
    centre = RADIUS_MM * scene.system.rotation[0, 0, :, 2]
    off = (x - centre[0]) ** 2 + (y - centre[1]) ** 2
    found = surface_map(scene.system, 0, np.array([x]), np.array([y]))
    assert found.z_mm[0] == pytest.approx(centre[2] - math.sqrt(RADIUS_MM**2 - off), abs=1e-11)
    assert abs(centre[1]) == pytest.approx(RADIUS_MM * abs(math.sin(math.radians(tilt_deg))), abs=1e-12)


def test_aperture_ends_at_the_semi_diameter() -> None:
    found = surface_map(scene_of(RADIUS_MM).system, 0, np.zeros(4), np.array([0.0, 1.49, 1.51, 6.0]))
    assert found.inside.tolist() == [True, True, False, False]


@pytest.mark.parametrize("shape", [(11,), (5, 5)])
def test_rays_obey_snells_law(shape: tuple[int, ...]) -> None:
    (found,) = crossings(scene_of(RADIUS_MM, shape), (0.0, 0.05))
    sines = np.sqrt(1.0 - np.array([found.incidence, found.refraction]) ** 2)
    np.testing.assert_allclose(sines[0], INDEX * sines[1], atol=1e-9)
    assert np.max(np.hypot(found.x_mm, found.y_mm)) == pytest.approx(1.5, rel=1e-6)


def test_rays_at_a_plane() -> None:
    (found,) = crossings(scene_of(None), (0.0, 0.1))
    angle = np.arctan2(found.y_mm - 0.1, 10.0)
    np.testing.assert_allclose(found.incidence, np.cos(angle), atol=1e-12)
    np.testing.assert_allclose(found.axial_before, np.cos(angle), atol=1e-12)
    np.testing.assert_allclose(found.axial_after, np.cos(np.arcsin(np.sin(angle) / INDEX)), atol=1e-12)


def plane_scene(index: float, coating: str, dimensions: int) -> Scene:
    """A plane surface between air and a medium."""
    lens = scene_of(None).lens.with_surface(0, material=index)
    grids = (Grid((5,) * dimensions, 1e-3, z) for z in (-10.0, 1.0))
    return Scene(lens, *grids, WAVELENGTH_UM, coating=coating)


@given(angle=st.floats(0.0, 1.4), index=st.floats(1.1, 2.5))
def test_ideal_coating_keeps_the_flux_and_bare_glass_what_it_does_not_reflect(
    angle: float, index: float
) -> None:
    before = np.array([math.cos(angle)])
    behind = np.array([math.sqrt(1.0 - (math.sin(angle) / index) ** 2)])
    share = index * behind / before
    ideal, te = (transmission(plane_scene(index, c, 1), 0, before, behind) for c in ("ideal", "bare"))
    assert (share * ideal**2)[0] == pytest.approx(1.0, rel=1e-12)
    reflected = (before - index * behind) / (before + index * behind)
    assert (share * te**2 + reflected**2)[0] == pytest.approx(1.0, rel=1e-12)
    mean = transmission(plane_scene(index, "bare", 2), 0, before, behind)
    along = (index * before - behind) / (index * before + behind)
    assert (share * mean**2)[0] == pytest.approx(1.0 - 0.5 * (reflected**2 + along**2)[0], rel=1e-9)


def test_an_object_point_without_rays_is_refused(paper_lens: Lens) -> None:
    grids = Grid((11,), 1e-3, -13.5), Grid((11,), 1e-3, 12.7)
    aside = {1: SurfacePerturbation(decenter_y_mm=25.0)}
    with pytest.raises(InputError, match="get through"):
        crossings(Scene(paper_lens, *grids, WAVELENGTH_UM, surface_perturbations=aside), (0.0, 0.0))
