"""Rays of perturbed systems as the sensor sees them."""

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
    from lensdesign.raytrace.rays import RayTrace


@dataclass(frozen=True, eq=False)
class Arrival:
    """Rays on the first sensor plane, in the sensor's own frame.

    Attributes
    ----------
    position_mm : ndarray, shape (trials, rays, 2)
        From the sensor's middle.
    direction : ndarray, shape (trials, rays, 3)
        Direction cosines; the last is along the sensor's normal.
    ok : ndarray of bool, shape (trials, rays)
        Which rays arrive.
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
    """Trace field points through the stop of each trial's lens to the sensor.

    To move the object is to move lens and sensor the other way, so that rays start where they always do.

    Parameters
    ----------
    lens
        The nominal lens.
    batch
        The trials.
    field_points_mm
        Object points (x, y), on the object.
    pupil_points
        Points on the stop as shares of its semi-diameter, shape (n, 2).
    wavelength_um
        The nominal wavelength.

    Raises
    ------
    InputError
        If a trial's lens cannot be.
    """
    from lensdesign.raytrace.bundles import launch_compiled
    from lensdesign.raytrace.compiled import compile_system
    from lensdesign.raytrace.rays import trace_compiled

    object_shift = batch.object_shift_mm(lens)
    pose = moved(batch.poses(), -object_shift) if batch.moves_rays else batch.poses()
    system = compile_system(lens, wavelength_um, pose, batch.surface_perturbations(lens, wavelength_um))
    origins, directions = launch_compiled(
        system,
        field_points_mm,
        pupil_points,
        lens.object_z_mm,
        lens.stop_index,
        lens.stop_semi_diameter_mm,
    )
    rays = trace_compiled(system, origins, directions, lens.sensor_z_mm[0], threads=1)
    trials = len(batch)
    if system.trials is None:
        rays = _repeated(rays, trials)
    if not batch.moves_rays:
        return Arrival(rays.position[..., :2], rays.direction, rays.ok)
    return _on_sensor(rays, batch.sensor_shift_mm(lens) - object_shift, batch.sensor_tilt_deg())


def moved(pose: Pose, shift_mm: Array) -> Pose:
    """A pose moved on, shift of shape (trials, 3)."""
    x, y, z = shift_mm.T
    return replace(
        pose,
        decenter_x_mm=pose.decenter_x_mm + x,
        decenter_y_mm=pose.decenter_y_mm + y,
        despace_mm=pose.despace_mm + z,
    )


def _on_sensor(rays: RayTrace, shift_mm: Array, tilt_deg: Array) -> Arrival:
    """Rays from the nominal plane to a sensor that is shifted and tilted about its middle."""
    rotation = rotation_matrix(*np.deg2rad(tilt_deg).T)
    middle = np.array([0.0, 0.0, 1.0]) * rays.position[:, :1, 2:] + shift_mm[:, None]
    position = np.einsum("tji,trj->tri", rotation, rays.position - middle)
    direction = np.einsum("tji,trj->tri", rotation, rays.direction)
    # A ray that did not arrive may have no direction along the axis.
    along = np.where(rays.ok, direction[..., 2], 1.0)
    across = position[..., :2] - direction[..., :2] * (position[..., 2] / along)[..., None]
    return Arrival(across, direction, rays.ok)


def _repeated(rays: RayTrace, trials: int) -> RayTrace:
    """Rays of one lens for as many trials, where no perturbation is of the lens."""
    held = {name: values for name, values in vars(rays).items() if values is not None}
    return replace(rays, **{name: np.repeat(values[None], trials, axis=0) for name, values in held.items()})
