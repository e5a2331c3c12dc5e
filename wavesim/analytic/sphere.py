"""A beam through a homogeneous sphere: the exact scalar field on a whole plane.

As for the cylinder (:mod:`wavesim.analytic.cylinder`), with spherical waves: the incident beam is the sum of
(2 l + 1) i^l b_l j_l(k r) P_l(cos(theta)), and u and du/dr are continuous at r = a. With Riccati's functions
r j_l and r y_l in place of Bessel's, each order is matched in the same way. One passage (Debye p = 1) between
lossless coatings is the phase of T12 T21 alone.

Source: C. F. Bohren and D. R. Huffman, "Absorption and Scattering of Light by Small Particles" (1983),
chapter 4, of which this is the scalar case.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.special import j0, jv, roots_legendre, yv

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive
from wavesim.analytic.beam import SPREAD_CUT, WAIST_CUT
from wavesim.analytic.cylinder import (
    SCENE_INDEX,
    STOP_ANGLE,
    RadialFunctions,
    matched_orders,
    round_lens,
)
from wavesim.analytic.registry import AnalyticCase
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complex128]


def riccati_functions(orders: int, argument: float) -> RadialFunctions:
    """Return x j_l, its derivative, x y_l and its derivative at the argument x, for l = 0 ... orders."""
    order = np.arange(orders + 1)
    scale = math.sqrt(0.5 * math.pi * argument)
    j = np.asarray(scale * jv(order + 0.5, argument), float)
    y = np.asarray(scale * yv(order + 0.5, argument), float)
    first = (math.cos(argument), math.sin(argument))
    slopes = []
    for values, start in zip((j, y), first, strict=True):
        slope = -order / argument * values
        slope[1:] += values[:-1]
        slope[0] = start
        slopes.append(slope)
    return j, slopes[0], y, slopes[1]


def passage_phases(size_parameter: float, index: float) -> ComplexArray:
    """Return T12 T21 of the orders up to x, whose rays meet the sphere; with ideal coatings of modulus 1."""
    x = size_parameter
    orders = math.floor(x)
    outside, inside = riccati_functions(orders, x), riccati_functions(orders, index * x)
    _, through, _ = matched_orders(index, outside, inside, -4.0 * index)
    return np.asarray(through / np.abs(through))


def beam_nodes(wavenumber_per_mm: float, spread: float, reach_mm: float) -> tuple[Array, Array]:
    """Return angles to the axis and weights exp(-theta^2 / (2 s^2)) sin(theta) of a beam's plane waves.

    They are a Gauss rule with enough nodes for points within `reach_mm` of the waist.
    """
    edge = SPREAD_CUT * spread
    nodes, weights = roots_legendre(math.ceil(0.7 * wavenumber_per_mm * reach_mm * edge + 80.0))
    angle = 0.5 * edge * (nodes + 1.0)
    return angle, 0.5 * edge * weights * np.sin(angle) * np.exp(-0.5 * (angle / spread) ** 2)


def beam_field(wavenumber_per_mm: float, spread: float, radius_mm: Array, distance_mm: float) -> ComplexArray:
    """Return the field of the beam at distances from the axis, in a plane behind its waist."""
    k = wavenumber_per_mm
    angle, weight = beam_nodes(k, spread, math.hypot(float(np.max(radius_mm)), distance_mm))
    waves = j0(k * np.outer(radius_mm, np.sin(angle)))
    return np.asarray(waves @ (weight * np.exp(1j * k * distance_mm * np.cos(angle))))


def spherical_waves(wavenumber_per_mm: float, spread: float, waist_z_mm: float, orders: int) -> ComplexArray:
    """Return the amplitudes (2 l + 1) i^l b_l of the beam's waves j_l(k r) P_l, for l = 0 ... orders."""
    angle, weight = beam_nodes(wavenumber_per_mm, spread, abs(waist_z_mm) + orders / wavenumber_per_mm)
    cosine = np.cos(angle)
    amplitude = weight * np.exp(-1j * wavenumber_per_mm * waist_z_mm * cosine)
    before, legendre = np.zeros_like(cosine), np.ones_like(cosine)
    result = np.empty(orders + 1, complex)
    for order in range(orders + 1):
        result[order] = (2 * order + 1) * (1.0, 1j, -1.0, -1j)[order % 4] * (legendre @ amplitude)
        before, legendre = legendre, _next_legendre(order, cosine, legendre, before)
    return result


def _next_legendre(order: int, cosine: Array, legendre: Array, previous: Array) -> Array:
    return np.asarray(((2 * order + 1) * cosine * legendre - order * previous) / (order + 1))


