"""Engines against each other on a lens that focuses differently along x and y."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Lens, ObjectSpace, Sensor, load_design
from lensdesign.errors import InputError
from wavesim.engines.slices.engine import AnnularSlices
from wavesim.engines.thin_lens import ThinLens
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.fields.field import Field, Grid, correlation, relative_error
from wavesim.scene.scene import Scene

PAPER = load_design("designs/paper_singlet.toml")
WAVELENGTH_UM = 0.532

pytestmark = pytest.mark.filterwarnings("ignore::wavesim.fields.sampling_checks.SamplingWarning")


def small_scene(radius_x_mm: float) -> Scene:
    """The paper's lens at an eighth of its size, stopped down, with a front of another radius along x."""
    front, back = PAPER.surfaces
    lens = Lens(
        wavelengths_um=(WAVELENGTH_UM,),
        object=ObjectSpace(field_diameter_mm=0.02, numerical_aperture=0.06, working_distance_mm=13.5 / 8),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(0.25,)),
        surfaces=(
            front.replaced(
                shape_type="biconic",
                radius_mm=42.3 / 8,
                radius_x_mm=radius_x_mm,
                thickness_mm=9.7 / 8,
                semi_diameter_mm=0.1,
            ),
            back.replaced(radius_mm=-12.0 / 8, semi_diameter_mm=10.0 / 8),
        ),
    )
    grids = Grid((24, 24), 0.0015, -13.5 / 8), Grid((150, 150), 0.003, 9.7 / 8 + 0.25)
    return Scene(lens, *grids, WAVELENGTH_UM)


def spot(scene: Scene) -> Field:
    values = np.exp(-0.5 * scene.object_grid.radius_squared_mm2() / 0.004**2)
    return Field(scene.object_grid, values.astype(complex), WAVELENGTH_UM)


def test_tiles_and_slices_agree() -> None:
    """Exit fields change by more than half with the radius along x, and in the same way for both."""
    round_, flat = small_scene(42.3 / 8), small_scene(1.2)
    source = spot(round_)
    tiles = [EikonalTiles(scene, error=0.02).forward(source).values for scene in (round_, flat)]
    slices = [AnnularSlices(scene, 8, "oblique").forward(source).values for scene in (round_, flat)]
    assert relative_error(tiles[1], tiles[0]) > 0.5
    for mine, theirs in zip(tiles, slices, strict=True):
        assert correlation(mine, theirs) > 0.9995


def test_a_thin_lens_refuses_it() -> None:
    with pytest.raises(InputError, match="not rotationally symmetric"):
        ThinLens(small_scene(1.2)).forward(spot(small_scene(1.2)))
