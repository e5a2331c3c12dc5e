"""Figures of surfaces in waves: heights, path differences along rays, and engines against each other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from small_twins import small_spot, stopped_down

from lensdesign import Pose, SurfacePerturbation, load_design
from lensdesign.errors import InputError
from lensdesign.lens import surface_figure_from_zernike
from lensdesign.raytrace.bundles import launch
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.rays import trace
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.slices.engine import AnnularSlices
from wavesim.engines.surfaces.samples import surface_slopes
from wavesim.engines.thin_lens import ThinLens
from wavesim.engines.wpm.engine import WavePropagation
from wavesim.fields.field import Field, Grid, correlation, relative_error
from wavesim.pupil.characteristic import PupilSampler
from wavesim.rays.interfaces import surface_map
from wavesim.scene.scene import Scene
from wavesim.scene.system_state import SystemState

PAPER = load_design("designs/paper_singlet.toml")
WAVELENGTH_UM = 0.532
SEMI_MM = (8.26, 10.0)

pytestmark = pytest.mark.filterwarnings("ignore::wavesim.fields.sampling_checks.SamplingWarning")


def figured(surface: int, um: dict[int, float]) -> dict[int, SurfacePerturbation]:
    """Zernike figure of one surface of the paper's lens."""
    return {surface: SurfacePerturbation(figure=surface_figure_from_zernike(um, SEMI_MM[surface]))}


# Where the surface lies.


def test_rays_end_on_the_map_of_a_tilted_figured_surface() -> None:
    changes = figured(1, {3: 2.0, 7: -1.0, 12: 3.0})
    pose = Pose(tilt_x_deg=2.0, tilt_y_deg=-1.0, decenter_x_mm=0.2)
    origins, directions = launch(
        PAPER, [(0.3, -0.5)], np.random.default_rng(2).uniform(-0.6, 0.6, (99, 2)), 0.532
    )
    rays = trace(PAPER, origins, directions, 0.532, pose, surface_perturbations=changes)
    assert rays.ok.all()
    system = compile_system(PAPER, 0.532, pose, changes)
    x, y, z = rays.position.T
    found = surface_map(system, 1, x, y)
    assert found.z_mm == pytest.approx(z, abs=1e-11)
    assert np.max(np.abs(surface_map(compile_system(PAPER, 0.532, pose), 1, x, y).z_mm - z)) > 1e-3
    step = 1e-5
    slopes = surface_slopes(system, 1, x, y, z)
    for axis, slope in zip(((0.0, step), (step, 0.0)), slopes, strict=True):
        high, low = (surface_map(system, 1, x + s * axis[0], y + s * axis[1]).z_mm for s in (1.0, -1.0))
        assert slope == pytest.approx((high - low) / (2.0 * step), abs=1e-6)


def test_height_of_an_upright_surface_is_sag_plus_figure() -> None:
    um = {5: 0.3, 8: -0.2}
    system = compile_system(PAPER, 0.532, surface_perturbations=figured(0, um))
    x, y = np.array([1.0, -3.0]), np.array([2.0, 4.0])
    right = PAPER.surfaces[0].sag_mm(np.hypot(x, y)) + surface_figure_from_zernike(um, SEMI_MM[0]).sag(x, y)
    assert surface_map(system, 0, x, y).z_mm == pytest.approx(right, abs=1e-15)


# Path differences.


@pytest.mark.parametrize("surface", [0, 1])
def test_path_difference_follows_from_the_nominal_rays(surface: int) -> None:
    """By Fermat's principle dV = (n1 cos i - n2 cos r) x the sag error along the normal, to first order."""
    sampler = PupilSampler(PAPER, (0.4, 0.8), samples=24)
    grid, left = sampler.grid, []
    heading = np.column_stack([grid.cosines, grid.axial_cosine])
    origins = np.tile(sampler.nominal.object_point_mm, (len(heading), 1))
    rays = trace(PAPER, origins, heading, WAVELENGTH_UM, record_hits=True)
    assert rays.hits is not None
    inside = np.diff(rays.hits, axis=1)[:, 0]
    inside /= np.linalg.norm(inside, axis=1, keepdims=True)
    before, behind = (heading, inside) if surface == 0 else (inside, rays.direction)
    n1, n2 = compile_system(PAPER, WAVELENGTH_UM).index[0, surface : surface + 2]
    # The normal is along n2 q - n1 p, and n2 cos r - n1 cos i is its length; its z part is what dz meets.
    change = n2 * behind[:, 2] - n1 * before[:, 2]
    x, y = rays.hits[:, surface, :2].T
    for scale in (0.02, 0.01):
        um = {3: scale, 7: 0.5 * scale, 12: -scale}
        found = sampler.pupil(SystemState(surface_perturbations=figured(surface, um))).opd_mm
        right = -change * surface_figure_from_zernike(um, SEMI_MM[surface]).sag(x, y)
        assert np.std(right) > 1e-6 * scale / 0.02
        left.append(float(np.max(np.abs(found - right))))
        assert left[-1] < 2e-2 * np.max(np.abs(right))
    # What is left is of second order.
    assert left[1] == pytest.approx(0.25 * left[0], rel=0.1)


# Engines.


def small_scene(figure_um: dict[int, float]) -> Scene:
    """A stopped-down lens with a measured figure on its front."""
    figure = {"semi_diameter_mm": 0.1, "zernike_um": figure_um} if figure_um else None
    return stopped_down(front={"figure": figure})


def test_engines_agree_on_an_astigmatic_and_comatic_figure() -> None:
    """Exit fields change by more than half with the figure, and in the same way for all."""
    bare, made = small_scene({}), small_scene({3: 0.15, 7: 0.1})
    source = small_spot(bare.object_grid)
    fields = {
        name: [build(scene).forward(source).values for scene in (bare, made)]
        for name, build in (
            ("eikonal", lambda s: FlatTiles(s, error=0.02)),
            ("oblique slices", lambda s: AnnularSlices(s, 8, "oblique")),
            ("wave propagation", WavePropagation),
        )
    }
    for name, (nominal, other) in fields.items():
        assert relative_error(other, nominal) > 0.5, name
        assert correlation(nominal, fields["eikonal"][0]) > 0.9995, name
        assert correlation(other, fields["eikonal"][1]) > 0.9995, name
        assert correlation(other, fields["eikonal"][0]) < 0.9, name


def test_the_thin_lens_names_the_figures_that_it_leaves_out() -> None:
    scene = small_scene({3: 0.15})
    assert not any("figure" in part.description for part in ThinLens(small_scene({})).error_terms())
    (found,) = (part for part in ThinLens(scene).error_terms() if "figure" in part.description)
    waves = 0.15 * (scene.system.index[0, 1] - 1.0) / WAVELENGTH_UM
    assert found.description == f"figure of surface 1: {waves:.3g} waves rms"
    assert found.relative_error == pytest.approx(2.0 * math.pi * waves, rel=1e-5)


def test_a_figure_that_is_not_symmetric_about_the_line_is_refused_on_it() -> None:
    plane = small_scene({8: 0.1})
    line = Grid((24,), 0.0015, -13.5 / 8), Grid((150,), 0.003, 9.7 / 8 + 0.25)
    scene = replace(plane, object_grid=line[0], exit_grid=line[1])
    source = Field(line[0], np.ones(24, complex), WAVELENGTH_UM)
    for build in (FlatTiles, AnnularSlices, WavePropagation):
        with pytest.raises(InputError, match="not symmetric"):
            build(scene).forward(source)
