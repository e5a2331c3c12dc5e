"""Surfaces as stairs: the wave propagation method in its published form.

One field covers both media. In every step its spectrum is propagated once as if all space were the first
medium and once as if it were the second, and each sample uses the result of its own medium.

Reference: K.-H. Brenner and W. Singer, "Light propagation through microlenses: a new simulation method",
Appl. Opt. 32, 4984 (1993).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import SamplingError
from wavesim.engines.surfaces.grids import WorkingGrid
from wavesim.engines.surfaces.waves import SurfaceSamples

ComplexArray = NDArray[np.complex128]


class Staircase:
    """The operator from the lowest to the highest plane that intersects a surface.

    Parameters
    ----------
    working
        Grid and media.
    surfaces
        Samples of each surface.
    step_mm
        Distance between planes.
    """

    def __init__(self, working: WorkingGrid, surfaces: Sequence[SurfaceSamples], step_mm: float) -> None:
        self.media, grid = working.media, working.grid
        self.heights, self.factors = [], []
        for samples in surfaces:
            # Outside the light a surface continues as an opaque plane.
            height = np.full(grid.size, samples.rim_z_mm)
            factor = np.zeros(grid.size, samples.transmission.dtype)
            height[samples.pixels], factor[samples.pixels] = samples.z_mm, samples.transmission
            self.heights.append(height.reshape(grid.shape))
            self.factors.append(factor.reshape(grid.shape))
        self.planes = planes([(np.min(h), np.max(h)) for h in self.heights], step_mm)
        self.start_mm, self.end_mm = self.planes[0], self.planes[-1]

    def forward(self, field: ComplexArray) -> ComplexArray:
        """Propagate a field from the first to the last plane.

        Raises
        ------
        SamplingError
            If the energy grows: samples that each follow their own medium do not conserve it.
        """
        energy_in = _energy(field)
        for length, medium, factor in self._steps():
            spectrum = scipy.fft.fftn(field, norm="ortho", workers=-1)
            field = np.zeros_like(spectrum)
            for m in np.unique(medium):
                wave = spectrum * self.media[m].waves.transfer_function(length)
                wave = scipy.fft.ifftn(wave, norm="ortho", workers=-1, overwrite_x=True)
                np.copyto(field, wave, where=medium == m)
            field *= factor
        self._validate_energy(energy_in, _energy(field))
        return field

    def adjoint(self, field: ComplexArray) -> ComplexArray:
        """Apply the exact adjoint of :meth:`forward`.

        Raises
        ------
        SamplingError
            If the energy grows, as in :meth:`forward`.
        """
        energy_in = _energy(field)
        for length, medium, factor in self._steps(adjoint=True):
            field = field * factor.conj()
            spectrum = np.zeros(field.shape, complex)
            for m in np.unique(medium):
                wave = np.where(medium == m, field, 0.0)
                wave = scipy.fft.fftn(wave, norm="ortho", workers=-1, overwrite_x=True)
                wave *= self.media[m].waves.transfer_function(-length)
                spectrum += wave
            field = scipy.fft.ifftn(spectrum, norm="ortho", workers=-1, overwrite_x=True)
        self._validate_energy(energy_in, _energy(field))
        return field

    def _validate_energy(self, energy_in: float, energy_out: float) -> None:
        first, last = self.media[0].index, self.media[-1].index
        energy_in *= max(1.0, first / last, last / first)
        # Largest growth of the energy through the stairs, after the ratio of the indices.
        most_growth = 1.5
        if energy_out > most_growth * energy_in:
            raise SamplingError(
                f"interface = staircase: the energy grows by a factor of {energy_out / energy_in:.3g}, since "
                "the stairs scatter too much of this light; use interface = substep"
            )

    def _steps(self, adjoint: bool = False) -> Iterator[tuple[float, NDArray[np.int8], NDArray[np.inexact]]]:
        """Yield each step's length, the medium of each sample, and the factor of the crossed surfaces."""
        # The last step has the length 0, and applies the surfaces behind the last middle.
        borders = [*self.planes, self.planes[-1]]
        middles = [-math.inf] + [0.5 * (low + high) for low, high in pairwise(borders)]
        steps = list(zip(pairwise(borders), pairwise(middles), strict=True))
        for (low, high), (before, middle) in reversed(steps) if adjoint else steps:
            medium = np.zeros(self.heights[0].shape, np.int8)
            factor = np.ones(self.heights[0].shape, np.result_type(*self.factors))
            for height, own in zip(self.heights, self.factors, strict=True):
                medium += height <= middle
                np.multiply(factor, own, out=factor, where=(height > before) & (height <= middle))
            yield high - low, medium, factor


def _energy(field: ComplexArray) -> float:
    return float(np.sum(np.abs(field) ** 2))


def planes(heights_mm: Sequence[tuple[float, float]], step_mm: float) -> list[float]:
    """Return positions of planes, evenly spaced within the depth of each surface, and none in the gaps."""
    found: list[float] = []
    for low, high in sorted(heights_mm):
        low = max(low, found[-1]) if found else low
        if high > low:
            count = math.ceil((high - low) / step_mm * (1.0 - 1e-12))
            found += list(np.linspace(low, high, count + 1))[1 if low in found[-1:] else 0 :]
        elif not found or high > found[-1]:
            found.append(high)
    return found
