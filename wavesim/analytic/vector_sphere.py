"""A polarized beam through a homogeneous sphere: the exact electric field on a plane by the Mie series.

The beam is the sum of plane waves whose amplitude depends on the angle to the axis alone, and whose electric
field is along the x axis of the double-pole basis (:mod:`lensdesign.raytrace.polarization`). Its multipoles
have the order m = 1. One passage (Debye p = 1) multiplies each of them by T12 T21: electric multipoles by
that of light along the plane of incidence, magnetic ones by that of light across it, which is that of scalar
waves. The object lies 0.2 radii in front of the sphere, so that the light behind it has no caustic.

Source: C. F. Bohren and D. R. Huffman, "Absorption and Scattering of Light by Small Particles" (1983),
chapter 4; G. Gouesbet and G. Grehan, "Generalized Lorenz-Mie Theories" (2011), for the beam.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from lensdesign.common.arrays import Array
from lensdesign.lens.coatings.coating import CoatingName
from wavesim.analytic.cylinder import SCENE_INDEX, matched_orders, round_lens
from wavesim.analytic.sphere import ComplexArray, beam_nodes, beam_on_plane, riccati_functions
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

DISTANCE = 1.2
"""Distance of the object from the sphere's centre, in radii."""


@dataclass(frozen=True, eq=False)
class VectorCase:
    """A scene of polarized light whose field behind the lens is known.

    Attributes
    ----------
    scene : Scene
        Lens, grids and polarization along x.
    object_field : Field
        Field on the scene's object grid.
    exact : tuple of Field
        Components on the exit grid: along x and along y in the double-pole basis of the local rays.
    """

    scene: Scene
    object_field: Field
    exact: tuple[Field, Field]


def vector_sphere_scene(
    radius_mm: float = 0.2, wavelength_um: float = 0.532, spread: float = 0.1, coating: CoatingName = "bare"
) -> VectorCase:
    """Return the case of a beam, polarized along x, through a sphere of index 1.5195.

    Parameters
    ----------
    radius_mm
        Radius of the sphere; up to some hundred wavelengths.
    wavelength_um
        Vacuum wavelength.
    spread
        Width of the beam's angular spectrum in radians, at most 0.12.
    coating
        ``bare``, or ``ideal`` for coatings that change no phase.
    """
    k, wavelength_mm = 2e3 * math.pi / wavelength_um, 1e-3 * wavelength_um
    stop_angle = 4.5 * spread
    object_pitch, exit_pitch = 0.25 * wavelength_mm, 0.5 * wavelength_mm
    cut = 4.5  # half-width of the object in units of the waist; the error is 4e-5
    object_count = 2 * math.ceil(cut / (k * spread) / object_pitch)
    exit_count = 2 * math.ceil(0.7 * radius_mm / exit_pitch)
    scene = Scene(
        lens=round_lens("Dielectric sphere", radius_mm, wavelength_um, stop_angle, DISTANCE, rear=0.9),
        object_grid=Grid((object_count, object_count), object_pitch, (1.0 - DISTANCE) * radius_mm),
        exit_grid=Grid((exit_count, exit_count), exit_pitch, 2.1 * radius_mm),
        wavelength_um=wavelength_um,
        coating=coating,
        polarization=0.0,
    )
    start = beam_on_plane(k, spread, scene.object_grid, wavelength_mm)
    waist_z_mm, is_ideal = -DISTANCE * radius_mm, coating == "ideal"
    waves = passed_multipoles(k * radius_mm, SCENE_INDEX, k, spread, waist_z_mm, is_ideal)
    components = _on_plane(waves, k, scene, 1.1 * radius_mm, wavelength_um)
    return VectorCase(scene, Field(scene.object_grid, start, wavelength_um), components)


def multipoles(wavenumber_per_mm: float, spread: float, waist_z_mm: float, orders: int) -> ComplexArray:
    """Return the amplitudes of the beam's regular multipoles, for n = 1 ... orders.

    The field is the sum of c_n (M_o1n - i N_e1n). The waist lies at `waist_z_mm` from the sphere's centre.
    """
    k = wavenumber_per_mm
    angle, weight = beam_nodes(k, spread, abs(waist_z_mm) + orders / k)
    cosine = np.cos(angle)
    amplitude = weight * np.exp(-1j * k * waist_z_mm * cosine)
    result = np.empty(orders, complex)
    for n, pi, tau in _angular_functions(cosine, orders):
        shared = (2 * n + 1) * (1.0, 1j, -1.0, -1j)[n % 4] / (n * (n + 1)) ** 2
        result[n - 1] = shared * ((pi + tau) @ amplitude)
    return result


