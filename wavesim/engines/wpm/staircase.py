"""Surfaces as stairs: the wave propagation method as it was published.

One field holds both media. In every step its spectrum is carried on as if all were the one medium and as if
all were the other, and each sample takes the result of the medium that it is in.

Source: K.-H. Brenner and W. Singer, "Light propagation through microlenses: a new simulation method", Appl.
Opt. 32, 4984 (1993).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import SamplingError
from wavesim.engines.surfaces.grids import WorkingGrid
from wavesim.engines.surfaces.waves import SurfaceSamples

ComplexArray = NDArray[np.complex128]

MOST_GROWTH = 1.5
"""Energy behind stairs, as a share of that in front, beyond what the indices on both sides may make of it."""


class Staircase:
    """The operator from the lowest to the highest plane on which there is a surface.

    Parameters
    ----------
    working
        Grid and media.
    surfaces
        Where light meets each surface.
    step_mm
        Between planes.
    """

    def __init__(self, working: WorkingGrid, surfaces: Sequence[SurfaceSamples], step_mm: float) -> None:
        self.media, grid = working.media, working.grid
        self.heights, self.factors = [], []
        for samples in surfaces:
            # Beside the light a surface goes on flat, and lets nothing through.
            height = np.full(grid.size, samples.rim_z_mm)
            factor = np.zeros(grid.size)
            height[samples.pixels], factor[samples.pixels] = samples.z_mm, samples.transmission
            self.heights.append(height.reshape(grid.shape))
            self.factors.append(factor.reshape(grid.shape))
        self.planes = planes([(np.min(h), np.max(h)) for h in self.heights], step_mm)
        self.start_mm, self.end_mm = self.planes[0], self.planes[-1]

    def forward(self, field: ComplexArray) -> ComplexArray:
        """Carry a field from the first to the last plane.

        Raises
        ------
        SamplingError
            If stairs feed on themselves: samples of two media need not conserve energy together.
        """
        before = _energy(field)
        for length, medium, factor in self._steps():
            spectrum = scipy.fft.fftn(field, norm="ortho", workers=-1)
            field = np.zeros_like(spectrum)
            for m in np.unique(medium):
                wave = spectrum * self.media[m].over(length)
                wave = scipy.fft.ifftn(wave, norm="ortho", workers=-1, overwrite_x=True)
                np.copyto(field, wave, where=medium == m)
            field *= factor
        self._refuse_growth(before, _energy(field))
        return field

    def adjoint(self, field: ComplexArray) -> ComplexArray:
        """Exact adjoint of :meth:`forward`, which raises as that does."""
        before = _energy(field)
        for length, medium, factor in self._steps(back=True):
            field = field * factor
            spectrum = np.zeros(field.shape, complex)
            for m in np.unique(medium):
                wave = np.where(medium == m, field, 0.0)
                wave = scipy.fft.fftn(wave, norm="ortho", workers=-1, overwrite_x=True)
                wave *= self.media[m].over(-length)
                spectrum += wave
            field = scipy.fft.ifftn(spectrum, norm="ortho", workers=-1, overwrite_x=True)
        self._refuse_growth(before, _energy(field))
        return field

    def _refuse_growth(self, before: float, after: float) -> None:
        first, last = self.media[0].index, self.media[-1].index
        before *= max(1.0, first / last, last / first)
        if after > MOST_GROWTH * before:
            raise SamplingError(
                f"the staircase makes {after / before:.3g} times the energy that it was given: it scatters "
                "too much of this light; take interface = substep"
            )

    def _steps(self, back: bool = False) -> Iterator[tuple[float, NDArray[np.int8], Array]]:
        """Length of each step, medium of each sample in it, and factor of what it crosses on its way in."""
        # The last step, of no length, crosses what the one before has left.
        borders = [*self.planes, self.planes[-1]]
        middles = [-math.inf] + [0.5 * (low + high) for low, high in pairwise(borders)]
        steps = list(zip(pairwise(borders), pairwise(middles), strict=True))
        for (low, high), (before, middle) in reversed(steps) if back else steps:
            medium = np.zeros(self.heights[0].shape, np.int8)
            factor = np.ones(self.heights[0].shape)
            for height, own in zip(self.heights, self.factors, strict=True):
                medium += height <= middle
                np.multiply(factor, own, out=factor, where=(height > before) & (height <= middle))
            yield high - low, medium, factor


def _energy(field: ComplexArray) -> float:
    return float(np.sum(np.abs(field) ** 2))


def planes(heights_mm: Sequence[tuple[float, float]], step_mm: float) -> list[float]:
    """Evenly spaced planes wherever a surface lies, and none between."""
    found: list[float] = []
    for low, high in sorted(heights_mm):
        low = max(low, found[-1]) if found else low
        if high > low:
            count = math.ceil((high - low) / step_mm * (1.0 - 1e-12))
            found += list(np.linspace(low, high, count + 1))[1 if low in found[-1:] else 0 :]
        elif not found or high > found[-1]:
            found.append(high)
    return found
