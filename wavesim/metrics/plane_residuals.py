"""Residuals of a result on one recording plane."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


class PlaneResidual(NamedTuple):
    """Residuals of a result on one recording plane.

    Attributes
    ----------
    distance_mm : float
        Distance of the plane from the exit vertex in mm.
    amplitude, sigma : ndarray, shape (ny, nx)
        Measured amplitude and its standard deviation; infinite in pixels that are unknown or were not used.
    error : ndarray, shape (ny, nx)
        Modelled minus measured amplitude.
    held : ndarray of int
        Flat indices of the pixels that were held out.
    held_sigma : ndarray
        Standard deviations of these pixels.
    engine_error : ndarray, shape (ny, nx), optional
        Amplitude of a more accurate engine minus that of the engine used, if it was computed.
    """

    distance_mm: float
    amplitude: Array
    sigma: Array
    error: Array
    held: NDArray[np.intp]
    held_sigma: Array
    engine_error: Array | None = None
