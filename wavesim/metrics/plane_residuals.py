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
        From the exit vertex.
    amplitude, sigma : ndarray, shape (ny, nx)
        As recorded, and its standard deviation: infinite in pixels that say nothing or were not used.
    error : ndarray, shape (ny, nx)
        The result's amplitude less the recorded one.
    held : ndarray of int
        Flat indices of pixels that were not used.
    held_sigma : ndarray
        Their standard deviations.
    engine_error : ndarray, shape (ny, nx), optional
        Amplitude by a more accurate engine less that of the engine used, where that was computed.
    """

    distance_mm: float
    amplitude: Array
    sigma: Array
    error: Array
    held: NDArray[np.intp]
    held_sigma: Array
    engine_error: Array | None = None
