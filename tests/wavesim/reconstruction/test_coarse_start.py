"""The smaller problem in which a whole field begins: what it says of the same object, and what it saves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import load_design, scaled
from wavesim import Field, Grid, Scene, engine_for, image, reconstruct_frames
from wavesim.reconstruction.coarse_start import coarse_problem, on_all_samples
from wavesim.sensor.measurement import Measurement

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 16)
WAVELENGTH_UM = 0.532
SCENE = Scene(
    LENS,
    Grid((480, 480), 0.4e-3, LENS.object_z_mm),
    Grid((440, 440), 3.2e-3, LENS.sensor_z_mm[0]),
    WAVELENGTH_UM,
)


def light() -> Field:
    radius2 = SCENE.object_grid.radius_squared_mm2()
    return Field(SCENE.object_grid, (radius2 < 0.09**2).astype(np.complex64), WAVELENGTH_UM)


def plane(scene: Scene, values: np.ndarray, shift_mm: tuple[float, float] = (0.0, 0.0)) -> Measurement:
    exit_field = engine_for(scene, "eikonal", error=0.02).forward(
        Field(scene.object_grid, values, WAVELENGTH_UM)
    )
    amplitude = np.abs(exit_field.values).astype(np.float32)
    return Measurement(0.0, amplitude, np.full_like(amplitude, 1e-3), shift_mm)


def test_known_pixels_see_what_they_see_of_the_whole_lens() -> None:
    y, x = SCENE.object_grid.y_mm[:, None], SCENE.object_grid.x_mm
    smooth = 0.6 + 0.4 * np.cos(2 * np.pi * y / 0.02) * np.sin(2 * np.pi * x / 0.03)
    values = (light().values * smooth).astype(np.complex64)
    recorded = plane(SCENE, values)
    small = coarse_problem(SCENE, light(), [recorded])
    assert small is not None
    assert small.scene.object_grid.shape == (240, 240)
    assert small.scene.exit_grid.size < 0.65 * SCENE.exit_grid.size
    half = small.light.with_values(values.reshape(240, 2, 240, 2).mean(axis=(1, 3)).astype(np.complex64))
    seen = np.abs(engine_for(small.scene, "eikonal", error=0.02).forward(half).values)
    measured, known = small.recorded[0], np.isfinite(small.recorded[0].sigma)
    assert 0.1 < known.mean() < 0.6
    off = np.linalg.norm((seen - measured.amplitude)[known]) / np.linalg.norm(measured.amplitude[known])
    assert off < 0.03
    # Beside them light of higher angles is missing.
    bright = ~known & (measured.amplitude > 0.0)
    assert np.linalg.norm((seen - measured.amplitude)[bright]) > 0.2 * np.linalg.norm(
        measured.amplitude[bright]
    )


def test_known_pixels_follow_a_displaced_sensor() -> None:
    recorded = plane(SCENE, light().values)
    places = []
    for shift in ((0.0, 0.0), (0.064, -0.032)):
        small = coarse_problem(SCENE, light(), [replace(recorded, shift_mm=shift)])
        assert small is not None
        grid, known = small.scene.exit_grid, np.isfinite(small.recorded[0].sigma)
        rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        places.append((grid.x_mm[columns].mean(), grid.y_mm[rows].mean()))
    moved = np.subtract(places[1], places[0])
    assert moved == pytest.approx((-0.064, 0.032), abs=3.3e-3)


def test_no_smaller_problem_where_it_saves_little() -> None:
    recorded = plane(SCENE, light().values)
    for pitch_um in (0.15, 1.0):
        grid = Grid((480, 480), 1e-3 * pitch_um, LENS.object_z_mm)
        scene = replace(SCENE, object_grid=grid)
        lit = Field(grid, np.ones((480, 480), np.complex64), WAVELENGTH_UM)
        assert coarse_problem(scene, lit, [recorded]) is None


@given(st.integers(2, 9), st.integers(2, 9), st.booleans(), st.booleans())
def test_linear_values_stay_on_all_samples(rows: int, columns: int, odd: bool, wide: bool) -> None:
    shape = (2 * rows + odd, 2 * columns + wide)
    fine = np.add.outer(2.0 * np.arange(shape[0]), -1.5j * np.arange(shape[1]))
    half = fine[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).mean(axis=(1, 3))
    found = on_all_samples(half, shape)
    assert found.shape == shape
    inside = np.s_[1 : 2 * rows - 1, 1 : 2 * columns - 1]
    assert found[inside] == pytest.approx(fine[inside])


@pytest.mark.usefixtures("quick_verdicts")
def test_a_whole_field_begins_on_half_of_its_samples() -> None:
    imaged = image(LENS, "usaf", patch_mm=0.12, engine="hierarchical", exposures=(1.0, 30.0), seed=1)
    said: list[str] = []
    found = reconstruct_frames(
        LENS,
        imaged.frames,
        patch_mm=0.12,
        kind="amplitude",
        engine="hierarchical",
        iterations=5,
        truth=imaged.target.transmission,
        progress=lambda what, done, count: said.append(what),
    )
    assert sum("half of the samples" in what and "super-tile" not in what for what in said) == 4
    assert found.truth["object_correlation"] is not None
    assert found.truth["object_correlation"] > 0.97
    assert len(found.curve) <= 5
