"""Light on the pixels that rough surfaces of the lens scatter.

A recorded plane contains the direct light, reduced by the scattered fraction, and the scattered light: the
direct light of the plane, convolved with the halo of each rough surface. A halo is a Gaussian with the radius
that :func:`lensdesign.analysis.roughness.roughness_report` finds. The energy is conserved except for
scattered light outside the sensor. Light that falls beside the sensor is not scattered onto it.

The result is the mean over many lenses with this roughness, without the interference of scattered and direct
light.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from scipy.special import erf

from lensdesign.analysis.roughness import RoughnessReport, roughness_report
from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from wavesim.fields.field import Grid
from wavesim.runtime.threads import row_blocks
from wavesim.scene.system_state import AS_DESIGNED, SystemState
from wavesim.sensor.measurement import Measurement

HALO_BYTES = 45
"""Bytes per pixel that the scattered light of one plane takes, as measured."""


@dataclass(frozen=True)
class Halo:
    """Scattered light of one surface on one plane.

    Attributes
    ----------
    fraction : float
        Fraction of the light that is scattered.
    radius_mm : float
        Radius at which the halo of a point falls to 1/e.

    Examples
    --------
    >>> import numpy as np
    >>> point = np.zeros((64, 64))
    >>> point[32, 32] = 1.0
    >>> recorded = with_scattered_light(point, 2.0, [Halo(fraction=0.01, radius_mm=0.01)])
    >>> round(float(recorded.sum()), 6), round(float(recorded[32, 32]), 3)
    (1.0, 0.99)
    """

    fraction: float
    radius_mm: float


def scatter_of_patch(
    lens: Lens,
    object_grid: Grid,
    wavelength_um: float,
    plane_distances_mm: Sequence[float],
    state: SystemState = AS_DESIGNED,
) -> RoughnessReport | None:
    """Return the light of a patch that rough surfaces scatter; None without a rough surface.

    Parameters
    ----------
    lens
        The nominal lens.
    object_grid
        Samples of the object plane. Four points represent its inscribed circle.
    wavelength_um
        Vacuum wavelength.
    plane_distances_mm
        Distances of the planes from the exit vertex.
    state
        Pose of the lens and perturbations of its surfaces.

    Raises
    ------
    DesignError
        If no ray passes the lens.
    InputError
        If the roughness of a surface without a stated one is perturbed.
    """
    if all(surface.roughness is None for surface in lens.surfaces) and not any(
        np.any(one.roughness_rms_nm) for one in state.surface_perturbations.values()
    ):
        return None
    # The mean of a quadratic function over a disc is that of four points at this fraction of the radius.
    offset = math.sqrt(0.5) * min(object_grid.half_widths_mm)
    (x, y), limit = object_grid.centre_mm, lens.half_field_mm
    points = []
    for dx, dy in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
        point = np.array([x + offset * dx, y + offset * dy])
        point *= min(1.0, limit / max(float(np.hypot(*point)), 1e-300))
        points.append((float(point[0]), float(point[1])))
    return roughness_report(
        lens, wavelength_um, points, plane_distances_mm, state.pose, state.surface_perturbations
    )


def halos_on_plane(report: RoughnessReport | None, index: int) -> tuple[Halo, ...]:
    """Return the halo of each rough surface on a plane; `index` counts the planes of the report from 0."""
    if report is None:
        return ()
    # Surfaces share the total as their phases squared do, to which small fractions are proportional.
    shares = [-math.log1p(-min(one.mean_fraction, 1.0 - 1e-12)) for one in report.surfaces]
    total = sum(shares) or 1.0
    return tuple(
        Halo(report.mean_fraction * share / total, one.halo_radius_mm[index])
        for one, share in zip(report.surfaces, shares, strict=True)
    )


def with_scattered_light(intensity: Array, pixel_pitch_um: float, halos: Sequence[Halo]) -> Array:
    """Return the light on pixels with the scattered light in place of a fraction of the direct light.

    Parameters
    ----------
    intensity : ndarray, shape (ny, nx)
        Direct light of a lens with smooth surfaces.
    pixel_pitch_um
        Distance between the centres of neighbouring pixels.
    halos
        Halos of the surfaces; the intensity itself is returned if there are none.
    """
    if not halos:
        return intensity
    result = scattered_on_pixels(intensity, pixel_pitch_um, halos)
    result += (1.0 - sum(halo.fraction for halo in halos)) * intensity
    return result.astype(intensity.dtype, copy=False)


def scattered_on_pixels(intensity: Array, pixel_pitch_um: float, halos: Sequence[Halo]) -> Array:
    """Return the scattered light alone; arguments are those of :func:`with_scattered_light`."""
    total = np.zeros(intensity.shape)
    for halo in halos:
        # A Gaussian that falls to 1/e at a radius has this standard deviation along each axis.
        deviation = math.sqrt(0.5) * halo.radius_mm / (1e-3 * pixel_pitch_um)
        blurred = _blurred_along_rows(intensity, deviation)
        blurred = _blurred_along_rows(blurred.T, deviation).T
        blurred *= halo.fraction
        total += blurred
    return total


def with_stated_scatter(
    recorded: Sequence[Measurement], pixel_pitch_um: float, report: RoughnessReport | None
) -> list[Measurement]:
    """Return measurements with the scattered light of the design as their background.

    The halos of the recorded light stand for those of the direct light; the relative difference is about the
    scattered fraction. A plane that has a background already keeps it.

    Parameters
    ----------
    recorded
        Measurements in the order of the report's planes.
    pixel_pitch_um
        Distance between the centres of neighbouring pixels.
    report
        Scattered light, from :func:`scatter_of_patch`.
    """
    planes = []
    for index, plane in enumerate(recorded):
        halos = halos_on_plane(report, index)
        if halos and plane.background is None:
            light = scattered_on_pixels(np.square(plane.amplitude), pixel_pitch_um, halos)
            plane = replace(plane, background=light.astype(plane.amplitude.dtype))
        planes.append(plane)
    return planes


def _blurred_along_rows(values: Array, deviation: float) -> Array:
    """Return a convolution of rows with a Gaussian of a standard deviation in pixels, dark outside."""
    count = values.shape[1]
    # The Gaussian is 0 to rounding beyond 9 standard deviations.
    reach = min(math.ceil(9.0 * deviation) + 1, count - 1)
    edges = (np.arange(-reach, reach + 2) - 0.5) / (math.sqrt(2.0) * max(deviation, 1e-9))
    kernel = 0.5 * np.diff(erf(edges))
    length = scipy.fft.next_fast_len(count + reach, real=True)
    ring = np.zeros(length)
    ring[np.arange(-reach, reach + 1) % length] = kernel
    transfer = scipy.fft.rfft(ring)
    result = np.empty(values.shape)
    for block in row_blocks(len(values)):
        spectrum = scipy.fft.rfft(np.asarray(values[block], float), length, axis=1)
        result[block] = scipy.fft.irfft(spectrum * transfer, length, axis=1)[:, :count]
    return np.maximum(result, 0.0, out=result)
