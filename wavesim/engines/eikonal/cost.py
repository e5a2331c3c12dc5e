"""Predicted time and memory of eikonal tiles, from the sizes of their grids.

Times are measured constants times the time of a pass over complex128 values (:mod:`wavesim.runtime.speed`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wavesim.engines.eikonal.flat_tiles import GROUP, coarse_is_used, coarse_steps_mm, precision_for
from wavesim.engines.eikonal.plan import Tile
from wavesim.engines.eikonal.residual import FACTOR_ORDER
from wavesim.engines.eikonal.super_tiles import SharedTileData, SuperTile
from wavesim.fields.resampling import kernel_for
from wavesim.rays.exit_planes import ExitPlane
from wavesim.rays.maps import BLOCK, RayMap
from wavesim.runtime.memory import COMPLEX64, COMPLEX128, FLOAT64
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds
from wavesim.runtime.threads import THREADS
from wavesim.scene.engine import Cost
from wavesim.scene.polarization import components_of
from wavesim.scene.scene import Scene

PROBE_SECONDS, MAP_SECONDS = {True: 0.015, False: 0.1}, {True: 0.004, False: 0.15}
"""Time to find the tile width, and to fit the maps of each tile, on a line (True) and on a plane (False)."""

EDGE_SECONDS, EDGE_PASSES = {True: 0.007, False: 0.02}, 350
"""Time to prepare the diffraction at the rim for each tile, and the number of complex products that take as
long as its evaluation at a sample of the plane."""

CARRY_PASSES, TAP_PASSES = 2.0, 0.55
"""Times per sample of a window, in complex products: for the carrier and the addition to the plane, and for
each tap of the interpolation from a coarse grid."""

BASE_BYTES, LEAST_BYTES = 100_000, {True: 1_500_000, False: 18_000_000}
"""Memory of the rays of one tile, and of the rays with the matrices of the polynomial fits, on a line and on
a plane."""


@dataclass(frozen=True)
class _Size:
    """Numbers of samples of one tile: object, coarse grid, nonuniform points, window on the plane.

    `between` counts the rows of the window on the columns of the coarse grid, `map_terms` the polynomials of
    its maps along one axis.
    """

    modes: int
    coarse: int
    between: int
    points: int
    window: int
    taps: int
    map_terms: int


def flat_cost(
    scene: Scene,
    plane: ExitPlane,
    tiles: Sequence[Tile],
    rank: int,
    low_rank: bool,
    mapper: Callable[[tuple[float, float]], RayMap],
    error: float,
) -> Cost:
    """Predict time and memory of flat tiles from the middle one; the time is that of complex128 fields."""
    middle = tiles[len(tiles) // 2]
    carrier = mapper(middle.centre_mm)
    size = _sizes(scene, plane, middle, carrier, error)
    count, shape = len(tiles), plane.grid.shape
    components = max(1, len(components_of(scene.polarization)))
    # Number of complex products that take as long as one nonuniform point.
    spread_passes = 60
    one = rank * (
        fft_seconds(4 * size.modes, scene.object_grid.is_line) + pass_seconds(spread_passes * size.points)
    )
    if not size.taps:
        one += components * pass_seconds(10 * size.window)
    # Slowdown of transforms that exceed a processor's cache, on a line and on a plane.
    spread_out = {True: 1.0, False: 2.4}
    one *= spread_out[scene.object_grid.is_line]
    if size.taps:
        carried = pass_seconds(round((CARRY_PASSES + TAP_PASSES * size.taps) * size.window)) / THREADS
        one += components * carried
    setup = MAP_SECONDS[scene.object_grid.is_line] + exponential_seconds(size.window)
    setup += 40.0 * pass_seconds(size.window + size.points)
    probing = PROBE_SECONDS[scene.object_grid.is_line]
    if carrier.edge is not None:
        edge = EDGE_SECONDS[scene.object_grid.is_line]
        setup, probing = setup + edge + pass_seconds(EDGE_PASSES * size.window), probing + edge
    beyond_seconds, beyond_bytes = 0.0, 0
    if plane.beyond is not None:
        beyond_seconds = plane.beyond.seconds
        beyond_bytes = plane.beyond.peak_bytes + COMPLEX128 * math.prod(shape)

    def peak_bytes(value_bytes: int) -> int:
        kept, passing = _bytes(size, rank, low_rank, len(shape), count, value_bytes)
        if components > 1:
            kept += value_bytes * components * size.points
            # Crossed components have a carrier in single precision.
            kept += COMPLEX64 * size.window if size.taps and value_bytes > COMPLEX64 else 0
        return max(LEAST_BYTES[scene.object_grid.is_line], count * kept + max(passing, beyond_bytes))

    return Cost(
        count * one + beyond_seconds,
        probing + count * setup,
        peak_bytes(COMPLEX128),
        peak_bytes(COMPLEX64),
    )


def hierarchical_cost(shared: SharedTileData, groups: Sequence[SuperTile]) -> Cost:
    """Predict time and memory of tiles in a hierarchy; values are complex64.

    Parameters
    ----------
    shared
        Data that all tiles share.
    groups
        Super-tiles of the field.
    """
    # Times in complex products: of a tile's maps for each sample of its grid, of its Fourier transform for
    # each sample and term, and of a propagated sample of a finer grid.
    map_passes, transform_passes, carry_passes = 130.0, 5.0, 5.0
    setup_seconds, least_seconds = 1.8, 0.2
    # Memory of polynomials and rays during the fit, and after it.
    fitting_bytes, fitted_bytes = 50_000_000, 18_000_000
    rank = len(shared.factors.tile_nodes)
    filled = 0.25 * math.pi
    seconds, largest, kept = least_seconds, 0, 0
    for group in groups:
        fine = math.prod(w.stop - w.start for w in group.window)
        coarse = math.prod(len(axis) for axis in group.axes)
        own = math.prod(group.tile_shape)
        lit = filled * math.prod(
            2.0 * h / s for h, s in zip(shared.half_width_mm, group.steps_mm, strict=True)
        )
        passes = len(group.tiles) * (
            map_passes * own + transform_passes * filled * rank * own + carry_passes * lit
        )
        seconds += pass_seconds(round(passes + carry_passes * filled * fine)) / THREADS
        kept += group.interpolation.nbytes
        tile = THREADS * own * (9 * FLOAT64 + 2 * rank * COMPLEX64)
        largest = max(largest, (THREADS + 1) * coarse * COMPLEX64 + tile)
    return Cost(seconds, setup_seconds, max(fitting_bytes, fitted_bytes + kept + largest))


def _sizes(scene: Scene, plane: ExitPlane, tile: Tile, carrier: RayMap, error: float) -> _Size:
    grid = plane.grid
    low, high = carrier.border_mm.min(axis=0), carrier.border_mm.max(axis=0)
    axes = (grid.y_mm, grid.x_mm)[: len(grid.shape)]
    ends = zip(low, high, axes, strict=True)
    sides = [float(np.clip(min(h, a[-1]) - max(b, a[0]), 0.0, None)) for b, h, a in ends]
    window = math.prod(math.ceil(side / grid.pitch_mm) + 1 for side in sides)
    modes = math.prod(len(o) for o in tile.offsets_mm)
    filled = 1.0 if grid.is_line else 0.25 * math.pi
    terms = int(carrier.maps.coefficients.shape[1])
    steps = coarse_steps_mm(carrier.bundle, tile.spans_mm, scene.wavenumber_per_mm)
    if not coarse_is_used(steps, axes):
        return _Size(modes, 0, 0, int(filled * window), window, 0, terms)
    taps = kernel_for(precision_for(np.dtype(complex), error).interpolation_error).taps
    along = [math.ceil(side / step) + taps + 1 for side, step in zip(sides, steps, strict=True)]
    coarse, between = math.prod(along), (math.ceil(sides[0] / grid.pitch_mm) + 1) * along[1]
    return _Size(modes, coarse, between, int(filled * coarse), window, taps, terms)


def _bytes(
    size: _Size, rank: int, low_rank: bool, dimensions: int, count: int, value_bytes: int
) -> tuple[int, int]:
    """Return the memory that each of `count` tiles keeps, and the temporary memory of its set-up and use."""
    # Memory of both transforms of a tile for each point and dimension.
    point_bytes = 24
    # Both transforms keep the positions of their points in double precision, and a permutation of them.
    kept = value_bytes * rank * (size.modes + size.points) + point_bytes * dimensions * size.points
    kept += value_bytes * size.window + size.coarse if size.taps else size.window
    making = (2 * value_bytes * rank + FLOAT64 * (3 * dimensions + 3)) * size.points
    if dimensions == 1:
        making = max(making, (5 * FLOAT64 + 3 * COMPLEX128) * size.window)
        terms = size.map_terms * FLOAT64
        if low_rank:
            terms = max(terms, (FACTOR_ORDER[True] + 1) * (FLOAT64 + COMPLEX128))
        making += min(size.points, BLOCK) * terms
    elif size.taps:
        making = max(making, (COMPLEX64 + 1) * size.window)
    own = size.coarse if size.taps else size.window
    using = min(count, THREADS) * value_bytes * (2 * rank * size.points + rank * size.modes + own)
    waiting = value_bytes * (min(count, GROUP) * own + size.between)
    return kept, max(making, using + waiting) + BASE_BYTES
