"""Every engine gives the field behind the cover glass of the sensor."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from engine_checks import dot_product_mismatch

from lensdesign import CoverGlass, Lens, scaled
from lensdesign.raytrace import cover_plate
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, relative_error
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene, placed_scene
from wavesim.scene.system_state import SystemState

ENGINES: list[tuple[str, dict[str, Any], float]] = [
    # The thin lens has a sharp edge, whose light leaves the window of the reference.
    ("eikonal", {}, 3e-3),
    ("eikonal", {"plane_z_mm": 1.4}, 3e-3),
    ("slices", {}, 1e-3),
    ("wpm", {"force": True}, 2e-3),
    ("thin-lens", {}, 4e-2),
]


@pytest.fixture(scope="module")
def bare(paper_lens: Lens) -> Lens:
    lens = scaled(paper_lens, 0.125)
    return lens.replaced(sensor=lens.sensor.replaced(plane_distances_mm=(1.2, 3.0)))


def covered(lens: Lens, material: str | float = "N-BK7") -> Lens:
    glass = CoverGlass(thickness_mm=0.7, material=material, distance_mm=0.3)
    return lens.replaced(sensor=lens.sensor.replaced(cover_glass=glass))


def scene_of(lens: Lens) -> Scene:
    return patch_scene(lens, 0.02, 0.1, plane_distance_mm=1.2, meridional=True)


def lines_on(scene: Scene) -> Field:
    y = scene.object_grid.y_mm - scene.object_grid.centre_mm[1]
    lines = 1.0 + 0.5 * np.cos(2.0 * np.pi * 600.0 * y)
    return Field(scene.object_grid, np.exp(-((y / 0.004) ** 2)) * lines + 0j, scene.wavelength_um)


def behind_plate(field: Field, lens: Lens) -> np.ndarray:
    """Return a field behind the plate by the factor of each plane wave, computed here on a wider window."""
    plate = cover_plate(lens, field.wavelength_um)
    assert plate is not None
    count = 4 * field.grid.shape[0]
    across = 2.0 * np.pi * np.fft.fftfreq(count, field.grid.pitch_mm)
    k = 2e3 * np.pi / field.wavelength_um
    air, glass = (np.sqrt(np.maximum((n * k) ** 2 - across**2, 0.0)) for n in (1.0, float(plate.index[0])))
    factor = np.exp(1j * plate.thickness_mm * (glass - air))
    return np.asarray(np.fft.ifft(np.fft.fft(field.values, count) * factor))[: field.grid.shape[0]]


@pytest.mark.parametrize(("name", "settings", "error"), ENGINES)
def test_field_is_that_in_air_through_the_plate(
    bare: Lens, name: str, settings: dict[str, Any], error: float
) -> None:
    lens = covered(bare)
    in_air, behind = (
        engine_for(scene_of(one), name, **settings).forward(lines_on(scene_of(one))) for one in (bare, lens)
    )
    assert relative_error(behind.values, behind_plate(in_air, lens)) < error
    assert relative_error(behind.values, in_air.values) > 0.5


@pytest.mark.parametrize(("name", "settings", "_error"), ENGINES)
def test_index_1_is_no_plate(bare: Lens, name: str, settings: dict[str, Any], _error: float) -> None:
    scenes = scene_of(bare), scene_of(covered(bare, 1.0))
    in_air, behind = (engine_for(one, name, **settings).forward(lines_on(one)).values for one in scenes)
    assert relative_error(behind, in_air) < 1e-12


@pytest.mark.parametrize(("name", "settings", "_error"), ENGINES)
def test_adjoint(bare: Lens, name: str, settings: dict[str, Any], _error: float) -> None:
    assert dot_product_mismatch(engine_for(scene_of(covered(bare)), name, **settings)) <= 1e-10


def test_without_a_lens_light_passes_the_plate(bare: Lens) -> None:
    scene = scene_of(covered(bare))
    near = replace(scene, object_grid=replace(scene.exit_grid, z_mm=-1e-3))
    assert dot_product_mismatch(engine_for(near, "no-lens", force=True)) <= 1e-10
    field = Field(near.object_grid, np.exp(-((near.object_grid.y_mm / 0.1) ** 2)) + 0j, near.wavelength_um)
    found = engine_for(near, "no-lens", force=True).forward(field)
    in_air = engine_for(replace(near, lens=bare), "no-lens", force=True).forward(field)
    assert relative_error(found.values, behind_plate(in_air, near.lens)) < 1e-5


def test_engines_with_and_without_the_plate_have_different_keys(bare: Lens) -> None:
    keys = {engine_for(scene_of(one), "slices").key() for one in (bare, covered(bare), covered(bare, 1.6))}
    assert len(keys) == 3


def test_another_wavelength_of_the_light_keeps_the_index_of_the_plate(bare: Lens) -> None:
    scene = scene_of(covered(bare))
    placed = placed_scene(scene, SystemState(wavelength_um=0.55))
    before, after = scene.system.cover_glass, placed.system.cover_glass
    assert before is not None
    assert after is not None
    assert after.index.tolist() == before.index.tolist()
