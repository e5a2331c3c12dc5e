"""Position of an object on a dark ground, where hardly anything but the lens's aberrations tells it.

The rim of the field stop shows where an object on a clear ground lies. On a dark ground, the total variation
holds edges between two samples, so that the object stays where the first iterations have put it, and the
bench follows it. Trials displace the object by whole samples, with the bench that follows. The one with the
smallest misfit is the better position. Displacements whose misfits count as equal tell how far the position
is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from wavesim.fields.field import Field

MisfitAt = Callable[[int, int], float]
"""Misfit with the object displaced by a number of samples along x and y."""

TRIED = (1, 2, 3, 5, 8)
"""Displacements in samples that are tried to both sides along each line."""

LINES = ((1, 0), (0, 1), (1, 1), (1, -1))
"""Directions of lines along which displacements are tried."""


def is_dark_at_rim(transmission: NDArray[np.floating], light: Field) -> bool:
    """Return whether an object passes hardly any light at the rim of the field stop.

    Parameters
    ----------
    transmission : ndarray, shape (ny, nx)
        Transmission of an amplitude object.
    light
        Illumination of the object.
    """
    # Width of the rim over the side, and mean square transmission there over that everywhere: objects on a
    # dark ground have 0.001 at most, others 0.8 at least.
    width, least_ratio = 0.05, 0.1
    power = np.abs(light.values) ** 2
    inside = power > 0.25 * np.median(power[power > 0.01 * power.max()])
    steps = max(round(width * len(power)), 1)
    rim = inside & ~scipy.ndimage.binary_erosion(inside, iterations=steps)
    passed = transmission.astype(float) ** 2
    return float(passed[rim].mean()) < least_ratio * float(passed[inside].mean())


def better_position(misfit_at: MisfitAt) -> tuple[int, int]:
    """Return the displacement (x, y) in samples with the smallest misfit, sought line by line.

    Parameters
    ----------
    misfit_at
        Misfits of displaced objects, after a few iterations.
    """
    # Fraction by which a displacement must lower the misfit.
    least_gain = 1e-3
    x = y = 0
    misfit = misfit_at(x, y)
    for along_x, along_y in LINES:
        places = [(x + sign * n * along_x, y + sign * n * along_y) for n in TRIED for sign in (-1, 1)]
        lowest, place = min((misfit_at(*place), place) for place in places)
        if lowest < (1.0 - least_gain) * misfit:
            misfit, (x, y) = lowest, place
    return x, y


def position_deviations(misfit_at: MisfitAt, tolerated_ratio: float) -> tuple[float, float]:
    """Return the standard deviation of the position along x and y in samples.

    Positions between the outermost ones that count as equal are equally probable. The deviation is that from
    the present position, and a lower limit where the outermost one that is tried counts as equal.

    Parameters
    ----------
    misfit_at
        Misfits of displaced objects, after a few iterations.
    tolerated_ratio
        Ratio of misfits up to which positions count as equal.
    """
    largest = tolerated_ratio * misfit_at(0, 0)

    def reach(x: int, y: int) -> int:
        equal = [n for n in TRIED if misfit_at(n * x, n * y) <= largest]
        return max(equal, default=0)

    def deviation(one: int, other: int) -> float:
        return math.sqrt((one**3 + other**3) / (3.0 * max(one + other, 1)))

    return deviation(reach(-1, 0), reach(1, 0)), deviation(reach(0, -1), reach(0, 1))
