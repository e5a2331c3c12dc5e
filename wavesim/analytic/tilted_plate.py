"""Exact field of a beam along the axis through a tilted plane-parallel plate; one passage, TE.

The plate multiplies a plane wave at the angle of incidence a by its two transmission coefficients and by
exp(i k d (sqrt(n^2 - sin^2 a) - cos a)), at any distance. For engines that propagate between planes
perpendicular to the axis, it is the simplest surface that is not such a plane.
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.poses import Pose
from lensdesign.lens.surface import Surface
from wavesim.analytic.beam import Beam, superpose
from wavesim.analytic.plane_interface import STOP_SPREADS, transmitted_te
from wavesim.analytic.registry import AnalyticCase
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

WAIST_WIDTHS, GAP_MM = 1.5, 0.02


def tilted_plate_scene(
    incidence_deg: float = 30.0,
    index: float = 1.5195,
    thickness_mm: float = 0.04,
    wavelength_um: float = 0.532,
    spread: float = 0.05,
) -> AnalyticCase:
    """Return the case of a beam along z through a plate that is tilted about x.

    Parameters
    ----------
    incidence_deg
        Tilt of the plate, from -50 to 50 degrees.
    index, thickness_mm
        Index and thickness of the plate.
    wavelength_um
        Vacuum wavelength.
    spread
        Width of the beam's angular spectrum in radians.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    steepest_deg = 50.0
    if not abs(incidence_deg) <= steepest_deg:
        raise InputError(
            f"incidence_deg = {incidence_deg!r}: must be from -{steepest_deg:g} to {steepest_deg:g}"
        )
    if not (math.isfinite(index) and index >= 1.0):
        raise InputError(f"index = {index!r}: must be at least 1")
    if not (math.isfinite(thickness_mm) and 0.0 < thickness_mm <= 10.0):
        raise InputError(f"thickness_mm = {thickness_mm!r}: must be above 0 and at most 10")
    beam, tilt = Beam(wavelength_um, spread), math.radians(incidence_deg)
    waist, pitch = WAIST_WIDTHS * beam.waist_half_width_mm, 0.25e-3 * wavelength_um
    semi, distance = _size(waist, abs(tilt), math.tan(STOP_SPREADS * spread))
    end = thickness_mm + 1.1 * (semi + thickness_mm) * abs(math.sin(tilt)) + GAP_MM
    wide = waist + (distance + end) * math.tan(STOP_SPREADS * spread) + thickness_mm
    scene = Scene(
        lens=_lens(index, thickness_mm, semi, distance, end, wavelength_um, spread),
        object_grid=Grid((2 * math.ceil(waist / pitch),), pitch, -distance),
        exit_grid=Grid((2 * math.ceil(wide / pitch),), pitch, end),
        wavelength_um=wavelength_um,
        pose=Pose(tilt_x_deg=incidence_deg),
        coating="bare",
    )
    y = scene.exit_grid.y_mm
    angle, weight = beam.plane_waves(float(np.max(np.abs(y))) + distance + end + 2.0 * thickness_mm)
    k, sine = beam.wavenumber_per_mm, np.sin(angle + tilt)
    inside = np.arcsin(sine / index)
    path = thickness_mm * (index * np.cos(inside) - np.cos(angle + tilt)) + (distance + end) * np.cos(angle)
    passed = transmitted_te(1.0, index, angle + tilt) * transmitted_te(index, 1.0, inside)
    exact = superpose(angle, weight * passed * np.exp(1j * k * path), k, y, np.zeros_like(y))
    start = scene.object_grid
    return AnalyticCase(
        scene,
        Field(start, beam.field(start.y_mm, np.zeros(start.size)), wavelength_um),
        Field(scene.exit_grid, exact, wavelength_um),
        uncertainty=math.sqrt(math.erfc(STOP_SPREADS)),
    )


def _size(waist_mm: float, tilt: float, widening: float) -> tuple[float, float]:
    """Return semi-diameter and distance of a plate that transmits the beam, with its rim off the grid."""
    sine = math.sin(tilt)
    semi = (waist_mm + GAP_MM * widening) / (math.cos(tilt) - 2.1 * sine * widening)
    return semi, 1.1 * semi * sine + GAP_MM


def _lens(
    index: float,
    thickness_mm: float,
    semi_mm: float,
    distance_mm: float,
    end_mm: float,
    wavelength_um: float,
    spread: float,
) -> Lens:
    return Lens(
        title="Tilted plate",
        wavelengths_um=(wavelength_um,),
        object=ObjectSpace(
            field_diameter_mm=0.1 * semi_mm,
            numerical_aperture=math.sin(STOP_SPREADS * spread),
            working_distance_mm=distance_mm,
        ),
        sensor=Sensor(
            pixel_pitch_um=wavelength_um, pixels=(1024, 1024), plane_distances_mm=(end_mm - thickness_mm,)
        ),
        surfaces=(
            Surface(thickness_mm=thickness_mm, material=index, semi_diameter_mm=semi_mm, stop=True),
            Surface(semi_diameter_mm=semi_mm + thickness_mm),
        ),
    )
