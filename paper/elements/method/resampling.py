"""Eq. B1: Fourier transforms onto any window and pitch, by Bluestein's method."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from paper.element import Element, Made, Number, Work
from wavesim import Field, Grid, propagate
from wavesim.fields import relative_error

WAIST_MM, DISTANCE_MM = 12e-3, 1.0


def equation_b1(work: Work) -> Made:
    """A Gaussian beam onto samples of another window and pitch, and the exponents of the identity."""
    wavelength = work.lens.wavelengths_um[0]
    near = Grid((256, 256), 5e-4, 0.0)
    far = Grid((240, 200), 3.7e-4, DISTANCE_MM, (0.01, -0.006))
    found = propagate(Field(near, _beam(near, wavelength), wavelength), far)
    error = relative_error(found.values, _beam(far, wavelength))
    f, x, scale = 1.7, 0.3, 2.5
    chirp = (scale * x - f) ** 2
    printed = 2.0 * math.pi * (scale * x**2 + f**2 - scale * chirp)
    right = math.pi * (scale * x**2 + f**2 / scale - chirp / scale)
    numbers = (
        Number("pitch of the source", 1e3 * near.pitch_mm, "µm"),
        Number("pitch of the target, shifted by 10 and −6 µm", 1e3 * far.pitch_mm, "µm"),
        Number("relative error against the closed form of a Gaussian beam", error),
        Number("sum of the exponents as printed, for f = 1.7, x = 0.3, l = 2.5", printed, "rad"),
        Number("sum of π[l x² + f²/l − (l x − f)²/l]", right, "rad"),
        Number("what the Fourier transform needs, 2π f x", 2.0 * math.pi * f * x, "rad"),
    )
    difference = (
        "The method is the same. The identity as printed is wrong: π[l x² + f²/l − (l x − f)²/l] is 2π f "
        "x, which the code uses. Free-space propagation uses the method wherever window or pitch change."
    )
    command = "python -m pytest tests/wavesim/fields/test_chirp_z.py"
    return Made(numbers, (command,), difference)


def _beam(grid: Grid, wavelength_um: float) -> NDArray[np.complex128]:
    """A Gaussian beam with its waist at z = 0 (Saleh and Teich, Fundamentals of Photonics, 3.1-7)."""
    k = 2e3 * math.pi / wavelength_um
    rayleigh = 0.5 * k * WAIST_MM**2
    q = grid.z_mm - 1j * rayleigh
    r2 = grid.x_mm**2 + grid.y_mm[:, None] ** 2
    return np.asarray(-1j * rayleigh / q * np.exp(1j * k * (grid.z_mm + r2 / (2.0 * q))))


ELEMENTS = (
    Element(
        "equation-b1",
        "Eq. B1: Bluestein's method",
        "An inverse Fourier transform becomes a convolution with chirps, so that window and sampling "
        "interval of the result can be chosen.",
        equation_b1,
    ),
)
