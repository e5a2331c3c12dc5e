"""Rays through a perturbed lens that end at given sensor points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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
    object_point_mm : ndarray, shape (3,) or (n, 3)
        Object point in mm, of all rays or of each.
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
        plane_z = self.plane_z_mm + state.sensor_shift_mm[2]
        point = self.object_point_mm + state.object_shift_mm
        own = tilted_points(self.points_mm, state.sensor_tilt_deg)
        targets, depth = own[:2] + shift[:2, None], own[2]
        depths = depth if np.any(depth) else None
        cosines = self._guided_cosines(system, point, plane_z, targets, depths)
        is_aimed = cosines is not None
        if cosines is None:
            cosines = self.cosines
        index = float(system.index[0, -1])
        # Most traces that aiming may take after the guides; one or two suffice for usual perturbations.
        aim_steps = 8
        for step in range(aim_steps):
            # Only aimed rays show what the perturbed stop transmits.
            is_aimed |= step > 0
            rays, arrived = shoot(system, point, cosines, plane_z, clip=is_aimed)
            arrived &= rays.ok
            miss, further = _miss(rays, arrived, targets, depths)
            if is_aimed and np.max(miss[0] ** 2 + miss[1] ** 2) <= self.reach_mm**2:
                bridge = rays.direction[:, 0] * miss[0] + rays.direction[:, 1] * miss[1] + further
                return Aimed(rays, cosines, miss, rays.opl + index * bridge, arrived)
            cosines = cosines + _times(self.inverse_per_mm, miss)
        furthest = float(np.sqrt(np.max(miss[0] ** 2 + miss[1] ** 2)))
        raise RayAimError(
            f"perturbed rays still miss their sensor points by up to {furthest:.3g} mm after {aim_steps} "
            f"steps (allowed: {self.reach_mm:.3g} mm): the perturbation is too large for the nominal ray map"
        )

    def _guided_cosines(
        self, system: CompiledSystem, point: Array, plane_z_mm: float, targets_mm: Array, depths: Array | None
    ) -> Array | None:
        """Return cosines of all rays from the corrections of a few, which vary smoothly over the bundle.

        None if the bundle has few rays, if one of the guides does not arrive, or if polynomials do not
        describe their corrections, as with a fine figure of a surface. Rays near the rim of the stop would
        then be aimed too badly to tell whether they pass it.
        """
        if self._guides is None:
            return None
        some = self._guides.rays
        nominal, inverse = self.cosines[:, some], self.inverse_per_mm[..., some]
        targets, own_depths = targets_mm[:, some], None if depths is None else depths[some]
        rays, arrived = shoot(system, point, nominal, plane_z_mm, clip=False)
        arrived &= rays.ok
        if not np.all(arrived):
            return None
        correction = _times(inverse, _miss(rays, arrived, targets, own_depths)[0])
        guided = self._guides.interpolated(correction)
        # Error of a correction over the largest one, about that of one step of aiming.
        largest_error = 0.02
        if np.max(np.abs(guided[:, some] - correction)) > largest_error * np.max(np.abs(correction)):
            return None
        return np.asarray(self.cosines + guided)

    @cached_property
    def _guides(self) -> _Guides | None:
        # Bundles with fewer rays, or with several object points, are traced at once.
        fewest_rays = 1000
        is_guided = self.cosines.shape[1] >= fewest_rays and self.object_point_mm.ndim == 1
        return _guides_of(self.cosines) if is_guided else None


DEGREE = 4
"""Degree of the polynomials that interpolate between guides."""

KEPT_RAYS = 2**16
"""Largest number of rays whose terms of the polynomials are kept, which takes 8 MB."""


@dataclass(frozen=True, eq=False)
class _Guides:
    """A few rays of a bundle, and the polynomials of the direction cosines that interpolate between them.

    Attributes
    ----------
    rays : ndarray, shape (m,)
        Indices of the guides.
    fit : ndarray, shape (m, terms)
        Values at the guides times this matrix are the coefficients of the polynomial.
    x, y : ndarray, shape (n,)
        Direction cosines of all rays about their middle, scaled to 1.
    """

    rays: NDArray[np.intp]
    fit: Array
    x: Array
    y: Array

    def interpolated(self, values: Array) -> Array:
        """Return values at the guides, shape (2, m), interpolated to all rays."""
        coefficients = values @ self.fit
        if len(self.x) <= KEPT_RAYS:
            return np.asarray(coefficients @ self._terms)
        parts = [slice(start, start + KEPT_RAYS) for start in range(0, len(self.x), KEPT_RAYS)]
        return np.concatenate([coefficients @ _terms(self.x[i], self.y[i]) for i in parts], axis=1)

    @cached_property
    def _terms(self) -> Array:
        return _terms(self.x, self.y)


def _terms(x: Array, y: Array) -> Array:
    """Return the products of powers of x and y up to `DEGREE`, shape (terms, n)."""
    return np.stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])


def _guides_of(cosines: Array) -> _Guides:
    """Return guides all over a bundle, and at its rim, where polynomials would extrapolate."""
    inside, around = 96, 24
    azimuth = 2.0 * np.pi * np.arange(around) / around
    centred = cosines - 0.5 * (cosines.min(axis=1) + cosines.max(axis=1))[:, None]
    rim = np.argmax(np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1) @ centred, axis=1)
    rays = np.unique(np.append(np.linspace(0, cosines.shape[1] - 1, inside).astype(int), rim))
    x, y = centred / np.max(np.abs(centred))
    return _Guides(rays, np.asarray(np.linalg.pinv(_terms(x[rays], y[rays]))), x, y)


def _miss(
    rays: RayTrace, arrived: NDArray[np.bool_], targets_mm: Array, depths_mm: Array | None
) -> tuple[Array, Array | float]:
    """Return the distances of rays from their sensor points, and their paths to the tilted sensor.

    Both are 0 for rays that do not arrive. `depths_mm` are None on a sensor without tilt.
    """
    miss = targets_mm - rays.position[:, :2].T
    further: Array | float = 0.0
    if depths_mm is not None:
        further = depths_mm / np.where(arrived, rays.direction[:, 2], 1.0)
        miss -= further * rays.direction[:, :2].T
    if not np.all(arrived):
        miss[:, ~arrived] = 0.0
    return miss, further


def _times(matrices: Array, vectors: Array) -> Array:
    """Return the product of matrices, shape (2, 2, n), and vectors, shape (2, n)."""
    return np.asarray(matrices[:, 0] * vectors[0] + matrices[:, 1] * vectors[1])


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
    """Trace rays from one point, or from one for each ray, along direction cosines, shape (2, n).

    Returns
    -------
    rays : RayTrace
        The rays. Those whose cosines exceed 1 are traced along the axis.
    real : ndarray of bool, shape (n,)
        True where the cosines are those of a real ray.
    """
    axial_square = 1.0 - cosines[0] ** 2 - cosines[1] ** 2
    real = axial_square > 0.0
    if not np.all(real):
        cosines, axial_square = np.where(real, cosines, 0.0), np.where(real, axial_square, 1.0)
    directions = np.empty((cosines.shape[1], 3))
    directions[:, :2] = cosines.T
    np.sqrt(axial_square, out=directions[:, 2])
    return trace_compiled(system, np.atleast_2d(point), directions, plane_z_mm, clip=clip, threads=1), real


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
