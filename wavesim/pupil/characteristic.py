"""Point characteristic V(c, s) of a lens, from rays, and the reconstruction pupil of a perturbed lens.

V(c, s) is the optical path from an object point c to a sensor point s (Hamilton's point characteristic).
Its gradients are the directions of the ray at both ends: dV/dc = -p and dV/ds = n q. The field of a plane
object O near c is U(s) = (1/lambda) a(s) exp(i k V(c, s)) times the spectrum of O at p(s). The amplitude
`a = sqrt(|dp/ds| cos(t_obj) / (n cos(t_out)))` follows from the conservation of energy along rays.

References
----------
M. Born and E. Wolf, "Principles of Optics", 7th edition (1999), section 4.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.raytrace.bundles import launch
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from wavesim.pupil.pupil import PupilGrid, ReconstructionPupil
from wavesim.pupil.ray_aiming import AimingMap, reach_for, shoot
from wavesim.rays.ray_bundles import FoldError
from wavesim.scene.system_state import AS_DESIGNED, SystemState, state_of


@dataclass(frozen=True, eq=False)
class PointCharacteristic:
    """Rays from one object point to one plane behind a lens, for the n samples inside the stop.

    Attributes
    ----------
    grid : PupilGrid
        Directions at the object: ``grid.cosines`` are p = (L, M).
    status : ndarray of int8, shape (samples, samples)
        :class:`lensdesign.raytrace.status.Status` of each ray of the grid; the n samples inside are OK.
    object_point_mm : ndarray, shape (3,)
        Object point c in mm.
    plane_z_mm : float
        Position z of the plane in mm.
    index_behind : float
        Refractive index n between the lens and the plane.
    sensor_points_mm : ndarray, shape (n, 2)
        Intersections s of the rays with the plane, in mm.
    path_mm : ndarray, shape (n,)
        Optical path V(c, s) in mm.
    directions : ndarray, shape (n, 3)
        Direction cosines q behind the lens.
    jacobian_mm : ndarray, shape (n, 2, 2)
        Derivatives ds/dp in mm.
    direction_jacobian : ndarray, shape (n, 2, 2)
        Derivatives dq/dp of the two transverse cosines.
    """

    grid: PupilGrid
    status: NDArray[np.int8]
    object_point_mm: Array
    plane_z_mm: float
    index_behind: float
    sensor_points_mm: Array
    path_mm: Array
    directions: Array
    jacobian_mm: Array
    direction_jacobian: Array

    @cached_property
    def determinant_mm2(self) -> Array:
        """Determinant of ds/dp in mm^2, shape (n,). Its sign changes only where the map of rays folds."""
        return np.asarray(np.linalg.det(self.jacobian_mm))

    @cached_property
    def inverse_jacobian(self) -> Array:
        """dp/ds in 1/mm, shape (n, 2, 2).

        Raises
        ------
        FoldError
            If the map of rays folds inside the bundle.
        """
        sign = np.sign(self.determinant_mm2)
        if np.any(sign != sign[0]) or sign[0] == 0.0:
            raise FoldError(
                f"the rays from ({self.object_point_mm[0]:g}, {self.object_point_mm[1]:g}) mm fold on the "
                f"plane z = {self.plane_z_mm:g} mm: several rays reach one sensor point there; "
                "choose a plane before or behind the caustic"
            )
        return np.asarray(np.linalg.inv(self.jacobian_mm))

    @cached_property
    def wavefront_curvature_per_mm(self) -> float:
        """Largest second derivative of V along the plane, over the bundle, in 1/mm."""
        hessian = self.index_behind * (self.direction_jacobian @ self.inverse_jacobian)
        return float(np.max(np.linalg.norm(hessian, axis=(1, 2))))

    def aiming_map(self) -> AimingMap:
        """Return the starting values for the aiming of perturbed rays.

        Raises
        ------
        FoldError
            If the map of rays folds.
        """
        return AimingMap(
            cosines=np.ascontiguousarray(self.grid.cosines.T),
            points_mm=np.ascontiguousarray(self.sensor_points_mm.T),
            inverse_per_mm=np.ascontiguousarray(np.moveaxis(self.inverse_jacobian, 0, -1)),
            object_point_mm=self.object_point_mm,
            plane_z_mm=self.plane_z_mm,
            reach_mm=reach_for(self.grid.wavelength_um, self.wavefront_curvature_per_mm),
        )


def point_characteristic(
    lens: Lens,
    field_mm: Sequence[float] = (0.0, 0.0),
    wavelength_um: float | None = None,
    plane_distance_mm: float = 3.0,
    samples: int = 128,
) -> PointCharacteristic:
    """Trace the point characteristic of a nominal lens.

    Parameters
    ----------
    lens
        The lens. Its stop and the other clear semi-diameters limit the bundle.
    field_mm
        Object point (x, y) on the object plane, in mm.
    wavelength_um
        Vacuum wavelength in um. Default: the design's first wavelength.
    plane_distance_mm
        Distance of the plane from the exit vertex in mm.
    samples
        Samples along each side of the square grid that covers the bundle's direction cosines, 8 to 4096.

    Raises
    ------
    InputError
        If a value is out of its range, no ray passes the lens, or the cover glass of the sensor does not fit
        in front of the plane.
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    field = np.asarray(field_mm, float)
    if field.shape != (2,) or not np.all(np.isfinite(field)):
        raise InputError(f"field_mm = {field_mm!r}: must be two finite numbers, x and y")
    if isinstance(samples, bool) or not isinstance(samples, int | np.integer) or not 8 <= samples <= 4096:
        raise InputError(f"samples = {samples!r}: must be a whole number from 8 to 4096")
    validate_positive("plane_distance_mm", plane_distance_mm)
    validate_positive("wavelength_um", wavelength)
    lens.sensor.cover_glass_at(plane_distance_mm)
    system = compile_system(lens, wavelength)
    point = np.array([*field, lens.object_z_mm])
    plane_z = lens.exit_vertex_z_mm + plane_distance_mm
    centre, spacing = _bounding_square(lens, field, wavelength, samples)
    whole = PupilGrid(centre, spacing, np.ones((samples, samples), bool), wavelength)
    rays, _ = shoot(system, point, whole.cosines.T, plane_z, clip=True)
    if not np.any(rays.ok):
        raise InputError(
            f"no ray from the object point ({field[0]:g}, {field[1]:g}) mm gets through the lens: "
            "choose a field point that the lens sees"
        )
    grid = PupilGrid(centre, spacing, rays.ok.reshape(samples, samples), wavelength)
    jacobian, direction_jacobian = ray_derivatives(system, point, grid.cosines.T, plane_z)
    return PointCharacteristic(
        grid=grid,
        status=rays.status.reshape(samples, samples),
        object_point_mm=point,
        plane_z_mm=plane_z,
        index_behind=float(system.index[0, -1]),
        sensor_points_mm=rays.position[rays.ok, :2],
        path_mm=rays.opl[rays.ok],
        directions=rays.direction[rays.ok],
        jacobian_mm=jacobian,
        direction_jacobian=direction_jacobian,
    )


