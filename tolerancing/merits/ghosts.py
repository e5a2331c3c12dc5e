"""Merit of ghosts: light that two surfaces of lens, cover glass and sensor reflect onto the sensor."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.perturbations.batch import PerturbationBatch
from wavesim.scene.system_state import SystemState


class GhostFraction(Merit):
    """Power of all ghosts on the sensor's area relative to the direct light, on the worst recording plane.

    It is the total of :func:`lensdesign.analysis.double_reflections.ghost_paths` for the perturbed lens and
    sensor, computed with 600 directions. Surfaces count as bare if all coatings of the design are ideal.
    """

    levels: ClassVar[tuple[str, ...]] = ("ray",)

    @property
    def location(self) -> str:
        return "over the whole field"

    @property
    def details(self) -> tuple[str, ...]:
        return self.location, *super().details

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        wavelength = context.wavelength_um(self.wavelength_um)
        states = context.states(batch, wavelength)
        return np.array([_ghost_fraction(context.lens, wavelength, state) for state in states])


def _ghost_fraction(lens: Lens, wavelength_um: float, state: SystemState) -> float:
    """Return the score of one lens. A shift of the object is the opposite shift of lens and sensor."""
    from lensdesign.analysis import GhostSampling, ghost_paths

    x, y, z = state.object_shift_mm
    pose = replace(
        state.pose,
        decenter_x_mm=state.pose.decenter_x_mm - x,
        decenter_y_mm=state.pose.decenter_y_mm - y,
        despace_mm=state.pose.despace_mm - z,
    )
    sensor_x, sensor_y, _ = state.sensor_shift_mm
    sensor_poses = tuple(
        Pose(
            sensor_x - x,
            sensor_y - y,
            state.sensor_pose(plane).distance_mm - z,
            *state.sensor_tilt_deg,
            pivot_z_mm=lens.exit_vertex_z_mm + plane_mm,
        )
        for plane, plane_mm in enumerate(lens.sensor.plane_distances_mm)
    )
    found = ghost_paths(
        lens,
        wavelength_um,
        pose=pose,
        surface_perturbations=state.surface_perturbations,
        sensor_poses=sensor_poses,
        sampling=GhostSampling(directions=600),
    )
    return found.total()
