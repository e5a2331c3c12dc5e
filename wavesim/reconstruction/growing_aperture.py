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

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.reconstruction.object_solver import Reconstructed
from wavesim.scene.settings import ITERATIONS
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


class StageSolver(Protocol):
    """Finds the object from the measurements of a stage, from a start, with so many iterations at most."""

    def __call__(
        self, given: Sequence[Measurement], start: Field | None, iterations: int
    ) -> Reconstructed: ...


def with_growing_aperture(
    solve: StageSolver,
    given: Sequence[Measurement],
    light: Field,
    *,
    iterations: int = ITERATIONS["object"],
    knows_scale: bool = False,
    on_stage: Callable[[int], None] = lambda stage: None,
) -> Reconstructed:
    """Return the object from all pixels, after the stages of a growing aperture.

    Parameters
    ----------
    solve
        Solver of one stage.
    given
        Measured planes with `sigma`.
    light
        Illumination of the object.
    iterations
        Largest number of iterations from all pixels.
    knows_scale
        Whether the scale of the amplitudes is known. Otherwise each stage starts from an object whose
        brightest parts are 1.
    on_stage
        Callback with the index of a stage, called before it.
    """
    start: Field | None = None
    for index, planes in enumerate(aperture_stages(given)):
        on_stage(index)
        found = solve(planes, start, min(STAGE_ITERATIONS, iterations)).transmission
        start = found if knows_scale else _brightest_is_1(found, light)
    return solve(given, start, iterations)


def _brightest_is_1(transmission: Field, light: Field) -> Field:
    """Return a transmission, known up to a factor, whose brightest lit parts are 1."""
    # A few samples at edges may exceed the brightest parts.
    brightest = float(np.quantile(np.abs(transmission.values[light.values != 0.0]), 0.99))
    return transmission if brightest == 0.0 else transmission.with_values(transmission.values / brightest)


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
