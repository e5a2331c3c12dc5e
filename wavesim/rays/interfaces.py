"""Refracting surfaces over a transverse grid: their height, their aperture, and the rays that cross them.

Engines that carry a field from plane to plane need to know where along z a surface lies at each transverse
point, and with which angles the light of one object point meets and leaves it there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.raytrace.bundles import launch_compiled
from lensdesign.raytrace.compiled import CompiledSystem
from lensdesign.raytrace.polarization import surface_coefficients
from lensdesign.raytrace.rays import RayTrace, trace_compiled
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complex128]

FAN_RINGS, FAN_ARMS = 24, 48


@dataclass(frozen=True)
class SurfaceMap:
    """Heights of a surface over transverse points of the fixed frame.

    Attributes
    ----------
    z_mm : ndarray
        Height of the surface in the fixed frame; NaN where it does not reach.
    inwards_mm : ndarray
        Distance of the point from the edge of the clear semi-diameter; positive inside.
    """

    z_mm: Array
    inwards_mm: Array

    @property
    def inside(self) -> NDArray[np.bool_]:
        """True if the surface exists, within its clear semi-diameter."""
        return np.asarray(np.isfinite(self.z_mm) & (self.inwards_mm >= 0.0))


@dataclass(frozen=True)
class Crossings:
    """Rays of one object point at one surface; arrays of shape (n,).

    Attributes
    ----------
    x_mm, y_mm : ndarray
        Coordinates at which the rays cross the surface.
    axial_before, axial_after : ndarray
        Cosines of the angle to the z axis, in front of the surface and behind it.
    incidence, refraction : ndarray
        Cosines of the angle to the surface's normal, in front and behind.
    """

    x_mm: Array
    y_mm: Array
    axial_before: Array
    axial_after: Array
    incidence: Array
    refraction: Array


def surface_map(system: CompiledSystem, surface: int, x_mm: Array, y_mm: Array) -> SurfaceMap:
    """Return height and aperture of a surface with its tilt, decenter and figure.

    Parameters
    ----------
    system
        One lens.
    surface
        Index from 0.
    x_mm, y_mm
        Transverse points; broadcast together.
    """
    vertex, rotation = system.vertex[0, surface], system.rotation[0, surface]
    dx, dy = np.broadcast_arrays(x_mm - vertex[0], y_mm - vertex[1])
    dz = np.zeros(dx.shape)
    r2 = dx * dx + dy * dy
    if not system.tilted[surface]:
        dz = system.sag(surface, dx, dy)
    else:
        height_tolerance_mm = 1e-12
        for _ in range(20):
            local = [dx * rotation[0, i] + dy * rotation[1, i] + dz * rotation[2, i] for i in range(3)]
            r2 = local[0] ** 2 + local[1] ** 2
            height, by_x, by_y = system.sag_and_slopes(surface, local[0], local[1])
            rise = rotation[2, 2] - by_x * rotation[2, 0] - by_y * rotation[2, 1]
            step = (local[2] - height) / rise
            dz = dz - step
            if not np.any(np.abs(step) > height_tolerance_mm):
                break
    inwards = system.semi_diameter[surface] - np.sqrt(r2)
    return SurfaceMap(np.asarray(vertex[2] + dz), np.asarray(inwards))


def crossings(scene: Scene, field_mm: tuple[float, float]) -> tuple[Crossings, ...]:
    """Trace the rays of one object point to each surface; only rays through the whole lens count.

    Raises
    ------
    InputError
        If no ray of the object point gets through.
    """
    system, lens = scene.system, scene.lens
    rim = 1.0 if scene.object_grid.is_line else np.sqrt(np.arange(1, FAN_RINGS + 1) / FAN_RINGS)
    if scene.object_grid.is_line:
        fan_rays = 801
        pupil = np.column_stack([np.zeros(fan_rays), np.linspace(-rim, rim, fan_rays)])
    else:
        angle = 2.0 * np.pi * np.arange(FAN_ARMS) / FAN_ARMS
        ring = np.stack([np.outer(rim, np.cos(angle)).ravel(), np.outer(rim, np.sin(angle)).ravel()], axis=-1)
        pupil = np.concatenate([np.zeros((1, 2)), ring])
    origins, directions = launch_compiled(
        system,
        [field_mm],
        pupil,
        scene.object_grid.z_mm,
        lens.stop_index,
        lens.stop_semi_diameter_mm * (1.0 - 1e-9),
    )
    rays = trace_compiled(system, origins, directions, record_hits=True)
    ok = rays.ok
    if np.count_nonzero(ok) < 3:
        raise InputError(f"fewer than three rays from the object point {field_mm} mm get through the lens")
    assert rays.hits is not None
    points = np.concatenate([origins[ok, None], rays.hits[ok]], axis=1)
    legs = np.diff(points, axis=1)
    headings = legs / np.linalg.norm(legs, axis=-1, keepdims=True)
    headings = np.concatenate([headings, rays.direction[ok, None]], axis=1)
    return tuple(
        _crossing(system, i, points[:, i + 1], headings[:, i], headings[:, i + 1])
        for i in range(system.surfaces)
    )


def validate_meridional(scene: Scene, rays: RayTrace) -> None:
    """Raise InputError if rays of a meridional line do not stay in its plane."""
    aside = np.abs(np.stack([rays.position[rays.ok, 0], rays.direction[rays.ok, 0]]))
    if scene.object_grid.is_line and np.any(aside > 1e-9):
        raise InputError(
            "the rays of the meridional line leave the plane x = 0: the lens is not symmetric about it; use "
            "planes instead of lines, or only decenter_y_mm, despace_mm and tilt_x_deg"
        )


def _crossing(
    system: CompiledSystem, surface: int, points: Array, incident: Array, refracted: Array
) -> Crossings:
    # The normal follows from Snell's law in vector form: n2 q - n1 p is along it.
    n1, n2 = system.index[0, surface], system.index[0, surface + 1]
    normal = n2 * refracted - n1 * incident
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    along_z = np.broadcast_to(np.array([0.0, 0.0, 1.0]), normal.shape)
    normal = np.where(size > 1e-9, normal / np.where(size > 0.0, size, 1.0), along_z)
    return Crossings(
        x_mm=points[:, 0],
        y_mm=points[:, 1],
        axial_before=incident[:, 2],
        axial_after=refracted[:, 2],
        incidence=np.abs(np.sum(normal * incident, axis=-1)),
        refraction=np.abs(np.sum(normal * refracted, axis=-1)),
    )


def transmission(scene: Scene, surface: int, incidence: Array, refraction: Array) -> NDArray[np.inexact]:
    """Return the transmission of scalar waves at a surface, from the cosines to its normal on both sides.

    An ideal coating keeps the flux, n cos |u|^2. Other coatings transmit like light across the plane of
    incidence on a line, and like :func:`scalar_coefficient` on a plane.
    """
    n1, n2 = (float(n) for n in scene.system.index[0, surface : surface + 2])
    keep = np.sqrt(n1 * incidence / (n2 * refraction))
    return np.asarray(keep * coating_coefficient(scene, surface, incidence))


def coating_coefficient(scene: Scene, surface: int, incidence: Array) -> NDArray[np.inexact]:
    """Return the transmission of scalar waves by a surface's coating, normalized to flux.

    On a ghost's path it is the reflection of the surfaces that reflect. It is real if the coating changes no
    phase.
    """
    if scene.system.coatings[surface].is_ideal:
        return np.ones(np.shape(incidence))
    found, is_reflected = surface_coefficients(scene.system, surface, incidence)
    s, p = (found.rs, found.rp) if is_reflected else (found.ts, found.tp)
    value = s if scene.object_grid.is_line else scalar_coefficient(s, p)
    return value if np.any(value.imag) else value.real


def coating_transmission(scene: Scene, cos_incidence: Array) -> NDArray[np.complex128]:
    """Return the transmission of scalar waves by all coatings on the path, normalized to flux, shape (n,).

    Parameters
    ----------
    scene
        Lens with its coatings.
    cos_incidence
        Cosines of the angles of incidence, shape (n, surfaces).
    """
    result = np.ones(len(cos_incidence), complex)
    for surface in range(scene.system.surfaces):
        result *= coating_coefficient(scene, surface, cos_incidence[:, surface])
    return result


def scalar_coefficient(s: ComplexArray, p: ComplexArray) -> ComplexArray:
    """Return the coefficient with the mean flux of both polarizations, and the phase of their sum."""
    total = s + p
    size = np.abs(total)
    mean = np.sqrt(0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2))
    return np.asarray(mean * np.where(size > 0.0, total / np.where(size > 0.0, size, 1.0), 1.0))
