"""Exact non-paraxial beam in free space: plane waves with a Gaussian angular spectrum."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive

ComplexArray = NDArray[np.complex128]

SPREAD_CUT = 8.5
"""Half-width of the angular spectrum in units of its spread, where it is 2e-16 of its peak."""

WAIST_CUT = 6.0
"""Half-width of the waist in units of its width 1 / (k s)."""


@dataclass(frozen=True)
class Beam:
    """A two-dimensional TE beam, symmetric about z.

    At (y, z) it is the integral of exp(-theta^2 / (2 s^2)) exp(i k (y sin theta + (z - waist) cos theta))
    over theta.

    Attributes
    ----------
    wavelength_um : float
        Vacuum wavelength; the beam is in air.
    spread : float
        Width s of the angular spectrum in radians, at most 0.18.
    waist_z_mm : float
        z of the waist, where the plane waves are in phase.

    Raises
    ------
    InputError
        If a value is not usable.
    """

    wavelength_um: float
    spread: float = 0.12
    waist_z_mm: float = 0.0

    def __post_init__(self) -> None:
        validate_positive("wavelength_um", self.wavelength_um)
        # Largest spread in radians; a wider spectrum would extend to waves at right angles to the axis.
        largest_spread = 0.18
        if not 0.0 < self.spread <= largest_spread:
            raise InputError(f"spread = {self.spread!r} rad: must be above 0 and at most {largest_spread}")
        if not math.isfinite(self.waist_z_mm):
            raise InputError(f"waist_z_mm = {self.waist_z_mm!r}: must be finite")

    @property
    def wavenumber_per_mm(self) -> float:
        """2 pi over the wavelength."""
        return 2e3 * math.pi / self.wavelength_um

    @property
    def waist_half_width_mm(self) -> float:
        """Half-width in the plane of the waist outside which the field is below 2e-8 of its peak."""
        return WAIST_CUT / (self.wavenumber_per_mm * self.spread)

    def plane_waves(self, reach_mm: float) -> tuple[Array, Array]:
        """Return angles and weights of plane waves that represent the beam within a reach of its waist.

        Their trapezoidal rule is accurate to rounding, since the spectrum is entire and vanishes at its ends.
        """
        edge = SPREAD_CUT * self.spread
        phase = self.wavenumber_per_mm * reach_mm + 40.0 / self.spread
        angle = np.linspace(-edge, edge, math.ceil(phase * edge / math.pi) + 1)
        return angle, np.exp(-0.5 * (angle / self.spread) ** 2) * (angle[1] - angle[0])

    def field(self, y_mm: ArrayLike, z_mm: ArrayLike) -> ComplexArray:
        """Return the field at points; `y_mm` and `z_mm` are broadcast together."""
        y, z = np.broadcast_arrays(np.asarray(y_mm, float), np.asarray(z_mm, float) - self.waist_z_mm)
        angle, weight = self.plane_waves(float(np.max(np.hypot(y, z), initial=0.0)))
        return superpose(angle, weight, self.wavenumber_per_mm, y, z)

    def cylinder_waves(self, orders: int) -> ComplexArray:
        """Return amplitudes `b_m` of the waves `J_m(k r) exp(i m phi)` about y = z = 0, for m = 0 ... orders.

        Here z = r cos(phi) and y = r sin(phi), and `b_-m = (-1)^m b_m`. A plane wave at the angle theta has
        the amplitudes `i^m exp(-i m theta)`, so one Fourier transform over theta gives all `b_m`.
        """
        k = self.wavenumber_per_mm
        count = fft.next_fast_len(math.ceil(k * abs(self.waist_z_mm) + 40.0 / self.spread) + orders)
        angle = 2.0 * math.pi * fft.fftfreq(count)
        spectrum = np.exp(-0.5 * (angle / self.spread) ** 2 - 1j * k * self.waist_z_mm * np.cos(angle))
        spectrum[np.abs(angle) > SPREAD_CUT * self.spread] = 0.0
        quarter_turns = np.array([1.0, 1j, -1.0, -1j])[np.arange(orders + 1) % 4]
        return np.asarray(quarter_turns * fft.fft(spectrum)[: orders + 1] * (2.0 * math.pi / count))


def superpose(
    angle: Array, amplitude: Array | ComplexArray, wavenumber_per_mm: float, y_mm: Array, z_mm: Array
) -> ComplexArray:
    """Return the sum of plane waves amplitude exp(i k (y sin angle + z cos angle)), shaped as `y_mm`."""
    y, z = y_mm.ravel(), z_mm.ravel()
    along_y, along_z = wavenumber_per_mm * np.sin(angle), wavenumber_per_mm * np.cos(angle)
    result = np.empty(y.size, complex)
    most_exponentials = 1 << 18
    step = max(1, most_exponentials // len(angle))
    for start in range(0, y.size, step):
        part = slice(start, start + step)
        phase = np.outer(y[part], along_y) + np.outer(z[part], along_z)
        result[part] = np.exp(1j * phase) @ amplitude
    return result.reshape(y_mm.shape)
