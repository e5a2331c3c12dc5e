"""Position of an object, which a search may miss by about a sample.

Planes with little diversity hardly tell where an object is. The total variation prefers edges between two
samples to edges within one, and may hold the object where the first iterations have put it. Misfits of
displaced objects, each after a few iterations, tell where the frames prefer it. If the misfit is lower there,
the search continues from there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.reconstruction.object_solver import Reconstructed
from wavesim.reconstruction.stop_rule import FAR, TOLERANCE

PARABOLA_ITERATIONS, TRIAL_ITERATIONS = 2, 4
"""Iterations after which the misfits of the parabola are read, and those at two positions are compared."""

MOST_MOVES = 6
"""Largest number of displacements, which bounds the time."""

Array = NDArray[np.inexact]
Displacement = tuple[float, float]


class PositionSolver(Protocol):
    """Continues a search from a start at a stated scale.

    Without a number of iterations, it searches until it has converged.
    """

    def __call__(self, start: Field, scale: float, *, iterations: int | None = None) -> Reconstructed: ...


def at_best_position(
    solve: PositionSolver, found: Reconstructed, light: Field, misfit_of_noise: float | None
) -> Reconstructed:
    """Return the object at the position that the frames prefer.

    Parameters
    ----------
    solve
        Continues the search.
    found
        The object found.
    light
        Illumination of the object.
    misfit_of_noise
        Misfit of noise alone; None if it is not known.

    Returns
    -------
    Reconstructed
        The object itself if no position near it has a lower misfit, or if its misfit is far from that of
        noise, which has other causes than the position. Otherwise the object that the search finds from the
        best position, with the misfits of all iterations that led to it.
    """
    power = np.abs(light.values) ** 2
    lit = power > 1e-6 * power.max()
    for _ in range(MOST_MOVES):
        if misfit_of_noise is None or found.misfit[-1] > FAR * misfit_of_noise:
            break
        displacement = _preferred_displacement(solve, found, lit)
        if displacement == (0.0, 0.0):
            break
        moved = _continued(solve, found, lit, displacement, TRIAL_ITERATIONS)
        unmoved = _continued(solve, found, lit, (0.0, 0.0), TRIAL_ITERATIONS)
        if moved.misfit[-1] > (1.0 - TOLERANCE) * unmoved.misfit[-1]:
            break
        after = solve(moved.transmission, moved.scale)
        found = replace(after, misfit=found.misfit + moved.misfit + after.misfit)
    return found


def _preferred_displacement(
    solve: PositionSolver, found: Reconstructed, lit: NDArray[np.bool_]
) -> Displacement:
    """Return the displacement by a sample that lowers the misfit most.

    If none lowers it, return the one at which parabolas of the misfit have their minimum, in half samples.
    """
    steps = ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))
    rises = np.array(
        [
            _continued(solve, found, lit, step, PARABOLA_ITERATIONS).misfit[-1] - found.misfit[-1]
            for step in steps
        ]
    )
    if rises.min() < -TOLERANCE * found.misfit[-1]:
        return steps[int(rises.argmin())]
    low, high = rises.reshape(2, 2).T  # at -1 and +1 samples along each axis
    bend = np.maximum(low + high, TOLERANCE * found.misfit[-1])
    y, x = np.round((low - high) / bend).clip(-2.0, 2.0) / 2.0
    return float(y), float(x)


def _continued(
    solve: PositionSolver,
    found: Reconstructed,
    lit: NDArray[np.bool_],
    displacement: Displacement,
    iterations: int,
) -> Reconstructed:
    """Return the result of further iterations from a displaced object."""
    values = _displaced(found.transmission.values, lit, displacement)
    return solve(found.transmission.with_values(values), found.scale, iterations=iterations)


def _displaced(values: Array, lit: NDArray[np.bool_], displacement: Displacement) -> Array:
    """Return values displaced by a number of samples; those that come from unlit samples stay."""
    moved = scipy.ndimage.shift(values, displacement, order=1)
    weight = scipy.ndimage.shift(lit.astype(float), displacement, order=1)
    is_known = lit & (weight > 0.5)
    return np.where(is_known, moved / np.where(is_known, weight, 1.0), values).astype(values.dtype)
