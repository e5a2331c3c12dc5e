"""Objects on a meridional line, and what a reconstruction leaves of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array

if TYPE_CHECKING:
    from wavesim.fields.field import Grid

ComplexArray = NDArray[np.complexfloating]
ObjectKind = Literal["lines", "amplitude", "complex"]

BARS = 5
"""Bars of a set of lines."""

SET_LENGTH = 2 * BARS - 1
"""Length of a set of lines, in line widths."""

SET_GAP = 4
"""Between two sets of lines, in widths of the wider lines."""

OBJECT_SEED, DETAIL_UM = 20240607, 2.0
"""Seed of the random objects, and the width of their finest detail."""

FINER = 8
"""Samples of a judged line for each sample of the reconstruction."""

JUDGED = 0.9
"""Fraction of the region, about its middle, over which the correlation is taken."""

MIDDLE = 0.5
"""Fraction of a bar's or a gap's width over which its intensity is averaged."""

LARGEST_SHIFT_UM = 2.0
"""Distance up to which what is found may lie beside its place; registration takes it out."""

EVEN = 1e-9
"""A line whose detail is less than this fraction of it shows nothing."""

DARK = 0.01
"""A bar and a gap that are darker together than this fraction of the brightest light show nothing."""


@dataclass(frozen=True)
class LineObject:
    """An object on the samples of a meridional line.

    Attributes
    ----------
    kind : {"lines", "amplitude", "complex"}
        Opaque bars on a bright ground; the same on a ground of random transmission; or on one of random
        transmission and phase.
    line_widths_um : tuple of float
        Widths of the sets of five bars, which lie side by side about the middle.
    grid : Grid
        Samples of the object.
    aperture : float
        Numerical aperture of the lens, beyond which it passes no detail.
    wavelength_um : float
        Vacuum wavelength.
    """

    kind: ObjectKind
    line_widths_um: tuple[float, ...]
    grid: Grid
    aperture: float
    wavelength_um: float

    @property
    def is_complex(self) -> bool:
        """Whether the object has a phase."""
        return self.kind == "complex"

    @cached_property
    def middles_mm(self) -> tuple[float, ...]:
        """Middle of each set of lines, from the middle of the region."""
        return set_middles_mm(self.line_widths_um)

    @cached_property
    def transmission(self) -> ComplexArray:
        """Complex transmission, the mean over each sample's cell."""
        values = np.ones(self.grid.size, complex)
        if self.kind != "lines":
            generator = np.random.default_rng(OBJECT_SEED)
            values *= 0.3 + 0.7 * self._smooth(generator)
            if self.kind == "complex":
                values *= np.exp(1j * np.pi * (self._smooth(generator) - 0.5))
        return np.asarray(values * (1.0 - self._covered))

    @cached_property
    def _covered(self) -> Array:
        """Fraction of each cell that bars cover."""
        pitch = self.grid.pitch_mm
        borders = (np.arange(self.grid.size + 1) - 0.5 * self.grid.size) * pitch
        covered = np.zeros(self.grid.size)
        for width_um, middle in zip(self.line_widths_um, self.middles_mm, strict=True):
            width = 1e-3 * width_um
            starts = middle + width * (2.0 * np.arange(BARS) - 0.5 * SET_LENGTH)
            reach = np.clip(borders[:, None], starts, starts + width) - starts
            covered += np.diff(reach.sum(axis=1)) / pitch
        return covered

    def _smooth(self, generator: np.random.Generator) -> Array:
        """Random values from 0 to 1 whose finest detail is `DETAIL_UM` wide."""
        import scipy.fft

        count = self.grid.size
        cycles = scipy.fft.rfftfreq(count, 1e3 * self.grid.pitch_mm)
        spectrum = scipy.fft.rfft(generator.standard_normal(count))
        values = scipy.fft.irfft(spectrum * np.exp(-((cycles * DETAIL_UM) ** 2)), count)
        return np.asarray((values - values.min()) / np.ptp(values))

    @cached_property
    def _passed(self) -> ComplexArray:
        """The object as the lens passes it, on finer samples."""
        return self._as_passed(self.transmission)

    def judge(self, found: ComplexArray) -> LineScores:
        """What is left of the object in a transmission that was found.

        The found transmission and the object are compared as the lens passes them, registered sideways
        within `LARGEST_SHIFT_UM`.

        Parameters
        ----------
        found : ndarray
            Complex transmission on the object's samples.
        """
        seen, true = self._as_passed(found), self._passed
        pitch_um = 1e3 * self.grid.pitch_mm / FINER
        most = round(LARGEST_SHIFT_UM / pitch_um)
        scores = [(self._correlation(seen, true, lag), lag) for lag in range(-most, most + 1)]
        correlation, lag = max(scores)
        power = np.abs(seen) ** 2
        contrasts = tuple(
            self._contrast(power, width, middle, lag * pitch_um)
            for width, middle in zip(self.line_widths_um, self.middles_mm, strict=True)
        )
        return LineScores(correlation, contrasts, lag * pitch_um)

    def _as_passed(self, values: ComplexArray) -> ComplexArray:
        """Values without the detail beyond the lens's aperture, on finer samples."""
        import scipy.fft

        count = len(values)
        padded = np.concatenate([values, np.full(count, values.mean())])
        spectrum = scipy.fft.fft(padded)
        cycles = scipy.fft.fftfreq(2 * count, 1e3 * self.grid.pitch_mm)
        spectrum[np.abs(cycles) > self.aperture / self.wavelength_um] = 0.0
        finer = np.zeros(2 * FINER * count, complex)
        finer[:count], finer[-count:] = spectrum[:count], spectrum[count:]
        offset = 0.5 * (FINER - 1) / FINER
        turns = scipy.fft.fftfreq(len(finer), 1.0 / len(finer)) / (2 * count)
        finer *= np.exp(-2j * np.pi * turns * offset)
        return np.asarray(FINER * scipy.fft.ifft(finer)[: FINER * count])

    def _correlation(self, seen: ComplexArray, true: ComplexArray, lag: int) -> float:
        """Correlation about the means, of what is found so many fine samples beside its place."""
        edge = max(round(0.5 * (1.0 - JUDGED) * len(true)), abs(lag))
        here = true[edge : len(true) - edge]
        there = seen[edge + lag : len(true) - edge + lag]
        least = EVEN * float(np.linalg.norm(there))
        here, there = here - here.mean(), there - there.mean()
        sizes = float(np.linalg.norm(here)), float(np.linalg.norm(there))
        return float(abs(np.vdot(here, there)) / (sizes[0] * sizes[1])) if sizes[1] > least else 0.0

    def _contrast(self, power: Array, width_um: float, middle_mm: float, shift_um: float) -> float:
        """(bright - dark) / (bright + dark) of a set of bars, each gap against the bars beside it."""
        pitch_um = 1e3 * self.grid.pitch_mm / FINER
        running = np.concatenate([[0.0], np.cumsum(power)])
        borders = (np.arange(len(running)) - 0.5 * len(power)) * pitch_um
        parts = 1e3 * middle_mm + shift_um + width_um * (np.arange(SET_LENGTH) - SET_LENGTH // 2)
        half = 0.5 * MIDDLE * width_um
        means = np.interp(parts + half, borders, running) - np.interp(parts - half, borders, running)
        bars, gaps = 0.5 * (means[0:-1:2] + means[2::2]), means[1::2]
        total = np.maximum(bars + gaps, DARK * power.max() * MIDDLE * width_um / pitch_um)
        return float(np.mean((gaps - bars) / total))


@dataclass(frozen=True)
class LineScores:
    """What a reconstruction leaves of an object on a line.

    Attributes
    ----------
    correlation : float
        Of found and true object about their means, registered sideways; from 0 to 1.
    contrasts : tuple of float
        Of each set of lines; negative where bright and dark trade places.
    shift_um : float
        How far the found object lies beside its place.
    """

    correlation: float
    contrasts: tuple[float, ...]
    shift_um: float


def set_middles_mm(line_widths_um: tuple[float, ...]) -> tuple[float, ...]:
    """Middles of sets of lines that lie side by side about 0."""
    ends, position = [], 0.0
    for number, width in enumerate(line_widths_um):
        if number:
            position += SET_GAP * max(width, line_widths_um[number - 1])
        ends.append((position, position + SET_LENGTH * width))
        position += SET_LENGTH * width
    return tuple(1e-3 * (0.5 * (start + end) - 0.5 * position) for start, end in ends)


def needed_mm(line_widths_um: tuple[float, ...]) -> float:
    """Length that sets of lines take, with a gap on either side."""
    gaps = sum(max(pair) for pair in pairwise(line_widths_um))
    ends = line_widths_um[0] + line_widths_um[-1] if line_widths_um else 0.0
    return 1e-3 * (SET_LENGTH * sum(line_widths_um) + SET_GAP * (gaps + ends))
