"""Object with less bias of the total variation, by which a result is judged.

The total variation reduces the contrast of fine detail, which long exposures measure far more precisely than
its automatic weight assumes. Its iterations then converge above the misfit of noise although the object is
right, and what they leave resembles a displaced bench. A judged copy of the object therefore continues with
half of the weight, up to three times, until the misfit is that of noise (discrepancy principle). The copy
fits more noise than the object, and normally serves the verdict alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from wavesim.fields.field import Field
from wavesim.reconstruction.object_solver import Reconstructed
from wavesim.reconstruction.stop_rule import AT_NOISE

LARGEST_BIAS, LEAST_FACTOR = 2.0, 0.125
"""Misfit over that of noise up to which the total variation may be its cause, and the smallest
factor of its weight. A larger misfit has other causes.
"""

LARGEST_SHOWN = 1.04
"""Misfit over that of noise above which the first copy is shown, if its own misfit is not above it."""


class WeightedSolver(Protocol):
    """Continues the search from a start, with a factor of the total variation's weight and an upper limit of
    the iterations.
    """

    def __call__(self, start: Field, scale: float, factor: float, iterations: int) -> Reconstructed: ...


def with_less_bias(
    solve: WeightedSolver, found: Reconstructed, misfit_of_noise: float | None, iterations: int
) -> tuple[Reconstructed, Reconstructed]:
    """Return the object that is shown, and the one that is judged.

    Parameters
    ----------
    solve
        Continues the search.
    found
        The object found, with an automatic weight of the total variation.
    misfit_of_noise
        Misfit of noise alone (:func:`wavesim.sensor.measurement.noise_misfit`); None if it is not known.
    iterations
        Largest number of iterations of all copies.

    Returns
    -------
    shown : Reconstructed
        The object found, or the first copy where the total variation was the cause of a misfit above
        `LARGEST_SHOWN`: half of its weight brings the misfit below.
    judged : Reconstructed
        The object found if its misfit is that of noise, if it is far above, or if it has not converged;
        otherwise the last copy.
    """
    factor, shown, judged = 1.0, found, found
    while factor > LEAST_FACTOR and may_be_biased(judged.misfit[-1], misfit_of_noise):
        left = iterations + len(found.misfit) - len(judged.misfit)
        if left <= 0 or judged.stopped_because == "iterations":
            break
        factor *= 0.5
        before = judged
        judged = solve(before.transmission, before.scale, factor, left)
        judged = replace(judged, misfit=before.misfit + judged.misfit)
        limit = LARGEST_SHOWN * (misfit_of_noise or 0.0)
        if before is found and judged.misfit[-1] <= limit < found.misfit[-1]:
            shown = judged
    return shown, judged


def may_be_biased(misfit: float, misfit_of_noise: float | None) -> bool:
    """Return whether an automatic total variation may cause the misfit that a converged search leaves."""
    return misfit_of_noise is not None and AT_NOISE < misfit / misfit_of_noise < LARGEST_BIAS
