"""Exact two-dimensional TE field of a beam through a homogeneous dielectric cylinder.

In cylinder waves about the axis of the cylinder, with r cos(phi) = z and r sin(phi) = y, the incident beam is
the sum of b_m J_m(k r) exp(i m phi), J = (H1 + H2) / 2, and each order is scattered by itself. The outgoing
part of an order is a series in the number of passages inside (Debye series): R11 for what the surface
returns at once, T12 R22^(p-1) T21 for what leaves after p chords. With H1 and H2 the Hankel functions of
both kinds, x = k a, y = n x, all coefficients follow from matching u and du/dr at r = a. The sum over all p
is the series of Lord Rayleigh and of Mie. Engines that carry light one way only should reproduce the term
p = 1.

Sources: E. A. Hovenac and J. A. Lock, "Assessing the contributions of surface waves and complex rays to
far-field Mie scattering by use of the Debye series", J. Opt. Soc. Am. A 9, 781 (1992); C. F. Bohren and
D. R. Huffman, "Absorption and Scattering of Light by Small Particles" (1983), section 8.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import hankel1, jv, yv

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive, validate_whole_number
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.analytic.beam import Beam
from wavesim.analytic.registry import AnalyticCase
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complex128]
RadialFunctions = tuple[Array, Array, Array, Array]

SCENE_INDEX = 1.5195

STOP_ANGLE = 0.5
"""Angle in radians to which the scene's stop admits the beam. Beyond 0.567, rays from an axial point cross
each other (a caustic); those from other points do so at smaller angles."""

OBJECT_DISTANCE = 1.5
"""Distance of the object from the centre of a round body, in radii."""


@dataclass(frozen=True)
class Cylinder:
    """A dielectric cylinder in air, about x; E along x (TE).

    Coefficients are those of the outgoing waves b_m H1_m(k r) exp(i m phi), for m = 0 ... orders, per
    incident wave b_m J_m(k r) exp(i m phi).

    Attributes
    ----------
    radius_mm, index, wavelength_um : float
        Radius, refractive index (from 1), vacuum wavelength.

    Raises
    ------
    InputError
        If a value is not usable.
    """

    radius_mm: float
    index: float
    wavelength_um: float

    def __post_init__(self) -> None:
        for name in ("radius_mm", "wavelength_um"):
            validate_positive(name, getattr(self, name))
        if not (math.isfinite(self.index) and self.index >= 1.0):
            raise InputError(f"index = {self.index!r}: must be finite and at least 1")
        # Largest size parameter up to which the Bessel functions were tested.
        largest_size = 2e4
        if not 0.1 <= self.size_parameter <= largest_size:
            raise InputError(
                f"radius_mm = {self.radius_mm:g} at {self.wavelength_um:g} µm: the circumference of "
                f"{self.size_parameter:.4g} wavelengths must be from 0.1 to {largest_size:g}"
            )

    @property
    def size_parameter(self) -> float:
        """Size parameter k a: the circumference in wavelengths."""
        return 2e3 * math.pi * self.radius_mm / self.wavelength_um

    @property
    def orders(self) -> int:
        """Highest order that the cylinder scatters."""
        x = self.size_parameter
        # Orders beyond the size parameter x, in units of x^(1/3) + 1; later coefficients are below 1e-16.
        edge_orders = 10.0
        return math.ceil(x + edge_orders * (x ** (1.0 / 3.0) + 1.0))

    @cached_property
    def _outside(self) -> RadialFunctions:
        return _bessel_functions(self.orders, self.size_parameter)

    @cached_property
    def _inside(self) -> RadialFunctions:
        return _bessel_functions(self.orders, self.index * self.size_parameter)

    @cached_property
    def _matched(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Coefficients (R11 - 1) / 2, T12 T21 and R22 of every order."""
        wronskians = (-4j / (math.pi * self.size_parameter)) ** 2
        return matched_orders(self.index, self._outside, self._inside, wronskians)

    def debye_coefficients(self, p: int) -> ComplexArray:
        """Return one term of the Debye series.

        Parameters
        ----------
        p : int
            Chords inside the cylinder. 0 is the light that the surface reflects, and the shadow in the
            incident beam; 1 is the light that passes once; p - 1 is the number of internal reflections.

        Raises
        ------
        InputError
            If p is not a whole number from 0.
        """
        validate_whole_number("p", p, 0)
        returned, through, kept = self._matched
        return returned if p == 0 else np.asarray(0.5 * through * kept ** (p - 1))

    def full_coefficients(self) -> ComplexArray:
        """Return the sum of the Debye series in the closed form of Rayleigh and Mie."""
        n = self.index
        j, dj, y, dy = self._outside
        j_in, dj_in, _, _ = self._inside
        matched = n * j * dj_in - dj * j_in
        return np.asarray(-matched / (matched + 1j * (n * y * dj_in - dy * j_in)))


