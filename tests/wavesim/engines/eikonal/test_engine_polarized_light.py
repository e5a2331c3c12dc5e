"""Components of the field behind a coated plate against sums over plane waves; energy and adjoint."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from coated_plate import COATED, FILMS, INDEX, WAVELENGTH_UM, beam, plane_waves, plate_scene

from lensdesign import Coating, CoatingLayer, InputError, load_design, scaled
from wavesim import Field, Grid, engine_for, patch_scene
from wavesim.engines.eikonal.engine import FlatTiles


def differences(found: tuple[Field, ...], exact: list[np.ndarray]) -> list[float]:
    """Relative differences of both components, with the measure of the sum over plane waves."""
    pairs = list(zip([field.values for field in found], exact, strict=True))
    scale = sum(np.vdot(e, f) for f, e in pairs) / sum(np.vdot(e, e) for _, e in pairs)
    total = math.sqrt(sum(float(np.sum(np.abs(f) ** 2)) for f, _ in pairs))
    return [float(np.linalg.norm(f - abs(scale) * e)) / total for f, e in pairs]


@pytest.mark.parametrize(("coating", "films"), [("bare", ()), (COATED, FILMS)])
@pytest.mark.parametrize("polarization", [0.0, 90.0])
def test_a_line_behind_a_plate_has_the_sum_over_plane_waves(
    coating: str | Coating, films: Any, polarization: float
) -> None:
    scene = plate_scene(4.0, coating, polarization, 1)
    found = FlatTiles(scene, tile_width_mm=1.0, error=1e-4).forward_components(beam(scene))
    s, p, _ = plane_waves(scene, films)
    exact = np.fft.ifft(p if polarization else s)
    apart = differences(found, [exact, 0.0 * exact])
    assert apart[0] < 1e-4
    assert apart[1] < 1e-12


def test_one_wide_tile_on_a_line_has_the_phase_of_the_coatings_at_all_its_points() -> None:
    """Light across the plane of incidence stays so, and is the light of scalar waves on a line."""
    waves = ((1.46, 1.0), (2.3, 1.0), (1.46, 1.0), (2.3, 2.0), (1.46, 1.0), (2.3, 1.0))
    layers = tuple(CoatingLayer(index=index, quarter_waves=count) for index, count in waves)
    narrow = Coating(layers=layers, design_wavelength_um=WAVELENGTH_UM)
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 16)
    scene = replace(patch_scene(lens, 0.06, 0.05, plane_distance_mm=0.125, meridional=True), coating=narrow)
    random = np.random.default_rng(5).standard_normal((2, *scene.object_grid.shape))
    light = Field(scene.object_grid, random[0] + 1j * random[1], scene.wavelength_um)
    fields = [
        FlatTiles(replace(scene, polarization=kind), tile_width_mm=1.0, error=0.2).forward_components(light)[
            0
        ]
        for kind in ("scalar", 0.0)
    ]
    scalar, along = (field.values for field in fields)
    assert np.linalg.norm(along - scalar) < 1e-3 * np.linalg.norm(scalar)


@pytest.mark.parametrize(("coating", "films", "allowed"), [("bare", (), 3e-4), (COATED, FILMS, 3e-4)])
def test_a_plane_behind_a_plate_has_the_sum_over_plane_waves(
    coating: str | Coating, films: Any, allowed: float
) -> None:
    """The error is inversely proportional to the size: 1e-4 at 0.4 mm."""
    scene = plate_scene(0.15, coating, 0.0, 2)
    found = FlatTiles(scene, tile_width_mm=1.0, error=1e-4).forward_components(beam(scene))
    s, p, turn = plane_waves(scene, films)
    mean, half = 0.5 * (p + s), 0.5 * (p - s)
    exact = [np.fft.ifft2(mean + half * turn.real), np.fft.ifft2(half * turn.imag)]
    along, crossed = differences(found, exact)
    assert along < allowed
    size = np.linalg.norm(exact[1]) / np.linalg.norm(exact[0])
    assert crossed < 0.04 * size


@pytest.mark.parametrize("polarization", ["unpolarized", "circular", 30.0])
def test_no_light_is_lost_by_ideal_coatings_and_the_reflected_part_by_bare_ones(
    polarization: str | float,
) -> None:
    energies = {}
    for coating in ("ideal", "bare"):
        scene = plate_scene(0.05, coating, polarization, 2)
        light = beam(scene)
        found = FlatTiles(scene, tile_width_mm=1.0, error=1e-3).forward_components(light)
        energies[coating] = sum(field.energy for field in found) / light.energy
    axial = (4.0 * INDEX / (1.0 + INDEX) ** 2) ** 2
    assert energies["ideal"] == pytest.approx(1.0, abs=0.05)  # |u|^2 counts without the cosine
    assert energies["bare"] / energies["ideal"] == pytest.approx(axial, abs=1e-3)


@pytest.mark.parametrize("polarization", ["unpolarized", 20.0])
@pytest.mark.parametrize("dtype", [np.complex128, np.complex64])
def test_the_adjoint_of_all_components(polarization: str | float, dtype: type) -> None:
    lens = load_design("designs/paper_singlet.toml")
    scene = replace(
        patch_scene(lens, 0.02, meridional=False, plane_distance_mm=2.0),
        polarization=polarization,
        coating="bare",
    )
    grid = scene.exit_grid
    scene = replace(scene, exit_grid=Grid((240, 240), 10.0 * grid.pitch_mm, grid.z_mm))
    random = np.random.default_rng(3)

    def noise(grid: Grid) -> Field:
        values = random.standard_normal((2, *grid.shape))
        return Field(grid, (values[0] + 1j * values[1]).astype(dtype), scene.wavelength_um)

    engine = engine_for(scene, "eikonal", tile_width_mm=0.011)
    start, ends = noise(scene.object_grid), [noise(scene.exit_grid) for _ in range(engine.components)]
    forward, adjoint = engine.forward_components(start), engine.adjoint_components(ends)
    left = sum(np.vdot(a.values, b.values) * a.grid.cell for a, b in zip(forward, ends, strict=True))
    right = np.vdot(start.values, adjoint.values) * start.grid.cell
    assert abs(left - right) < (1e-7 if dtype == np.complex128 else 1e-4) * abs(right)
    keys = {engine.key(), *(engine.component(index).key() for index in range(engine.components))}
    assert len(keys) == engine.components + 1
    for index in range(engine.components):
        one = engine.component(index)
        assert np.array_equal(one.forward(start).values, forward[index].values)
    parts = [engine.component(i).adjoint(end).values for i, end in enumerate(ends)]
    assert np.abs(sum(parts) - adjoint.values).max() < 1e-4 * np.abs(adjoint.values).max()


def test_scalar_engines_and_calls_refuse_components() -> None:
    scene = patch_scene(load_design("designs/paper_singlet.toml"), 0.02)
    polarized = replace(scene, polarization="unpolarized")
    for name in ("slices", "wpm", "thin-lens", "no-lens", "hierarchical"):
        with pytest.raises(InputError, match="propagates scalar waves"):
            engine_for(polarized, name)
    engine = engine_for(polarized, "eikonal")
    dark = Field(scene.object_grid, np.zeros(scene.object_grid.shape, complex), scene.wavelength_um)
    with pytest.raises(InputError, match="has 4 components"):
        engine.forward(dark)
    with pytest.raises(InputError, match="from 0 to 3"):
        engine.component(4)
    with pytest.raises(InputError, match="scalar waves have one component"):
        engine_for(scene, "eikonal").component(1)
    with pytest.raises(InputError, match="polarization = 'slanted'"):
        replace(scene, polarization="slanted")
