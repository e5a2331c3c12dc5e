"""Recorded amplitudes, their standard deviations, and the weights of pixels in a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.special
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.runtime.threads import row_blocks
from wavesim.scene.system_state import SystemState

Array = NDArray[np.floating[Any]]


LARGEST_RATIO = 1e9
"""Largest ratio of two planes' largest amplitudes; above it, the planes have different units."""

DARK = 0.25 * math.sqrt(2.0 * math.pi)
"""Ratio of intensity to its standard deviation below which an amplitude's deviation is constant."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """Amplitude recorded on one plane.

    Attributes
    ----------
    distance_mm : float
        Distance along +z, in mm, from the plane in which the field is reconstructed.
    amplitude : ndarray, shape (ny, nx)
        Square root of the intensity. All planes have the same unit.
    sigma : ndarray, shape (ny, nx), optional
        Standard deviation of each amplitude, in its unit. It is infinite in unknown pixels, such as
        saturated or dead ones. Default: equal deviations in all pixels.
    shift_mm : (x, y)
        Lateral displacement of the sensor's centre from its nominal position, in mm.
    background : ndarray, shape (ny, nx), optional
        Background intensity on each pixel, in the unit of the squared amplitude.
    tilt_deg : (x, y)
        Tilt of the sensor about its centre, see :class:`wavesim.SystemState`.
    blur_mm : float
        Standard deviation of the blur along x and y, such as by vibration. It is equal on all planes.
    fraction_per_intensity : ndarray, shape (ny, nx), optional
        Fraction of the camera's largest signal that a pixel has recorded, per unit of the squared amplitude;
        0 in unknown pixels. A nonlinearity of the camera needs it.

    Examples
    --------
    An amplitude with one saturated pixel:

    >>> import numpy as np
    >>> from wavesim import Measurement
    >>> amplitude = np.sqrt([[100.0, 400.0], [25.0, 900.0]])
    >>> sigma = np.array([[0.5, 0.5], [0.5, np.inf]])
    >>> Measurement(2.0, amplitude, sigma).known.tolist()
    [[True, True], [True, False]]
    """

    distance_mm: float
    amplitude: Array
    sigma: Array | None = None
    shift_mm: tuple[float, float] = (0.0, 0.0)
    background: Array | None = None
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    blur_mm: float = 0.0
    fraction_per_intensity: Array | None = None

    @property
    def known(self) -> NDArray[np.bool_] | None:
        """Mask of pixels with a finite standard deviation; None if all have one."""
        if self.sigma is None or np.all(np.isfinite(self.sigma)):
            return None
        return np.asarray(np.isfinite(self.sigma))


def placed_planes(nominal: Sequence[Measurement], state: SystemState) -> list[Measurement]:
    """Return measurements at the true positions of their planes, with the backgrounds of a state.

    Amplitudes are corrected for errors of the exposures and for the nonlinearity of the camera.

    Raises
    ------
    InputError
        If the state has a nonlinearity, and a measurement does not say which signals the camera recorded.
    """
    return [
        _placed_plane(_corrected(plane, state, index), state, index) for index, plane in enumerate(nominal)
    ]


def _corrected(plane: Measurement, state: SystemState, index: int) -> Measurement:
    """Return a plane as a linear camera with the true exposure measures it."""
    error, nonlinearity = state.exposure_error(index), state.nonlinearity
    if not (error or nonlinearity):
        return plane
    factor = np.full((1, 1), 1.0 / (1.0 + error))
    if nonlinearity:
        if plane.fraction_per_intensity is None:
            raise InputError(
                f"nonlinearity = {nonlinearity:g}: needs planes that state the signals that the camera "
                "recorded"
            )
        factor = factor * (1.0 + nonlinearity * plane.fraction_per_intensity * np.square(plane.amplitude))
    root = np.sqrt(factor).astype(plane.amplitude.dtype)
    return replace(
        plane,
        amplitude=plane.amplitude * root,
        sigma=None if plane.sigma is None else plane.sigma * root,
    )


def _placed_plane(plane: Measurement, state: SystemState, index: int) -> Measurement:
    fractions, background = state.background_on(index, plane.amplitude.shape), None
    if fractions is not None:
        mean = np.mean(np.square(plane.amplitude), dtype=float)
        background = np.full_like(plane.amplitude, mean * fractions)
    pose = state.sensor_pose(index)
    return replace(
        plane,
        distance_mm=plane.distance_mm + pose.distance_mm,
        shift_mm=pose.shift_mm,
        tilt_deg=pose.tilt_deg,
        background=background,
        blur_mm=1e-3 * state.vibration_um,
    )


def recorded_intensity(distance_mm: float, intensity: Array, variance: Array) -> Measurement:
    """Return amplitude and standard deviation from an intensity and its variance.

    The amplitude is the square root of the intensity, or 0 where the intensity is negative. Its standard
    deviation is that of the intensity over twice the amplitude. In dark pixels it is limited to 0.63 times
    the square root of the intensity's standard deviation: the root mean square amplitude of normal noise
    that is clipped at 0.

    Parameters
    ----------
    distance_mm
        See :class:`Measurement`.
    intensity, variance
        Intensity and its variance, of equal shape; an infinite variance marks an unknown pixel.

    Raises
    ------
    InputError
        If shapes differ, or a variance is not above 0.
    """
    if intensity.shape != variance.shape or not np.all(variance > 0.0):
        raise InputError(
            f"recorded intensity of shape {intensity.shape}, variance of shape {variance.shape}: must have "
            "one shape, and variances above 0"
        )
    known = np.isfinite(variance)
    deviation = np.sqrt(np.where(known, variance, 1.0))
    lowest = DARK * deviation
    sigma = np.where(known, deviation / (2.0 * np.sqrt(np.maximum(intensity, lowest))), np.inf)
    return Measurement(distance_mm, np.sqrt(np.maximum(intensity, 0.0)), sigma)


def with_intensity(plane: Measurement, intensity: Array, variance: Array) -> Measurement:
    """Return a measurement with another intensity and variance, in the precision of its amplitude.

    Parameters
    ----------
    plane
        The measurement, of which the rest is kept.
    intensity, variance
        See :func:`recorded_intensity`.
    """
    other = recorded_intensity(plane.distance_mm, intensity, variance)
    assert other.sigma is not None
    dtype = plane.amplitude.dtype
    return replace(plane, amplitude=other.amplitude.astype(dtype), sigma=other.sigma.astype(dtype))


def intensity_deviation(plane: Measurement) -> Array:
    """Return the standard deviation of the intensity of each pixel, from amplitude and its deviation.

    It reverses :func:`recorded_intensity`, and is infinite in unknown pixels.

    Raises
    ------
    InputError
        If the plane has no `sigma`.
    """
    if plane.sigma is None:
        raise InputError("measurement: needs sigma, from which the deviation of its intensity follows")
    known = np.isfinite(plane.sigma)
    sigma = np.where(known, plane.sigma, 0.0).astype(float)
    is_dark = plane.amplitude < 2.0 * DARK * sigma
    deviation = np.where(is_dark, 4.0 * DARK * sigma**2, 2.0 * plane.amplitude * sigma)
    return np.asarray(np.where(known, deviation, np.inf))


def amplitude_bias(plane: Measurement, modelled: Array) -> Array:
    """Return the mean of the measured amplitude less the amplitude without noise, for each pixel.

    The measured amplitude is the root of an intensity with normal noise of the deviation s, clipped at 0. For
    a modelled intensity I the mean of the root is, with x = I / s and the parabolic cylinder function D,

        sqrt(s) exp(-x^2 / 4) D_{-3/2}(-x) / (2 sqrt(2)).

    For bright pixels the bias is -s^2 / (8 I^{3/2}), and dark pixels seem to be bright.

    Parameters
    ----------
    plane
        Measured plane with standard deviations. The bias is 0 in pixels that are not known.
    modelled : ndarray, shape (ny, nx)
        Modelled amplitudes, with the background.

    Raises
    ------
    InputError
        If the plane has no `sigma`.

    References
    ----------
    I. S. Gradshteyn and I. M. Ryzhik, "Table of Integrals, Series, and Products", 3.462.1.
    """
    deviation = intensity_deviation(plane)
    known = np.isfinite(deviation) & (deviation > 0.0)
    deviation = np.where(known, deviation, 1.0)
    intensity = np.maximum(modelled.astype(float), 0.0) ** 2 / deviation
    # Ratio of intensity to its deviation above which the first term of the series is accurate to 1e-5.
    bright = 15.0
    dim = np.minimum(intensity, bright)
    mean = np.exp(-0.25 * dim**2) * scipy.special.pbdv(-1.5, -dim)[0] / (2.0 * math.sqrt(2.0))
    series = -0.125 / np.maximum(intensity, bright) ** 1.5
    bias = np.where(intensity < bright, mean - np.sqrt(dim), series)
    return np.asarray(np.where(known, np.sqrt(deviation) * bias, 0.0))


def amplitude_unit(recorded: Sequence[Measurement]) -> float:
    """Return the power of two (often 1) as unit of amplitude, so that squares fit in single precision.

    Raises
    ------
    InputError
        If the largest amplitudes of two planes differ by more than the factor `LARGEST_RATIO`.
    """
    largest = [float(plane.amplitude.max()) for plane in recorded]
    dimmest, brightest = (largest.index(pick(largest)) for pick in (min, max))
    if largest[brightest] > LARGEST_RATIO * largest[dimmest]:
        ratio = largest[brightest] / largest[dimmest]
        raise InputError(
            f"plane {brightest + 1}: amplitudes reach {ratio:.3g} times those of plane {dimmest + 1}: all "
            "planes must have the same unit"
        )
    return power_of_two(largest[brightest])


def power_of_two(largest: float) -> float:
    """Return the power of two below a value, or 1 if single precision can represent the sum of squares."""
    # Largest amplitude, and inverse of the smallest, whose sum of squares single precision can represent.
    largest_amplitude = 1e9
    return (
        1.0
        if 1.0 / largest_amplitude <= largest <= largest_amplitude
        else 2.0 ** math.floor(math.log2(largest))
    )


def in_unit(recorded: Sequence[Measurement], unit: float) -> list[Measurement]:
    """Return the measurements with amplitudes and standard deviations divided by a unit."""
    if unit == 1.0:
        return list(recorded)
    return [
        replace(
            p,
            amplitude=p.amplitude / unit,
            sigma=None if p.sigma is None else p.sigma / unit,
            background=None if p.background is None else p.background / unit**2,
        )
        for p in recorded
    ]


def full_weight_sigma(recorded: Sequence[Measurement]) -> float:
    """Return the standard deviation up to which a pixel has weight 1.

    It is the smallest standard deviation among the brightest known pixels of all planes. Long exposures can
    measure faint light more precisely. Weights relative to the smallest deviation of all pixels would make
    the bright pixels, which contain most of the light, irrelevant, and an iteration would not fit them.
    """
    at_brightest = []
    for plane in recorded:
        if plane.sigma is not None:
            brightest = np.argmax(np.where(np.isfinite(plane.sigma), plane.amplitude, -1.0))
            at_brightest.append(float(plane.sigma.flat[int(brightest)]))
    return min(at_brightest, default=1.0)


def noise_misfit(recorded: Sequence[Measurement]) -> float | None:
    """Return the misfit expected from the stated noise alone; None if a plane has no standard deviations.

    The misfit is the weighted relative L2 difference between computed and recorded amplitudes of all planes.
    """
    full = full_weight_sigma(recorded)
    missed = size = 0.0
    for plane in recorded:
        if plane.sigma is None:
            return None
        for rows in row_blocks(len(plane.sigma)):
            known = np.isfinite(plane.sigma[rows])
            stated = plane.sigma[rows][known].astype(float)
            weight = np.minimum(full / stated, 1.0) ** 2
            missed += float(weight @ stated**2)
            size += float(weight @ plane.amplitude[rows][known].astype(float) ** 2)
    return math.sqrt(missed / size)


def weights_of(recorded: Sequence[Measurement]) -> list[Array | None]:
    """Return the pixel weights of each plane: (:func:`full_weight_sigma` / standard deviation)^2, at most 1.

    A plane without standard deviations has None: all of its pixels have weight 1.
    """
    full = full_weight_sigma(recorded)
    return [None if p.sigma is None else np.asarray(np.minimum(full / p.sigma, 1.0) ** 2) for p in recorded]
