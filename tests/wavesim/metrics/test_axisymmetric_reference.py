"""Light about the axis, summed over all plane waves: against exact fields, and beside other engines."""

from dataclasses import replace

import numpy as np
import pytest

from lensdesign import Pose, load_design, scaled
from lensdesign.errors import InputError
from wavesim.analytic.registry import analytic_case
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Grid, relative_error
from wavesim.metrics.axisymmetric_reference import axial_case, rings, summed_plane_waves
from wavesim.scene.patches import patch_scene

DESIGN = load_design("designs/paper_singlet.toml")


@pytest.mark.parametrize("solution", ["slit", "hole"])
def test_a_point_behind_a_stop_in_free_space(solution: str) -> None:
    case = analytic_case(solution, semi_diameter_mm=0.025)
    exact, axis = case.exact.values, case.scene.exit_grid.y_mm
    rows = slice(len(axis) // 2, None)
    middle = exact[rows] if exact.ndim == 1 else exact[rows, len(axis) // 2]
    radii = np.hypot(axis[rows], 0.0 if exact.ndim == 1 else axis[len(axis) // 2])
    found = summed_plane_waves(case.scene, case.object_field.values, radii)
    assert relative_error(found, middle) < 1e-5


def test_on_a_line_wave_propagation_comes_to_the_same() -> None:
    scene = patch_scene(scaled(DESIGN, 1 / 64), 0.01, plane_distance_mm=2 / 64, meridional=True)
    start = rings(scene.object_grid, scene.wavelength_um, 0.5)
    found = engine_for(scene, "wpm", zones=120.0).forward(start).values
    exact = summed_plane_waves(scene, start.values, np.abs(scene.exit_grid.y_mm))
    assert relative_error(found, exact) < 6e-3


def test_on_a_plane_wave_propagation_differs_by_its_band() -> None:
    case = axial_case(scaled(DESIGN, 1 / 200), 0.006, plane_distance_mm=0.01)
    few, more = (
        relative_error(
            engine_for(case.scene, "wpm", zones=zones).forward(case.object_field).values, case.exact.values
        )
        for zones in (2.0, 8.0)
    )
    assert more < 0.7 * few
    assert more < 0.04
    assert case.uncertainty < 0.02


def test_rings_fill_the_aperture_and_end_within_the_grid() -> None:
    grid = Grid((96, 96), 4e-4, -1.0)
    values = rings(grid, 0.5, 0.4).values
    assert np.mean(np.abs(values) ** 2) == pytest.approx(1.0)
    assert np.max(np.abs(values[0])) < 1e-2 * np.max(np.abs(values))
    spectrum = np.abs(np.fft.fft2(values)) ** 2
    sine = np.hypot(*np.meshgrid(*[np.fft.fftfreq(96, 4e-4)] * 2)) * 0.5e-3
    inner, outer = (spectrum[(sine > low) & (sine < high)].mean() for low, high in ((0.05, 0.2), (0.2, 0.4)))
    assert inner == pytest.approx(outer, rel=0.6)
    assert spectrum[sine > 0.52].max() < 1e-3 * spectrum[sine < 0.4].mean()


def test_surfaces_that_are_not_of_revolution_are_refused() -> None:
    scene = patch_scene(scaled(DESIGN, 1 / 64), 0.01, plane_distance_mm=2 / 64, meridional=True)
    tilted = replace(scene, pose=Pose(tilt_x_deg=0.1))
    with pytest.raises(InputError, match=r"surface 0 .*revolution"):
        summed_plane_waves(tilted, np.ones(scene.object_grid.shape), np.zeros(1))
