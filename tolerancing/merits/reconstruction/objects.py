"""Test objects on a meridional line, and scores of their reconstructions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from tolerancing.merits.line_pairs import BARS

if TYPE_CHECKING:
    from wavesim.fields.field import Grid

ComplexArray = NDArray[np.complexfloating]
ObjectKind = Literal["lines", "amplitude", "complex"]

SET_LENGTH = 2 * BARS - 1
"""Length of a set of lines, in line widths."""

SET_GAP = 4
"""Gap between two sets of lines, in widths of the wider lines."""

UPSAMPLING = 8
"""Samples of an evaluated line for each sample of the reconstruction."""

LARGEST_SHIFT_UM = 2.0
"""Largest lateral shift of the reconstruction that registration removes."""


@dataclass(frozen=True)
class LineObject:
    """An object on the samples of a meridional line.

    Attributes
    ----------
    kind : {"lines", "amplitude", "complex"}
        Opaque bars on a bright ground, on a ground of random transmission, or on a ground of random
        transmission and phase.
    line_widths_um : tuple of float
        Line widths of the sets of five bars, which lie side by side about the centre.
    grid : Grid
        Samples of the object.
    aperture : float
        Numerical aperture of the lens, which limits its spatial frequencies.
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
        """True if the object has a phase."""
        return self.kind == "complex"

    @cached_property
    def centres_mm(self) -> tuple[float, ...]:
        """Centre of each set of lines, from the centre of the region."""
        return set_centres_mm(self.line_widths_um)

    @cached_property
    def transmission(self) -> ComplexArray:
        """Complex transmission, averaged over the cell of each sample."""
        values = np.ones(self.grid.size, complex)
        if self.kind != "lines":
            # A fixed seed: all studies use the same random object.
            generator = np.random.default_rng(20240607)
            values *= 0.3 + 0.7 * self._smooth(generator)
            if self.kind == "complex":
                values *= np.exp(1j * np.pi * (self._smooth(generator) - 0.5))
        return np.asarray(values * (1.0 - self._covered))

    @cached_property
    def _covered(self) -> Array:
        """Fraction of each cell that is covered by bars."""
        pitch = self.grid.pitch_mm
        borders = (np.arange(self.grid.size + 1) - 0.5 * self.grid.size) * pitch
        covered = np.zeros(self.grid.size)
        for width_um, centre in zip(self.line_widths_um, self.centres_mm, strict=True):
            width = 1e-3 * width_um
            starts = centre + width * (2.0 * np.arange(BARS) - 0.5 * SET_LENGTH)
            lengths = np.clip(borders[:, None], starts, starts + width) - starts
            covered += np.diff(lengths.sum(axis=1)) / pitch
        return covered

    def _smooth(self, generator: np.random.Generator) -> Array:
        """Return random values from 0 to 1 with detail no finer than 2 um."""
        import scipy.fft

        count = self.grid.size
        cycles = scipy.fft.rfftfreq(count, 1e3 * self.grid.pitch_mm)
        spectrum = scipy.fft.rfft(generator.standard_normal(count))
        values = scipy.fft.irfft(spectrum * np.exp(-((cycles * 2.0) ** 2)), count)
        return np.asarray((values - values.min()) / np.ptp(values))

    @cached_property
    def _filtered(self) -> ComplexArray:
        """The object within the bandwidth of the lens, upsampled."""
        return self._bandlimited(self.transmission)

    def score(self, found: ComplexArray) -> LineScores:
        """Score a reconstructed transmission against the object.

        Both are compared within the bandwidth of the lens, after registration of a lateral shift of at most
        `LARGEST_SHIFT_UM`.

        Parameters
        ----------
        found : ndarray
            Complex transmission on the object's samples.
        """
        reconstructed, true = self._bandlimited(found), self._filtered
        pitch_um = 1e3 * self.grid.pitch_mm / UPSAMPLING
        most = round(LARGEST_SHIFT_UM / pitch_um)
        scores = [(self._correlation(reconstructed, true, lag), lag) for lag in range(-most, most + 1)]
        correlation, lag = max(scores)
        power = np.abs(reconstructed) ** 2
        contrasts = tuple(
            self._contrast(power, width, centre, lag * pitch_um)
            for width, centre in zip(self.line_widths_um, self.centres_mm, strict=True)
        )
        return LineScores(correlation, contrasts, lag * pitch_um)

    def _bandlimited(self, values: ComplexArray) -> ComplexArray:
        """Remove spatial frequencies beyond the aperture of the lens, and upsample."""
        import scipy.fft

        count = len(values)
        padded = np.concatenate([values, np.full(count, values.mean())])
        spectrum = scipy.fft.fft(padded)
        cycles = scipy.fft.fftfreq(2 * count, 1e3 * self.grid.pitch_mm)
        spectrum[np.abs(cycles) > self.aperture / self.wavelength_um] = 0.0
        finer = np.zeros(2 * UPSAMPLING * count, complex)
        finer[:count], finer[-count:] = spectrum[:count], spectrum[count:]
        offset = 0.5 * (UPSAMPLING - 1) / UPSAMPLING
        frequencies = scipy.fft.fftfreq(len(finer), 1.0 / len(finer)) / (2 * count)
        finer *= np.exp(-2j * np.pi * frequencies * offset)
        return np.asarray(UPSAMPLING * scipy.fft.ifft(finer)[: UPSAMPLING * count])

    def _correlation(self, found: ComplexArray, true: ComplexArray, lag: int) -> float:
        """Return the correlation about the means over 90 % of the region, with `found` shifted by `lag`."""
        edge = max(round(0.5 * (1.0 - 0.9) * len(true)), abs(lag))
        a = true[edge : len(true) - edge]
        b = found[edge + lag : len(true) - edge + lag]
        # A reconstruction without detail has no correlation.
        least = 1e-9 * float(np.linalg.norm(b))
        a, b = a - a.mean(), b - b.mean()
        norms = float(np.linalg.norm(a)), float(np.linalg.norm(b))
        return float(abs(np.vdot(a, b)) / (norms[0] * norms[1])) if norms[1] > least else 0.0

    def _contrast(self, power: Array, width_um: float, centre_mm: float, shift_um: float) -> float:
        """Return (bright - dark) / (bright + dark) of a set of bars, each gap against its two bars."""
        pitch_um = 1e3 * self.grid.pitch_mm / UPSAMPLING
        cumulative = np.concatenate([[0.0], np.cumsum(power)])
        borders = (np.arange(len(cumulative)) - 0.5 * len(power)) * pitch_um
        centres = 1e3 * centre_mm + shift_um + width_um * (np.arange(SET_LENGTH) - SET_LENGTH // 2)
        # Central fraction of a bar's or a gap's width over which its intensity is averaged.
        middle = 0.5
        half = 0.5 * middle * width_um
        means = np.interp(centres + half, borders, cumulative) - np.interp(
            centres - half, borders, cumulative
        )
        bars, gaps = 0.5 * (means[0:-1:2] + means[2::2]), means[1::2]
        # Bars and gaps that are both darker than 1 % of the brightest light have no contrast.
        total = np.maximum(bars + gaps, 0.01 * power.max() * middle * width_um / pitch_um)
        return float(np.mean((gaps - bars) / total))


@dataclass(frozen=True)
class LineScores:
    """Scores of a reconstructed object on a line.

    Attributes
    ----------
    correlation : float
        Correlation of reconstructed and true object about their means, after registration; from 0 to 1.
    contrasts : tuple of float
        Contrast of each set of lines; negative if bright and dark are exchanged.
    shift_um : float
        Lateral shift of the reconstructed object.
    """

    correlation: float
    contrasts: tuple[float, ...]
    shift_um: float


def set_centres_mm(line_widths_um: tuple[float, ...]) -> tuple[float, ...]:
    """Return the centres of sets of lines that lie side by side about 0."""
    ends, position = [], 0.0
    for index, width in enumerate(line_widths_um):
        if index:
            position += SET_GAP * max(width, line_widths_um[index - 1])
        ends.append((position, position + SET_LENGTH * width))
        position += SET_LENGTH * width
    return tuple(1e-3 * (0.5 * (start + end) - 0.5 * position) for start, end in ends)


def required_length_mm(line_widths_um: tuple[float, ...]) -> float:
    """Return the length of sets of lines, with a gap on either side."""
    gaps = sum(max(pair) for pair in pairwise(line_widths_um))
    ends = line_widths_um[0] + line_widths_um[-1] if line_widths_um else 0.0
    return 1e-3 * (SET_LENGTH * sum(line_widths_um) + SET_GAP * (gaps + ends))
