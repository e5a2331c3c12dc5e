"""Phase compensation within a slice: the phase of light between the surface and the cutting planes.

:class:`Vertical` compensation (Eqs. 4, C3, C6) assumes light parallel to the axis. :class:`Oblique`
compensation uses the direction of the rays from the object's centre at the surface.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.surfaces.samples import surface_slopes
from wavesim.engines.surfaces.waves import Medium
from wavesim.fields.field import Grid
from wavesim.rays.interfaces import Crossings, crossings, surface_map, transmission
from wavesim.rays.maps import SmoothMap, fit_map
from wavesim.scene.scene import Scene

LINE_ORDER, PLANE_ORDER = 30, 12
"""Order of the polynomials over the footprint, on a line and on a plane."""


@dataclass(frozen=True, eq=False)
class CentreRays:
    """Rays of one object point at their crossings with a surface; arrays of shape (n,).

    Attributes
    ----------
    x_mm, y_mm, z_mm : ndarray
        Crossing points.
    axial : (ndarray, ndarray)
        Index times cosine of the angle to the z axis, in front of the surface and behind it.
    lean : (ndarray, ndarray)
        1 - s tan(t) in front and behind, with the slope s of the surface along the ray's transverse
        direction: the flux through the surface over the flux through its projection along z.
    slope : ndarray
        Largest slope of the surface.
    transmission : ndarray
        Transmission of the field.
    indices : (float, float)
        Refractive indices in front of the surface and behind it.
    is_line : bool
        Whether the rays are a meridional fan.
    """

    x_mm: Array
    y_mm: Array
    z_mm: Array
    axial: tuple[Array, Array]
    lean: tuple[Array, Array]
    slope: Array
    transmission: NDArray[np.inexact]
    indices: tuple[float, float]
    is_line: bool


def centre_rays(scene: Scene, point_mm: tuple[float, float], fan: bool = False) -> tuple[CentreRays, ...]:
    """Trace rays of an object point to every surface.

    Parameters
    ----------
    scene
        Lens, grids and wavelength.
    point_mm
        Object point (x, y).
    fan
        Whether to trace a meridional fan only, also on a plane.

    Raises
    ------
    InputError
        If no ray passes the lens.
    """
    if fan and not scene.object_grid.is_line:
        line = Grid((1,), scene.object_grid.pitch_mm, scene.object_grid.z_mm)
        scene = replace(scene, object_grid=line, exit_grid=replace(line, z_mm=scene.exit_grid.z_mm))
    return tuple(_rays(scene, i, found) for i, found in enumerate(crossings(scene, point_mm)))


def _rays(scene: Scene, surface: int, found: Crossings) -> CentreRays:
    system = scene.system
    n1, n2 = (float(n) for n in system.index[0, surface : surface + 2])
    z = surface_map(system, surface, found.x_mm, found.y_mm).z_mm
    slopes = surface_slopes(system, surface, found.x_mm, found.y_mm, z)
    slope = np.hypot(slopes[0], slopes[1])
    area = np.hypot(1.0, slope)
    return CentreRays(
        found.x_mm,
        found.y_mm,
        z,
        (n1 * found.axial_before, n2 * found.axial_after),
        (found.incidence * area / found.axial_before, found.refraction * area / found.axial_after),
        slope,
        transmission(scene, surface, found.incidence, found.refraction),
        (n1, n2),
        scene.object_grid.is_line,
    )


@dataclass(frozen=True, eq=False)
class Compensation(ABC):
    """Phase that light gains in the slices of one surface, and transmission of the surface.

    Both are known along the rays of the object's centre. Between the rays they are polynomials over y and x,
    or over y only. Beyond the light of the object's centre the values are those at its rim.

    Attributes
    ----------
    ray : CentreRays
        Rays of the object's centre at the surface.
    """

    ray: CentreRays

    @property
    @abstractmethod
    def density(self) -> Array:
        """Density of planes over height, not normalized, for equal phase errors of all slices."""

    @abstractmethod
    def ends_mm(self, planes_mm: Array) -> tuple[Array, Array]:
        """Return z of the planes at which each slice receives light, and at which it emits light."""

    @abstractmethod
    def phase_error(self, planes_mm: Array, wavenumber_per_mm: float) -> Array:
        """Return the phase error for each ray of a meridional fan, in radians."""

    @abstractmethod
    def at(self, y_mm: Array, x_mm: Array, inside: NDArray[np.bool_]) -> Array:
        """Return optical path per height in front of the surface and behind it, and modulus and phase of the
        transmission, at samples of rows and columns that are inside; shape (4, n).
        """

    @property
    @abstractmethod
    def _mapped(self) -> list[Array]:
        """Quantities along the rays of which there are polynomials."""

    @cached_property
    def _maps(self) -> SmoothMap:
        ray = self.ray
        points = ray.y_mm[:, None] if ray.is_line else np.column_stack([ray.y_mm, ray.x_mm])
        count = len(points)
        order = min(LINE_ORDER, count // 2) if ray.is_line else min(PLANE_ORDER, math.isqrt(count) - 1)
        # Some rays of a fan are sufficient; a bundle needs all of them.
        most = 5 * (order + 1) if ray.is_line else count
        pick = np.unique(np.rint(np.linspace(0, count - 1, most)).astype(int))
        return fit_map(points[pick], np.stack(self._mapped)[:, pick], order)

    def _interpolated(self, y_mm: Array, x_mm: Array, inside: NDArray[np.bool_]) -> Array:
        maps = self._maps
        axes = (y_mm, x_mm)[: len(maps.middle)]
        found = np.stack([part.reshape(inside.shape)[inside] for part in maps.along(axes).each()])
        down, *across = (
            (a - middle) / half for a, middle, half in zip(axes, maps.middle, maps.half_width, strict=True)
        )
        away2 = down[:, None] ** 2 + (across[0] ** 2 if across else 0.0)
        rows, columns = np.nonzero(inside & (away2 > 1.0))
        offset = np.stack([down[rows], *(part[columns] for part in across)], axis=-1)
        offset /= np.sqrt(away2[rows, columns])[:, None]
        found[:, (away2 > 1.0)[inside]] = maps.at(maps.middle + maps.half_width * offset)
        return found


class Vertical(Compensation):
    """The paper's compensation for light parallel to the axis (Eqs. 4, C3, C6).

    Between the surface and the two planes of its slice, light gains k n h over a height h.
    """

    @property
    def density(self) -> Array:
        return np.asarray(sum(self.obliquity))

    @property
    def obliquity(self) -> tuple[Array, Array]:
        """Optical path error per height, in front and behind: n (1 - cos t)."""
        before, behind = (n - c for n, c in zip(self.ray.indices, self.ray.axial, strict=True))
        return before, behind

    def ends_mm(self, planes_mm: Array) -> tuple[Array, Array]:
        """Return the two planes of each slice, z_p and z_(p+1)."""
        return planes_mm[:-1], planes_mm[1:]

    def phase_error(self, planes_mm: Array, wavenumber_per_mm: float) -> Array:
        which = slice_of(planes_mm, self.ray.z_mm)
        low, high = planes_mm[which], planes_mm[which + 1]
        before, behind = self.obliquity
        path = before * (self.ray.z_mm - low) + behind * (high - self.ray.z_mm)
        return np.asarray(wavenumber_per_mm * path)

    def at(self, y_mm: Array, x_mm: Array, inside: NDArray[np.bool_]) -> Array:
        transmission = self._interpolated(y_mm, x_mm, inside)
        count = transmission.shape[1]
        return np.stack([*(np.full(count, n) for n in self.ray.indices), *transmission])

    @property
    def _mapped(self) -> list[Array]:
        return _modulus_and_phase(self.ray.transmission)


class Oblique(Compensation):
    """Compensation along the rays of the object's centre, which gain k n h cos(t) at an angle t to the axis.

    A slice receives and emits light at the plane in its middle, so that the error has no first order in the
    height. Within a slice the light is taken for a plane wave.
    """

    @property
    def density(self) -> Array:
        return np.asarray(np.sqrt(sum(self.drift)))

    @property
    def drift(self) -> tuple[Array, Array]:
        """Change along z of index times cosine at one transverse point; only for a meridional fan."""
        # The cosine is constant along a ray, so that it changes along z by -tan(t) times its transverse
        # change.
        ray = self.ray
        order = np.argsort(ray.y_mm)
        result = []
        for n, axial, lean in zip(ray.indices, ray.axial, ray.lean, strict=True):
            tangent = np.sqrt(np.maximum((n / axial) ** 2 - 1.0, 0.0))
            along = np.empty_like(axial)
            along[order] = np.gradient(axial[order], ray.y_mm[order])
            result.append(np.abs(tangent * along / lean))
        return result[0], result[1]

    def ends_mm(self, planes_mm: Array) -> tuple[Array, Array]:
        """Return the plane in the middle of each slice, twice."""
        middles = 0.5 * (planes_mm[:-1] + planes_mm[1:])
        return middles, middles

    def phase_error(self, planes_mm: Array, wavenumber_per_mm: float) -> Array:
        height = self._height(self.ray, planes_mm)
        before, behind = self.drift
        return np.asarray(0.5 * wavenumber_per_mm * height**2 * (before + behind))

    def other_angles(self, other: CentreRays, planes_mm: Array) -> Array:
        """Return the path error where the compensation is used for the light of another point."""
        ray = self.ray
        order = np.argsort(ray.y_mm)
        front, behind = (
            own - np.interp(other.y_mm, ray.y_mm[order], axial[order])
            for own, axial in zip(other.axial, ray.axial, strict=True)
        )
        return np.asarray(self._height(other, planes_mm) * (front - behind))

    def at(self, y_mm: Array, x_mm: Array, inside: NDArray[np.bool_]) -> Array:
        return self._interpolated(y_mm, x_mm, inside)

    @property
    def _mapped(self) -> list[Array]:
        # The transmission includes the fraction of a slice's light that leaves through its projection along
        # z, as in Kirchhoff's integral over the surface.
        return [*self.ray.axial, *_modulus_and_phase(self.ray.transmission * self.ray.lean[1])]

    def _height(self, ray: CentreRays, planes_mm: Array) -> Array:
        """Return the height of each ray's crossing above the middle of its slice."""
        return np.asarray(ray.z_mm - self.ends_mm(planes_mm)[0][slice_of(planes_mm, ray.z_mm)])


