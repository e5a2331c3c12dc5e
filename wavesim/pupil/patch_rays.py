"""Rays from a patch's centre through a nominal lens, and through perturbed copies to the same sensor points.

The nominal rays form a regular grid in object-side direction cosines p. Each ends at a sensor point s(p). The
rays through a perturbed lens to the same points leave the object in directions p'(s). They have the path
V'(s) and the amplitude a'(s) = sqrt(|dp'/ds| cos(t_obj) / (n cos(t_out))), with path errors below
`PATH_TOLERANCE_WAVES`. On a meridional line there is only y, and dp'/ds is the derivative along y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from wavesim.pupil.characteristic import PointCharacteristic, point_characteristic
from wavesim.pupil.ray_aiming import Aimed, AimingMap, shoot
from wavesim.rays.ray_bundles import FoldError
from wavesim.scene.system_state import SystemState


@dataclass(frozen=True, eq=False)
class AimedRays:
    """Rays through a perturbed lens to the n sensor points of the nominal rays.

    Attributes
    ----------
    path_mm : ndarray, shape (n,)
        Optical path V' to the sensor point in mm.
    cosines : ndarray, shape (2, n)
        Object-side direction cosines p' = (L, M).
    amplitude : ndarray, shape (n,)
        Amplitude a' in 1/mm, on a line in 1/sqrt(mm); 0 where not valid.
    valid : ndarray of bool, shape (n,)
        Rays that arrive; the other values of the remaining rays have no meaning.
    """

    path_mm: Array
    cosines: Array
    amplitude: Array
    valid: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class NominalRays:
    """The nominal rays, and starting values for the aiming of perturbed rays.

    Attributes
    ----------
    base : PointCharacteristic
        The rays; on a line, only those of the grid's middle column.
    line : bool
        Whether the patch is a meridional line along y.
    system : CompiledSystem
        The nominal lens.
    """

    base: PointCharacteristic
    line: bool
    system: CompiledSystem

    @cached_property
    def axes(self) -> list[int]:
        """Indices of the transverse coordinates (x, y) that exist."""
        return [1] if self.line else [0, 1]

    @cached_property
    def map(self) -> AimingMap:
        """Starting values for the aiming of perturbed rays; raises FoldError if the map of rays folds."""
        return self.base.aiming_map()

    @property
    def inverse(self) -> Array:
        """dp/ds in 1/mm, shape (2, 2, n)."""
        return self.map.inverse_per_mm

    @cached_property
    def spread(self) -> Array:
        """Derivative ds/dp in mm on a line, or its determinant in mm^2 in the plane, shape (n,)."""
        if self.line:
            return np.ascontiguousarray(self.base.jacobian_mm[:, 1, 1])
        return self.base.determinant_mm2

    @cached_property
    def amplitude(self) -> Array:
        """Amplitude a in 1/mm, on a line in 1/sqrt(mm), shape (n,)."""
        ratio = self.base.grid.axial_cosine / (self.base.index_behind * self.base.directions[:, 2])
        return np.asarray(np.sqrt(ratio / np.abs(self.spread)))

    @cached_property
    def path_hessian_per_mm(self) -> Array:
        """Second derivatives of V with respect to the object point, in 1/mm; shape (n, d, d)."""
        base, columns = self.base, []
        step_mm = 1e-3
        for axis in self.axes:
            step = step_mm * np.eye(3)[axis]
            low, high = (
                shoot(
                    self.system, base.object_point_mm + move, base.grid.cosines.T, base.plane_z_mm, clip=False
                )[0].position
                for move in (-step, step)
            )
            columns.append((high - low)[:, self.axes] / (2.0 * step_mm))
        # dp/dc at a fixed s is -(dp/ds)(ds/dc), and dV/dc is -p.
        inverse = self.base.inverse_jacobian[:, self.axes][:, :, self.axes]
        return np.asarray(inverse @ np.stack(columns, axis=-1))

    @cached_property
    def path_hessian_deviation_per_mm(self) -> Array:
        """Deviation of `path_hessian_per_mm` from its mean over the stop, shape (n, d, d)."""
        return np.asarray(self.path_hessian_per_mm - self.path_hessian_per_mm.mean(axis=0))

    def aimed(self, system: CompiledSystem, state: SystemState) -> AimedRays:
        """Aim perturbed rays at the sensor points, by a quasi-Newton iteration with the nominal Jacobian.

        The effect of a tilted sensor on the amplitude is neglected.

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
        FoldError
            If the perturbed rays fold on the plane.
        InputError
            If on a line the rays leave its plane, or none arrives.
        """
        found = self.map.aim(system, state)
        self._refuse_skew(found)
        point = self.base.object_point_mm + state.object_shift_mm
        return self._with_amplitude(system, point, self.base.plane_z_mm + state.sensor_shift_mm[2], found)

    def _with_amplitude(
        self, system: CompiledSystem, point: Array, plane_z_mm: float, found: Aimed
    ) -> AimedRays:
        """Return aimed rays with their path extended to the sensor points, and their amplitude."""
        rays, cosines, miss = found.rays, found.cosines, found.miss_mm
        index = float(system.index[0, -1])
        slopes, valid = [], found.arrived.copy()
        # Step of direction cosines for one-sided differences; their error is some 1e-5 of the derivative.
        step = 1e-5
        for axis in self.axes:
            moved = cosines + step * np.eye(2)[axis][:, None]
            ends, real = shoot(system, point, moved, plane_z_mm, clip=False)
            valid &= ends.ok & real
            slopes.append((ends.position[:, :2] - rays.position[:, :2])[:, self.axes].T / step)
        spread = slopes[0][0] if self.line else slopes[0][0] * slopes[1][1] - slopes[0][1] * slopes[1][0]
        if not np.any(valid):
            raise InputError("no ray of the patch arrives through both the nominal and the perturbed lens")
        if np.any(np.sign(spread[valid]) != np.sign(self.spread[0])):
            raise FoldError(
                f"the rays through the perturbed lens fold on the plane z = {plane_z_mm:g} mm: several rays "
                "reach one sensor point there; choose a plane before or behind the caustic"
            )
        axial = np.sqrt(1.0 - np.sum(cosines**2, axis=0), where=valid, out=np.ones(len(valid)))
        power = np.divide(
            axial,
            index * rays.direction[:, 2] * np.abs(spread),
            where=valid,
            out=np.zeros(len(valid)),
        )
        change = self.inverse[:, 0] * miss[0] + self.inverse[:, 1] * miss[1]
        return AimedRays(found.path_mm, cosines + change, np.sqrt(power), valid)

    def _refuse_skew(self, found: Aimed) -> None:
        if self.line and np.any(np.abs(found.rays.position[found.arrived, 0]) > 1e-9):
            raise InputError(
                "the rays of the meridional line leave the plane x = 0: use the plane in place of the line, "
                "or only decenter_y_mm, despace_mm and tilt_x_deg, and no shift along x"
            )


def nominal_rays(
    lens: Lens,
    field_mm: Sequence[float],
    wavelength_um: float | None,
    plane_distance_mm: float,
    samples: int,
    line: bool,
) -> NominalRays:
    """Trace the nominal rays; on a line an odd number of samples keeps one column at x = 0.

    Raises
    ------
    InputError
        As :func:`wavesim.pupil.characteristic.point_characteristic`; or, on a line, if the field point lies
        beside x = 0 or the lens is not symmetric about it.
    FoldError
        If the nominal rays fold on the plane.
    """
    base = point_characteristic(lens, field_mm, wavelength_um, plane_distance_mm, samples)
    if line:
        base = _meridian(base)
    rays = NominalRays(base, line, compile_system(lens, base.grid.wavelength_um))
    _ = rays.map
    return rays


def _meridian(base: PointCharacteristic) -> PointCharacteristic:
    """Return only the rays of the middle column."""
    if base.object_point_mm[0] != 0.0:
        raise InputError(
            f"field_mm = ({base.object_point_mm[0]:g}, {base.object_point_mm[1]:g}): the field point of a "
            "meridional line lies at x = 0"
        )
    grid = base.grid
    column = grid.index % grid.samples == grid.samples // 2
    if not np.any(column) or np.max(np.abs(base.sensor_points_mm[column, 0])) > 1e-9:
        raise InputError(
            "the lens is not symmetric about the plane x = 0: use the plane in place of the line"
        )
    inside = np.zeros_like(grid.inside)
    inside.ravel()[grid.index[column]] = True
    return replace(
        base,
        grid=replace(grid, centre=(0.0, grid.centre[1]), inside=inside),
        sensor_points_mm=base.sensor_points_mm[column],
        path_mm=base.path_mm[column],
        directions=base.directions[column],
        jacobian_mm=base.jacobian_mm[column],
        direction_jacobian=base.direction_jacobian[column],
    )
