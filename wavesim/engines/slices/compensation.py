"""Phase compensation within a slice: the phase of light between the surface and the cutting planes.

Vertical compensation (Eqs. 4, C3, C6) assumes light parallel to the axis, which gains k n h over a height h.
Oblique compensation uses the direction of the rays from the object's centre at the surface, with a gain of k
n h cos(t) for the angle t to the axis in each medium.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
    """

    x_mm: Array
    y_mm: Array
    z_mm: Array
    axial: tuple[Array, Array]
    lean: tuple[Array, Array]
    slope: Array
    transmission: NDArray[np.inexact]
    indices: tuple[float, float]

    @property
    def obliquity(self) -> tuple[Array, Array]:
        """Optical path error of vertical compensation per height, in front and behind."""
        before, behind = (n - c for n, c in zip(self.indices, self.axial, strict=True))
        return before, behind

    @property
    def drift(self) -> tuple[Array, Array]:
        """Change along z of index times cosine at one transverse point; only for a meridional fan."""
        # The cosine is constant along a ray, so that it changes along z by -tan(t) times its transverse
        # change.
        order = np.argsort(self.y_mm)
        result = []
        for n, axial, lean in zip(self.indices, self.axial, self.lean, strict=True):
            tangent = np.sqrt(np.maximum((n / axial) ** 2 - 1.0, 0.0))
            along = np.empty_like(axial)
            along[order] = np.gradient(axial[order], self.y_mm[order])
            result.append(np.abs(tangent * along / lean))
        return result[0], result[1]

    def density(self, oblique: bool) -> Array:
        """Return the density of planes over height, not normalized, for equal phase errors of all slices."""
        if oblique:
            return np.asarray(np.sqrt(sum(self.drift)))
        return np.asarray(sum(self.obliquity))


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
    )


@dataclass(frozen=True, eq=False)
class Compensation:
    """Optical path per height on both sides of a surface, and transmission of the field.

    Beyond the light of the object's centre the values are those at its rim.

    Attributes
    ----------
    maps : SmoothMap
        Maps of these quantities over y and x, or over y only: optical path per height on both sides, modulus
        and phase of the transmission. For vertical compensation there are only maps of the transmission.
    indices : (float, float), optional
        Refractive indices in front of the surface and behind it, for vertical compensation.
    """

    maps: SmoothMap
    indices: tuple[float, float] | None

    def at(self, y_mm: Array, x_mm: Array, inside: NDArray[np.bool_]) -> Array:
        """Return the four quantities at samples of rows and columns that are inside, shape (4, n)."""
        maps = self.maps
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
        if self.indices is not None:
            found = np.stack([*(np.full(found.shape[1], n) for n in self.indices), *found])
        return found


def compensation(scene: Scene, ray: CentreRays, oblique: bool) -> Compensation:
    """Return the compensation over a surface.

    For oblique compensation the transmission includes the fraction of a slice's light that leaves through its
    projection along z, as in Kirchhoff's integral over the surface.
    """
    is_line = scene.object_grid.is_line
    amplitude = ray.transmission * ray.lean[1] if oblique else ray.transmission
    points = ray.y_mm[:, None] if is_line else np.column_stack([ray.y_mm, ray.x_mm])
    order = min(LINE_ORDER, len(points) // 2) if is_line else min(PLANE_ORDER, math.isqrt(len(points)) - 1)
    # Some rays of a fan are sufficient; a bundle needs all of them.
    most = 5 * (order + 1) if is_line else len(points)
    pick = np.unique(np.rint(np.linspace(0, len(points) - 1, most)).astype(int))
    middle = np.exp(-1j * np.angle(np.mean(amplitude)))  # keeps the phase of a coating away from pi
    own = [np.abs(amplitude), np.angle(amplitude * middle) - np.angle(middle)]
    values = np.stack([*ray.axial, *own] if oblique else own)
    return Compensation(fit_map(points[pick], values[:, pick], order), None if oblique else ray.indices)


def slice_phase(ray: CentreRays, planes_mm: Array, oblique: bool, wavenumber_per_mm: float) -> Array:
    """Return the phase error of the compensation for the rays of the object's centre, in radians.

    Parameters
    ----------
    ray
        Rays of a meridional fan at one surface.
    planes_mm
        Cutting planes of the surface.
    oblique
        Kind of compensation. Oblique compensation assumes a plane wave within a slice.
    wavenumber_per_mm
        Vacuum wavenumber.
    """
    which = slice_of(planes_mm, ray.z_mm)
    low, high = planes_mm[which], planes_mm[which + 1]
    if oblique:
        height = ray.z_mm - 0.5 * (low + high)
        before, behind = ray.drift
        return np.asarray(0.5 * wavenumber_per_mm * height**2 * (before + behind))
    before, behind = ray.obliquity
    return np.asarray(wavenumber_per_mm * (before * (ray.z_mm - low) + behind * (high - ray.z_mm)))


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


def other_angles(ray: CentreRays, other: CentreRays, planes_mm: Array) -> Array:
    """Return the path error of the compensation for one point's light when used for another point's light."""
    which = slice_of(planes_mm, other.z_mm)
    height = other.z_mm - 0.5 * (planes_mm[which] + planes_mm[which + 1])
    order = np.argsort(ray.y_mm)
    front, behind = (
        own - np.interp(other.y_mm, ray.y_mm[order], axial[order])
        for own, axial in zip(other.axial, ray.axial, strict=True)
    )
    return np.asarray(height * (front - behind))


def slice_of(planes_mm: Array, z_mm: Array) -> NDArray[np.intp]:
    """Return the slice of each height; heights beyond the outermost planes belong to the outermost slices."""
    return np.asarray(np.searchsorted(planes_mm[1:-1], z_mm, side="right"), np.intp)
