"""Edges of an object, which the total variation may hold in wrong places.

A search with total variation from its first iteration keeps edges where the first iterations have put them.
Charts with dense strokes and textures then end in a local minimum whose misfit is clearly above that of
noise. Without total variation, edges move to where the frames have them, but noise remains, which the total
variation removes afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from wavesim.reconstruction.object_solver import Reconstructed

RIGHT_MISFIT = 1.03
"""Misfit over that of noise up to which edges are right. With one exposure, the total variation alone
leaves 1.01 to 1.03; with long exposures it can leave more.
"""


def with_free_edges(
    search: Callable[[], Reconstructed], found: Reconstructed, misfit_of_noise: float | None
) -> Reconstructed:
    """Return the object found, or one whose first iterations had no total variation.

    Parameters
    ----------
    search
        Searches anew, without total variation at first.
    found
        The object found.
    misfit_of_noise
        Misfit of noise alone (:func:`wavesim.sensor.measurement.noise_misfit`); None if it is not known.

    Returns
    -------
    Reconstructed
        The object itself if its misfit is nearly that of noise or not larger than that of the new search.
        Otherwise the new one, with the misfits of all iterations.
    """
    if misfit_of_noise is None or found.misfit[-1] <= RIGHT_MISFIT * misfit_of_noise:
        return found
    other = search()
    if other.misfit[-1] >= found.misfit[-1]:
        return found
    return replace(other, misfit=found.misfit + other.misfit)
