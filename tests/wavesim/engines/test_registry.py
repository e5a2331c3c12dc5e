"""Engines by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lensdesign import Lens, load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.surface_figure import SurfaceFigure
from wavesim.engines.choosing import engine_for
from wavesim.engines.eikonal.engine import HierarchicalTiles
from wavesim.engines.registry import ALIASES, ENGINES, engine_class, settings_of
from wavesim.fields.field import Field, Grid
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene


@pytest.fixture(scope="module")
def scene(paper_lens: Lens) -> Scene:
    return Scene(paper_lens, Grid((20,), 1e-3, -13.5), Grid((20,), 1e-3, 12.7), 0.532)


PLANES_ONLY = ("hierarchical",)


NAMES = (*ENGINES, "hierarchical")


@pytest.mark.parametrize("name", NAMES)
def test_every_engine_is_made_by_its_name(paper_lens: Lens, name: str) -> None:
    shape = (20, 20) if name in PLANES_ONLY else (20,)
    scene = Scene(paper_lens, Grid(shape, 1e-3, -13.5), Grid(shape, 1e-3, 12.7), 0.532)
    engine = engine_for(scene, name)
    assert isinstance(engine, engine_class(name))
    assert engine.name == name
    assert engine.scene is scene


def test_aliases_give_the_eikonal_engine_with_a_hierarchy() -> None:
    for alias in ALIASES:
        assert alias not in ENGINES
        assert engine_class(alias) is HierarchicalTiles
        assert settings_of(alias) == settings_of("eikonal")


def test_settings_reach_the_engine(scene: Scene) -> None:
    assert engine_for(scene, "wpm", step_um=0.25).settings()["step_um"] == 0.25


def test_an_unknown_engine_is_refused_with_a_hint(scene: Scene) -> None:
    with pytest.raises(InputError, match=r"engine = 'slice'.*allowed: .*wpm.*slices"):
        engine_for(scene, "slice")


def test_an_unknown_setting_is_refused_with_a_hint(scene: Scene) -> None:
    with pytest.raises(InputError, match=r"engine wpm: step_umm = 1.0.*allowed: .*step_um"):
        engine_for(scene, "wpm", step_umm=1.0)
    with pytest.raises(InputError, match=r"engine no-lens: pitch_mm = 1.0.*allowed: force"):
        engine_for(scene, "no-lens", pitch_mm=1.0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_no_engine_takes_or_gives_what_is_not_finite(name: str, value: float) -> None:
    twin = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    scene = patch_scene(twin, 0.01, plane_distance_mm=0.1, meridional=name not in PLANES_ONLY)
    engine = engine_for(scene, name)
    for grid, carry in ((scene.object_grid, engine.forward), (scene.exit_grid, engine.adjoint)):
        values = np.ones(grid.shape, complex)
        assert np.all(np.isfinite(carry(Field(grid, values, 0.532)).values))
        values.flat[3] = value
        with pytest.raises(InputError, match="not finite"):
            carry(Field(grid, values, 0.532))


def test_engines_have_the_same_key_only_where_they_do_the_same(paper_lens: Lens) -> None:
    ends = Grid((60, 60), 0.5e-3, -13.5), Grid((50, 50), 0.2, 12.7)
    coefficients = np.random.default_rng(1).normal(size=(40, 40)) * 1e-5
    other = coefficients.copy()
    other[20, 20] += 1e-12  # where a shortened text of the array would not show it

    def key(values: np.ndarray, **settings: Any) -> str:
        figure = SurfaceFigure(8.5, 0.45, values)
        scene = Scene(paper_lens, *ends, 0.532, surface_perturbations={0: SurfacePerturbation(figure=figure)})
        engine = engine_for(scene, "slices", **settings)
        before = engine.key()
        scene.system  # noqa: B018
        assert engine.key() == before
        return before

    assert key(coefficients, slices=20) == key(coefficients.copy(), slices=20)
    assert len({key(coefficients, slices=20), key(other, slices=20), key(coefficients, slices=21)}) == 3
