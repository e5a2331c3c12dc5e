"""Peak-to-valley and root mean square of measured figures, in waves at 633 nm (Fig. 2g)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.files.surface_figures import surface_figure
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface_figure import SurfaceFigure
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM
from lensdesign.lens.zernikes import zernike
from lensdesign.raytrace.bundles import pupil_rings

Array = NDArray[Any]
Removed = Literal["piston", "tilt", "power"]


@dataclass(frozen=True)
class FormError:
    """Departure of a made surface from the designed one, over its clear aperture.

    Attributes
    ----------
    surface
        Number of the surface, from 1.
    pv_waves, rms_waves
        Peak-to-valley and root mean square in waves, with best-fit piston and tilt removed.
    pv_without_power_waves, rms_without_power_waves
        Peak-to-valley and root mean square in waves, with best-fit power (defocus, r^2) also removed.
    wavelength_um
        Wavelength that is the unit of the waves.
    """

    surface: int
    pv_waves: float
    rms_waves: float
    pv_without_power_waves: float
    rms_without_power_waves: float
    wavelength_um: float = TEST_WAVELENGTH_UM


def form_errors(lens: Lens) -> tuple[FormError, ...]:
    """Return the form error of every surface that has a measured figure.

    Raises
    ------
    InputError
        If a figure cannot be read, or does not cover the clear aperture of its surface.

    Examples
    --------
    >>> from lensdesign import SurfaceFigureSource, Lens, ObjectSpace, Sensor, Surface
    >>> figure = SurfaceFigureSource(zernike_waves_633nm={12: 0.05}, semi_diameter_mm=4.0)
    >>> lens = Lens(
    ...     wavelengths_um=(0.55,),
    ...     object=ObjectSpace(field_diameter_mm=2.0, numerical_aperture=0.1, working_distance_mm=20.0),
    ...     sensor=Sensor(pixel_pitch_um=3.5, pixels=(1000, 1000), plane_distances_mm=(20.0,)),
    ...     surfaces=(Surface(semi_diameter_mm=4.0, figure=figure),),
    ... )
    >>> [round(error.rms_waves, 4) for error in form_errors(lens)]
    [0.05]
    """
    found = []
    for number, surface in enumerate(lens.surfaces, start=1):
        figure = surface_figure(surface)
        if figure is not None and surface.semi_diameter_mm is not None:
            without_tilt = pv_rms_waves(figure, surface.semi_diameter_mm, "tilt")
            without_power = pv_rms_waves(figure, surface.semi_diameter_mm, "power")
            found.append(FormError(number, *without_tilt, *without_power))
    return tuple(found)


def pv_rms_waves(
    figure: SurfaceFigure, semi_diameter_mm: float, removed: Removed = "tilt"
) -> tuple[float, float]:
    """Return peak-to-valley and root mean square of a figure in waves at 633 nm (`TEST_WAVELENGTH_UM`).

    Parameters
    ----------
    figure
        A single figure, without trials.
    semi_diameter_mm
        Semi-diameter of the disc over which the values are computed.
    removed
        Polynomials that are fitted by least squares over the disc and subtracted: ``piston``; ``tilt`` (with
        piston); or ``power`` (r^2, with both).

    Returns
    -------
    pv_waves, rms_waves : float

    Examples
    --------
    >>> from lensdesign.lens import surface_figure_from_zernike
    >>> figure = surface_figure_from_zernike({4: 0.6328}, semi_diameter_mm=5.0)
    >>> [round(value, 2) for value in pv_rms_waves(figure, 5.0)]
    [3.46, 1.0]
    """
    nodes = semi_diameter_mm / figure.spacing_mm
    rings = max(48, round(nodes))
    samples = pupil_rings(rings, 4 * rings, edge=True)
    x, y = semi_diameter_mm * samples.points.T
    waves = 1e3 / TEST_WAVELENGTH_UM * figure.sag(x, y)
    residual = waves - fitted(waves, samples.points, samples.weights, removed) @ terms(
        samples.points, removed
    )
    return float(np.ptp(residual)), float(np.sqrt(samples.weights @ residual**2))


def terms(points: Array, removed: Removed) -> Array:
    """Return the removed polynomials at points of the unit disc, shape (terms, n)."""
    rho, theta = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    # OSA/ANSI indices of the polynomials removed from a map; each choice includes the ones before it.
    removed_indices: dict[str, tuple[int, ...]] = {"piston": (0,), "tilt": (0, 1, 2), "power": (0, 1, 2, 4)}
    return np.stack([zernike(index, rho, theta) for index in removed_indices[removed]])


def fitted(values: Array, points: Array, weights: Array, removed: Removed) -> Array:
    """Return the coefficients of the removed polynomials by weighted least squares, shape (terms,)."""
    basis = terms(points, removed)
    return np.asarray(np.linalg.solve((basis * weights) @ basis.T, basis @ (weights * values)))
