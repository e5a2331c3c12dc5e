"""Window of each surface, and the plane waves that it holds.

A window is periodic, so that its plane waves have whole orders. Each medium keeps the orders within its band:
few of many behind a lens that emits light in a narrow cone. Between grids the field is represented by these
waves only. Fourier sums along one axis after the other, some rows or columns at a time, convert it, so that
no array has more samples than the larger one of both grids.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wavesim.engines.surfaces.grids import LightExtent, sampled
from wavesim.engines.surfaces.waves import Medium
from wavesim.fields.chirp_z import chirp_z_transform
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import BandLimit, Samples, centres_mm
from wavesim.scene.scene import Scene

TRANSFER_FINENESS = 0.9
"""Pitch for the transfer between two windows, as a fraction of the coarsest that samples the field."""

BLOCK_BYTES = 1 << 22
"""Size of a block of rows or columns that is processed at a time."""


@dataclass(frozen=True)
class Waves:
    """Plane waves of a medium in a window, by their orders along each axis: from -m to m, ascending.

    Attributes
    ----------
    medium : Medium
        Medium; its grid is the window's.
    """

    medium: Medium

    @property
    def grid(self) -> Grid:
        """Samples of the window."""
        return self.medium.grid

    @property
    def orders(self) -> tuple[int, ...]:
        """Highest order along each axis."""
        return tuple(self._highest_order(n, self.medium.band_per_mm) for n in self.grid.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a spectrum."""
        return tuple(2 * m + 1 for m in self.orders)

    @property
    def size(self) -> int:
        """Number of waves, including those in the corners beyond the band."""
        return math.prod(self.shape)

    @property
    def area(self) -> float:
        """Area of the window, or its side on a line."""
        return math.prod(2.0 * half for half in self.grid.half_widths_mm)

    def frequencies(self, orders: Sequence[int]) -> list[Samples]:
        """Return the frequencies in cycles per mm along each axis, up to some orders."""
        sides = (2.0 * half for half in self.grid.half_widths_mm)
        return [Samples(0.0, 1.0 / side, 2 * m + 1) for side, m in zip(sides, orders, strict=True)]

    def points(self, grid: Grid) -> list[Samples]:
        """Return the samples of a grid along each axis, relative to this window's first sample."""
        first = [
            c - 0.5 * (n - 1) * self.grid.pitch_mm
            for c, n in zip(centres_mm(self.grid), self.grid.shape, strict=True)
        ]
        return [
            Samples(c - start, grid.pitch_mm, n)
            for c, start, n in zip(centres_mm(grid), first, grid.shape, strict=True)
        ]

    def analyze(self, values: Any, grid: Grid, orders: Sequence[int]) -> Any:
        """Return the spectrum up to some orders of samples on a grid; adjoint of :meth:`synthesize`."""
        return fourier_sums(values, self.points(grid), self.frequencies(orders), -1, grid.cell)

    def synthesize(self, spectrum: Any, grid: Grid, orders: Sequence[int]) -> Any:
        """Return the samples on a grid of the waves up to some orders."""
        return fourier_sums(spectrum, self.frequencies(orders), self.points(grid), 1, 1.0 / self.area)

    def resolved_by(self, grid: Grid) -> tuple[int, ...]:
        """Return the highest orders that the samples of a grid represent without aliasing."""
        return tuple(
            min(self._highest_order(n, math.pi / grid.pitch_mm), m)
            for n, m in zip(self.grid.shape, self.orders, strict=True)
        )

    def _highest_order(self, count: int, wavenumber_per_mm: float) -> int:
        side = count * self.grid.pitch_mm
        return min(math.floor(wavenumber_per_mm * side / (2.0 * math.pi) * (1.0 + 1e-12)), (count - 1) // 2)


def surface_grids(
    scene: Scene, light: LightExtent, pitch_mm: float | None = None, half_width_mm: float | None = None
) -> tuple[Grid, ...]:
    """Return window and pitch of every surface; the outer ones also fit the object and the exit grid.

    Raises
    ------
    InputError
        If a given pitch or width is not finite and above 0.
    SamplingError
        If a given pitch or width, which applies to all surfaces, cannot sample the field.
    """
    last = len(light.reach_mm) - 1
    halves = [light.own_half_mm(i) for i in range(last + 1)]
    for i in range(last):
        # The wider one of two windows represents the field between the surfaces.
        wider = i if halves[i] > halves[i + 1] else i + 1
        halves[wider] = max(halves[wider], light.leg_half_mm(i))
    farthest_z_mm, nearest_z_mm = light.heights_mm[0][1], light.heights_mm[-1][0]
    ends = ((0, 0, scene.object_grid, farthest_z_mm), (last, last + 1, scene.exit_grid, nearest_z_mm))
    for i, medium, grid, z_mm in ends:
        # No periodic copy of light that leaves the window reaches the grid.
        shift_mm = abs(grid.z_mm - z_mm) * light.tangents[medium]
        halves[i] = max(halves[i], 0.5 * (_farthest_mm(grid, light.middle_mm) + light.reach_mm[i] + shift_mm))
    return tuple(
        sampled(scene, light, coarsest, half, pitch_mm, half_width_mm)
        for coarsest, half in zip(light.coarsest_mm, halves, strict=True)
    )


def arriving(scene: Scene, light: LightExtent) -> BandLimit:
    """Return the lateral shifts from the object to the first surface that are transmitted.

    Light that meets the surface is transmitted, and steeper light is attenuated smoothly, since a sharp end
    of the spectrum would cause ripples over the whole window.
    """
    grid, k = scene.object_grid, scene.wavenumber_per_mm * float(scene.system.index[0, 0])
    steepest = min(light.bands_per_mm[0], math.pi / grid.pitch_mm)
    stopped = (light.heights_mm[0][0] - grid.z_mm) * steepest / math.sqrt(k * k - steepest * steepest)
    away = _farthest_mm(grid, light.middle_mm) * math.sqrt(len(grid.shape))
    return BandLimit(0.0, light.reach_mm[0] + away, stopped)


def _farthest_mm(grid: Grid, middle_mm: tuple[float, float]) -> float:
    middle = middle_mm[::-1][: len(grid.shape)]
    ends = zip(centres_mm(grid), middle, grid.half_widths_mm, strict=True)
    return max(abs(centre - here) + half for centre, here, half in ends)


def transferred(spectrum: Any, source: Waves, target: Waves) -> Any:
    """Return the spectrum in another window of the same centre, for the field in the smaller one of both.

    With both windows swapped it is the adjoint.
    """
    if source.grid == target.grid:
        return spectrum
    least, orders = min((w.grid.half_widths_mm[0], w.orders) for w in (source, target))
    count = math.ceil((2 * max(orders) + 1) / TRANSFER_FINENESS)
    between = Grid((count,) * len(orders), 2.0 * least / count, 0.0, source.grid.centre_mm)
    source_cycles, target_cycles = (w.frequencies(w.orders) for w in (source, target))
    source_points, target_points = source.points(between), target.points(between)

    def transform(values: Any, axis: int) -> Any:
        samples = chirp_z_transform(values, source_cycles[axis], source_points[axis], sign=1, axis=axis)
        return chirp_z_transform(samples, target_points[axis], target_cycles[axis], sign=-1, axis=axis)

    spectrum = _along_axes(spectrum, transform, target.shape, count)
    spectrum *= between.cell / source.area
    return spectrum


def fourier_sums(
    values: Any, source: Sequence[Samples], target: Sequence[Samples], sign: int, scale: float
) -> Any:
    """Apply chirp-z transforms along all axes, and multiply by a number."""

    def transform(values: Any, axis: int) -> Any:
        return chirp_z_transform(values, source[axis], target[axis], sign=sign, axis=axis)

    result = _along_axes(values, transform, tuple(t.count for t in target))
    result *= scale
    return result


def _along_axes(
    values: Any, transform: Callable[[Any, int], Any], shape: tuple[int, ...], longest: int = 0
) -> Any:
    """Transform along one axis after the other in blocks, in the order that keeps arrays small."""
    if values.ndim == 1:
        return transform(values, 0)
    kind = np.result_type(values.dtype, np.complex64)
    for axis in (1, 0) if math.prod(shape) > math.prod(values.shape) else (0, 1):
        count, others = shape[axis], values.shape[1 - axis]
        result = np.empty((count, others) if axis == 0 else (others, count), dtype=kind)
        for part in parts(others, 4 * max(values.shape[axis] + count, 2 * longest)):
            block_of = (slice(None), part) if axis == 0 else (part, slice(None))
            result[block_of] = transform(values[block_of], axis)
        values = result
    return values


def parts(count: int, samples: int) -> Iterator[slice]:
    """Return parts of a range of rows or columns of so many samples, each small enough for one block."""
    step = block(samples)
    return (slice(start, min(start + step, count)) for start in range(0, count, step))


def block(samples: int) -> int:
    """Return the number of rows or columns of so many samples in a block."""
    return max(BLOCK_BYTES // (16 * samples), 8)
