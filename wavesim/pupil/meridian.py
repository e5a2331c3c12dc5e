"""Waves on a meridian of the object and the sensor, through a nominal lens and perturbed copies of it.

The meridian is a line across the object through a field point, and the points s of the sensor that its rays
reach with direction cosines along the line. On it the lens is a matrix::

    E(s, x) = sqrt(|dp/ds| dx ds / lambda) exp(i k V(x, s))

for each recording plane, with the point characteristic V from rays. It contains no isoplanatic or paraxial
approximation. A perturbed lens multiplies the elements by exp(2 pi i w(x, s)), w = (V' - V) / lambda. Since w
is smooth in x and in the nominal cosine p(x, s), rays to a few points determine it as a polynomial.

The model neglects rays beside the line, and changes of the amplitude and of the stop's rim.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from wavesim.pupil.characteristic import ray_derivatives
from wavesim.pupil.pupil import ComplexArray
from wavesim.pupil.ray_aiming import AimingMap, reach_for, shoot
from wavesim.rays.ray_bundles import FoldError
from wavesim.scene.system_state import SystemState

PIXELS_PER_SAMPLE = 4
"""Number of pixels of each plane that are used for each sample of the object; others are omitted evenly."""

NODES, ORDERS = (5, 15), (3, 6)
"""Object points and cosines at which perturbed rays are traced, and orders of the polynomial."""


@dataclass(frozen=True, eq=False)
class MeridianPlane:
    """Model of one recording plane.

    Attributes
    ----------
    number : int
        Index of the plane, from 0.
    matrix : ndarray, shape (pixels, samples)
        E, unitary except for the stop.
    cosines : ndarray, shape (pixels, samples)
        Direction cosine p(x, s) over the numerical aperture; 0 where there is no ray.
    map : AimingMap
        Nominal rays of all object points of `NODES`.
    path_mm : ndarray, shape (rays,)
        Optical paths of these rays in mm.
    nodes : ndarray, shape (2, rays)
        x over half the line's length, and p over the numerical aperture, of these rays.
    """

    number: int
    matrix: ComplexArray
    cosines: Array
    map: AimingMap
    path_mm: Array
    nodes: Array


@dataclass(frozen=True, eq=False)
class Meridian:
    """A line of the object, and the sensor's pixels that its light reaches.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    field_mm : (x, y)
        Centre of the line on the object plane, in mm.
    length_mm : float
        Length of the line in mm.
    azimuth_deg : float
        Angle of the line from the x axis towards y, in degrees.
    planes_mm : tuple of float
        Distances of the recording planes from the exit vertex in mm; the design's planes if empty.
    wavelength_um : float, optional
        Vacuum wavelength in um. Default: the design's first wavelength.
    pixels_per_sample : float
        Number of pixels of each plane that are used for each sample of the object; others are omitted evenly.
    fans : int
        Number of object points from which nominal rays are traced. Between them, path and cosine are
        polynomials of the object point. 0 traces a fan from each sample.

    Raises
    ------
    InputError
        If a value is out of its range, or no ray passes the lens.
    FoldError
        If rays of the line fold on a plane.
    """

    lens: Lens
    field_mm: Sequence[float] = (0.0, 0.0)
    length_mm: float = 0.05
    azimuth_deg: float = 0.0
    planes_mm: tuple[float, ...] = ()
    wavelength_um: float | None = None
    pixels_per_sample: float = PIXELS_PER_SAMPLE
    fans: int = 0

    def __post_init__(self) -> None:
        validate_positive("length_mm", self.length_mm)
        validate_positive("pixels_per_sample", self.pixels_per_sample)
        # Fewest fans between which a path is a polynomial of the object point.
        fewest_fans = 4
        if self.fans and self.fans < fewest_fans:
            raise InputError(f"fans = {self.fans}: must be 0, or {fewest_fans} or more")

    @cached_property
    def wavelength(self) -> float:
        """Vacuum wavelength in um."""
        return self.wavelength_um or self.lens.wavelengths_um[0]

    @cached_property
    def direction(self) -> Array:
        """Direction of the line, shape (2,)."""
        angle = math.radians(self.azimuth_deg)
        return np.array([math.cos(angle), math.sin(angle)])

    @cached_property
    def coordinates_mm(self) -> Array:
        """Positions of the object's samples relative to the centre of the line."""
        # Pitch of the object's samples over half the period of the finest fringes that the aperture holds.
        fineness = 0.8
        pitch = fineness * 0.5e-3 * self.wavelength / self.lens.object.numerical_aperture
        count = max(math.ceil(self.length_mm / pitch), 8)
        return np.asarray((np.arange(count) - 0.5 * (count - 1)) * self.length_mm / count)

    @cached_property
    def planes(self) -> tuple[MeridianPlane, ...]:
        """Nominal model of each plane."""
        distances = self.planes_mm or self.lens.sensor.plane_distances_mm
        return tuple(self._plane(*numbered) for numbered in enumerate(distances))

    def waves(self, state: SystemState, system: CompiledSystem | None = None) -> list[Array]:
        """Return the path change through a perturbed lens in waves, up to a constant for each plane.

        Parameters
        ----------
        state
            Lens, object, sensor and light.
        system
            The perturbed lens, if it is already compiled at the wavelength (default: compiled here).

        Returns
        -------
        list of ndarray, shape (pixels, samples)
            Path change for each plane; without meaning where there is no light.

        Raises
        ------
        RayAimError
            If the perturbation is so large that rays cannot be aimed.
        InputError
            If too few rays arrive.
        """
        if system is None:
            system = compile_system(self.lens, self.wavelength, state.pose, state.surface_perturbations)
        return [self._waves(plane, system, state) for plane in self.planes]

    @cached_property
    def _system(self) -> CompiledSystem:
        return compile_system(self.lens, self.wavelength)

    @property
    def _aperture(self) -> float:
        return self.lens.object.numerical_aperture

    def _point(self, x_mm: float) -> Array:
        across = np.asarray(self.field_mm, float) + x_mm * self.direction
        return np.array([*across, self.lens.object_z_mm])

    def _plane(self, number: int, distance_mm: float) -> MeridianPlane:
        z_mm, samples = self.lens.exit_vertex_z_mm + distance_mm, self.coordinates_mm
        nodes = [math.cos(math.pi * (n + 0.5) / self.fans) for n in range(self.fans)]
        traced = [0.5 * self.length_mm * x for x in nodes] if self.fans else samples.tolist()
        fans = [self._fan(x, z_mm) for x in traced]
        pixel = 1e-3 * self.lens.sensor.pixel_pitch_um
        low, high = (pick(at(fan[0]) for fan in fans) for pick, at in ((min, np.min), (max, np.max)))
        every = max(1, int(int((high - low) / pixel) / (self.pixels_per_sample * len(samples))))
        numbers = range(math.floor(low / pixel), math.ceil(high / pixel) + 1, every)
        pixels = pixel * np.array(numbers, float)
        if self.fans:
            matrix, cosines = self._between(pixels, fans, nodes)
        else:
            matrix, cosines = np.zeros((len(pixels), len(fans)), complex), np.zeros((len(pixels), len(fans)))
            for column, fan in enumerate(fans):
                lit = (pixels > fan[0][0]) & (pixels < fan[0][-1])
                root, path, cosines[lit, column] = self._elements(pixels[lit], *fan)
                matrix[lit, column] = root * self._phasor(path)
        matrix *= math.sqrt(every * pixel * self.length_mm / len(samples) / (1e-3 * self.wavelength))
        return MeridianPlane(number, matrix, cosines / self._aperture, *self._nodes(z_mm))

    def _between(
        self, pixels: Array, fans: Sequence[tuple[Array, Array, Array, Array]], nodes: list[float]
    ) -> tuple[ComplexArray, Array]:
        """Return the elements at all samples from fans at a few object points."""
        from numpy.polynomial.chebyshev import chebvander

        order = len(nodes) - 1
        across = chebvander(self.coordinates_mm / (0.5 * self.length_mm), order)
        weights = np.linalg.solve(chebvander(nodes, order).T, across.T)
        root, path, cosines = (
            np.stack(part, axis=1) @ weights
            for part in zip(*(self._elements(pixels, *fan) for fan in fans), strict=True)
        )
        ends = np.array([(fan[0][0], fan[0][-1]) for fan in fans]).T @ weights
        lit = (pixels[:, None] > ends[0]) & (pixels[:, None] < ends[1])
        return np.where(lit, root * self._phasor(path), 0.0), np.where(lit, cosines, 0.0)

    def _phasor(self, path_mm: Array) -> ComplexArray:
        return np.asarray(np.exp(2j * np.pi * np.remainder(path_mm / (1e-3 * self.wavelength), 1.0)))

    def _fan(self, x_mm: float, z_mm: float) -> tuple[Array, Array, Array, Array]:
        """Return positions, cosines and paths on the plane for rays of a sample, and initial cosines."""
        # Rays of a nominal fan; between them path and cosine are splines.
        fan = 241
        cosines = np.linspace(-1.02, 1.02, fan) * self._aperture
        rays, _ = shoot(self._system, self._point(x_mm), np.outer(self.direction, cosines), z_mm, clip=True)
        passed = rays.ok
        if np.count_nonzero(passed) < 8:
            raise InputError(
                f"field_mm = {tuple(self.field_mm)!r}: too few rays of a line of {self.length_mm:g} mm get "
                "through the lens: choose a field point that the lens sees, or a shorter line"
            )
        places, behind = (part[passed, :2] @ self.direction for part in (rays.position, rays.direction))
        path, cosines = rays.opl[passed], cosines[passed]
        if places[-1] < places[0]:
            places, behind, path, cosines = places[::-1], behind[::-1], path[::-1], cosines[::-1]
        if np.any(np.diff(places) <= 0.0):
            raise FoldError(
                f"the rays from {x_mm:g} mm beside {tuple(self.field_mm)!r} mm fold on the plane "
                f"z = {z_mm:g} mm: choose a plane before or behind the caustic"
            )
        return places, float(self._system.index[0, -1]) * behind, path, cosines

    def _elements(
        self, pixels: Array, places: Array, behind: Array, path: Array, cosines: Array
    ) -> tuple[Array, Array, Array]:
        """Return the root of the density of rays, the path and the cosine at pixels."""
        from scipy.interpolate import CubicHermiteSpline, CubicSpline

        along = CubicHermiteSpline(places, path, behind)(pixels)
        here = CubicSpline(places, cosines)
        return np.sqrt(np.abs(here(pixels, 1))), along, here(pixels)

    def _nodes(self, z_mm: float) -> tuple[AimingMap, Array, Array]:
        """Return the nominal rays to which perturbed rays are aimed, their paths and their nodes."""
        across, along = (np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in NODES)
        x, p = np.repeat(across, len(along)), np.tile(along, len(across))
        points = np.array([self._point(0.5 * one * self.length_mm) for one in x])
        rays, _ = shoot(self._system, points, np.outer(self.direction, self._aperture * p), z_mm, clip=True)
        passed = rays.ok
        x, p, points = x[passed], p[passed], points[passed]
        cosines = np.outer(self.direction, self._aperture * p)
        jacobian, turned = ray_derivatives(self._system, points, cosines, z_mm)
        inverse = np.linalg.inv(jacobian)
        bent = float(np.max(np.linalg.norm(turned @ inverse, axis=(1, 2)), initial=0.0))
        aiming = AimingMap(
            cosines=np.ascontiguousarray(cosines),
            points_mm=np.ascontiguousarray(rays.position[passed, :2].T),
            inverse_per_mm=np.ascontiguousarray(np.moveaxis(inverse, 0, -1)),
            object_point_mm=points,
            plane_z_mm=z_mm,
            reach_mm=reach_for(self.wavelength, bent),
        )
        return aiming, rays.opl[passed], np.stack([x, p])

    def _waves(self, plane: MeridianPlane, system: CompiledSystem, state: SystemState) -> Array:
        across = state.sensor_shift_mm[:2]
        here = replace(state, sensor_shift_mm=(*across, state.sensor_pose(plane.number).distance_mm))
        ratio = self.wavelength / (state.wavelength_um or self.wavelength)
        found = plane.map.aim(system, here)
        path, (x, p) = (ratio * found.path_mm - plane.path_mm)[found.arrived], plane.nodes[:, found.arrived]
        terms = (ORDERS[0] + 1) * (ORDERS[1] + 1)
        if len(path) <= terms:
            raise InputError(f"only {len(path)} rays of a line arrive through the perturbed lens")
        powers = np.stack([x**i * p**j for j in range(ORDERS[1] + 1) for i in range(ORDERS[0] + 1)], axis=1)
        waves = (path - path.mean()) * (1e3 / self.wavelength)
        fitted = np.linalg.lstsq(powers, waves, rcond=1e-9)[0].reshape(ORDERS[1] + 1, ORDERS[0] + 1)
        along = fitted @ np.vander(self.coordinates_mm / (0.5 * self.length_mm), ORDERS[0] + 1, True).T
        result = np.zeros(plane.cosines.shape)
        for row in along[::-1]:
            result *= plane.cosines
            result += row
        return result
