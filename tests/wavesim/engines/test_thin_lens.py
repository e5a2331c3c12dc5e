"""The thin lens, against Gaussian beams carried by ray-transfer matrices."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from engine_checks import dot_product_mismatch, engine_peak_bytes
from numpy.typing import NDArray

from lensdesign import Lens, Pose
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.surface import Surface
from wavesim.engines.thin_lens import ThinLens
from wavesim.fields.field import Field, Grid, correlation, relative_error
from wavesim.scene.scene import Scene

WAVELENGTH_UM, INDEX = 0.532, 1.5
K_PER_MM = 2e3 * math.pi / WAVELENGTH_UM
RADII_MM, THICKNESS_MM, DISTANCE_MM = (2.0, -3.0), 0.6, 1.5


def weak_lens(front_mm: float | None = RADII_MM[0], back_mm: float | None = RADII_MM[1]) -> Lens:
    """Biconvex, thick, for light of small angles."""
    return Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.1, numerical_aperture=0.1, working_distance_mm=DISTANCE_MM),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(1.0,)),
        surfaces=(
            Surface(
                radius_mm=front_mm,
                thickness_mm=THICKNESS_MM,
                material=INDEX,
                semi_diameter_mm=0.15,
                stop=True,
            ),
            Surface(radius_mm=back_mm, semi_diameter_mm=0.3),
        ),
    )


IN_PLACE = Pose()


def line_scene(pose: Pose = IN_PLACE, exit_z_mm: float = 2.0, y_mm: float = 0.0) -> Scene:
    grids = Grid((200,), 1.5e-3, -DISTANCE_MM, (0.0, y_mm)), Grid((400,), 1.5e-3, exit_z_mm, (0.0, y_mm))
    return Scene(weak_lens(), *grids, WAVELENGTH_UM, pose=pose)


def beam(grid: Grid, waist_mm: float = 0.02) -> Field:
    r2 = (grid.y_mm - grid.centre_mm[1]) ** 2
    if not grid.is_line:
        r2 = r2[:, None] + (grid.x_mm - grid.centre_mm[0]) ** 2
    return Field(grid, np.exp(-r2 / waist_mm**2).astype(complex), WAVELENGTH_UM)


def carried(grid: Grid, waist_mm: float = 0.02) -> NDArray[np.complex128]:
    """A Gaussian beam of the meridional world through the thick lens, surface by surface."""
    q, amplitude = -0.5j * K_PER_MM * waist_mm**2, 1.0 + 0.0j
    path = DISTANCE_MM + INDEX * THICKNESS_MM + grid.z_mm - THICKNESS_MM
    power = (INDEX - 1.0) / RADII_MM[0], (1.0 - INDEX) / RADII_MM[1]
    for reduced, bend in zip((DISTANCE_MM, THICKNESS_MM / INDEX), power, strict=True):
        amplitude *= np.sqrt(q / (q + reduced))
        q = q + reduced
        q = 1.0 / (1.0 / q - bend)
    reduced = grid.z_mm - THICKNESS_MM
    amplitude *= np.sqrt(q / (q + reduced))
    q = q + reduced
    return np.asarray(amplitude * np.exp(1j * K_PER_MM * (path + 0.5 * grid.y_mm**2 / q)))


@pytest.mark.parametrize("exit_z_mm", [0.7, 2.0, 5.0])
def test_gaussian_beam(exit_z_mm: float) -> None:
    scene = line_scene(exit_z_mm=exit_z_mm)
    found = ThinLens(scene).forward(beam(scene.object_grid)).values
    assert relative_error(found, carried(scene.exit_grid)) < 1e-2


@pytest.mark.parametrize("shape", [(60,), (20, 24)])
def test_adjoint(shape: tuple[int, ...]) -> None:
    end = tuple(n + 10 for n in shape)
    pose = Pose(decenter_y_mm=0.01, tilt_x_deg=1.0)
    scene = Scene(weak_lens(), Grid(shape, 2e-3, -1.5), Grid(end, 2e-3, 1.0), WAVELENGTH_UM, pose=pose)
    assert dot_product_mismatch(ThinLens(scene)) <= 1e-10


def test_plane_is_the_product_of_lines_for_small_angles() -> None:
    scene = line_scene()
    line = ThinLens(scene).forward(beam(scene.object_grid)).values
    grids = Grid((100, 100), 1.5e-3, -DISTANCE_MM), Grid((64, 64), 3e-3, 2.0)
    plane_scene = Scene(weak_lens(), *grids, WAVELENGTH_UM)
    plane = ThinLens(plane_scene).forward(beam(grids[0])).values
    profile = np.interp(grids[1].y_mm, scene.exit_grid.y_mm, np.abs(line))
    assert correlation(np.abs(plane), np.outer(profile, profile)) > 0.999


def test_decentered_lens_is_a_shifted_scene() -> None:
    shift = 0.03
    moved, still = line_scene(Pose(decenter_y_mm=shift)), line_scene(y_mm=-shift)
    a = ThinLens(moved).forward(beam(moved.object_grid)).values
    b = ThinLens(still).forward(beam(still.object_grid)).values
    assert relative_error(a, b) < 1e-9


def test_despaced_lens_is_a_shifted_scene() -> None:
    moved = line_scene(Pose(despace_mm=0.2))
    still = replace(
        moved, pose=Pose(), object_grid=moved.object_grid.at(-1.7), exit_grid=moved.exit_grid.at(1.8)
    )
    a = ThinLens(moved).forward(beam(moved.object_grid)).values
    b = ThinLens(still).forward(beam(still.object_grid)).values
    # The stop's cone is that of the displaced object; the beam keeps clear of it.
    assert relative_error(a, b) < 1e-3


def test_bare_glass_passes_what_it_does_not_reflect() -> None:
    ideal = line_scene()
    field = beam(ideal.object_grid)
    kept, passed = (ThinLens(s).forward(field).energy for s in (ideal, replace(ideal, coating="bare")))
    assert passed / kept == pytest.approx((1.0 - ((INDEX - 1.0) / (INDEX + 1.0)) ** 2) ** 2, rel=1e-9)


def test_perturbed_radius_changes_the_focus() -> None:
    scene = line_scene()
    bent = replace(scene, surface_perturbations={0: SurfacePerturbation(radius_mm=0.5)})
    assert ThinLens(bent).thin.power_per_mm == pytest.approx(
        0.5 / 2.5 + 0.5 / 3.0 - THICKNESS_MM / INDEX * 0.25 / 7.5
    )


def test_stop_takes_in_the_real_cone(paper_lens: Lens) -> None:
    scene = Scene(paper_lens, Grid((50,), 1e-3, -13.5), Grid((50,), 1e-3, 12.7), 0.532)
    thin = ThinLens(scene).thin
    sag = float(paper_lens.surfaces[0].sag_mm(8.26))
    assert thin.semi_diameter_mm / (thin.front_mm[2] + 13.5) == pytest.approx(8.26 / (13.5 + sag))


def test_neglected_grows_with_aberrations(paper_lens: Lens) -> None:
    (little,) = ThinLens(line_scene()).error_terms()
    scene = Scene(paper_lens, Grid((50,), 1e-3, -13.5), Grid((50,), 1e-3, 12.7), 0.532)
    (much,) = ThinLens(scene).error_terms()
    assert little.relative_error < 0.5 < 1.0 < much.relative_error


def test_refuses_what_it_cannot_hold() -> None:
    with pytest.raises(SamplingError, match="pitch_mm"):
        ThinLens(line_scene(), pitch_mm=0.01).forward(beam(line_scene().object_grid))
    with pytest.raises(InputError, match="pitch_mm"):
        ThinLens(line_scene(), pitch_mm=-1.0)


def test_refuses_an_afocal_lens() -> None:
    grids = Grid((50,), 1e-3, -1.5), Grid((50,), 1e-3, 2.0)
    scene = Scene(weak_lens(None, None), *grids, WAVELENGTH_UM)
    with pytest.raises(InputError, match="afocal"):
        ThinLens(scene).forward(beam(scene.object_grid))


def plane_scene() -> Scene:
    grids = Grid((100, 100), 1.5e-3, -DISTANCE_MM), Grid((128, 128), 3e-3, 2.0)
    return Scene(weak_lens(), *grids, WAVELENGTH_UM)


@pytest.mark.parametrize("make", [line_scene, plane_scene])
def test_predicts_its_memory_and_time(make: Callable[[], Scene]) -> None:
    engine = ThinLens(make())
    cost, field = engine.cost(), beam(engine.scene.object_grid)
    peak = engine_peak_bytes(engine, field)
    assert cost.peak_bytes == pytest.approx(peak, rel=0.3)
    assert cost.seconds > 0.0  # held against the time that is taken by benchmarks.chooser


def test_full_plane_of_a_full_lens_is_refused(paper_lens: Lens) -> None:
    grids = Grid((200, 200), 2.5e-4, -13.5), Grid((400, 400), 4e-3, 12.7)
    engine = ThinLens(Scene(paper_lens, *grids, 0.532))
    with pytest.raises(SamplingError, match=r"samples .*bytes.*force = True"):
        engine.forward(Field(grids[0], np.ones(grids[0].shape), 0.532))
