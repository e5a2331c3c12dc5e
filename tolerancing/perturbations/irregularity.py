"""Random figures of polished surfaces: Zernike polynomials of the third to fifth wavefront order.

Piston, tilt and power are left out, since tolerances of their own stand for them. What is left falls with the
radial order n as 1/n^2, as the low orders of polishing do.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from lensdesign.analysis.form_error import TEST_WAVELENGTH_UM
from lensdesign.common.arrays import Array
from lensdesign.lens.figure import SurfaceFigure, figure_from_zernike
from lensdesign.lens.zernikes import zernike, zernike_orders
from lensdesign.raytrace.bundles import pupil_rings

INDICES = (3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14)
"""OSA/ANSI indices: astigmatism, coma, trefoil and the fourth radial order."""

RINGS, ARMS = 24, 72
"""Over which the peak to valley is taken, the rim included."""


FALLING = np.array([zernike_orders(index)[0] ** -2.0 for index in INDICES])
"""How large each of them is, beside the others."""


def draw_shape(generator: np.random.Generator) -> Array:
    """Coefficients of `INDICES`, of root mean square 1, shape (11,)."""
    coefficients = generator.standard_normal(len(INDICES)) * FALLING
    return np.asarray(coefficients / np.sqrt(np.sum(coefficients**2)))


def peak_to_valley(shapes: Array) -> Array:
    """Of figures with these coefficients, shape (trials,) for shapes (trials, 11)."""
    # Row by row: a product of all rows at once may round differently with their number.
    return np.array([np.ptp(shape @ _sampled()) for shape in shapes])


def random_figures(shapes: Array, waves: Array, quantity: str, semi_diameter_mm: float) -> SurfaceFigure:
    """Figures of given size.

    Parameters
    ----------
    shapes
        Of :func:`draw_shape`, shape (trials, 11).
    waves
        Size in waves of 632.8 nm of sag error, shape (trials,); a negative one turns the figure over.
    quantity
        ``pv`` or ``rms``: what the size is.
    semi_diameter_mm
        Of the surface.
    """
    size_um = TEST_WAVELENGTH_UM * waves / (peak_to_valley(shapes) if quantity == "pv" else 1.0)
    units, spacing_mm = _unit_splines(semi_diameter_mm)
    coefficients = np.stack([np.tensordot(row, units, axes=1) for row in size_um[:, None] * shapes])
    return SurfaceFigure(semi_diameter_mm, spacing_mm, coefficients)


@lru_cache(maxsize=1)
def _sampled() -> Array:
    points = pupil_rings(RINGS, ARMS, edge=True).points
    rho, theta = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    return np.stack([zernike(index, rho, theta) for index in INDICES])


@lru_cache(maxsize=8)
def _unit_splines(semi_diameter_mm: float) -> tuple[Array, float]:
    """Spline coefficients in mm of each polynomial at 1 um, and the spacing of their grid in mm.

    Splines are linear in the heights, so that those of a figure are sums of these.
    """
    ones = np.eye(len(INDICES))
    figure = figure_from_zernike({index: ones[k] for k, index in enumerate(INDICES)}, semi_diameter_mm)
    return figure.coefficients, figure.spacing_mm