def matched_orders(
    index: float, outside: RadialFunctions, inside: RadialFunctions, wronskians: complex
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return reflection and transmission of each order at a round surface, from matching u and du/dr.

    Parameters
    ----------
    index
        Refractive index n inside; outside it is 1.
    outside, inside
        J, J', Y, Y' (or the functions that correspond to them) at x = k a and at n x.
    wronskians
        n W(x) W(n x), where W is the Wronskian of J + i Y and J - i Y.

    Returns
    -------
    returned, through, kept : complex arrays over the orders
        (R11 - 1) / 2, T12 T21 and R22.
    """
    j, dj, y, dy = outside
    j_in, dj_in, y_in, dy_in = inside
    out, dout = j + 1j * y, dj + 1j * dy
    in_in, din_in = j_in - 1j * y_in, dj_in - 1j * dy_in
    determinant = index * out * din_in - dout * in_in
    returned = (dj * in_in - index * j * din_in) / determinant
    kept = (dout * in_in.conj() - index * out * din_in.conj()) / determinant
    return returned, wronskians / determinant**2, kept


def _bessel_functions(orders: int, argument: float) -> RadialFunctions:
    """Return J, J', Y and Y' for the orders 0 to `orders`."""
    m = np.arange(orders + 1)
    j, y = np.asarray(jv(m, argument), float), np.asarray(yv(m, argument), float)
    return j, _slope(m, j, argument), y, _slope(m, y, argument)


def _slope(orders: NDArray[np.int_], values: Array, argument: float) -> Array:
    slope = -orders / argument * values
    slope[1:] += values[:-1]
    slope[0] = -values[1]
    return slope


def outgoing_field(
    cylinder: Cylinder, beam: Beam, coefficients: ComplexArray, y_mm: ArrayLike, z_mm: ArrayLike
) -> ComplexArray:
    """Return the sum of outgoing waves outside the cylinder.

    Parameters
    ----------
    cylinder, beam
        The cylinder and the incident beam.
    coefficients
        Coefficients of the outgoing waves from the cylinder's methods, or a sum of such.
    y_mm, z_mm
        Points from the centre of the cylinder; broadcast together.

    Raises
    ------
    InputError
        If a point lies inside the cylinder, or beam and cylinder have different wavelengths.
    """
    if beam.wavelength_um != cylinder.wavelength_um:
        raise InputError(
            f"the beam's wavelength of {beam.wavelength_um:g} µm is not the cylinder's "
            f"{cylinder.wavelength_um:g} µm"
        )
    y, z = np.broadcast_arrays(np.asarray(y_mm, float), np.asarray(z_mm, float))
    radius = np.hypot(y, z)
    if np.any(radius < cylinder.radius_mm * (1.0 - 1e-12)):
        raise InputError(
            f"a point at {np.min(radius):g} mm from the centre lies inside the cylinder, whose radius is "
            f"{cylinder.radius_mm:g} mm: outgoing waves are summed outside only"
        )
    kr = beam.wavenumber_per_mm * radius
    waves = coefficients * beam.cylinder_waves(len(coefficients) - 1)
    # Upward recurrence is stable for H1, since no solution grows faster.
    before, wave = hankel1(0, kr), hankel1(1, kr)
    turn = (z + 1j * y) / radius
    angular = turn.copy()
    total = waves[0] * before
    for m in range(1, len(waves)):
        total += (2.0 * waves[m]) * wave * angular.real
        before, wave = wave, (2.0 * m / kr) * wave - before
        angular *= turn
    return np.asarray(total)


def transmitted_field(cylinder: Cylinder, beam: Beam, y_mm: ArrayLike, z_mm: ArrayLike) -> ComplexArray:
    """Return the light that passes the cylinder once, without inner reflections (Debye p = 1)."""
    return outgoing_field(cylinder, beam, cylinder.debye_coefficients(1), y_mm, z_mm)


def total_field(cylinder: Cylinder, beam: Beam, y_mm: ArrayLike, z_mm: ArrayLike) -> ComplexArray:
    """Return the total field outside: incident, reflected and transmitted."""
    scattered = outgoing_field(cylinder, beam, cylinder.full_coefficients(), y_mm, z_mm)
    return np.asarray(beam.field(y_mm, z_mm) + scattered)


def cylinder_scene(
    radius_mm: float = 0.1, wavelength_um: float = 0.532, spread: float = 0.12
) -> AnalyticCase:
    """Return the scene of a beam from half a radius in front of a cylinder to a tenth of a radius behind it.

    Parameters
    ----------
    radius_mm
        Radius in mm, from 15 wavelengths on.
    wavelength_um
        Vacuum wavelength.
    spread
        Width of the beam's angular spectrum in radians; up to 0.13.

    Returns
    -------
    AnalyticCase
        `exact` is the light that passes once, p = 1. Its uncertainty is the fraction of the beam outside
        the stop.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    cylinder = Cylinder(radius_mm, SCENE_INDEX, wavelength_um)
    beam = Beam(wavelength_um, spread, -OBJECT_DISTANCE * radius_mm)
    wavelength_mm = 1e-3 * wavelength_um
    if radius_mm < 15.0 * wavelength_mm:
        raise InputError(
            f"radius_mm = {radius_mm:g}: must be at least 15 wavelengths, {15.0 * wavelength_mm:g} mm; "
            "a smaller cylinder is narrower than the beam"
        )
    if spread > 0.13:
        raise InputError(f"spread = {spread:g} rad: must be at most 0.13; the stop cuts a wider beam")
    object_pitch, exit_pitch = 0.25 * wavelength_mm, 0.5 * wavelength_mm
    scene = Scene(
        lens=round_lens("Dielectric cylinder", radius_mm, wavelength_um, STOP_ANGLE),
        object_grid=Grid(
            (2 * math.ceil(beam.waist_half_width_mm / object_pitch),), object_pitch, -0.5 * radius_mm
        ),
        exit_grid=Grid((2 * math.ceil(0.75 * radius_mm / exit_pitch),), exit_pitch, 2.1 * radius_mm),
        wavelength_um=wavelength_um,
        coating="bare",
    )
    start = beam.field(scene.object_grid.y_mm, beam.waist_z_mm)
    end = transmitted_field(cylinder, beam, scene.exit_grid.y_mm, scene.exit_grid.z_mm - radius_mm)
    return AnalyticCase(
        scene,
        Field(scene.object_grid, start, wavelength_um),
        Field(scene.exit_grid, end, wavelength_um),
        uncertainty=math.sqrt(math.erfc(STOP_ANGLE / spread)),
    )


def round_lens(
    title: str,
    radius_mm: float,
    wavelength_um: float,
    stop_angle: float,
    distance: float = OBJECT_DISTANCE,
    rear: float = 0.68,
) -> Lens:
    """Return the central part of a cylinder or a sphere as a lens.

    Its stop admits rays up to an angle (radians) from a point at a distance from the centre. The distance and
    the semi-diameter of the rear surface are in radii.
    """
    stop = math.sin(math.asin(distance * math.sin(stop_angle)) - stop_angle)
    return Lens(
        title=title,
        wavelengths_um=(wavelength_um,),
        object=ObjectSpace(
            field_diameter_mm=0.2 * radius_mm,
            numerical_aperture=math.sin(stop_angle),
            working_distance_mm=(distance - 1.0) * radius_mm,
        ),
        sensor=Sensor(
            pixel_pitch_um=wavelength_um, pixels=(1024, 1024), plane_distances_mm=(0.1 * radius_mm,)
        ),
        surfaces=(
            Surface(
                radius_mm=radius_mm,
                thickness_mm=2.0 * radius_mm,
                material=SCENE_INDEX,
                semi_diameter_mm=stop * radius_mm,
                stop=True,
            ),
            Surface(radius_mm=-radius_mm, semi_diameter_mm=rear * radius_mm),
        ),
    )
