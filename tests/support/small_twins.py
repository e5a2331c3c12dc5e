"""Small twins of the paper's lens: one with bars under its field stop for calibrations, one for engines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lensdesign import Lens, ObjectSpace, Sensor, load_design, scaled
from wavesim.calibration.parameters import Unknowns, parameters_by_name
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.system_state import AS_DESIGNED, SystemState

WAVELENGTH_UM = 0.532
PIXEL_MM = 3.2e-3


def twin_scene(samples: int) -> Scene:
    """So many samples a side of the object of a 1/32 twin, and 216 pixels near its lens."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    grid = Grid((samples, samples), 4.2e-4, lens.object_z_mm)
    return Scene(lens, grid, Grid((216, 216), PIXEL_MM, lens.exit_vertex_z_mm + 0.08), WAVELENGTH_UM)


def unknowns(values: Mapping[str, float], lens: Lens, fixed: SystemState = AS_DESIGNED) -> Unknowns:
    """A bench with values of parameters by their names."""
    known = parameters_by_name(lens)
    return Unknowns(fixed, {known[name]: value for name, value in values.items()})


def stopped_down(stop_mm: float = 0.1, front: dict[str, Any] | None = None, **changes: Any) -> Scene:
    """The paper's lens at an eighth of its size, stopped down, on the full plane.

    `front` holds changes of the front surface, and `changes` those of the scene.
    """
    first, last = load_design("designs/paper_singlet.toml").surfaces
    own = {"radius_mm": 42.3 / 8, "thickness_mm": 9.7 / 8, "semi_diameter_mm": stop_mm}
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.02, numerical_aperture=0.06, working_distance_mm=13.5 / 8),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(0.25,)),
        surfaces=(
            first.replaced(**own | (front or {})),
            last.replaced(radius_mm=-12.0 / 8, semi_diameter_mm=10.0 / 8),
        ),
    )
    grids = Grid((24, 24), 0.0015, -13.5 / 8), Grid((150, 150), 0.003, 9.7 / 8 + 0.25)
    return Scene(lens, *grids, WAVELENGTH_UM, **changes)


def small_spot(grid: Grid, width_mm: float = 0.004) -> Field:
    """A Gaussian amplitude whose standard deviation is a width."""
    values = np.exp(-0.5 * grid.radius_squared_mm2() / width_mm**2)
    return Field(grid, values.astype(complex), WAVELENGTH_UM)


def lit_within(scene: Scene, radius_mm: float) -> np.ndarray:
    """The field stop."""
    return np.hypot(scene.object_grid.y_mm[:, None], scene.object_grid.x_mm) < radius_mm


def small_twin() -> tuple[Engine, Field]:
    """Tiles of a small scene, and even light within its field stop, in double precision."""
    scene = twin_scene(60)
    light = Field(scene.object_grid, lit_within(scene, 0.012).astype(complex), WAVELENGTH_UM)
    return engine_for(scene, "eikonal", error=0.3), light


def bars_under_stop() -> tuple[Scene, Field, np.ndarray, np.random.Generator]:
    """The scene, even light within its field stop, sets of dark bars, and the generator that drew them."""
    scene = twin_scene(144)
    light = Field(scene.object_grid, lit_within(scene, 0.029).astype(np.complex64), WAVELENGTH_UM)
    y, x = scene.object_grid.y_mm[:, None], scene.object_grid.x_mm
    rng = np.random.default_rng(7)
    bars = np.ones(scene.object_grid.shape)
    for _ in range(12):
        width, cy, cx = rng.uniform(0.9e-3, 3e-3), *rng.uniform(-0.02, 0.02, 2)
        for bar in range(3):
            bars[(np.abs(x - cx - 2 * bar * width) < 0.5 * width) & (np.abs(y - cy) < 2.5 * width)] = 0.0
    return scene, light, bars, rng
