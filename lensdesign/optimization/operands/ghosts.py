"""Operands of ghosts: power that two surfaces of lens, cover glass and sensor reflect onto the sensor.

The power is that of :func:`lensdesign.analysis.double_reflections.ghost_paths` at the first wavelength, for
the lens as designed. The search computes it with fewer rays, whose apertures fade, and takes derivatives by
finite differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lensdesign.analysis.double_reflections import GhostSampling, ghost_paths
from lensdesign.common.arrays import Array
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens

GHOST_MARGIN = 0.03
"""Relative margin of the search, because its few rays differ from those of the check."""

_SEARCH_SAMPLING = GhostSampling(fields=2, directions=400, edge_width=0.2)


@dataclass(frozen=True)
class GhostValues:
    """Ghosts of a lens of the search: p recording planes, v variables.

    Attributes
    ----------
    fractions, fractions_by : ndarray, shapes (p,) and (p, v)
        Power of all ghosts on the sensor relative to the direct light, and its derivatives; NaN if no light
        passes the lens.
    """

    fractions: Array
    fractions_by: Array


def ghost_values(
    lens_at: Callable[[Array], Lens], point: Array, width: Array, derivatives: bool
) -> GhostValues:
    """Return the ghosts at a point of the unit box of a search.

    Parameters
    ----------
    lens_at
        Function that returns the lens at a point, with the apertures that its rays need.
    point
        Point of the unit box.
    width
        Ranges of the variables, by which derivatives are divided.
    derivatives
        Whether derivatives are needed.
    """
    fractions = _fractions(lens_at(point))
    if not derivatives:
        return GhostValues(fractions, np.zeros((len(fractions), 0)))
    step = 1e-4  # of the box; a larger one would not be consistent with the noise of rays at edges
    by = np.empty((len(fractions), len(point)))
    for k in range(len(point)):
        inward = -step if point[k] > 0.5 else step
        moved = lens_at(point + inward * np.eye(len(point))[k])
        by[:, k] = (_fractions(moved) - fractions) / (inward * width[k])
    return GhostValues(fractions, by)


def _fractions(lens: Lens) -> Array:
    planes_mm = lens.sensor.plane_distances_mm
    try:
        totals = ghost_paths(lens, sampling=_SEARCH_SAMPLING).totals
    except TransferLensError:  # no light passes
        return np.full(len(planes_mm), np.nan)
    return np.array([totals[plane_mm] for plane_mm in planes_mm])
