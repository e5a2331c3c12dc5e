"""Predicted time and memory of the wave propagation method, from the sizes of its grid."""

from __future__ import annotations

from collections.abc import Sequence

from wavesim.engines.surfaces.grids import WorkingGrid
from wavesim.engines.surfaces.waves import planes_across
from wavesim.engines.wpm.staircase import planes
from wavesim.runtime.memory import COMPLEX128, FLOAT64
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds


def passage_cost(working: WorkingGrid, steps_mm: Sequence[float], interface: str) -> tuple[float, int]:
    """Return seconds of one propagation through all surfaces, and peak bytes, including stored arrays."""
    if interface == "staircase":
        return _staircase_cost(working, steps_mm[0])
    grid, line, samples = working.grid, working.grid.is_line, working.samples_on_surfaces
    seconds, largest = 0.0, 0.0
    for i, (low, high) in enumerate(working.heights_mm):
        slopes = len(grid.shape) if high > low else 0
        front, behind = (planes_across(high - low, steps_mm[m]) for m in (i, i + 1))
        for count, times in ((front, 1), (behind, 1 + slopes)):
            one = count * (fft_seconds(grid.size, line) + 2.0 * pass_seconds(grid.size))
            shares = 4 * samples[i] if slopes else samples[i]
            one += exponential_seconds(shares) + 6.0 * pass_seconds(shares)
            seconds += times * (one + 3.0 * exponential_seconds(grid.size))
        largest = max(largest, COMPLEX128 * ((4.0 if slopes else 3.0) * grid.size + 3.0 * samples[i]))
    seconds += 2.0 * fft_seconds(grid.size, line)
    return seconds, int(largest) + kept_bytes(working)


def setup_cost(working: WorkingGrid) -> tuple[float, int]:
    """Return seconds and peak bytes of the sampling of all surfaces."""
    size, samples = working.grid.size, max(working.samples_on_surfaces)
    seconds = 0.01 if working.grid.is_line else 0.02
    # Time to evaluate a polynomial for the transmission, in complex products.
    polynomial_passes = 150.0
    for count in working.samples_on_surfaces:
        seconds += 40.0 * pass_seconds(count) + 6.0 * pass_seconds(size)
        if not working.grid.is_line:
            seconds += polynomial_passes * pass_seconds(count)
    return seconds, 3 * FLOAT64 * size + 25 * FLOAT64 * samples + kept_bytes(working)


def kept_bytes(working: WorkingGrid) -> int:
    """Return the memory of the media's axial wavenumbers, the samples of the surfaces, and the rays."""
    media = (FLOAT64 + 1) * working.grid.size * len(working.media)
    # Memory of the rays of the object's centre.
    ray_bytes = 250_000
    return ray_bytes + media + FLOAT64 * (3 + len(working.grid.shape)) * sum(working.samples_on_surfaces)


def _staircase_cost(working: WorkingGrid, step_mm: float) -> tuple[float, int]:
    size, line, surfaces = working.grid.size, working.grid.is_line, len(working.heights_mm)
    steps = len(planes(working.heights_mm, step_mm))
    each = 3.0 * (fft_seconds(size, line) + exponential_seconds(size)) + pass_seconds(14 * size)
    held = 2 * FLOAT64 * surfaces * size
    return steps * each, kept_bytes(working) + held + (4 * COMPLEX128 + 2 * FLOAT64) * size