def _bounding_square(
    lens: Lens, field: Array, wavelength_um: float, samples: int
) -> tuple[tuple[float, float], float]:
    """Return centre and spacing of the grid that covers the cosines of all rays through the stop's rim."""
    rim_points = 256
    angle = 2.0 * np.pi * np.arange(rim_points) / rim_points
    _, rim = launch(lens, field, np.column_stack([np.cos(angle), np.sin(angle)]), wavelength_um)
    low, high = rim[:, :2].min(axis=0), rim[:, :2].max(axis=0)
    centre = 0.5 * (low + high)
    return (float(centre[0]), float(centre[1])), float(np.max(high - low)) / samples


def ray_derivatives(
    system: CompiledSystem, point: Array, cosines: Array, plane_z_mm: float
) -> tuple[Array, Array]:
    """Return ds/dp and dq/dp by central differences; one-sided where a neighbour does not arrive."""
    base, _ = shoot(system, point, cosines, plane_z_mm, clip=False)
    parts: list[tuple[Array, Array]] = []
    # Step of direction cosines for central differences; their error is some 1e-8 of the derivative.
    step = 1e-4
    for axis in np.eye(2):
        ends = []
        for sign in (-1.0, 1.0):
            rays, real = shoot(system, point, cosines + sign * step * axis[:, None], plane_z_mm, clip=False)
            arrived = rays.ok & real
            values = np.hstack([rays.position[:, :2], rays.direction[:, :2]])
            fallback = np.hstack([base.position[:, :2], base.direction[:, :2]])
            ends.append((np.where(arrived[:, None], values, fallback), sign * arrived))
        width = step * (ends[1][1] - ends[0][1])
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (ends[1][0] - ends[0][0]) / width[:, None]
        parts.append((slope[:, :2], slope[:, 2:]))
    return np.stack([p[0] for p in parts], axis=-1), np.stack([p[1] for p in parts], axis=-1)


