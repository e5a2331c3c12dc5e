"""Random figures of polished surfaces: Zernike polynomials of the third to fifth wavefront order.

Piston, tilt and power are excluded, because they have tolerances of their own. The standard deviation of a
coefficient falls with the radial order n as 1/n^2, as it does for the low orders of polishing errors.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from lensdesign.analysis.form_error import TEST_WAVELENGTH_UM
from lensdesign.common.arrays import Array
from lensdesign.lens.surface_figure import SurfaceFigure, surface_figure_from_zernike
from lensdesign.lens.zernikes import zernike, zernike_orders
from lensdesign.raytrace.bundles import pupil_rings

INDICES = (3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14)
"""OSA/ANSI indices: astigmatism, coma, trefoil and the fourth radial order."""


def draw_shape(generator: np.random.Generator) -> Array:
    """Draw coefficients of the polynomials `INDICES`, normalised to a root mean square of 1, shape (11,)."""
    relative_deviations = np.array([zernike_orders(index)[0] ** -2.0 for index in INDICES])
    coefficients = generator.standard_normal(len(INDICES)) * relative_deviations
    return np.asarray(coefficients / np.sqrt(np.sum(coefficients**2)))


def peak_to_valley(shapes: Array) -> Array:
    """Return the peak-to-valley value of each figure, from coefficients of shape (trials, 11)."""
    return _peak_to_valley(np.ascontiguousarray(shapes, float).tobytes())


@lru_cache(maxsize=64)
def _peak_to_valley(shapes: bytes) -> Array:
    """Return the values of the same figures, which scaled draws and other lenses ask for many times."""
    rows = np.frombuffer(shapes).reshape(-1, len(INDICES))
    # Row by row: a product of all rows at once may round differently with the number of rows.
    found = np.array([np.ptp(row @ _sampled()) for row in rows])
    found.flags.writeable = False
    return found


def random_surface_figures(
    shapes: Array, waves: Array, quantity: str, semi_diameter_mm: float
) -> SurfaceFigure:
    """Return surface figures of the requested sizes.

    Parameters
    ----------
    shapes : ndarray, shape (trials, 11)
        Coefficients from :func:`draw_shape`.
    waves : ndarray, shape (trials,)
        Size of the sag error in waves of 632.8 nm. A negative size inverts the figure.
    quantity : {"pv", "rms"}
        Whether the size is the peak-to-valley or the root mean square value.
    semi_diameter_mm
        Clear semi-diameter of the surface.
    """
    size_um = TEST_WAVELENGTH_UM * waves / (peak_to_valley(shapes) if quantity == "pv" else 1.0)
    units, spacing_mm = _unit_splines(semi_diameter_mm)
    coefficients = np.stack([np.tensordot(row, units, axes=1) for row in size_um[:, None] * shapes])
    return SurfaceFigure(semi_diameter_mm, spacing_mm, coefficients)


@lru_cache(maxsize=1)
def _sampled() -> Array:
    """Return the polynomials at sample points of the unit disc, the rim included, shape (11, points)."""
    rings, arms = 24, 72
    points = pupil_rings(rings, arms, edge=True).points
    rho, theta = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    return np.stack([zernike(index, rho, theta) for index in INDICES])


@lru_cache(maxsize=8)
def _unit_splines(semi_diameter_mm: float) -> tuple[Array, float]:
    """Return spline coefficients (mm) of each polynomial at 1 um, and the spacing of their grid in mm."""
    ones = np.eye(len(INDICES))
    figure = surface_figure_from_zernike(
        {index: ones[k] for k, index in enumerate(INDICES)}, semi_diameter_mm
    )
    return figure.coefficients, figure.spacing_mm
