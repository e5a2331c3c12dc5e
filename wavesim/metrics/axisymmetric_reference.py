"""Light around the axis of a lens as a sum over all plane waves: reference fields for a whole exit plane.

Surfaces refract like their tangent planes, as in the wave propagation method. The plane waves of a medium are
summed by quadrature, so that the band is not limited and the aperture's rim is not made of samples. A field
of rotational symmetry is computed along a radius: the light of a point on the axis, or of rings around it. On
a line the field is symmetric about the axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, j1

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.analytic.aperture_diffraction import panel_nodes
from wavesim.analytic.registry import AnalyticCase
from wavesim.engines.surfaces.samples import other_transmission, surface_slopes, transmission_at
from wavesim.engines.wpm.engine import TANGENT_PLANE
from wavesim.fields.field import Field, Grid
from wavesim.rays.interfaces import crossings, surface_map
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complex128]

PANEL_WAVES, ANGLES_AT_ONCE = 1.9, 200
"""Width of a panel on a surface in wavelengths; number of angles that are summed at a time."""


@dataclass(frozen=True, eq=False)
class _Sheet:
    """Sources along a radius: their distances from the axis, heights, slopes and measures."""

    r_mm: Array
    z_mm: Array
    slope: Array
    measure: Array


def axial_case(lens: Lens, patch_mm: float, **where: Any) -> AnalyticCase:
    """Return a case around the axis on a whole plane, filled with rings that emit light in all directions.

    Parameters
    ----------
    lens, patch_mm, **where
        As in :func:`wavesim.scene.patches.patch_scene`.

    Returns
    -------
    AnalyticCase
        `exact` is the sum over all plane waves. `uncertainty` is the estimated error of two approximations:
        tangent planes in place of the surfaces, and the transmission of light from the axis for all light.

    Raises
    ------
    InputError
        If a surface is not rotationally symmetric about the z axis.
    """
    scene = patch_scene(lens, patch_mm, **where)
    start = rings(scene.object_grid, scene.wavelength_um, lens.object.numerical_aperture)
    grid = scene.exit_grid
    radii, places = np.unique(_radius(grid), return_inverse=True)
    exact = summed_plane_waves(scene, start.values, radii)[places].reshape(grid.shape)
    curvature = float(np.max(np.abs([shape.curvature for shape in scene.system.shapes])))
    uncertainty = math.hypot(TANGENT_PLANE * curvature / scene.wavenumber_per_mm, other_transmission(scene))
    return AnalyticCase(scene, start, Field(grid, exact, scene.wavelength_um), uncertainty)


def rings(grid: Grid, wavelength_um: float, numerical_aperture: float) -> Field:
    """Return random rings around the axis that fill the aperture evenly and fade out within the grid."""
    rng = np.random.default_rng(20261123)
    radius = _radius(grid)
    # Radius at which the amplitude is 1/e.
    fade = 0.4 * min(grid.half_widths_mm)
    # The light overfills the aperture by a tenth.
    largest_wavenumber = 2e3 * math.pi / wavelength_um * 1.1 * numerical_aperture
    values = np.zeros(grid.shape, complex)
    count = math.ceil(largest_wavenumber * fade)
    for q in largest_wavenumber * (np.arange(count) + 0.5) / count:
        values += q * complex(*rng.standard_normal(2)) * j0(q * radius)
    values *= np.exp(-((radius / fade) ** 2))
    return Field(grid, values / np.sqrt(np.mean(np.abs(values) ** 2)), wavelength_um)


def summed_plane_waves(scene: Scene, values: NDArray, radii_mm: Array) -> ComplexArray:
    """Return the field on the exit plane for rotationally symmetric values on the object grid.

    Parameters
    ----------
    scene
        An upright, centred lens of surfaces of revolution, with the object grid around its axis.
    values
        Values on the object grid; on a line symmetric about the axis.
    radii_mm
        Distances from the axis on the exit grid's plane in mm, shape (n,).

    Returns
    -------
    ndarray of complex, shape (n,)
        Complex amplitude at these distances.

    Raises
    ------
    InputError
        If a surface is not rotationally symmetric about the z axis, or the sensor has a cover glass.
    """
    if scene.system.cover_glass is not None:
        raise InputError("sensor, cover_glass: this reference has no plate; remove the table from the design")
    is_line, index = scene.object_grid.is_line, scene.system.index[0]
    rays = crossings(scene, scene.object_grid.centre_mm)
    surfaces = [_surface(scene, number) for number in range(scene.system.surfaces)]
    end = np.zeros_like(radii_mm)
    sheets = [_object(scene), *surfaces, _Sheet(radii_mm, end + scene.exit_grid.z_mm, end, end)]
    field: ComplexArray = np.asarray(values, complex).ravel()
    for number, (here, there) in enumerate(pairwise(sheets)):
        k = scene.wavenumber_per_mm * float(index[number])
        field = _radiated(here, np.asarray(field * here.measure, complex), k, there, is_line)
        if number < len(surfaces):
            passed = transmission_at(scene, number, rays[number], np.zeros_like(there.r_mm), there.r_mm)
            field *= passed
    return field


def _radius(grid: Grid) -> Array:
    """Return the distances from the axis; those that differ by rounding are equal."""
    return np.asarray(np.round(np.sqrt(grid.radius_squared_mm2()), 12), float)


def _object(scene: Scene) -> _Sheet:
    grid = scene.object_grid
    r = _radius(grid).ravel()
    measure = np.full_like(r, grid.cell * (0.5 if grid.is_line else 0.5 / math.pi))
    return _Sheet(r, np.full_like(r, grid.z_mm), np.zeros_like(r), measure)


def _surface(scene: Scene, number: int) -> _Sheet:
    """Return nodes along a radius, up to the rim."""
    wavelength_mm = 1e-3 * scene.wavelength_um
    r, weight = panel_nodes(0.0, float(scene.system.semi_diameter[number]), PANEL_WAVES * wavelength_mm)
    # Azimuths at which a surface must have the same height.
    azimuth_count = 17
    azimuth = 2.0 * math.pi * np.arange(azimuth_count) / azimuth_count
    some = r[:: max(1, len(r) // azimuth_count), None]
    around = surface_map(scene.system, number, some * np.sin(azimuth), some * np.cos(azimuth)).z_mm
    # Largest difference of the heights, in wavelengths.
    largest_waves = 1e-6
    if not np.ptp(around, axis=1).max() <= largest_waves * wavelength_mm:
        raise InputError(f"surface {number} is not one of revolution about the z axis")
    zero = np.zeros_like(r)
    z = surface_map(scene.system, number, zero, r).z_mm
    slope = surface_slopes(scene.system, number, zero, r, z)[0]
    return _Sheet(r, z, slope, weight if scene.object_grid.is_line else weight * r)


def _radiated(source: _Sheet, sources: ComplexArray, k: float, target: _Sheet, is_line: bool) -> ComplexArray:
    """Return Kirchhoff's integral over a source sheet at a target sheet, as a sum of plane waves."""
    top, bottom = float(np.max(source.z_mm)), float(np.min(source.z_mm))
    apart = math.hypot(np.max(source.r_mm) + np.max(target.r_mm), np.max(target.z_mm) - bottom)
    angles, weights = panel_nodes(0.0, 0.5 * math.pi, 4.0 * math.pi / (k * apart))
    found = np.zeros(len(target.r_mm), complex)
    for part in np.array_split(np.arange(len(angles)), math.ceil(len(angles) / ANGLES_AT_ONCE)):
        q, kz = k * np.sin(angles[part]), k * np.cos(angles[part])
        across, lean = np.outer(q, source.r_mm), 1j * (q / kz)[:, None] * source.slope
        waves = 2.0 * (np.cos(across) + lean * np.sin(across)) if is_line else j0(across) + lean * j1(across)
        sent = (waves * np.exp(-1j * np.outer(kz, source.z_mm - top))) @ sources * kz * weights[part]
        on = np.exp(1j * np.outer(target.z_mm - top, kz))
        across = np.outer(target.r_mm, q)
        found += (np.cos(across) * on) @ (sent / math.pi) if is_line else (j0(across) * on) @ (sent * q)
    return found
