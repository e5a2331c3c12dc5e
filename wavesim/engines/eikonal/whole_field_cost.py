"""Predicted time and memory of eikonal tiles in two levels, from the sizes of their grids."""

from __future__ import annotations

import math
from collections.abc import Sequence

from wavesim.engines.eikonal.carrier_interpolation import CarrierInterpolation
from wavesim.engines.eikonal.super_tiles import SuperTile, WholeFieldSettings
from wavesim.runtime.memory import COMPLEX64, FLOAT64
from wavesim.runtime.speed import pass_seconds
from wavesim.runtime.threads import THREADS
from wavesim.scene.engine import Cost
from wavesim.scene.scene import Scene

MAP_PASSES, TRANSFORM_PASSES, CARRY_PASSES = 130.0, 5.0, 5.0
"""Time in complex products (complex128), as measured: of a tile's maps for each sample of its grid, of its
Fourier transform for each sample and term, and of a propagated sample of a finer grid."""

SETUP_SECONDS, LEAST_SECONDS = 1.8, 0.2
FITTING_BYTES, FITTED_BYTES = 50_000_000, 18_000_000
"""Memory of polynomials and rays during the fit, and after it."""


def whole_field_cost(scene: Scene, settings: WholeFieldSettings, groups: Sequence[SuperTile]) -> Cost:
    """Return time of one use and of the set-up, and peak memory without argument and result.

    Parameters
    ----------
    scene, settings
        Scene and common settings of the tiles.
    groups
        Super-tiles of the field.
    """
    rank = len(settings.factors.tile_nodes)
    filled = 0.25 * math.pi
    seconds, largest, kept = LEAST_SECONDS, 0, 0
    for group in groups:
        fine = math.prod(w.stop - w.start for w in group.window)
        coarse = math.prod(len(axis) for axis in group.axes)
        own = math.prod(group.tile_shape)
        lit = filled * math.prod(
            2.0 * h / s for h, s in zip(settings.half_width_mm, group.steps_mm, strict=True)
        )
        passes = len(group.tiles) * (
            MAP_PASSES * own + TRANSFORM_PASSES * filled * rank * own + CARRY_PASSES * lit
        )
        seconds += pass_seconds(round(passes + CARRY_PASSES * filled * fine)) / THREADS
        kept += interpolation_bytes(group.interpolation)
        tile = THREADS * own * (9 * FLOAT64 + 2 * rank * COMPLEX64)
        largest = max(largest, (THREADS + 1) * coarse * COMPLEX64 + tile)
    return Cost(seconds, SETUP_SECONDS, max(FITTING_BYTES, FITTED_BYTES + kept + largest))


def interpolation_bytes(interpolation: CarrierInterpolation) -> int:
    """Return the memory that a super-tile keeps for its propagation to the plane."""
    weights = interpolation.weights
    arrays = [*weights.first, *weights.smooth_weights, interpolation.phase_waves, interpolation.edge]
    arrays += [a for axis in weights.field for a in (axis.first, axis.weight, *axis.adjoint)]
    return sum(int(array.nbytes) for array in arrays)
