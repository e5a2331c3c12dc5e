"""Pixels of a growing aperture: light at small angles first, light at larger angles later.

The search for an amplitude or phase object can stagnate in a local minimum, for example where most of the
object is dark, where fine bars fill it, or where its phase is strong. Light at small angles reaches the
middle of the sensor and depends on the coarse parts of the object alone, which are found from almost any
start. Each stage adds pixels around the middle and starts from the object of the stage before. The same idea
is used for inverse problems of other waves, where stages add frequencies.

References
----------
C. Bunks, F. M. Saleck, S. Zaleski and G. Chavent, "Multiscale seismic waveform inversion", Geophysics 60,
1457 (1995).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wavesim.sensor.measurement import Measurement

STAGES = 12
"""Number of stages. With 8 stages some objects on a dark ground are missed."""

STAGE_ITERATIONS = 40
"""Largest number of iterations of a stage. With 15 an object may not follow the aperture."""

FIRST_RADIUS = 0.1
"""Radius of the first stage over half the longer side of the pixels' grid."""


def aperture_stages(recorded: Sequence[Measurement]) -> Iterator[list[Measurement]]:
    """Yield the measurements of each stage: pixels outside of a growing circle are unknown.

    Parameters
    ----------
    recorded
        Measured planes with `sigma`. A circle is centred on the centroid of the measured intensity.

    Yields
    ------
    list of Measurement
        All planes, with an infinite standard deviation outside of the circle.
    """
    radii = [_relative_radius(plane) for plane in recorded]
    for fraction in np.geomspace(FIRST_RADIUS, 1.0, STAGES):
        yield [_within(plane, radius <= fraction) for plane, radius in zip(recorded, radii, strict=True)]


def _relative_radius(plane: Measurement) -> NDArray[np.float64]:
    """Return the distance of each pixel from the centroid of the light, over half the longer side."""
    assert plane.sigma is not None
    rows, columns = (np.arange(count, dtype=float) for count in plane.amplitude.shape)
    weight = np.where(np.isfinite(plane.sigma), plane.amplitude.astype(float) ** 2, 0.0)
    total = max(float(weight.sum()), np.finfo(float).tiny)
    row, column = float(weight.sum(1) @ rows) / total, float(weight.sum(0) @ columns) / total
    return np.hypot(rows[:, None] - row, columns - column) / (0.5 * max(plane.amplitude.shape))


def _within(plane: Measurement, inside: NDArray[np.bool_]) -> Measurement:
    """Return a measurement whose pixels outside of a region are unknown."""
    assert plane.sigma is not None
    return replace(plane, sigma=np.where(inside, plane.sigma, np.inf).astype(plane.sigma.dtype))
