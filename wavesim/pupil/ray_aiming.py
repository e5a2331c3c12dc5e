"""Rays through a perturbed lens that end at given sensor points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.poses import rotation_matrix
from lensdesign.raytrace.compiled import CompiledSystem
from lensdesign.raytrace.rays import RayTrace, trace_compiled
from wavesim.scene.system_state import SystemState

PATH_TOLERANCE_WAVES = 1e-4
"""Largest error of an optical path difference due to aiming at a sensor point, in waves."""


class RayAimError(InputError):
    """Rays through a perturbed lens could not be aimed at their sensor points."""


@dataclass(frozen=True, eq=False)
class Aimed:
    """Rays that end at their sensor points, or close to them.

    Attributes
    ----------
    rays : RayTrace
        Traced rays, to the sensor's plane without its tilt.
    cosines : ndarray, shape (2, n)
        Direction cosines at the object.
    miss_mm : ndarray, shape (2, n)
        Remaining distance to the sensor points in mm; 0 for rays that do not arrive.
    path_mm : ndarray, shape (n,)
        Optical path to the sensor points themselves in mm: V'(s) = V'(s') + n q'.(s - s').
    arrived : ndarray of bool, shape (n,)
        Rays that arrive.
    """

    rays: RayTrace
    cosines: Array
    miss_mm: Array
    path_mm: Array
    arrived: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AimingMap:
    """The nominal rays, from which perturbed rays are aimed by a quasi-Newton iteration.

    Attributes
    ----------
    cosines : ndarray, shape (2, n)
        Direction cosines of the nominal rays at the object.
    points_mm : ndarray, shape (2, n)
        Intersections of the nominal rays with the sensor, in mm.
    inverse_per_mm : ndarray, shape (2, 2, n)
        Derivatives of the cosines with respect to the points, in 1/mm.
    object_point_mm : ndarray, shape (3,)
        Object point in mm.
    plane_z_mm : float
        Position z of the sensor's plane in mm.
    reach_mm : float
        Largest allowed distance of a ray from its sensor point in mm.
    """

    cosines: Array
    points_mm: Array
    inverse_per_mm: Array
    object_point_mm: Array
    plane_z_mm: float
    reach_mm: float

    def aim(self, system: CompiledSystem, state: SystemState) -> Aimed:
        """Aim rays through a perturbed lens.

        Parameters
        ----------
        system
            The perturbed lens.
        state
            Positions of object and sensor.

        Raises
        ------
        RayAimError
            If aiming does not converge.
        """
        shift = np.asarray(state.sensor_shift_mm)
        inverse, plane_z = self.inverse_per_mm, self.plane_z_mm + state.sensor_shift_mm[2]
        point = self.object_point_mm + state.object_shift_mm
        own = tilted_points(self.points_mm, state.sensor_tilt_deg)
        targets, depth = own[:2] + shift[:2, None], own[2]
        flat, cosines = not np.any(depth), self.cosines
        index = float(system.index[0, -1])
        # Most traces that aiming may take; two suffice for perturbations that a mount allows.
        aim_steps = 8
        for step in range(aim_steps):
            # Only aimed rays show what the perturbed stop transmits.
            rays, real = shoot(system, point, cosines, plane_z, clip=step > 0)
            arrived = rays.ok & real
            miss = targets - rays.position[:, :2].T
            if not flat:
                further = depth / np.where(arrived, rays.direction[:, 2], 1.0)
                miss -= further * rays.direction[:, :2].T
            miss[:, ~arrived] = 0.0
            if step > 0 and np.max(miss[0] ** 2 + miss[1] ** 2) <= self.reach_mm**2:
                bridge = rays.direction[:, 0] * miss[0] + rays.direction[:, 1] * miss[1]
                if not flat:
                    bridge += further
                return Aimed(rays, cosines, miss, rays.opl + index * bridge, arrived)
            cosines = cosines + (inverse[:, 0] * miss[0] + inverse[:, 1] * miss[1])
        furthest = float(np.sqrt(np.max(miss[0] ** 2 + miss[1] ** 2)))
        raise RayAimError(
            f"perturbed rays still miss their sensor points by up to {furthest:.3g} mm after {aim_steps} "
            f"steps (allowed: {self.reach_mm:.3g} mm): the perturbation is too large for the nominal ray map"
        )


def reach_for(wavelength_um: float, curvature_per_mm: float) -> float:
    """Return the ray aiming tolerance, in mm, for a path error of at most `PATH_TOLERANCE_WAVES`."""
    return float(np.sqrt(2e-3 * PATH_TOLERANCE_WAVES * wavelength_um / max(curvature_per_mm, 1e-12)))


def shoot(
    system: CompiledSystem,
    point: Array,
    cosines: Array,
    plane_z_mm: float,
    clip: bool,
) -> tuple[RayTrace, NDArray[np.bool_]]:
    """Trace rays from one point along direction cosines, shape (2, n).

    Returns
    -------
    rays : RayTrace
        The rays. Those whose cosines exceed 1 are traced along the axis.
    real : ndarray of bool, shape (n,)
        True where the cosines are those of a real ray.
    """
    axial_square = 1.0 - cosines[0] ** 2 - cosines[1] ** 2
    real = axial_square > 0.0
    directions = np.empty((cosines.shape[1], 3))
    directions[:, 0] = np.where(real, cosines[0], 0.0)
    directions[:, 1] = np.where(real, cosines[1], 0.0)
    directions[:, 2] = np.sqrt(np.where(real, axial_square, 1.0))
    return trace_compiled(system, point[None], directions, plane_z_mm, clip=clip, threads=1), real


def tilted_points(points_mm: Array, tilt_deg: Sequence[float]) -> Array:
    """Return sensor points on a sensor that is tilted about the centre of its plane.

    Parameters
    ----------
    points_mm : ndarray, shape (2, n)
        Coordinates x and y on the sensor in mm.
    tilt_deg
        Right-handed rotation about x, then about the rotated y axis, in degrees.

    Returns
    -------
    ndarray, shape (3, n)
        Positions relative to the centre of the sensor's plane, in mm.
    """
    flat = np.vstack([points_mm, np.zeros((1, points_mm.shape[1]))])
    if not any(tilt_deg):
        return flat
    (rotation,) = rotation_matrix(*np.deg2rad(np.asarray(tilt_deg, float)[:, None]))
    return np.asarray(rotation @ flat)
