"""Chirp-z transform (Bluestein), and free space to a window of any position and pitch.

The chirp-z transform writes x f as (x^2 + f^2 - (f - x)^2) / 2, so that a Fourier sum becomes a convolution
with a chirp (the paper's Appendix B). Free space needs two of them: the first gives the part of the spectrum
that reaches the output window, the second gives the field on the window's samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.fft

from lensdesign.errors import InputError
from lensdesign.raytrace.plane_plate import PlanePlate
from wavesim.fields.angular_spectrum import FACTOR_BYTES
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import (
    BandLimit,
    PlaneWaves,
    Samples,
    along,
    padded_shape,
    phasor_of,
    sampling_windows,
)
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds


def chirp_z_transform(
    values: Any, source: Samples, target: Samples, *, sign: int = -1, axis: int = -1
) -> Any:
    """Return the sum over n of values[n] exp(sign 2 pi i x[n] f[m]), for evenly spaced x and f of any step.

    Parameters
    ----------
    values
        Array with one value for each point of `source` along `axis`.
    source, target
        Points x of the sum, and f of the result.
    sign
        Sign of the exponent, -1 or 1. The adjoint swaps source and target, and changes the sign.
    axis
        Axis of the sum.

    Returns
    -------
    array
        One value for each point of `target` along `axis`. Single precision stays single.

    Raises
    ------
    InputError
        If the number of values along the axis is not that of the source.
    """
    kind = np.result_type(values.dtype, np.complex64)
    axis = axis % values.ndim
    if values.shape[axis] != source.count:
        raise InputError(
            f"values have {values.shape[axis]} samples along axis {axis}: must be {source.count}"
        )
    two_pi = sign * 2.0 * math.pi

    def wave(phase: Any) -> Any:
        return along(phasor_of(phase, kind), axis, values.ndim)

    x, f = source.offsets(), target.offsets()
    rate = 0.5 * two_pi * source.step * target.step
    order_x = np.arange(source.count, dtype=np.float64) - 0.5 * (source.count - 1)
    order_f = np.arange(target.count, dtype=np.float64) - 0.5 * (target.count - 1)
    size = scipy.fft.next_fast_len(source.count + target.count - 1)
    lag = np.arange(size, dtype=np.float64)
    lag = np.where(lag < target.count, lag, lag - size) - 0.5 * (target.count - source.count)
    chirp = scipy.fft.fft(wave(-rate * lag**2), axis=axis, workers=-1)

    spread = values * wave(rate * order_x**2 + two_pi * target.centre * x)
    spectrum = scipy.fft.fft(spread, size, axis, workers=-1, overwrite_x=True)
    summed = scipy.fft.ifft(spectrum * chirp, axis=axis, workers=-1, overwrite_x=True)
    cropped = summed[(slice(None),) * axis + (slice(0, target.count), ...)]
    return cropped * wave(rate * order_f**2 + two_pi * source.centre * (f + target.centre))


class ChirpZ:
    """Propagation by chirp-z transforms, to any window and pitch.

    Only the part of the spectrum that reaches the target is sampled. Input and output points are relative to
    the centres of their grids.
    """

    def __init__(
        self,
        source: Grid,
        target: Grid,
        wavelength_um: float,
        index: float,
        plate: PlanePlate | None = None,
    ) -> None:
        self.source, self.target = source, target
        self.wavelength_um, self.index, self.plate = wavelength_um, index, plate
        self.distance_mm = target.z_mm - source.z_mm
        self.inputs = [Samples(0.0, source.pitch_mm, n) for n in source.shape]
        self.outputs = [Samples(0.0, target.pitch_mm, n) for n in target.shape]
        counts = padded_shape(source, target, wavelength_um, index, self.distance_mm, plate)
        self.bands = [
            pair.band_limit(n) for pair, n in zip(sampling_windows(source, target), counts, strict=True)
        ]
        self.frequencies = self._arriving(source, counts)
        self.counts = tuple(f.count for f in self.frequencies)
        self.samples = math.prod(self.counts)

    def forward(self, values: Any) -> Any:
        return self._propagated(values, self.inputs, self.outputs, self.source.cell, adjoint=False)

    def adjoint(self, values: Any) -> Any:
        return self._propagated(values, self.outputs, self.inputs, self.target.cell, adjoint=True)

    def _propagated(
        self, values: Any, points: list[Samples], targets: list[Samples], cell: float, *, adjoint: bool
    ) -> Any:
        kind = np.result_type(values.dtype, np.complex64)
        cell *= math.prod(f.step for f in self.frequencies)
        dimensions = len(self.frequencies)
        cycles = [along(f.points(), axis, dimensions) for axis, f in enumerate(self.frequencies)]
        waves = PlaneWaves(cycles, self.wavelength_um, self.index)
        factor = cell * waves.transfer_function(self.distance_mm, self.bands, plate=self.plate, dtype=kind)
        for axis, (x, f) in enumerate(zip(points, self.frequencies, strict=True)):
            values = chirp_z_transform(values, x, f, sign=-1, axis=axis)
        values = values * (np.conj(factor) if adjoint else factor)
        for axis, (f, x) in enumerate(zip(self.frequencies, targets, strict=True)):
            values = chirp_z_transform(values, f, x, sign=1, axis=axis)
        return values

    def _arriving(self, source: Grid, counts: tuple[int, ...]) -> list[Samples]:
        """Return the frequencies that reach the output window, at the step that the period requires."""
        nyquist = 0.5 / source.pitch_mm
        bounds = [
            self._bounds(p, nyquist, self._steepest_across(axis, nyquist))
            for axis, p in enumerate(self.bands)
        ]
        result = []
        for (low, high), count in zip(bounds, counts, strict=True):
            step = 1.0 / (count * source.pitch_mm)
            if low <= -nyquist and high >= nyquist:
                result.append(Samples(0.0, step, count))
            else:
                low, high = max(low, -nyquist), min(high, nyquist)
                result.append(Samples(0.5 * (low + high), step, max(math.ceil((high - low) / step) + 1, 1)))
        return result

    def _steepest_across(self, axis: int, nyquist: float) -> float:
        """Return the largest frequency along the other axis that reaches the window."""
        if len(self.bands) == 1:
            return 0.0
        return max(abs(f) for f in self._bounds(self.bands[1 - axis], nyquist, 0.0))

    def _bounds(self, band: BandLimit, nyquist: float, across: float) -> tuple[float, float]:
        """Return the lowest and highest transmitted frequency along one axis, by the highest of the other."""
        if self.plate is not None:
            return self._bounds_behind_plate(band, nyquist, across)
        if self.distance_mm == 0.0:
            return -nyquist, nyquist
        highest = 1e3 * self.index / self.wavelength_um
        least_fraction = math.sqrt(max(1.0 - (across / highest) ** 2, 0.0))
        ends = []
        for side in (-1.0, 1.0):
            slope = (band.shift_mm + side * band.stopped_mm) / self.distance_mm
            sine = slope / math.hypot(1.0, slope)
            ends += [highest * sine, highest * sine * least_fraction]
        low, high = min(ends), max(ends)
        return max(low, -nyquist), min(high, nyquist)

    def _bounds_behind_plate(self, band: BandLimit, nyquist: float, across: float) -> tuple[float, float]:
        """Return the bounds of :meth:`_bounds` from samples of the lateral shift."""
        count = 4097
        cycles, step = np.linspace(-nyquist, nyquist, count, retstep=True)
        arrives = np.zeros(count, bool)
        for other in (0.0, across):
            waves = PlaneWaves([cycles, np.asarray(other)], self.wavelength_um, self.index)
            shift_mm = next(waves.lateral_shift_mm(self.distance_mm, self.plate))
            arrives |= waves.propagating & (np.abs(shift_mm - band.shift_mm) <= band.stopped_mm)
        if not np.any(arrives):
            return -nyquist, nyquist
        return max(cycles[arrives][0] - step, -nyquist), min(cycles[arrives][-1] + step, nyquist)

    @property
    def widest(self) -> int:
        """Samples of the largest transform."""
        return max(length * others for _, length, _, others in self._sums())

    @property
    def seconds(self) -> float:
        """Predicted time of one use on this machine."""
        total = 4.0 * exponential_seconds(self.samples)
        for given, length, result, others in self._sums():
            total += 2.0 * fft_seconds(length * others, self.source.is_line) + fft_seconds(length, True)
            total += (given + length + 2.0 * result) * others * pass_seconds(1 << 16) / (1 << 16)
            total += exponential_seconds(given + length + result)
        return total

    @property
    def peak_bytes(self) -> int:
        """Peak memory of one use, without its result."""
        sums = [
            (2 * given + 2 * length + result) * others + (3 * length) // 2 + given + result
            for given, length, result, others in self._sums()
        ]
        return max(16 * (self.samples + max(sums)), FACTOR_BYTES * self.samples)

    def _sums(self) -> Iterator[tuple[int, int, int, int]]:
        """Yield samples given, of the convolution, of the result, and across, for each chirp-z transform."""
        shape = list(self.source.shape)
        for counts in ([f.count for f in self.frequencies], self.target.shape):
            for axis, result in enumerate(counts):
                given = shape[axis]
                yield given, scipy.fft.next_fast_len(given + result - 1), result, math.prod(shape) // given
                shape[axis] = result
