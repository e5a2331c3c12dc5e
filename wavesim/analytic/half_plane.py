"""Diffraction of a TE beam at a straight edge, seen through a plane-parallel plate: Sommerfeld's half-plane.

A plane wave that comes in at the angle a on a black screen is behind it, in air, the sum of plane waves of
the spectrum 1 / (4 pi i sin((a - b) / 2)) over all angles b, which is the incoming wave times Fresnel's
integral F(x) of :mod:`wavesim.rays.edge_diffraction`; x^2 is k times the detour by way of the edge. A perfect
conductor takes from this such a field of the wave that it reflects. See A. Sommerfeld, "Mathematische Theorie
der Diffraction", Math. Ann. 47, 317 (1896), and P. C. Clemmow, "The Plane Wave Spectrum Representation of
Electromagnetic Fields" (1966). Behind the screen each plane wave passes the plate by itself.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_choice
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.analytic.beam import SPREAD_CUT, Beam, superpose
from wavesim.analytic.plane_interface import transmitted_te
from wavesim.analytic.registry import AnalyticCase
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

Screen = Literal["black", "conductor"]

BEYOND, FADES, STEEPEST = 0.2, 0.4, 1.5
"""Angles in radians beyond the exit grid's border, as seen from the edge, up to which plane waves are
complete, and over which they are attenuated, and the upper limit. Steeper waves miss the exit grid."""

GAP = 0.2
"""Distance from the screen to the plate, relative to the object's distance."""


def half_plane_scene(
    index: float = 1.5195,
    thickness_mm: float = 0.4,
    distance_mm: float = 0.5,
    wavelength_um: float = 0.532,
    spread: float = 0.05,
    screen: Screen = "black",
) -> AnalyticCase:
    """Return the scene of a beam whose upper half is blocked in front of a plate.

    The waist is `distance_mm` in front of the stop's upper end, the plate a fifth of that behind it, the exit
    grid a `distance_mm` behind the plate.

    Parameters
    ----------
    index, thickness_mm
        Index and thickness of the plate; an index of 1 means free space.
    distance_mm
        Distance from the object to the screen.
    wavelength_um
        Vacuum wavelength.
    spread
        Width of the beam's angular spectrum in radians.
    screen
        Material of the stop; engines assume a black one.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    validate_choice("screen", screen, ("black", "conductor"))
    for name, value in (("thickness_mm", thickness_mm), ("distance_mm", distance_mm)):
        if not (math.isfinite(value) and 0.0 < value <= 100.0):
            raise InputError(f"{name} = {value!r}: must be above 0 and at most 100")
    if not (math.isfinite(index) and index >= 1.0):
        raise InputError(f"index = {index!r}: must be at least 1")
    beam = Beam(wavelength_um, spread)
    # Semi-diameter of the stop, whose other end the beam does not reach.
    stop_spreads = 12.0
    stop_mm, gap = stop_spreads * spread * distance_mm, GAP * distance_mm
    behind = gap + thickness_mm + distance_mm
    waist, pitch = 1.5 * beam.waist_half_width_mm, 0.4e-3 * wavelength_um
    # Half-width of the beam at the screen, in units of its spread.
    relative_half_width = 5.0
    wide = waist + (distance_mm + behind) * math.tan(relative_half_width * spread)
    scene = Scene(
        lens=_lens(index, thickness_mm, distance_mm, stop_mm, wavelength_um),
        object_grid=Grid((2 * math.ceil(waist / pitch),), pitch, -distance_mm, (0.0, stop_mm)),
        exit_grid=Grid((2 * math.ceil(wide / pitch),), pitch, behind, (0.0, stop_mm)),
        wavelength_um=wavelength_um,
        coating="bare",
    )
    y = scene.exit_grid.y_mm - stop_mm
    angle, weight = _behind_screen(beam, distance_mm, (float(np.max(np.abs(y))), behind), screen)
    sine, k = np.sin(angle), beam.wavenumber_per_mm
    inside = np.arcsin(sine / index)
    path = (gap + distance_mm) * np.cos(angle) + index * thickness_mm * np.cos(inside)
    passed = transmitted_te(1.0, index, angle) * transmitted_te(index, 1.0, inside)
    exact = superpose(angle, weight * passed * np.exp(1j * k * path), k, y, np.zeros_like(y))
    start = beam.field(scene.object_grid.y_mm - stop_mm, np.zeros(scene.object_grid.size))
    return AnalyticCase(
        scene,
        Field(scene.object_grid, start, wavelength_um),
        Field(scene.exit_grid, exact, wavelength_um),
        uncertainty=math.sqrt(math.erfc(relative_half_width)),
    )


def _behind_screen(
    beam: Beam, distance_mm: float, reach_mm: tuple[float, float], screen: Screen
) -> tuple[Array, NDArray[np.complex128]]:
    """Return angles and weights of plane waves about the edge of a screen that covers y > 0.

    They represent the field at points within a reach of the edge, across and along the axis.
    """
    wide, far = reach_mm
    whole = math.atan(wide / far) + BEYOND
    end = min(whole + FADES, STEEPEST)
    turns = beam.wavenumber_per_mm * (wide + (far + distance_mm) * math.sin(end))
    step = math.pi / (turns + 40.0 / beam.spread)
    count, most = math.ceil(end / step), math.ceil(SPREAD_CUT * beam.spread / step)
    angle: Array = step * np.arange(-count, count + 1, dtype=float)
    # Between the others, so that the pole of 1 / sin is met evenly from both sides.
    comes: Array = step * (np.arange(-most, most, dtype=float) + 0.5)
    lit = _spectrum(beam, comes, distance_mm) * (step / (4j * math.pi))
    # The pole gives half of the incident beam. All other terms depend on differences and sums of angles.
    differences = step * (np.arange(-most - count, most + count) + 0.5)
    spectrum = 0.5 * _spectrum(beam, angle, distance_mm)
    spectrum += fftconvolve(1.0 / np.sin(0.5 * differences), lit[::-1], mode="valid")[::-1]
    if screen == "conductor":
        spectrum += fftconvolve(1.0 / np.cos(0.5 * differences), lit[::-1], mode="valid")
    fades = np.clip((end - np.abs(angle)) / (end - whole), 0.0, 1.0)
    smooth = fades**3 * (10.0 - 15.0 * fades + 6.0 * fades**2)
    return angle, np.asarray(spectrum * smooth * step)


def _spectrum(beam: Beam, angle: Array, distance_mm: float) -> NDArray[np.complex128]:
    """Return the spectrum of the beam about the edge, over angles."""
    path = beam.wavenumber_per_mm * distance_mm * np.cos(angle)
    return np.asarray(np.exp(1j * path - 0.5 * (angle / beam.spread) ** 2))


def _lens(
    index: float, thickness_mm: float, distance_mm: float, stop_mm: float, wavelength_um: float
) -> Lens:
    """Return the lens of a stop in air with a plate behind it."""
    return Lens(
        title="Stop in front of a plate",
        wavelengths_um=(wavelength_um,),
        object=ObjectSpace(
            field_diameter_mm=2.2 * stop_mm,
            numerical_aperture=math.sin(math.atan(stop_mm / distance_mm)),
            working_distance_mm=distance_mm,
        ),
        sensor=Sensor(pixel_pitch_um=wavelength_um, pixels=(1024, 1024), plane_distances_mm=(distance_mm,)),
        surfaces=(
            Surface(thickness_mm=GAP * distance_mm, semi_diameter_mm=stop_mm, stop=True),
            Surface(thickness_mm=thickness_mm, material=None if index == 1.0 else index),
            Surface(),
        ),
    )
