"""A field from one grid to any other parallel one as an operator: with its adjoint, and what it takes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from wavesim.fields.field import Field, Grid
from wavesim.fields.plane_waves import fast_count
from wavesim.fields.windowed import Passing, propagate_to, propagate_to_adjoint
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds

FACTOR_BYTES = 64
"""For each sample of the spectrum, while its factor is made."""


@dataclass(frozen=True)
class GridTransfer:
    """Free space between two grids.

    Attributes
    ----------
    source, target : Grid
        Both lines, or both planes; the target may lie in front of the source.
    wavelength_um, index : float
        Vacuum wavelength, and refractive index between the grids.
    """

    source: Grid
    target: Grid
    wavelength_um: float
    index: float

    def forward(self, values: Any) -> Any:
        """Values on the target of a field on the source; NumPy's in double precision."""
        field = Field(self.source, _doubled(values), self.wavelength_um, self.index)
        return propagate_to(field, self.target, check=False).values

    def adjoint(self, values: Any) -> Any:
        """Adjoint of :meth:`forward` for <f, g> = cell * sum(conj(f) g)."""
        field = Field(self.target, _doubled(values), self.wavelength_um, self.index)
        return propagate_to_adjoint(field, self.source).values

    @cached_property
    def samples(self) -> int:
        """Of the spectrum."""
        return math.prod(self._spectral)

    @property
    def seconds(self) -> float:
        """What one use takes on this machine."""
        total = 4.0 * exponential_seconds(self.samples)
        for given, length, taken, others in self._sums():
            total += 2.0 * fft_seconds(length * others, self.source.is_line) + fft_seconds(length, True)
            total += (given + length + 2.0 * taken) * others * pass_seconds(1 << 16) / (1 << 16)
            total += exponential_seconds(given + length + taken)
        return total

    @property
    def peak_bytes(self) -> int:
        """Most memory of one use, its result not counted."""
        sums = [
            (2 * given + 2 * length + taken) * others + (3 * length) // 2 + given + taken
            for given, length, taken, others in self._sums()
        ]
        return max(16 * (self.samples + max(sums)), FACTOR_BYTES * self.samples)

    @cached_property
    def _spectral(self) -> tuple[int, ...]:
        passing = Passing(self.source, self.target, self.wavelength_um, self.index)
        return tuple(f.count for f in passing.frequencies)

    def _sums(self) -> Iterator[tuple[int, int, int, int]]:
        """Of each chirp-z transform: samples given, of the convolution, taken, and along the other axis."""
        shape = list(self.source.shape)
        for wanted in (self._spectral, self.target.shape):
            for axis, taken in enumerate(wanted):
                given = shape[axis]
                yield given, fast_count(given + taken - 1), taken, math.prod(shape) // given
                shape[axis] = taken


def _doubled(values: Any) -> Any:
    return np.asarray(values, complex) if isinstance(values, np.ndarray) else values