class PupilSampler:
    """Reconstruction pupils of perturbed copies of one lens.

    The nominal rays are traced once. All points of a small patch around the object point have the same pupil
    (isoplanatic approximation), and surfaces transmit all light.

    Parameters
    ----------
    lens
        The nominal lens. Its stop and the other clear semi-diameters limit the bundle.
    field_mm
        Object point (x, y) on the object plane, in mm.
    wavelength_um
        Vacuum wavelength in um. Default: the design's first wavelength.
    plane_distance_mm
        Distance of the sensor plane from the exit vertex of the nominal lens, in mm. The plane does not move
        with the lens.
    samples
        Samples along each side of the square grid of direction cosines, 8 to 4096.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    nominal : PointCharacteristic
        The nominal rays.
    grid : PupilGrid
        Direction cosines at the object, which all pupils share.

    Raises
    ------
    InputError
        If a value is out of its range, or no ray passes the lens.
    FoldError
        If the nominal rays fold on the plane.

    Examples
    --------
    Strehl ratio of a tilted lens at a field point off the axis:

    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PupilSampler, refocus, strehl
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> sampler = PupilSampler(lens, field_mm=(0.0, 1.0), samples=64)
    >>> round(strehl(refocus(sampler.pupil(Pose(tilt_x_deg=0.1))).pupil), 2)
    0.25
    """

    def __init__(
        self,
        lens: Lens,
        field_mm: Sequence[float] = (0.0, 0.0),
        wavelength_um: float | None = None,
        plane_distance_mm: float = 3.0,
        samples: int = 128,
    ) -> None:
        self.lens = lens
        self.nominal = point_characteristic(lens, field_mm, wavelength_um, plane_distance_mm, samples)
        self.grid = self.nominal.grid
        self._map = self.nominal.aiming_map()

    def pupil(
        self, state: SystemState | Pose = AS_DESIGNED, system: CompiledSystem | None = None
    ) -> ReconstructionPupil:
        """Return the reconstruction pupil dV(p) = V'(c, s(p)) - V(c, s(p)) of one perturbed lens.

        A quasi-Newton iteration with the nominal Jacobian finds the perturbed ray that ends near s(p), at s'.
        Its path is extended by V'(s) = V'(s') + n q'.(s - s').

        Parameters
        ----------
        state
            Lens, object, sensor and light; or the pose of the lens alone. At another wavelength the
            difference of the paths in waves counts, V'/wavelength' - V/wavelength. It is returned as a length
            at the nominal wavelength.
        system
            The perturbed lens, if it is already compiled at the nominal wavelength (default: compiled here).

        Returns
        -------
        ReconstructionPupil
            The pupil, which includes piston, shift and defocus.

        Raises
        ------
        InputError
            If a value is invalid, or no ray arrives through both lenses.
        RayAimError
            If aiming does not converge.
        """
        place, wavelength = state_of(state), self.grid.wavelength_um
        if system is None:
            system = compile_system(self.lens, wavelength, place.pose, place.surface_perturbations)
        if system.trials is not None:
            raise InputError(
                f"the perturbation has {system.trials} trials: a pupil needs that of a single lens"
            )
        aimed = self._map.aim(system, place)
        scale = wavelength / (place.wavelength_um or wavelength)
        return ReconstructionPupil(self.grid, scale * aimed.path_mm - self.nominal.path_mm, aimed.arrived)
