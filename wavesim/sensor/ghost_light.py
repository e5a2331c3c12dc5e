"""Smooth light of ghosts on the pixels of a recording plane, as rays give it."""

from __future__ import annotations

import numpy as np

from lensdesign.analysis.ghost_maps import ghost_maps, sum_on_pixels
from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, Sensor
from lensdesign.lens.poses import Pose
from wavesim.fields.field import Field
from wavesim.scene.system_state import AS_DESIGNED, SystemState


def ghost_light(
    lens: Lens,
    behind_object: Field,
    sensor: Sensor,
    plane_distance_mm: float,
    *,
    only_beyond_lens: bool = False,
    state: SystemState = AS_DESIGNED,
    index: int = 0,
) -> Array:
    """Return the light of ghosts on pixels as fractions of the direct light of the plane.

    Parameters
    ----------
    lens
        The nominal lens with its coatings.
    behind_object
        Field behind the object, whose brightness weights the object points. They radiate evenly over all
        directions.
    sensor
        Pixels.
    plane_distance_mm
        Distance of the plane from the exit vertex.
    only_beyond_lens
        Whether to omit ghosts between two surfaces of the lens.
    state, index
        Deviations of lens and sensor from the design, and the index of the plane.

    Returns
    -------
    ndarray, shape (rows, columns)

    Raises
    ------
    InputError
        If no light passes the lens.
    """
    grid, power = behind_object.grid, np.abs(behind_object.values) ** 2
    if not np.any(power > 0.0):
        raise InputError("ghosts: the object is dark")
    # Object points are means over blocks of samples.
    blocks = 12
    parts = [np.array_split(np.arange(count), min(blocks, count)) for count in power.shape]
    points, weights = [], []
    for rows in parts[0]:
        for columns in parts[1]:
            points.append((float(grid.x_mm[columns].mean()), float(grid.y_mm[rows].mean())))
            weights.append(float(power[np.ix_(rows, columns)].sum()))
    sensor_at = state.sensor_pose(index)
    tilt_x_deg, tilt_y_deg = sensor_at.tilt_deg
    sensor_pose = Pose(
        decenter_x_mm=sensor_at.shift_mm[0],
        decenter_y_mm=sensor_at.shift_mm[1],
        despace_mm=sensor_at.distance_mm,
        tilt_x_deg=tilt_x_deg,
        tilt_y_deg=tilt_y_deg,
        pivot_z_mm=lens.exit_vertex_z_mm + plane_distance_mm,
    )
    maps = ghost_maps(
        lens,
        np.array(points),
        np.array(weights),
        plane_distance_mm,
        sensor.size_mm,
        wavelength_um=behind_object.wavelength_um,
        only_beyond_lens=only_beyond_lens,
        object_z_mm=grid.z_mm,
        pose=state.pose,
        surface_perturbations=state.surface_perturbations,
        sensor_pose=sensor_pose,
    )
    return sum_on_pixels(maps, sensor.pixels[::-1])
