"""Oversampling ratio of recorded frames: pixels in the light for each unknown of the object.

:mod:`lensdesign.analysis.oversampling` predicts the ratio from a lens. Here the pixels are counted on frames.
A pixel counts where its standard deviation is finite (it is neither saturated nor dead), and where the mean
intensity of the 3 x 3 pixels around it exceeds the standard deviation of its own intensity. The mean makes
false counts rare: noise without light exceeds this limit in 1 of 1000 pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter

from lensdesign.analysis.oversampling import (
    INTENSITY_DEGREES,
    ObjectKind,
    Oversampling,
    real_unknowns,
)
from lensdesign.analysis.space_bandwidth import sbp_object
from lensdesign.errors import InputError
from wavesim.sensor.measurement import Measurement, intensity_deviation

NEIGHBOURHOOD = 3
"""Side, in pixels, of the square over which the light of a pixel is averaged."""


def pixels_in_light(plane: Measurement) -> int:
    """Return the number of known pixels of a plane that receive more light than their noise.

    Parameters
    ----------
    plane
        Measured plane with standard deviations.

    Raises
    ------
    InputError
        If the plane has no `sigma`.

    Examples
    --------
    Light on a quarter of the pixels, one of which is saturated:

    >>> import numpy as np
    >>> from wavesim import Measurement
    >>> from wavesim.reconstruction.oversampling import pixels_in_light
    >>> amplitude, sigma = np.zeros((40, 40)), np.full((40, 40), 0.5)
    >>> amplitude[:20, :20], sigma[5, 5] = 10.0, np.inf
    >>> pixels_in_light(Measurement(0.0, amplitude, sigma))
    440
    """
    if plane.sigma is None:
        raise InputError("measurement: needs sigma, with which the light of a pixel is compared")
    rows, block = len(plane.amplitude), 256
    margin, count = NEIGHBOURHOOD // 2, 0
    # A few rows at a time, with those that their neighbourhoods need: planes of a whole field are large.
    for start in range(0, rows, block):
        first = max(start - margin, 0)
        part = slice(first, min(start + block + margin, rows))
        own = slice(start - first, min(start + block, rows) - first)
        deviation = intensity_deviation(
            replace(plane, amplitude=plane.amplitude[part], sigma=plane.sigma[part])
        )
        known = np.isfinite(deviation)
        weight = uniform_filter(known.astype(float), NEIGHBOURHOOD, mode="constant")
        intensity = np.where(known, np.square(plane.amplitude[part], dtype=float), 0.0)
        light = uniform_filter(intensity, NEIGHBOURHOOD, mode="constant")
        is_lit = known & (light > weight * np.where(known, deviation, 0.0))
        count += int(np.count_nonzero(is_lit[own]))
    return count


def measured_oversampling(
    recorded: Sequence[Measurement],
    plane_distances_mm: Sequence[float],
    *,
    kind: ObjectKind,
    support_mm: float,
    numerical_aperture: float,
    wavelength_um: float,
) -> Oversampling:
    """Return the oversampling ratio of measured planes.

    The pixels of a plane count up to four for each degree of freedom of the light. An intensity has no more
    (:mod:`lensdesign.analysis.oversampling`).

    Parameters
    ----------
    recorded
        Measured planes with standard deviations.
    plane_distances_mm
        Their distances from the exit vertex.
    kind
        "amplitude", "phase" or "complex".
    support_mm
        Diameter of the field stop.
    numerical_aperture
        Numerical aperture of the lens on the side of the object.
    wavelength_um
        Vacuum wavelength.

    Raises
    ------
    InputError
        If a plane has no standard deviations, or a value is out of range.
    """
    unknowns = real_unknowns(kind, support_mm, numerical_aperture, (wavelength_um,))
    most = INTENSITY_DEGREES * sbp_object(support_mm, numerical_aperture, wavelength_um)
    measured = tuple(min(float(pixels_in_light(plane)), most) for plane in recorded)
    return Oversampling(kind, support_mm, (wavelength_um,), 1, tuple(plane_distances_mm), measured, unknowns)
