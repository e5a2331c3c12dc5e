"""Rays of perturbed systems in the coordinates of the sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, rotation_matrix
from tolerancing.perturbations.batch import PerturbationBatch

if TYPE_CHECKING:
    from lensdesign.raytrace.plane_plate import PlanePlate
    from lensdesign.raytrace.rays import RayTrace


@dataclass(frozen=True, eq=False)
class Arrival:
    """Rays on the first sensor plane, in the sensor's own frame.

    Attributes
    ----------
    position_mm : ndarray, shape (trials, rays, 2)
        Positions from the centre of the sensor.
    direction : ndarray, shape (trials, rays, 3)
        Direction cosines; the last is along the sensor's normal.
    ok : ndarray of bool, shape (trials, rays)
        True for rays that arrive.
    """

    position_mm: Array
    direction: Array
    ok: NDArray[np.bool_]


def arriving_rays(
    lens: Lens,
    batch: PerturbationBatch,
    field_points_mm: tuple[tuple[float, float], ...],
    pupil_points: Array,
    wavelength_um: float,
) -> Arrival:
    """Trace rays from field points through the stop of each trial's lens to the sensor.

    A shift of the object is treated as the opposite shift of lens and sensor, so that all trials have the
    same starting points.

    Parameters
    ----------
    lens
        The nominal lens.
    batch
        The trials.
    field_points_mm
        Object points (x, y) in mm.
    pupil_points : ndarray, shape (n, 2)
        Points on the stop in units of its semi-diameter.
    wavelength_um
        The nominal vacuum wavelength.

    Raises
    ------
    InputError
        If a trial's lens is geometrically impossible.
    """
    from lensdesign.raytrace.bundles import launch_compiled
    from lensdesign.raytrace.compiled import compile_system
    from lensdesign.raytrace.rays import trace_compiled

    object_shift = batch.object_shift_mm(lens)
    pose = shifted_pose(batch.poses(), -object_shift) if batch.moves_rays else batch.poses()
    system = compile_system(lens, wavelength_um, pose, batch.surface_perturbations(lens, wavelength_um))
    origins, directions = launch_compiled(
        system,
        field_points_mm,
        pupil_points,
        lens.object_z_mm,
        lens.stop_index,
        lens.stop_semi_diameter_mm,
    )
    # The cover glass moves and tilts with the sensor: rays pass it in the sensor's frame.
    in_air, plate = system.without_cover_glass(), system.cover_glass
    rays = trace_compiled(in_air, origins, directions, lens.sensor_z_mm[0], threads=1)
    trials = len(batch)
    if system.trials is None:
        rays = _repeated(rays, trials)
    if not batch.moves_rays:
        arrival = Arrival(rays.position[..., :2], rays.direction, rays.ok)
    else:
        shift_mm = batch.sensor_shift_mm(lens) - object_shift
        arrival = _on_sensor(rays, shift_mm, batch.sensor_tilt_deg())
    return arrival if plate is None else _behind_plate(arrival, plate)


def _behind_plate(arrival: Arrival, plate: PlanePlate) -> Arrival:
    """Return rays on the sensor behind a plate that is parallel to it."""
    cosines = np.where(arrival.ok[..., None], arrival.direction[..., :2], 0.0)
    return replace(arrival, position_mm=arrival.position_mm + plate.lateral_shift_mm(cosines))


def shifted_pose(pose: Pose, shift_mm: Array) -> Pose:
    """Return a pose with an additional shift of shape (trials, 3)."""
    x, y, z = shift_mm.T
    return replace(
        pose,
        decenter_x_mm=pose.decenter_x_mm + x,
        decenter_y_mm=pose.decenter_y_mm + y,
        despace_mm=pose.despace_mm + z,
    )


def _on_sensor(rays: RayTrace, shift_mm: Array, tilt_deg: Array) -> Arrival:
    """Transfer rays from the nominal plane to a sensor that is shifted and tilted about its centre."""
    rotation = rotation_matrix(*np.deg2rad(tilt_deg).T)
    centre = np.array([0.0, 0.0, 1.0]) * rays.position[:, :1, 2:] + shift_mm[:, None]
    position = np.einsum("tji,trj->tri", rotation, rays.position - centre)
    direction = np.einsum("tji,trj->tri", rotation, rays.direction)
    # A ray that did not arrive may have no direction along the axis.
    along = np.where(rays.ok, direction[..., 2], 1.0)
    across = position[..., :2] - direction[..., :2] * (position[..., 2] / along)[..., None]
    return Arrival(across, direction, rays.ok)


def _repeated(rays: RayTrace, trials: int) -> RayTrace:
    """Repeat the rays of one lens for all trials, for batches that do not perturb the lens."""
    arrays = {name: values for name, values in vars(rays).items() if values is not None}
    return replace(rays, **{name: np.repeat(values[None], trials, axis=0) for name, values in arrays.items()})