COMPENSATIONS: dict[str, type[Compensation]] = {"vertical": Vertical, "oblique": Oblique}


def _modulus_and_phase(amplitude: NDArray[np.inexact]) -> list[Array]:
    middle = np.exp(-1j * np.angle(np.mean(amplitude)))  # keeps the phase of a coating away from pi
    return [np.abs(amplitude), np.angle(amplitude * middle) - np.angle(middle)]


def border_light(ray: CentreRays, planes_mm: Array, medium: Medium) -> Array:
    """Return the fraction of the light that the borders of slices diffract, for every ray of a meridional
    fan.

    Slices adjoin at the surface, but their light is oblique: between neighbours it overlaps, or leaves a gap,
    over a fraction of the slice's width. Each such stripe diffracts light into the whole band. Slices that
    are thinner than the band resolves have no stripes.
    """
    thickness = np.diff(planes_mm)[slice_of(planes_mm, ray.z_mm)]
    fraction = np.abs(1.0 - ray.lean[1])
    orders = thickness / np.maximum(ray.slope, 1e-12) * medium.band_per_mm / np.pi
    apart = (medium.largest_kz_per_mm - medium.smallest_kz_per_mm) * thickness
    borders = 1.0 - 1.0 / (len(planes_mm) - 1)
    return np.asarray(borders * fraction * np.minimum(np.minimum(1.0, orders * fraction), 0.25 * apart**2))


def slice_of(planes_mm: Array, z_mm: Array) -> NDArray[np.intp]:
    """Return the slice of each height (Eq. C2): p where z_p <= g < z_(p+1).

    Heights beyond the outermost planes belong to the outermost slices.
    """
    return np.asarray(np.searchsorted(planes_mm[1:-1], z_mm, side="right"), np.intp)
