"""Fourier sums between evenly spaced points of any pitch (Bluestein), and with them free space to any window.

The chirp-z transform writes x f as (x^2 + f^2 - (f - x)^2) / 2, so that a Fourier sum becomes a convolution
with a chirp (the paper's Appendix B). Free space takes one such sum to the part of the spectrum that can
reach the output window, and a second one to the window's samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from lensdesign.errors import InputError
from wavesim.fields.angular_spectrum import FACTOR_BYTES
from wavesim.fields.field import Field, Grid
from wavesim.fields.guards import check_propagation, check_sample_count
from wavesim.fields.plane_waves import (
    BandLimit,
    Samples,
    along,
    centres_mm,
    fast_count,
    period_counts,
    phasor_of,
    transfer,
    windows,
)
from wavesim.runtime.arrays import array_module, fft, ifft
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds


def chirp_z_transform(
    values: Any, source: Samples, target: Samples, *, sign: int = -1, axis: int = -1
) -> Any:
    """Sum over n of values[n] exp(sign 2 pi i x[n] f[m]), for evenly spaced x and f of any step.

    Parameters
    ----------
    values
        Along `axis` one for each point of `source`.
    source, target
        Points x of the sum, and f of the result.
    sign
        -1 or 1. The adjoint swaps source and target, and the sign.
    axis
        Along which to sum.

    Returns
    -------
    array
        Single precision stays single; along `axis` one for each point of `target`.
    """
    xp = array_module(values)
    kind = xp.result_type(values.dtype, xp.complex64)
    axis = axis % values.ndim
    if values.shape[axis] != source.count:
        raise InputError(f"values have {values.shape[axis]} samples along axis {axis}, not {source.count}")
    turn = sign * 2.0 * math.pi

    def wave(phase: Any) -> Any:
        return along(phasor_of(phase, kind, xp), axis, values.ndim, xp)

    x, f = source.offsets(xp), target.offsets(xp)
    rate = 0.5 * turn * source.step * target.step
    order_x = xp.arange(source.count, dtype=xp.float64) - 0.5 * (source.count - 1)
    order_f = xp.arange(target.count, dtype=xp.float64) - 0.5 * (target.count - 1)
    size = fast_count(source.count + target.count - 1)
    lag = xp.arange(size, dtype=xp.float64)
    lag = xp.where(lag < target.count, lag, lag - size) - 0.5 * (target.count - source.count)
    chirp = fft(wave(-rate * lag**2), axis=axis)

    spread = values * wave(rate * order_x**2 + turn * target.centre * x)
    spectrum = fft(spread, size, axis, overwrite=True)
    summed = ifft(spectrum * chirp, axis, overwrite=True)
    wanted = summed[(slice(None),) * axis + (slice(0, target.count), ...)]
    return wanted * wave(rate * order_f**2 + turn * source.centre * (f + target.centre))


class ChirpZ:
    """A passage by chirp-z transforms, to any window and pitch.

    The sampled part of the spectrum is the one that arrives. Input and output points are counted from the
    middles of their grids.
    """

    def __init__(self, source: Grid, target: Grid, wavelength_um: float, index: float) -> None:
        self.source, self.target = source, target
        self.wavelength_um, self.index = wavelength_um, index
        self.distance_mm = target.z_mm - source.z_mm
        self.inputs = [Samples(0.0, source.pitch_mm, n) for n in source.shape]
        self.outputs = [Samples(0.0, target.pitch_mm, n) for n in target.shape]
        counts = period_counts(source, target, wavelength_um, index, self.distance_mm)
        self.bands = [pair.pass_band(n) for pair, n in zip(windows(source, target), counts, strict=True)]
        self.frequencies = self._arriving(source, counts)
        self.samples = math.prod(f.count for f in self.frequencies)

    def check(self, values: Any, coarse_output: bool) -> None:
        """Warn, or refuse, where samples cannot hold the field."""
        places = f"{centres_mm(self.source)} to {centres_mm(self.target)} mm"
        counts = [f.count for f in self.frequencies]
        check_sample_count(counts, f"{abs(self.distance_mm):.4g} mm from {places}")
        field = Field(self.source, values, self.wavelength_um, self.index)
        check_propagation(field, self.target, coarse_output=coarse_output)

    def forward(self, values: Any) -> Any:
        return self._carried(values, self.inputs, self.outputs, self.source.cell, back=False)

    def adjoint(self, values: Any) -> Any:
        return self._carried(values, self.outputs, self.inputs, self.target.cell, back=True)

    def _carried(
        self, values: Any, given: list[Samples], wanted: list[Samples], cell: float, *, back: bool
    ) -> Any:
        xp = array_module(values)
        kind = xp.result_type(values.dtype, xp.complex64)
        cell *= math.prod(f.step for f in self.frequencies)
        dimensions = len(self.frequencies)
        cycles = [along(f.points(xp), axis, dimensions, xp) for axis, f in enumerate(self.frequencies)]
        factor = cell * transfer(
            cycles, self.wavelength_um, self.index, self.distance_mm, self.bands, dtype=kind, xp=xp
        )
        for axis, (x, f) in enumerate(zip(given, self.frequencies, strict=True)):
            values = chirp_z_transform(values, x, f, sign=-1, axis=axis)
        values = values * (xp.conj(factor) if back else factor)
        for axis, (f, x) in enumerate(zip(self.frequencies, wanted, strict=True)):
            values = chirp_z_transform(values, f, x, sign=1, axis=axis)
        return values

    def _arriving(self, source: Grid, counts: tuple[int, ...]) -> list[Samples]:
        """Frequencies that reach the output window, at the step that the period asks for."""
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
        """Largest frequency along the other axis that arrives."""
        if len(self.bands) == 1:
            return 0.0
        return max(abs(f) for f in self._bounds(self.bands[1 - axis], nyquist, 0.0))

    def _bounds(self, let: BandLimit, nyquist: float, across: float) -> tuple[float, float]:
        """Lowest and highest frequency along one axis that passes, given the highest along the other."""
        if self.distance_mm == 0.0:
            return -nyquist, nyquist
        most = 1e3 * self.index / self.wavelength_um
        least_share = math.sqrt(max(1.0 - (across / most) ** 2, 0.0))
        ends = []
        for side in (-1.0, 1.0):
            slope = (let.shift_mm + side * let.stopped_mm) / self.distance_mm
            sine = slope / math.hypot(1.0, slope)
            ends += [most * sine, most * sine * least_share]
        low, high = min(ends), max(ends)
        return max(low, -nyquist), min(high, nyquist)

    @property
    def widest(self) -> int:
        """Samples of the largest transform."""
        return max(length * others for _, length, _, others in self._sums())

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

    def _sums(self) -> Iterator[tuple[int, int, int, int]]:
        """Of each chirp-z transform: samples given, of the convolution, taken, and along the other axis."""
        shape = list(self.source.shape)
        for wanted in ([f.count for f in self.frequencies], self.target.shape):
            for axis, taken in enumerate(wanted):
                given = shape[axis]
                yield given, fast_count(given + taken - 1), taken, math.prod(shape) // given
                shape[axis] = taken