def outgoing_field(
    waves: ComplexArray, wavenumber_per_mm: float, radius_mm: Array, z_mm: float
) -> ComplexArray:
    """Return the sum of outgoing waves h_l(k r) P_l(cos(theta)) outside the sphere."""
    distance = np.hypot(radius_mm, z_mm)
    cosine, kr = z_mm / distance, wavenumber_per_mm * distance
    # Upward recurrence is stable for h_l, since no solution grows faster, and for P_l.
    wave, after = -1j * np.exp(1j * kr) / kr, -(1.0 / kr + 1j / kr**2) * np.exp(1j * kr)
    before, legendre = np.zeros_like(cosine), np.ones_like(cosine)
    total = np.zeros(kr.shape, complex)
    for order, amplitude in enumerate(waves):
        total += amplitude * wave * legendre
        wave, after = after, (2 * order + 3) / kr * after - wave
        before, legendre = legendre, _next_legendre(order, cosine, legendre, before)
    return total


def sphere_scene(radius_mm: float = 0.05, wavelength_um: float = 0.532, spread: float = 0.08) -> AnalyticCase:
    """Return the case of a beam through a sphere of index 1.5195.

    The object lies half a radius in front of the sphere, the exit plane a tenth of a radius behind it.

    Parameters
    ----------
    radius_mm
        Radius in mm, from 15 to 400 wavelengths.
    wavelength_um
        Vacuum wavelength.
    spread
        Width of the beam's angular spectrum in radians; from 0.05 to 0.13.

    Returns
    -------
    AnalyticCase
        Scene of whole planes, with ideal coatings. `exact` is the light that passes once, p = 1. Its
        uncertainty is the fraction of the beam outside the stop.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    validate_positive("wavelength_um", wavelength_um)
    wavelength_mm = 1e-3 * wavelength_um
    # Radius, in wavelengths, up to which the scene's exit plane has at most 1.4 million samples.
    largest_radius_waves = 400.0
    smallest, largest = 15.0 * wavelength_mm, largest_radius_waves * wavelength_mm
    if not smallest <= radius_mm <= largest:
        raise InputError(
            f"radius_mm = {radius_mm!r}: must be from {smallest:.4g} to {largest:.4g} mm, "
            f"15 to {largest_radius_waves:g} wavelengths"
        )
    if not 0.05 <= spread <= 0.13:
        raise InputError(f"spread = {spread!r} rad: must be from 0.05 to 0.13")
    # Half-angle of the stop in units of the beam's spread; it is at most that of the cylinder's scene.
    stop_spreads = 4.5
    k, stop_angle = 2.0 * math.pi / wavelength_mm, min(stop_spreads * spread, STOP_ANGLE)
    object_pitch, exit_pitch = 0.25 * wavelength_mm, 0.5 * wavelength_mm
    object_count = 2 * math.ceil(WAIST_CUT / (k * spread) / object_pitch)
    exit_count = 2 * math.ceil(0.75 * radius_mm / exit_pitch)
    scene = Scene(
        lens=round_lens("Dielectric sphere", radius_mm, wavelength_um, stop_angle),
        object_grid=Grid((object_count, object_count), object_pitch, -0.5 * radius_mm),
        exit_grid=Grid((exit_count, exit_count), exit_pitch, 2.1 * radius_mm),
        wavelength_um=wavelength_um,
    )
    phases = passage_phases(k * radius_mm, SCENE_INDEX)
    waves = 0.5 * phases * spherical_waves(k, spread, -1.5 * radius_mm, len(phases) - 1)
    start = beam_on_plane(k, spread, scene.object_grid, wavelength_mm)
    end = _on_plane(
        lambda radius: outgoing_field(waves, k, radius, 1.1 * radius_mm), scene.exit_grid, wavelength_mm
    )
    return AnalyticCase(
        scene,
        Field(scene.object_grid, start, wavelength_um),
        Field(scene.exit_grid, end, wavelength_um),
        uncertainty=math.exp(-0.5 * (stop_angle / spread) ** 2),
    )


def beam_on_plane(wavenumber_per_mm: float, spread: float, grid: Grid, wavelength_mm: float) -> ComplexArray:
    """Return the field of the beam on a grid in the plane of its waist."""
    return _on_plane(lambda radius: beam_field(wavenumber_per_mm, spread, radius, 0.0), grid, wavelength_mm)


def _on_plane(field: Callable[[Array], ComplexArray], grid: Grid, wavelength_mm: float) -> ComplexArray:
    """Return a field on a grid that depends only on the distance from the axis.

    It is interpolated from 24 samples per wavelength by splines of degree 7. The error is below 1e-11 of its
    peak.
    """
    radius = np.asarray(np.sqrt(grid.radius_squared_mm2()), float)
    step = wavelength_mm / 24.0
    samples = np.asarray(step * np.arange(math.ceil(float(radius.max()) / step) + 5), float)
    values = field(samples)
    # Mirrored across the axis, where the field is even.
    line = make_interp_spline(np.r_[-samples[:0:-1], samples], np.r_[values[:0:-1], values], k=7)
    return np.asarray(line(radius))
