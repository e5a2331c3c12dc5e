"""Peak-to-valley and root mean square of measured figures, in waves at 633 nm (Fig. 2g)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.files.figures import surface_figure
from lensdesign.lens.figure import SurfaceFigure
from lensdesign.lens.figure_source import TEST_WAVELENGTH_UM
from lensdesign.lens.lens import Lens
from lensdesign.lens.zernikes import zernike
from lensdesign.raytrace.bundles import pupil_rings

Array = NDArray[Any]
Removed = Literal["piston", "tilt", "power"]

REMOVED: dict[str, tuple[int, ...]] = {"piston": (0,), "tilt": (0, 1, 2), "power": (0, 1, 2, 4)}
"""OSA/ANSI indices of what is taken out of a map; each holds those before it."""

FEWEST_RINGS = 48


@dataclass(frozen=True)
class FormError:
    """How far a made surface departs from the designed one, over its clear aperture.

    Attributes
    ----------
    surface
        Number of the surface, from 1.
    pv_waves, rms_waves
        Peak-to-valley and root mean square, best-fit piston and tilt removed, in waves.
    pv_without_power_waves, rms_without_power_waves
        The same with the best-fit power (defocus, r^2) removed too.
    wavelength_um
        What waves are counted in.
    """

    surface: int
    pv_waves: float
    rms_waves: float
    pv_without_power_waves: float
    rms_without_power_waves: float
    wavelength_um: float = TEST_WAVELENGTH_UM


def form_errors(lens: Lens) -> tuple[FormError, ...]:
    """Form error of every surface that has a measured figure.

    Raises
    ------
    InputError
        If a figure cannot be read, or does not cover its surface's clear aperture.
    """
    found = []
    for number, surface in enumerate(lens.surfaces, start=1):
        figure = surface_figure(surface)
        if figure is not None and surface.semi_diameter_mm is not None:
            whole = pv_rms_waves(figure, surface.semi_diameter_mm, "tilt")
            rest = pv_rms_waves(figure, surface.semi_diameter_mm, "power")
            found.append(FormError(number, *whole, *rest))
    return tuple(found)


def pv_rms_waves(
    figure: SurfaceFigure, semi_diameter_mm: float, removed: Removed = "tilt"
) -> tuple[float, float]:
    """Peak-to-valley and root mean square of a figure in waves at 633 nm (`TEST_WAVELENGTH_UM`).

    Parameters
    ----------
    figure
        One figure.
    semi_diameter_mm
        Of the disc over which it counts.
    removed
        What is fitted by least squares over the disc and taken out: ``piston``; ``tilt``, with piston; or
        ``power`` (r^2), with both.
    """
    nodes = semi_diameter_mm / figure.spacing_mm
    rings = max(FEWEST_RINGS, round(nodes))
    samples = pupil_rings(rings, 4 * rings, edge=True)
    x, y = semi_diameter_mm * samples.points.T
    waves = 1e3 / TEST_WAVELENGTH_UM * figure.sag(x, y)
    residual = waves - fitted(waves, samples.points, samples.weights, removed) @ terms(
        samples.points, removed
    )
    return float(np.ptp(residual)), float(np.sqrt(samples.weights @ residual**2))


def terms(points: Array, removed: Removed) -> Array:
    """The polynomials that are taken out, at points of the unit disc, shape (terms, n)."""
    rho, theta = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    return np.stack([zernike(index, rho, theta) for index in REMOVED[removed]])


def fitted(values: Array, points: Array, weights: Array, removed: Removed) -> Array:
    """Coefficients of the polynomials by weighted least squares, shape (terms,)."""
    basis = terms(points, removed)
    return np.asarray(np.linalg.solve((basis * weights) @ basis.T, basis @ (weights * values)))
