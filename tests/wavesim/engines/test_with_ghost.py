"""The ghost's field against Fresnel's integral through ray-transfer matrices with two mirrors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.with_ghost import WithGhost
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 16)
PLANE_MM = 0.125
SCENE = Scene(
    LENS, Grid((33,), 4e-4, LENS.object_z_mm), Grid((641,), 1.6e-3, LENS.exit_vertex_z_mm + PLANE_MM), 0.532
)
ENGINE = WithGhost(FlatTiles(SCENE), 0.0018)


def way(length):
    return np.array([[1.0, length], [0.0, 1.0]])


def matrices():
    """From the object to the plane: straight, and by way of both mirrors, which are concave to the light."""
    n, r1, r2, t = float(LENS.indices(0.532)[1]), 42.3 / 16, 12.0 / 16, 9.7 / 16
    into = way(t) @ [[1.0, 0.0], [(1.0 - n) / (n * r1), 1.0 / n]] @ way(13.5 / 16)
    out = way(PLANE_MM) @ [[1.0, 0.0], [(1.0 - n) / r2, n]]
    back, front = (np.array([[1.0, 0.0], [-2.0 / r, 1.0]]) for r in (r2, r1))
    return out @ into, out @ way(t) @ front @ way(t) @ back @ into, 2.0 * n * t


def test_light_of_a_point() -> None:
    values = np.zeros(33, complex)
    values[16] = 1.0
    point = Field(SCENE.object_grid, values, 0.532)
    straight, ghost = (e.forward(point).values for e in (ENGINE.straight, *ENGINE.ghosts))
    whole = ENGINE.forward(point).values
    assert whole == pytest.approx(straight + np.sqrt(0.0018) * ghost, abs=1e-12)
    direct, twice, detour_mm = matrices()
    near = slice(320 - 12, 320 + 13)
    y, k = SCENE.exit_grid.y_mm[near], SCENE.wavenumber_per_mm
    bend = twice[1, 1] / twice[0, 1] - direct[1, 1] / direct[0, 1]
    # Past its focus the light of a line is a quarter wave behind.
    phase = k * (detour_mm + 0.5 * bend * y**2) - 0.5 * np.pi
    expected = np.sqrt(abs(direct[0, 1] / twice[0, 1])) * np.exp(1j * phase)
    found = (ghost / straight)[near]
    assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)


def test_steep_light_is_left_out() -> None:
    """Only where its angle keeps to half the grid's band: there the matrices say where that ends."""
    values = np.zeros(33, complex)
    values[16] = 1.0
    ghost = np.abs(ENGINE.ghosts[0].forward(Field(SCENE.object_grid, values, 0.532)).values)
    lit = SCENE.exit_grid.y_mm[ghost > 0.5 * ghost[320]]
    _, twice, _ = matrices()
    ends = 0.532 / (4.0 * 1.6) * abs(twice[0, 1] / twice[1, 1])
    assert np.abs([lit[0], lit[-1]]) == pytest.approx([ends, ends], abs=3e-3)


def test_back_is_the_conjugate_transpose() -> None:
    random = np.random.default_rng(1)
    a, b = (random.normal(size=(n, 2)) @ [1.0, 1j] for n in (33, 641))
    there = np.vdot(b, ENGINE.forward(Field(SCENE.object_grid, a, 0.532)).values) * SCENE.exit_grid.cell
    back = np.vdot(ENGINE.adjoint(Field(SCENE.exit_grid, b, 0.532)).values, a) * SCENE.object_grid.cell
    assert there == pytest.approx(back, rel=1e-10)
    assert ENGINE.key() != WithGhost(ENGINE.straight, 0.001).key()
    assert ENGINE.cost().peak_bytes > ENGINE.straight.cost().peak_bytes


@pytest.mark.parametrize("coating", ["bare", "mgf2"])
def test_coatings_give_the_amplitude_of_every_ghost(coating: str) -> None:
    """On the axis both surfaces reflect and transmit as at normal incidence."""
    scene = replace(SCENE, coating=coating)
    point = np.zeros(33, complex)
    point[16] = 1.0
    whole = WithGhost(FlatTiles(scene))
    (ghost,) = whole.ghosts
    light = Field(scene.object_grid, point, 0.532)
    found, full = (engine.forward(light).values[320] for engine in (ghost, ENGINE.ghosts[0]))
    direct, ideal = (FlatTiles(s).forward(light).values[320] for s in (scene, SCENE))
    n = float(LENS.indices(0.532)[1])
    first, second = scene.system.coatings
    into, out = first.coefficients(1.0, n, 1.0), second.coefficients(n, 1.0, 1.0)
    inside = first.turned().coefficients(n, 1.0, 1.0)
    assert found / full == pytest.approx(complex(into.ts * out.rs * inside.rs * out.ts), rel=2e-3)
    assert direct / ideal == pytest.approx(complex(into.ts * out.ts), rel=1e-3)
    with pytest.raises(InputError, match="ideal coatings reflect no light"):
        WithGhost(FlatTiles(SCENE)).forward(light)


def test_the_adjoint_of_coated_ghosts() -> None:
    random = np.random.default_rng(2)
    engine = WithGhost(FlatTiles(replace(SCENE, coating="mgf2")))
    a, b = (random.normal(size=(n, 2)) @ [1.0, 1j] for n in (33, 641))
    left = np.vdot(b, engine.forward(Field(SCENE.object_grid, a, 0.532)).values) * SCENE.exit_grid.cell
    right = np.vdot(engine.adjoint(Field(SCENE.exit_grid, b, 0.532)).values, a) * SCENE.object_grid.cell
    assert left == pytest.approx(right, rel=1e-10)


def test_shares_that_are_none() -> None:
    with pytest.raises(InputError, match=r"ghost = .*: must be .* from 0 to 1"):
        WithGhost(ENGINE.straight, 1.5)


def test_polarized_light_has_no_ghost() -> None:
    polarized = FlatTiles(replace(SCENE, polarization="unpolarized"))
    with pytest.raises(InputError, match="polarization, ghost: coherent ghosts"):
        WithGhost(polarized, 0.001)
