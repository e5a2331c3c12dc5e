"""Rays with amplitude and caustics, against closed forms of planes and spheres."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Lens, Pose
from lensdesign.errors import InputError
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.fields.field import Grid
from wavesim.rays.ray_bundles import open_pupil, shoot, trace_bundle
from wavesim.scene.scene import Scene

STOP_MM, INDEX = 0.5, 1.5


def plate_scene(dimensions: int, coating: str = "ideal", index: float = INDEX) -> Scene:
    """One plane surface at z = 0, glass behind."""
    surface = Surface(material=index if index > 1.0 else None, semi_diameter_mm=STOP_MM, stop=True)
    return scene_of((surface,), dimensions, coating)


def scene_of(surfaces: tuple[Surface, ...], dimensions: int, coating: str = "ideal") -> Scene:
    lens = Lens(
        wavelengths_um=(0.5,),
        object=ObjectSpace(field_diameter_mm=0.1, numerical_aperture=0.4, working_distance_mm=1.0),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(1.0,)),
        surfaces=surfaces,
    )
    shape = (20,) * dimensions
    return Scene(lens, Grid(shape, 1e-3, -1.0), Grid(shape, 1e-2, 2.0), 0.5, coating=coating)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_free_space(dimensions: int) -> None:
    scene = plate_scene(dimensions, index=1.0)
    y = np.linspace(-0.45, 0.45, 7)
    bundle = trace_bundle(scene, np.zeros(2), np.column_stack([np.zeros(7), y / STOP_MM]), 2.0)
    distance = np.hypot(3.0, 3.0 * y)
    assert bundle.ok.all()
    assert bundle.sensor_mm[:, 0] == pytest.approx(3.0 * y)
    assert bundle.path_mm == pytest.approx(distance)
    assert bundle.cosines[:, 0] == pytest.approx(3.0 * y / distance)
    assert bundle.slopes == pytest.approx(bundle.cosines)
    # The propagator's far field: cos(theta) over r, or over its root on a line.
    assert bundle.amplitude == pytest.approx(3.0 / distance / distance ** (0.5 * dimensions), rel=1e-6)
    assert not bundle.caustics.any()


@pytest.mark.parametrize("dimensions", [1, 2])
def test_flux_of_ray_tubes_is_kept_and_bare_glass_takes_fresnels_share(dimensions: int) -> None:
    y = np.linspace(-0.9, 0.9, 9)
    pupil = np.column_stack([0.1 * (dimensions - 1) * np.ones(9), y])
    ideal, bare = (
        trace_bundle(plate_scene(dimensions, coating), np.zeros(2), pupil, 2.0)
        for coating in ("ideal", "bare")
    )
    sine2 = np.sum(ideal.cosines**2, axis=1)
    before, behind = np.sqrt(1 - sine2), np.sqrt(1 - sine2 / INDEX**2)
    te = 4 * INDEX * before * behind / (before + INDEX * behind) ** 2
    tm = 4 * INDEX * before * behind / (INDEX * before + behind) ** 2
    share = te if dimensions == 1 else 0.5 * (te + tm)
    assert (bare.amplitude / ideal.amplitude) ** 2 == pytest.approx(share)
    spread = np.abs(np.linalg.det(ideal.cosine_jacobian) / ideal.determinant)
    assert ideal.amplitude**2 * INDEX * behind == pytest.approx(spread * before)


@pytest.mark.parametrize(("dimensions", "expected"), [(1, 1), (2, 2)])
def test_a_focus_is_one_caustic_on_a_line_and_two_on_a_plane(dimensions: int, expected: int) -> None:
    front = Surface(radius_mm=0.3, thickness_mm=0.3, material=1.5, semi_diameter_mm=0.06, stop=True)
    scene = scene_of((front, Surface(radius_mm=-0.3, semi_diameter_mm=0.1)), dimensions)
    pupil = np.column_stack([0.2 * (dimensions - 1) * np.ones(5), np.linspace(-0.9, 0.9, 5)])
    assert (trace_bundle(scene, np.zeros(2), pupil, 0.35).caustics == 0).all()
    assert (trace_bundle(scene, np.zeros(2), pupil, 1.5).caustics == expected).all()


def test_open_pupil_ends_where_a_later_surface_clips() -> None:
    front = Surface(thickness_mm=1.0, semi_diameter_mm=STOP_MM, stop=True)
    scene = scene_of((front, Surface(semi_diameter_mm=0.6)), 2)
    found = open_pupil(scene, (0.0, 0.0), 2.0)
    # From 1 mm in front to 1 mm behind: half of 0.6 mm passes at the stop.
    assert np.hypot(*found.rim.T) == pytest.approx(0.6, abs=1e-6)
    line = open_pupil(scene_of((front, Surface(semi_diameter_mm=0.6)), 1), (0.0, 0.1), 2.0)
    assert np.sort(line.rim[:, 1]) == pytest.approx([-0.5, 0.7], abs=1e-6)


def test_rays_that_leave_the_meridional_plane_are_refused(paper_lens: Lens) -> None:
    grids = Grid((20,), 1e-3, -13.5), Grid((20,), 1e-2, 12.7)
    scene = Scene(paper_lens, *grids, 0.532, pose=Pose(decenter_x_mm=0.1))
    with pytest.raises(InputError, match="plane x = 0"):
        trace_bundle(scene, np.zeros(2), np.array([[0.0, 0.5]]), 12.7)


def test_stop_points_beyond_the_surface_are_missed_rays(paper_lens: Lens) -> None:
    scene = Scene(paper_lens, Grid((20,), 1e-3, -13.5), Grid((20,), 1e-2, 12.7), 0.532)
    rays = shoot(scene, np.zeros((2, 2)), np.array([[0.0, 0.5], [0.0, 9.0]]), 12.7, clip=False)
    assert rays.ok.tolist() == [True, False]


def test_an_object_that_the_lens_does_not_see_is_refused() -> None:
    front = Surface(thickness_mm=1.0, semi_diameter_mm=STOP_MM, stop=True)
    scene = scene_of((front, Surface(semi_diameter_mm=0.1)), 1)
    with pytest.raises(InputError, match=r"object point \(0, 5\) mm"):
        open_pupil(scene, (0.0, 5.0), 2.0)
