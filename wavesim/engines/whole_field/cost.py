"""What eikonal tiles in two levels take, told from the sizes of their grids."""

from __future__ import annotations

import math
from collections.abc import Sequence

from wavesim.engines.whole_field.tiles import SuperTile, WholeFieldSettings
from wavesim.runtime.memory import COMPLEX64, FLOAT64
from wavesim.runtime.speed import pass_seconds
from wavesim.runtime.threads import THREADS
from wavesim.scene.engine import Cost
from wavesim.scene.scene import Scene

MAP_PASSES, TRANSFORM_PASSES, CARRY_PASSES = 370.0, 45.0, 33.0
"""Complex products (of complex128) as which count: a tile's maps, for each sample of its grid; its Fourier
transform, for each sample and term; a carried sample of a finer grid. Measured."""

SETUP_SECONDS, LEAST_SECONDS = 1.8, 0.2
BASE_BYTES = 60_000_000
"""Of polynomials and rays, while they are fitted."""


def whole_field_cost(scene: Scene, settings: WholeFieldSettings, groups: Sequence[SuperTile]) -> Cost:
    """Seconds of one use and of the set-up, and most bytes at one time beside argument and result.

    Parameters
    ----------
    scene, settings
        The field.
    groups
        Its super-tiles.
    """
    rank = len(settings.factors.tile_nodes)
    filled = 0.25 * math.pi
    seconds, largest = LEAST_SECONDS, 0
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
        rows = group.window[0].stop - group.window[0].start
        summing = (THREADS + 1) * coarse * COMPLEX64
        back = (rows * len(group.axes[1]) + coarse) * COMPLEX64
        tile = THREADS * own * (9 * FLOAT64 + 2 * rank * COMPLEX64)
        largest = max(largest, max(summing, back) + tile)
    return Cost(seconds, SETUP_SECONDS, BASE_BYTES + largest)
