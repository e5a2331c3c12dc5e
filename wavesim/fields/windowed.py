"""Fourier sums between evenly spaced points of any pitch (Bluestein), and with them free space to any window.

The chirp-z transform writes x f as (x^2 + f^2 - (f - x)^2) / 2, so that a Fourier sum becomes a convolution
with a chirp (the paper's Appendix B). Free space takes one such sum to the part of the spectrum that can
reach the output window, and a second one to the window's samples.
"""

from __future__ import annotations

import math
from typing import Any

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.field import Field, Grid
from wavesim.fields.free_space import MOST_SAMPLES
from wavesim.fields.guards import check_propagation
from wavesim.fields.plane_waves import (
    Passage,
    Samples,
    along,
    centres_mm,
    fast_count,
    period_counts,
    transfer,
    windows,
)
from wavesim.runtime.arrays import array_module, fft, ifft


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
        return along(xp.asarray(xp.exp(1j * phase), dtype=kind), axis, values.ndim, xp)

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


def propagate_to(field: Field, grid: Grid, *, check: bool = True, coarse_output: bool = False) -> Field:
    """Carry a field to any grid in a parallel plane: other pitch, window and centre.

    Parameters
    ----------
    field
        Single precision stays single; the phases are formed in double.
    grid
        Where to; in front of the field if it is to be carried back.
    check
        Whether to judge the sampling first (:func:`wavesim.fields.guards.check_propagation`).
    coarse_output
        Whether to accept an output pitch too coarse for the field that falls there.

    Raises
    ------
    SamplingError
        If the samples cannot hold the field on its way, or the spectrum needs too many of them.
    InputError
        If one grid is a line and the other a plane.

    Warns
    -----
    SamplingWarning
        If a small part of the energy is lost.
    """
    passing = Passing(field.grid, grid, field.wavelength_um, field.index)
    if check:
        if math.prod(f.count for f in passing.frequencies) > MOST_SAMPLES:
            sides = " x ".join(str(f.count) for f in passing.frequencies)
            raise SamplingError(
                f"{abs(passing.distance_mm):.4g} mm from {centres_mm(field.grid)} to {centres_mm(grid)} mm "
                f"takes {sides} samples of the spectrum, more than {MOST_SAMPLES:.3g}: give smaller windows "
                "or a coarser input pitch"
            )
        check_propagation(field, passing.distance_mm, grid, coarse_output=coarse_output)
    xp = array_module(field.values)
    factor = passing.factor(xp) * (passing.cell * field.grid.cell)
    values = field.values
    for axis, (x, f) in enumerate(zip(passing.inputs, passing.frequencies, strict=True)):
        values = chirp_z_transform(values, x, f, sign=-1, axis=axis)
    values = values * xp.asarray(factor, dtype=values.dtype)
    for axis, (f, x) in enumerate(zip(passing.frequencies, passing.outputs, strict=True)):
        values = chirp_z_transform(values, f, x, sign=1, axis=axis)
    return Field(grid, values, field.wavelength_um, field.index)


def propagate_to_adjoint(field: Field, grid: Grid) -> Field:
    """Exact adjoint of :func:`propagate_to` from `grid` to the field's grid, unchecked."""
    passing = Passing(grid, field.grid, field.wavelength_um, field.index)
    xp = array_module(field.values)
    factor = xp.conj(passing.factor(xp)) * (passing.cell * field.grid.cell)
    values = field.values
    for axis, (x, f) in enumerate(zip(passing.outputs, passing.frequencies, strict=True)):
        values = chirp_z_transform(values, x, f, sign=-1, axis=axis)
    values = values * xp.asarray(factor, dtype=values.dtype)
    for axis, (f, x) in enumerate(zip(passing.frequencies, passing.inputs, strict=True)):
        values = chirp_z_transform(values, f, x, sign=1, axis=axis)
    return Field(grid, values, field.wavelength_um, field.index)


class Passing:
    """From one grid to another: the sampled part of the spectrum, and its factor.

    Input and output points are counted from the middles of their grids.
    """

    def __init__(self, source: Grid, target: Grid, wavelength_um: float, index: float) -> None:
        if source.is_line != target.is_line:
            raise InputError("input grid and output grid: both must be lines, or both planes")
        self.distance_mm = target.z_mm - source.z_mm
        self.wavelength_um, self.index = wavelength_um, index
        self.inputs = [Samples(0.0, source.pitch_mm, n) for n in source.shape]
        self.outputs = [Samples(0.0, target.pitch_mm, n) for n in target.shape]
        counts = period_counts(source, target, wavelength_um, index, self.distance_mm)
        self.passages = [pair.passage(n) for pair, n in zip(windows(source, target), counts, strict=True)]
        self.frequencies = self._arriving(source, counts)
        self.cell = math.prod(f.step for f in self.frequencies)

    def _arriving(self, source: Grid, counts: tuple[int, ...]) -> list[Samples]:
        """Frequencies that reach the output window, at the step that the period asks for."""
        nyquist = 0.5 / source.pitch_mm
        bounds = [
            self._bounds(p, nyquist, self._steepest_across(axis, nyquist))
            for axis, p in enumerate(self.passages)
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
        if len(self.passages) == 1:
            return 0.0
        return max(abs(f) for f in self._bounds(self.passages[1 - axis], nyquist, 0.0))

    def _bounds(self, let: Passage, nyquist: float, across: float) -> tuple[float, float]:
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

    def factor(self, xp: Any) -> Any:
        dimensions = len(self.frequencies)
        cycles = [along(f.points(xp), axis, dimensions, xp) for axis, f in enumerate(self.frequencies)]
        return transfer(cycles, self.wavelength_um, self.index, self.distance_mm, self.passages, xp)
