"""Interpolation of a field from a coarse grid to a window of a fine one with a carrier, and its adjoint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.fields.resampling import Kernel, Weights, for_column_blocks, interpolation, onto_coarse
from wavesim.fields.resampling_kernel import collect, expand


@dataclass(frozen=True, eq=False)
class InterpolationWeights:
    """Weights of the interpolation from coarse grids to a part of a fine one: of the field, and of smooth
    functions.

    Attributes
    ----------
    field : (Weights, Weights)
        Weights of the field along y and x, in float32.
    first, smooth_weights : two ndarrays each
        First of four samples and their weights, along y and x, on the grid of the smooth functions.
    """

    field: tuple[Weights, Weights]
    first: tuple[NDArray[np.int64], NDArray[np.int64]]
    smooth_weights: tuple[Array, Array]


def interpolation_weights(
    coarse: tuple[Array, Array], smooth: tuple[Array, Array], fine: tuple[Array, Array], kernel: Kernel
) -> InterpolationWeights:
    """Return the weights from axes (y, x) of two coarse grids to those of a fine one."""
    field = [interpolation(c, f, kernel).astype(np.float32) for c, f in zip(coarse, fine, strict=True)]
    cubic = [_cubic(s, f) for s, f in zip(smooth, fine, strict=True)]
    first, smooth_weights = (cubic[0][0], cubic[1][0]), (cubic[0][1], cubic[1][1])
    return InterpolationWeights((field[0], field[1]), first, smooth_weights)


def _cubic(coarse: Array, fine: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the first of four samples for each fine one, and their Lagrange weights."""
    index = (fine - coarse[0]) / (coarse[1] - coarse[0])
    first = np.clip(np.floor(index).astype(np.int64) - 1, 0, len(coarse) - 4)
    t = index - first - 1.0
    weights = [-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2, -(t + 1) * t * (t - 2) / 2]
    return first, np.stack([*weights, (t + 1) * t * (t - 1) / 6], axis=-1)


@dataclass(frozen=True, eq=False)
class CarrierInterpolation:
    """Interpolation from a coarse grid to a window of a fine one, times its carrier.

    Attributes
    ----------
    weights : InterpolationWeights
    phase_waves : array
        Phase of the carrier in waves (over 2 pi) on the smooth grid.
    edge : array of float32
        Smooth edge of the aperture: 0 where it is dark, 1 or more where it is open, on the smooth grid.
    window : (slice, slice)
        Window of the fine grid.
    """

    weights: InterpolationWeights
    phase_waves: Any
    edge: Any
    window: tuple[slice, slice]

    @property
    def nbytes(self) -> int:
        """Memory of its arrays."""
        arrays = [*self.weights.first, *self.weights.smooth_weights, self.phase_waves, self.edge]
        arrays += [a for axis in self.weights.field for a in (axis.first, axis.weight, *axis.adjoint)]
        return sum(int(array.nbytes) for array in arrays)

    def add(self, coarse: NDArray, fine: NDArray, first_row: int = 0, threads: int = 1) -> None:
        """Add a coarse field to a fine one, or to its rows from `first_row` on; `fine` is C-contiguous."""
        band, needed = self.onto_rows(first_row, first_row + fine.shape[0])
        (y, x), origin = band.weights.field, (band.window[0].start - first_row, band.window[1].start)
        along = (y.first, y.weight), (x.first, x.weight)
        fixed = coarse[needed].view(np.float32), *along, None, band._carrier(), fine.view(np.float32), origin
        for_column_blocks(partial(expand, *fixed), len(x.first), threads)

    def onto_rows(self, start: int, stop: int) -> tuple[CarrierInterpolation, slice]:
        """Return the step to the fine grid's rows from `start` to `stop`, and the coarse rows that it uses.

        Both are empty if the window has no such row.
        """
        inside, across = self.window
        start = min(max(start, inside.start), inside.stop)
        stop = max(min(stop, inside.stop), start)
        w, rows = self.weights, slice(start - inside.start, stop - inside.start)
        y = w.field[0]
        first, weight = y.first[rows], y.weight[rows]
        low, high = (int(first[0]), int(first[-1]) + weight.shape[1]) if len(first) else (0, 0)
        field = Weights(first - low, weight, high - low), w.field[1]
        weights = InterpolationWeights(
            field, (w.first[0][rows], w.first[1]), (w.smooth_weights[0][rows], w.smooth_weights[1])
        )
        return replace(self, weights=weights, window=(slice(start, stop), across)), slice(low, high)

    def collect(self, fine: NDArray, threads: int = 1) -> NDArray[np.complex64]:
        """Apply the conjugate transpose to a C-contiguous fine field."""
        weights, origin = self.weights, (self.window[0].start, self.window[1].start)
        (y, x), carrier = weights.field, self._carrier()
        fixed = fine.view(np.float32), origin, None, carrier, y.adjoint, x.adjoint
        return onto_coarse(partial(collect, *fixed), weights.field, np.complex64, threads)

    def _carrier(self) -> tuple[NDArray, ...]:
        """Return the arrays that the compiled loops use."""
        (first_y, first_x), (weights_y, weights_x) = self.weights.first, self.weights.smooth_weights
        return (
            self.phase_waves,
            self.edge,
            first_y,
            weights_y,
            first_x,
            weights_x,
            weights_x.astype(np.float32),
        )
