"""Predicted time and memory of the sliced method, from the sizes of its grids."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import scipy.fft

from wavesim.engines.slices.samples import BLOCK, index_type
from wavesim.engines.slices.windows import BLOCK_BYTES, TRANSFER_FINENESS, Waves
from wavesim.engines.surfaces.grids import LightExtent
from wavesim.runtime.memory import COMPLEX128, FLOAT64
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds
from wavesim.runtime.threads import THREADS
from wavesim.scene.engine import Cost
from wavesim.scene.scene import Scene


def slices_cost(
    scene: Scene,
    sides: Sequence[tuple[Waves, Waves]],
    light: LightExtent,
    slices: int,
    unit: int,
    equal_steps: bool,
) -> Cost:
    """Return time and memory of one propagation through all surfaces, and of the set-up.

    Parameters
    ----------
    scene, sides, light
        Scene, plane waves on both sides of each surface, and extent of the light.
    slices
        Number of slices of each surface.
    unit
        Bytes of a sample.
    equal_steps
        Whether the steps between planes are equal.
    """
    is_line = scene.object_grid.is_line
    squares = [_square(front, reach) for (front, _), reach in zip(sides, light.reach_mm, strict=True)]
    images = (unit + index_type(slices).itemsize) * sum(rows * columns for rows, columns in squares)
    counts = [slices if high > low else 1 for low, high in light.heights_mm]
    seconds, working = _ends(scene, sides, unit)
    # Mean width of the part of a window in which a slice lies, relative to the width of the whole surface.
    mean_width = 0.75
    # Complex arrays of a block of samples while a slice is processed.
    block_arrays = 5
    for (front, behind), square, count in zip(sides, squares, counts, strict=True):
        samples, length = front.grid.size, front.grid.shape[0]
        rows, width = max(front.shape[0], behind.shape[0]), square[1]
        factors = (front.size + behind.size) // (2 if is_line else 4)
        kept = front.size + behind.size + rows * width + factors
        block = (
            min(THREADS, _blocks(length * width)) * block_arrays * min(_block_samples(length), length * width)
        )
        working = max(working, unit * (kept + block))
        inner = 2.0 * mean_width * width * length if not is_line else 2.0 * samples
        outer = 0.0 if is_line else float(length * (front.shape[0] + behind.shape[0]))
        each = (1.0 if is_line else 0.5) * fft_seconds(int(inner + outer), is_line)
        each += 2.0 * pass_seconds(int(inner + outer))
        seconds += (count if equal_steps else 2 * count) * exponential_seconds(1 if equal_steps else factors)
        seconds += count * each + 2.0 * exponential_seconds(factors)
    for (_, before), (front, _) in pairwise(sides):
        if before.grid != front.grid:
            between = math.ceil(
                front.size * before.size / min(front.size, before.size) / TRANSFER_FINENESS**2
            )
            seconds += 4.0 * fft_seconds(2 * between, is_line)
            working = max(working, unit * (front.size + before.size + max(front.size, before.size)))
    samples = sum(rows * columns for rows, columns in squares)
    most = max(rows * columns for rows, columns in squares)
    # Real arrays of a block of samples while the slices are prepared, on a line and on a plane.
    made_arrays = {True: 36, False: 18}
    made = made_arrays[is_line] * FLOAT64 * min(most, THREADS * BLOCK)
    setup = 0.006 + 8.0 * exponential_seconds(samples)
    # Memory of the rays and their polynomials, on a line and on a plane.
    fit_bytes = {True: 750_000, False: 4_400_000}
    return Cost(seconds, setup, int(images + max(working, made, fit_bytes[is_line])))


def _ends(scene: Scene, sides: Sequence[tuple[Waves, Waves]], unit: int) -> tuple[float, int]:
    """Return seconds and bytes of the propagation from the object and to the exit."""
    seconds, most = 0.0, 0
    for waves, grid in ((sides[0][0], scene.object_grid), (sides[-1][1], scene.exit_grid)):
        length = scipy.fft.next_fast_len(waves.shape[0] + grid.shape[0])
        others = max(waves.shape[0], grid.shape[0]) + min(waves.shape[0], grid.shape[0])
        lines = 1 if grid.is_line else others
        seconds += 2.0 * fft_seconds(length * lines, True) + 4.0 * exponential_seconds(waves.size)
        work = 6 * length
        if not grid.is_line:
            row = 4 * (waves.shape[0] + grid.shape[0])
            work = min(row * others, max(BLOCK_BYTES // COMPLEX128, 8 * row))
        most = max(most, unit * (2 * waves.size + work))
    return seconds, most


def _square(waves: Waves, reach_mm: float) -> tuple[int, int]:
    """Return rows and columns of the part of a window that light reaches."""
    side = [min(n, math.ceil(2.0 * reach_mm / waves.grid.pitch_mm)) for n in waves.grid.shape]
    return side[0], (*side, 1)[1]


def _block_samples(length: int) -> int:
    return length * max(BLOCK_BYTES // (COMPLEX128 * length), 8)


def _blocks(samples: int) -> int:
    return max(1, samples // (BLOCK_BYTES // COMPLEX128))
