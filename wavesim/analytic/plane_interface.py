"""Exact field of a beam through plane interfaces, or none; two-dimensional, TE.

For each plane wave of the beam, the refractive index times the sine of its angle is constant. The wave is
multiplied by Fresnel's coefficient at each interface, and by the phase factor exp(i k n d cos(angle)) of each
layer. Light that is reflected inside a plate is neglected: the field is that of one passage.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.analytic.beam import SPREAD_CUT, Beam, superpose
from wavesim.analytic.registry import AnalyticCase
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

STOP_SPREADS = 5.0
"""Largest angle to the beam's axis that the scene's stop transmits, in units of the beam's spread."""


def transmitted_te(index_before: float, index_behind: float, angle: Array) -> Array:
    """Return Fresnel's TE transmission coefficient of plane waves at an angle of incidence (radians)."""
    before = index_before * np.cos(angle)
    behind = np.sqrt(index_behind**2 - (index_before * np.sin(angle)) ** 2)
    return np.asarray(2.0 * before / (before + behind))


def plate_scene(
    incidence_deg: float = 30.0,
    index: float = 1.5195,
    thickness_mm: float = 0.2,
    wavelength_um: float = 0.532,
    spread: float = 0.05,
) -> AnalyticCase:
    """Return the case of a beam through a plane-parallel plate.

    The object lies half of the plate's thickness in front of it, the exit plane half of it behind it.

    Parameters
    ----------
    incidence_deg
        Angle of the beam's axis to the normal.
    index, thickness_mm
        Index and thickness of the plate; an index of 1 means free space.
    wavelength_um
        Vacuum wavelength.
    spread
        Width of the beam's angular spectrum in radians.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    surfaces = (index, thickness_mm), (1.0, 0.5 * thickness_mm)
    return _scene("Plane-parallel plate", surfaces, 0.5 * thickness_mm, incidence_deg, wavelength_um, spread)


def plane_scene(
    incidence_deg: float = 30.0,
    index: float = 1.5195,
    distance_mm: float = 0.1,
    wavelength_um: float = 0.532,
    spread: float = 0.05,
) -> AnalyticCase:
    """Return the case of a beam through one plane interface.

    The object lies `distance_mm` in front of the interface, the exit plane as far behind it, in glass. For
    the other parameters and errors see :func:`plate_scene`.
    """
    return _scene(
        "Plane interface", ((index, distance_mm),), distance_mm, incidence_deg, wavelength_um, spread
    )


def beam_scene(
    incidence_deg: float = 0.0,
    distance_mm: float = 0.05,
    wavelength_um: float = 0.532,
    spread: float = 0.16,
) -> AnalyticCase:
    """Return the case of a non-paraxial beam in free space; its spectrum extends to 46 degrees.

    The object is the waist. The lens is a plane with air on both sides, at `distance_mm` from both grids. For
    the other parameters and errors see :func:`plate_scene`.
    """
    return _scene("Free space", ((1.0, distance_mm),), distance_mm, incidence_deg, wavelength_um, spread)


def _scene(
    title: str,
    surfaces: Sequence[tuple[float, float]],
    distance_mm: float,
    incidence_deg: float,
    wavelength_um: float,
    spread: float,
) -> AnalyticCase:
    """Return the case of plane surfaces, each with the index and the thickness of the medium behind it."""
    beam, tilt = Beam(wavelength_um, spread), math.radians(incidence_deg)
    layers = [(1.0, distance_mm), *surfaces]
    for index, thickness in layers:
        if not (math.isfinite(index) and index >= 1.0 and math.isfinite(thickness) and thickness > 0.0):
            raise InputError(
                f"index = {index!r}, thickness of {thickness!r} mm: the index must be at least 1, and the "
                "thickness above 0"
            )
    # Angle beyond which plane waves of the beam are refused.
    steepest_rad = 1.4
    if not 0.0 <= tilt <= steepest_rad - SPREAD_CUT * spread:
        raise InputError(
            f"incidence_deg = {incidence_deg!r} with spread = {spread:g} rad: must be from 0 to "
            f"{math.degrees(steepest_rad - SPREAD_CUT * spread):.4g}°"
        )
    rim = tilt + STOP_SPREADS * spread
    heights = np.cumsum([[d * _tangent(n, a) for a in (tilt, rim)] for n, d in layers], axis=0)
    waist = 1.5 * beam.waist_half_width_mm / math.cos(tilt)
    pitch = 0.25e-3 * wavelength_um
    start_y, end_y = -float(heights[0, 0]), float(heights[-1, 0] - heights[0, 0])
    scene = Scene(
        lens=_lens(title, layers, heights, wavelength_um, rim),
        object_grid=Grid((2 * math.ceil(waist / pitch),), pitch, -distance_mm, (0.0, start_y)),
        exit_grid=Grid(
            (2 * math.ceil((1.6 * (heights[-1, 1] - heights[-1, 0]) + waist) / pitch),),
            pitch,
            sum(d for _, d in surfaces),
            (0.0, end_y),
        ),
        wavelength_um=wavelength_um,
        coating="bare",
    )
    start = _field(beam, tilt, [], scene.object_grid.y_mm - start_y)
    end = _field(beam, tilt, layers, scene.exit_grid.y_mm - start_y)
    return AnalyticCase(
        scene,
        Field(scene.object_grid, start, wavelength_um),
        Field(scene.exit_grid, end, wavelength_um, layers[-1][0]),
        uncertainty=math.sqrt(math.erfc(STOP_SPREADS)),
    )


def _tangent(index: float, angle: float) -> float:
    return math.tan(math.asin(math.sin(angle) / index))


def _field(
    beam: Beam, tilt: float, layers: Sequence[tuple[float, float]], y_mm: Array
) -> NDArray[np.complex128]:
    """Return the field of the beam, tilted about its waist, behind layers of (index, thickness)."""
    steepest = tilt + SPREAD_CUT * beam.spread
    reach = float(np.max(np.abs(y_mm))) + sum(d * _tangent(n, steepest) for n, d in layers)
    angle, weight = beam.plane_waves(reach)
    angle = angle + tilt
    path, transmission = np.zeros_like(angle), np.ones_like(angle)
    before = 1.0
    for index, thickness in layers:
        path += thickness * np.sqrt(index**2 - np.sin(angle) ** 2)
        transmission *= transmitted_te(before, index, np.arcsin(np.sin(angle) / before))
        before = index
    k = beam.wavenumber_per_mm
    return superpose(angle, weight * transmission * np.exp(1j * k * path), k, y_mm, np.zeros_like(y_mm))


def _lens(
    title: str, layers: Sequence[tuple[float, float]], heights: Array, wavelength_um: float, rim: float
) -> Lens:
    """Return plane surfaces, wide enough for rays from the centre of the waist to the rim of the stop."""
    stop = float(heights[0, 1] - heights[0, 0])
    planes = []
    for i, (index, thickness) in enumerate(layers[1:]):
        last = i == len(layers) - 2
        planes.append(
            Surface(
                thickness_mm=None if last else thickness,
                material=None if index == 1.0 else index,
                semi_diameter_mm=stop + 1.01 * float(heights[i, 1] - heights[0, 1]),
                stop=i == 0,
            )
        )
    return Lens(
        title=title,
        wavelengths_um=(wavelength_um,),
        object=ObjectSpace(
            field_diameter_mm=0.1 * stop,
            numerical_aperture=math.sin(rim),
            working_distance_mm=layers[0][1],
        ),
        sensor=Sensor(pixel_pitch_um=wavelength_um, pixels=(1024, 1024), plane_distances_mm=(layers[-1][1],)),
        surfaces=tuple(planes),
    )
