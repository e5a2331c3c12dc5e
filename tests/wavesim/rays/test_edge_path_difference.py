"""Ways round by the rim, against straight lines through a hole in free space."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Lens
from lensdesign.lens.lens import ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.fields.field import Grid
from wavesim.rays.edge_path_difference import EdgePathDifference
from wavesim.rays.ray_bundles import open_pupil
from wavesim.scene.scene import Scene

FRONT_MM, BEHIND_MM, STOP_MM, OFF_MM = 0.3, 0.2, 0.06, 0.004


def hole(dimensions: int) -> Scene:
    lens = Lens(
        wavelengths_um=(0.5,),
        object=ObjectSpace(field_diameter_mm=0.02, numerical_aperture=0.19, working_distance_mm=FRONT_MM),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(100, 100), plane_distances_mm=(BEHIND_MM,)),
        surfaces=(Surface(semi_diameter_mm=STOP_MM, stop=True),),
    )
    start = Grid((3,) * dimensions, 4e-4, -FRONT_MM, (0.0, OFF_MM))
    return Scene(lens, start, Grid((20,) * dimensions, 1e-3, BEHIND_MM), 0.5)


@pytest.mark.parametrize("dimensions", [1, 2])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_marches_along_the_shortest_way_round(dimensions: int, side: float) -> None:
    scene = hole(dimensions)
    point = (0.0, OFF_MM)
    pupil = open_pupil(scene, point, BEHIND_MM, 24)
    detours = EdgePathDifference(scene, point, pupil, BEHIND_MM)
    arms = np.arange(len(pupil.reach))
    near = [detours.trace_landings(sign * 0.1 * detours.zone_mm, arms) for sign in (1.0, -1.0)]
    per_mm = (near[0].inwards - near[1].inwards) / (0.2 * detours.zone_mm)
    depths = side * np.array([0.1, 0.2, 0.3])[:, None] * pupil.reach
    for depth, found in zip(depths, detours.march(depths, arms, per_mm, near[0].ok), strict=True):
        assert found.ok.all()
        np.testing.assert_allclose(found.inwards, depth, atol=0.05)
        through = STOP_MM * found.stop
        start = np.array([0.0, OFF_MM])
        end = start + (through - start) * (FRONT_MM + BEHIND_MM) / FRONT_MM
        direct = np.hypot(np.linalg.norm(end - start, axis=1), FRONT_MM + BEHIND_MM)
        angle = np.linspace(-np.pi, np.pi, 20001) if dimensions == 2 else np.array([-0.5, 0.5]) * np.pi
        rim = STOP_MM * np.column_stack([np.cos(angle) * (dimensions == 2), np.sin(angle)])
        for i in range(len(end)):
            before = np.hypot(np.linalg.norm(rim - start, axis=1), FRONT_MM)
            round_by = before + np.hypot(np.linalg.norm(rim - end[i], axis=1), BEHIND_MM)
            nearest = np.linalg.norm(rim - through[i], axis=1) < 0.6 * STOP_MM
            expected = scene.wavenumber_per_mm * (np.min(round_by[nearest]) - direct[i])
            assert found.detour[i] == pytest.approx(expected, rel=2e-3, abs=1e-3)


def test_what_is_lost_stays_lost() -> None:
    scene = hole(1)
    detours = EdgePathDifference(scene, (0.0, 0.0), open_pupil(scene, (0.0, 0.0), BEHIND_MM), BEHIND_MM)
    gone = np.array([True, False])
    found = list(detours.march(np.full((2, 2), 0.05) * [[1], [2]], np.arange(2), np.full(2, -1.0), gone))
    assert not any(one.ok[1] for one in found)
