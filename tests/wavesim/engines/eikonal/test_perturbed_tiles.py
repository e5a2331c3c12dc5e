"""Tiles turned by a slightly different lens, against tiles that were made of that lens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_twins import bars_under_stop

from lensdesign.lens.poses import Pose, SurfacePerturbation
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.eikonal.perturbed_tiles import (
    PerturbedScene,
    PerturbedTiles,
    exit_field_changes_by_engines,
    exit_field_changes_by_rays,
    path_derivatives,
)
from wavesim.fields.field import Field
from wavesim.scene.scene import Scene, placed_scene
from wavesim.scene.system_state import SystemState

WHAT = ("decenter", "tilt", "lens", "object farther", "object aside")


def changed(scene: Scene, what: str, size: float) -> Scene:
    """The scene with a lens or an object that is not as it was; at 1, paths change by some radians."""
    state = {
        "decenter": SystemState(Pose(decenter_x_mm=5e-4 * size, decenter_y_mm=-3e-4 * size)),
        "tilt": SystemState(Pose(tilt_x_deg=0.05 * size, tilt_y_deg=-0.03 * size)),
        "lens": SystemState(
            surface_perturbations={0: SurfacePerturbation(index=3e-4 * size, thickness_mm=4e-4 * size)}
        ),
        "object farther": SystemState(object_shift_mm=(0.0, 0.0, -5e-4 * size)),
        "object aside": SystemState(object_shift_mm=(4e-4 * size, -3e-4 * size, 0.0)),
    }[what]
    return placed_scene(scene, state)


def made_of(scene: Scene, lit: Field) -> np.ndarray:
    """The field behind tiles of the scene's own."""
    there = Field(scene.object_grid, lit.values, lit.wavelength_um, lit.index)
    return FlatTiles(scene, error=0.1, tile_width_mm=0.03).forward(there).values


@pytest.fixture(scope="module")
def reference() -> tuple[FlatTiles, Field]:
    """Four tiles and more, so that each is narrow beside the object."""
    scene, light, bars, _ = bars_under_stop()
    engine = FlatTiles(scene, error=0.1, tile_width_mm=0.03)
    return engine, light.with_values(light.values * bars)


@pytest.mark.parametrize("what", WHAT)
def test_turned_tiles_are_those_of_the_changed_lens(reference: tuple[FlatTiles, Field], what: str) -> None:
    engine, lit = reference
    scene = changed(engine.scene, what, 1.0)
    made = made_of(scene, lit)
    there = Field(scene.object_grid, lit.values, lit.wavelength_um, lit.index)
    turned = PerturbedTiles(engine, scene).forward(there).values
    change = np.linalg.norm(made - engine.forward(lit).values)
    assert change > 0.05 * np.linalg.norm(made)
    assert np.linalg.norm(turned - made) < 0.1 * change


@pytest.mark.parametrize("relative_change", [5e-3, -5e-3])
def test_tiles_of_a_similar_wavelength_are_those_made_for_it(
    reference: tuple[FlatTiles, Field], relative_change: float
) -> None:
    """Also where the index of the glass changes with the wavelength; a phase of all light does not count."""
    engine, lit = reference
    wavelength_um = engine.scene.wavelength_um * (1.0 + relative_change)
    scene = replace(engine.scene, wavelength_um=wavelength_um)
    there = Field(scene.object_grid, lit.values, wavelength_um, lit.index)
    made = made_of(scene, there)
    turned = PerturbedTiles(engine, scene).forward(there).values
    before = engine.forward(lit).values
    turned, before = (one * np.exp(-1j * np.angle(np.vdot(made, one))) for one in (turned, before))
    change = np.linalg.norm(made - before)
    assert change > 0.05 * np.linalg.norm(made)
    assert np.linalg.norm(turned - made) < 0.05 * change


@pytest.mark.parametrize("what", WHAT)
def test_changes_of_the_field_are_those_of_the_engine(reference: tuple[FlatTiles, Field], what: str) -> None:
    engine, lit = reference
    step = 0.02
    scene = changed(engine.scene, what, step)
    there, dtype = [PerturbedScene(scene, step)], lit.values.dtype
    (by_path,) = exit_field_changes_by_rays(engine, lit, path_derivatives(engine, dtype, there))
    (by_tiles,) = exit_field_changes_by_engines(
        engine, lit, there, lambda one: FlatTiles(one, error=0.1, tile_width_mm=0.03)
    )
    change = (made_of(scene, lit) - engine.forward(lit).values) / step
    assert np.linalg.norm(by_tiles - by_path) < 0.02 * np.linalg.norm(by_path)
    assert np.linalg.norm(by_path - change) < 0.1 * np.linalg.norm(change)


@pytest.mark.parametrize("what", ["lens", "object farther"])
def test_a_phase_of_the_whole_field_does_not_spoil_differences_of_engines(
    reference: tuple[FlatTiles, Field], what: str
) -> None:
    """A thicker lens or a farther object delays all light alike, by some radians here."""
    engine, lit = reference
    there = [PerturbedScene(changed(engine.scene, what, 0.5), 0.5)]
    by_rays, by_engines = (
        exit_field_changes_by_rays(engine, lit, path_derivatives(engine, lit.values.dtype, there)),
        exit_field_changes_by_engines(
            engine, lit, there, lambda one: FlatTiles(one, error=0.1, tile_width_mm=0.03)
        ),
    )
    assert np.linalg.norm(by_engines[0] - by_rays[0]) < 0.01 * np.linalg.norm(by_rays[0])


@pytest.mark.parametrize("what", WHAT)
def test_slopes_of_rays_hold_where_tiles_are_turned(reference: tuple[FlatTiles, Field], what: str) -> None:
    """A lens that has changed by some radians changes on as it did."""
    engine, lit = reference
    turned = PerturbedTiles(engine, changed(engine.scene, what, 1.0))
    dtype, step = lit.values.dtype, 0.02
    slopes = [
        path_derivatives(one, dtype, [PerturbedScene(changed(engine.scene, what, size + step), step)])
        for one, size in ((engine, 0.0), (turned, 1.0))
    ]
    before, now = (exit_field_changes_by_rays(turned, lit, own)[0] for own in slopes)
    assert np.linalg.norm(before - now) < 0.1 * np.linalg.norm(now)


def test_turned_tiles_and_their_adjoint_agree(reference: tuple[FlatTiles, Field]) -> None:
    engine, lit = reference
    turned = PerturbedTiles(engine, changed(engine.scene, "decenter", 1.0))
    field = turned.forward(lit)
    there = turned.adjoint(field)
    cells = engine.scene.object_grid.cell, engine.scene.exit_grid.cell
    forth = np.vdot(field.values, field.values).real * cells[1]
    assert forth == pytest.approx(np.vdot(there.values, lit.values).real * cells[0], rel=1e-4)
