"""Pixels of a growing aperture: light at small angles first, light at larger angles later.

The search for an amplitude object can stagnate in a local minimum, for example where most of the object is
dark or where fine bars fill it. Light at small angles reaches the middle of the sensor and depends on the
coarse parts of the object alone, which are found from almost any start. Each stage adds pixels around the
middle and starts from the object of the stage before. The same idea is used for inverse problems of other
waves, where stages add frequencies.

References
----------
C. Bunks, F. M. Saleck, S. Zaleski and G. Chavent, "Multiscale seismic waveform inversion", Geophysics 60,
1457 (1995).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

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
    for fraction in np.geomspace(FIRST_RADIUS, 1.0, STAGES):
        yield [_within(plane, float(fraction)) for plane in recorded]


def _within(plane: Measurement, fraction: float) -> Measurement:
    """Return a measurement whose pixels outside of a circle are unknown."""
    assert plane.sigma is not None
    rows, columns = (np.arange(count, dtype=float) for count in plane.amplitude.shape)
    weight = np.where(np.isfinite(plane.sigma), plane.amplitude.astype(float) ** 2, 0.0)
    total = max(float(weight.sum()), np.finfo(float).tiny)
    row, column = float(weight.sum(1) @ rows) / total, float(weight.sum(0) @ columns) / total
    radius = 0.5 * fraction * max(plane.amplitude.shape)
    inside = (rows[:, None] - row) ** 2 + (columns - column) ** 2 <= radius**2
    return replace(plane, sigma=np.where(inside, plane.sigma, np.inf).astype(plane.sigma.dtype))