def passed_multipoles(
    size_parameter: float,
    index: float,
    wavenumber_per_mm: float,
    spread: float,
    waist_z_mm: float,
    is_ideal: bool,
) -> tuple[ComplexArray, ComplexArray]:
    """Return the outgoing magnetic and electric multipoles after one passage, n = 1 ... x."""
    x = size_parameter
    orders = math.floor(x)
    outside, inside = riccati_functions(orders, x), riccati_functions(orders, index * x)
    wronskians = -4.0 * index
    _, magnetic, _ = matched_orders(index, outside, inside, wronskians)
    # Along the plane of incidence, u and n du/dr change places.
    j, dj, y, dy = outside
    j_in, dj_in, y_in, dy_in = inside
    out, dout = j + 1j * y, dj + 1j * dy
    determinant = out * (dj_in - 1j * dy_in) - index * dout * (j_in - 1j * y_in)
    electric = wronskians / determinant**2
    beam = 0.5 * multipoles(wavenumber_per_mm, spread, waist_z_mm, orders)
    passed = [values[1:] / np.abs(values[1:]) if is_ideal else values[1:] for values in (magnetic, electric)]
    return beam * passed[0], beam * passed[1]


def meridional_fields(
    waves: tuple[ComplexArray, ComplexArray], wavenumber_per_mm: float, radius_mm: Array, z_mm: float
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return the outgoing electric field in a plane, without its dependence on the azimuth.

    The components away from the axis and along it are to be multiplied by cos(azimuth), that around it by
    -sin(azimuth).
    """
    distance = np.hypot(radius_mm, z_mm)
    cosine, sine, kr = z_mm / distance, radius_mm / distance, wavenumber_per_mm * distance
    # Spherical Hankel functions by upward recurrence, which is stable for them.
    before, wave = -1j * np.exp(1j * kr) / kr, -(1.0 / kr + 1j / kr**2) * np.exp(1j * kr)
    radial, polar, around = (np.zeros(kr.shape, complex) for _ in range(3))
    for (n, pi, tau), magnetic, electric in zip(
        _angular_functions(cosine, len(waves[0])), *waves, strict=True
    ):
        slope = before - n * wave / kr
        polar += magnetic * pi * wave - 1j * electric * tau * slope
        around += magnetic * tau * wave - 1j * electric * pi * slope
        radial += -1j * electric * n * (n + 1) * sine * pi * wave / kr
        before, wave = wave, (2 * n + 1) / kr * wave - before
    outwards, along = radial * sine + polar * cosine, radial * cosine - polar * sine
    return np.asarray(outwards), np.asarray(along), around


def _on_plane(
    waves: tuple[ComplexArray, ComplexArray], k: float, scene: Scene, z_mm: float, wavelength_um: float
) -> tuple[Field, Field]:
    """Return both components on the exit grid, interpolated between samples along the radius."""
    grid: Grid = scene.exit_grid
    radius = np.asarray(np.sqrt(grid.radius_squared_mm2()), float)
    step = 1e-3 * wavelength_um / 24.0
    samples = np.asarray(step * np.arange(math.ceil(float(radius.max()) / step) + 5), float)
    outwards, along, around = meridional_fields(waves, k, samples, z_mm)
    # The local ray is along the gradient of the phase.
    slope = np.gradient(np.unwrap(np.angle(around)), step) / k
    sine = np.clip(slope, -1.0, 1.0)
    sine[0] = 0.0
    meridional = outwards * np.sqrt(1.0 - sine**2) - along * sine
    both = []
    for values in (meridional, around):
        mirrored = np.r_[values[:0:-1], values]
        both.append(make_interp_spline(np.r_[-samples[:0:-1], samples], mirrored, k=7)(radius))
    azimuth = np.arctan2(grid.y_mm[:, None], grid.x_mm)
    c, s = np.cos(azimuth), np.sin(azimuth)
    return (
        Field(grid, c * c * both[0] + s * s * both[1], wavelength_um),
        Field(grid, s * c * (both[0] - both[1]), wavelength_um),
    )


def _angular_functions(cosine: Array, orders: int) -> Iterator[tuple[int, Array, Array]]:
    """Yield n, pi_n and tau_n for n = 1 ... orders."""
    before, pi = np.zeros_like(cosine), np.ones_like(cosine)
    for n in range(1, orders + 1):
        yield n, pi, n * cosine * pi - (n + 1) * before
        before, pi = pi, ((2 * n + 1) * cosine * pi - (n + 1) * before) / n
