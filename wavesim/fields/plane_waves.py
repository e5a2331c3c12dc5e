"""Plane waves: which of them a grid holds, where they go, and their factors over a distance.

Over a distance z a plane wave moves the light it carries by z tan(theta). Its factor exp(i kz z) can be
sampled as long as that walk, seen from the output window, stays below half the period that the sampled
spectrum gives the field (Matsushima and Shimobaba 2009; for windows off the axis, Matsushima 2010). What
walks farther reaches no output sample and is faded out over a few Fresnel zones, so that its cut leaves no
ripples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import DTypeLike, NDArray

from wavesim.fields.field import Grid

ComplexArray = NDArray[np.complexfloating[Any, Any]]

TURN = 2.0 * math.pi
FADE_ZONES = 6.0
"""Width of the fade in Fresnel lengths sqrt(wavelength * distance)."""
STEEPEST_COSINE = 0.3
"""Beyond this slope waves carry too little light over a distance to widen the fade for."""
FACTOR_ROWS = 16
"""Of a factor that is kept, made at a time."""


@dataclass(frozen=True)
class Samples:
    """Evenly spaced points on one axis.

    Attributes
    ----------
    centre, step : float
        Middle of the points, and the distance between neighbours.
    count : int
        How many.
    """

    centre: float
    step: float
    count: int

    def offsets(self, xp: Any = np) -> Any:
        """Points less their centre: float64."""
        return self.step * (xp.arange(self.count, dtype=xp.float64) - 0.5 * (self.count - 1))

    def points(self, xp: Any = np) -> Any:
        """The points: float64."""
        return self.offsets(xp) + self.centre


def along(values: Any, axis: int, dimensions: int, xp: Any = np) -> Any:
    """A 1-D array laid along one axis of several."""
    return xp.reshape(values, (1,) * axis + (-1,) + (1,) * (dimensions - axis - 1))


def fft_frequencies(shape: tuple[int, ...], pitch_mm: float, xp: Any = np) -> list[Any]:
    """Cycles per mm along each axis, in FFT order, shaped so that they broadcast to `shape`."""
    result = []
    for axis, n in enumerate(shape):
        order = xp.arange(n, dtype=xp.float64)
        cycles = xp.where(order > (n - 1) // 2, order - n, order) / (n * pitch_mm)
        result.append(along(cycles, axis, len(shape), xp))
    return result


def axial_wavenumbers(
    cycles_per_mm: Sequence[Any], wavelength_um: float, index: float, xp: Any = np
) -> tuple[Any, Any]:
    """kz (1/mm, 0 where the wave decays) of plane waves, and where they do not decay."""
    squared = xp.asarray((2e3 * math.pi * index / wavelength_um) ** 2)
    for cycles in cycles_per_mm:
        squared = squared - (2.0 * math.pi * cycles) ** 2
    propagating = squared > 0.0
    return xp.sqrt(xp.where(propagating, squared, xp.zeros_like(squared))), propagating


def lateral_shift_mm(cycles_per_mm: Sequence[Any], kz: Any, distance_mm: float, xp: Any = np) -> list[Any]:
    """How far plane waves carry light along each axis over a distance; meaningless where kz is 0."""
    safe = xp.where(kz > 0.0, kz, xp.ones_like(kz))
    return [2.0 * math.pi * distance_mm * cycles / safe for cycles in cycles_per_mm]


@dataclass(frozen=True)
class BandLimit:
    """Along one axis, which walks a transfer function lets pass.

    Attributes
    ----------
    shift_mm : float
        Of the output window's centre from the input window's.
    passed_mm, stopped_mm : float
        Walks that differ from the shift by less pass whole, and by more not at all. Where the two are equal
        the cut is sharp.
    """

    shift_mm: float
    passed_mm: float
    stopped_mm: float

    def weight(self, walk_mm: Any, xp: Any = np) -> Any:
        """Between 0 and 1 for each walk."""
        away = abs(walk_mm - self.shift_mm)
        if self.stopped_mm <= self.passed_mm:
            return xp.asarray(away <= self.passed_mm, dtype=xp.float64)
        part = (self.stopped_mm - away) / (self.stopped_mm - self.passed_mm)
        part = xp.clip(part, 0.0, 1.0)
        return xp.sin(0.5 * math.pi * xp.sin(0.5 * math.pi * part) ** 2) ** 2


def phasor_of(phase: Any, dtype: Any = None, xp: Any = np) -> Any:
    """exp(i phase) of phases in float64, which are reduced before they are rounded to a single `dtype`.

    complex64 if that is the `dtype`, else complex128.
    """
    kind = xp.complex64 if dtype == xp.complex64 else xp.complex128
    if kind == xp.complex64:
        phase = xp.asarray(phase - TURN * xp.round(phase / TURN), dtype=xp.float32)
    if not hasattr(phase, "real"):  # of the array API alone: no parts to write to
        return xp.cos(phase) + 1j * xp.sin(phase)
    result = xp.empty(phase.shape, dtype=kind)
    xp.cos(phase, out=result.real)
    xp.sin(phase, out=result.imag)
    return result


def transfer(
    cycles_per_mm: Sequence[Any],
    wavelength_um: float,
    index: float,
    distance_mm: float,
    bands: Sequence[BandLimit] | None = None,
    *,
    dtype: Any = None,
    xp: Any = np,
) -> Any:
    """Factor of each plane wave over a distance, decaying ones left out: complex128, or as `dtype` says.

    With `bands` it is taken to the shifted output window, and what does not pass is left out.
    """
    kz, propagating = axial_wavenumbers(cycles_per_mm, wavelength_um, index, xp)
    phase = kz * distance_mm
    weight = xp.asarray(propagating, dtype=xp.float64)
    if bands is not None:
        walks = lateral_shift_mm(cycles_per_mm, kz, distance_mm, xp)
        for cycles, walk, band in zip(cycles_per_mm, walks, bands, strict=True):
            weight = weight * band.weight(walk, xp)
            phase = phase + TURN * band.shift_mm * cycles
    factor = phasor_of(phase, dtype, xp)
    return factor * xp.asarray(weight, dtype=xp.float32 if factor.dtype == xp.complex64 else xp.float64)


class TransferFunction:
    """Free space between parallel planes, as a factor of a field's spectrum: `spectrum * way`.

    The factor is the same for a frequency and its negative along each axis: a quarter of it is kept, beside
    the factors of a sideways shift, one along each axis.

    Parameters
    ----------
    grid
        Of the field, on either plane.
    wavelength_um
        Vacuum wavelength.
    distance_mm
        From the first plane to the second.
    dtype
        Of the factor.
    shift_mm : (x, y)
        Of the second plane's samples from the first's.

    Attributes
    ----------
    factor : ndarray
        For frequencies that are not negative; one sample, 1, where the way changes nothing.
    rows, columns : ndarray of int
        Which row and column of the factor belong to each row and column of a spectrum; a line is one row.
    down, across : ndarray
        Factors of the shift for each row and column; 1 without one.
    is_none : bool
        Whether the way changes nothing.
    """

    __array_ufunc__ = None  # a product with an array is ours to make

    def __init__(
        self,
        grid: Grid,
        wavelength_um: float,
        distance_mm: float,
        dtype: DTypeLike,
        shift_mm: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        shape = (1, *grid.shape)[-2:]
        self.down, self.across = (
            np.exp(2j * np.pi / grid.pitch_mm * shift * scipy.fft.fftfreq(n)).astype(dtype)
            for n, shift in zip(shape, reversed(shift_mm), strict=True)
        )
        down, across = (np.arange(n // 2 + 1) / (n * grid.pitch_mm) for n in shape)
        held = math.hypot(down[-1], across[-1]) < 1e3 / wavelength_um
        self.is_none = distance_mm == 0.0 and not any(shift_mm) and held
        orders = [np.minimum(np.arange(n), n - np.arange(n)) for n in shape]
        self.rows, self.columns = (np.zeros_like(order) if self.is_none else order for order in orders)
        self.factor: ComplexArray = np.ones((1, 1) if self.is_none else (len(down), len(across)), dtype)
        for first in range(0, 0 if self.is_none else len(down), FACTOR_ROWS):
            rows = slice(first, first + FACTOR_ROWS)
            cycles = [down[rows, None], across]
            self.factor[rows] = transfer(cycles, wavelength_um, 1.0, distance_mm, dtype=np.dtype(dtype))

    def __rmul__(self, spectrum: ComplexArray) -> ComplexArray:
        return self.times(spectrum.copy())

    def times(self, spectrum: ComplexArray, *, back: bool = False) -> ComplexArray:
        """A spectrum on the second plane, in place; `back`: from it to the first."""
        if self.is_none:
            return spectrum
        factor, down, across = self.factor, self.down, self.across
        if back:
            factor, down, across = factor.conj(), down.conj(), across.conj()
        for row, along, values in zip(self.rows, down, np.atleast_2d(spectrum), strict=True):
            values *= along * across * factor[row, self.columns]
        return spectrum

    def there(self, spectrum: ComplexArray) -> ComplexArray:
        """The field on the second plane, from its spectrum on the first."""
        return np.asarray(scipy.fft.ifftn(self.times(spectrum.copy()), workers=-1, overwrite_x=True))

    def back(self, values: ComplexArray) -> ComplexArray:
        """The spectrum on the first plane, from the field on the second: the adjoint; uses the field up."""
        return self.times(np.asarray(scipy.fft.fftn(values, workers=-1, overwrite_x=True)), back=True)


def largest_lateral_shift_mm(grid: Grid, wavelength_um: float, index: float, distance_mm: float) -> float:
    """Walk along an axis of the steepest wave that a grid holds; infinite at 90 degrees."""
    sine = wavelength_um / (2e3 * index * grid.pitch_mm)
    cosine_squared = 1.0 - len(grid.shape) * sine * sine
    if distance_mm == 0.0:
        return 0.0
    return abs(distance_mm) * sine / math.sqrt(cosine_squared) if cosine_squared > 0.0 else math.inf


def fresnel_length_mm(wavelength_um: float, index: float, distance_mm: float, walk_mm: float) -> float:
    """Width over which a wave's walk is blurred: sqrt(wavelength distance / cos^3)."""
    distance = abs(distance_mm)
    cosine = max(distance / math.hypot(distance, walk_mm), STEEPEST_COSINE) if distance else 1.0
    return math.sqrt(1e-3 * wavelength_um / index * distance / cosine**3)


@dataclass(frozen=True)
class SamplingWindow:
    """An input and an output window, along one axis.

    Attributes
    ----------
    pitch_mm : float
        Of the input samples.
    shift_mm : float
        From the input window's centre to the output window's.
    half_in_mm, half_out_mm : float
        Half of their widths.
    """

    pitch_mm: float
    shift_mm: float
    half_in_mm: float
    half_out_mm: float

    @property
    def reach_mm(self) -> float:
        """Half the sum of the widths: how far from the shift a walk may be and still end inside."""
        return self.half_in_mm + self.half_out_mm

    def pass_band(self, count: int) -> BandLimit:
        """What may pass when a period of the field has `count` samples."""
        period = count * self.pitch_mm
        if period >= 2.0 * self.reach_mm:
            return BandLimit(self.shift_mm, self.reach_mm, period - self.reach_mm)
        return BandLimit(self.shift_mm, 0.5 * period, 0.5 * period)


def windows(source: Grid, target: Grid) -> list[SamplingWindow]:
    """For each axis."""
    return [
        SamplingWindow(source.pitch_mm, there - here, half_in, half_out)
        for here, there, half_in, half_out in zip(
            centres_mm(source), centres_mm(target), source.half_widths_mm, target.half_widths_mm, strict=True
        )
    ]


def centres_mm(grid: Grid) -> tuple[float, ...]:
    """Of a grid, in the order of its shape."""
    return grid.centre_mm[::-1][: len(grid.shape)]


def period_counts(
    source: Grid, target: Grid, wavelength_um: float, index: float, distance_mm: float
) -> tuple[int, ...]:
    """Samples along each axis that a period must have so that no copy of the field reaches the output."""
    counts = []
    steepest = largest_lateral_shift_mm(source, wavelength_um, index, distance_mm)
    for axis, pair in enumerate(windows(source, target)):
        farthest = min(pair.reach_mm + abs(pair.shift_mm), steepest)
        fade = FADE_ZONES * fresnel_length_mm(wavelength_um, index, distance_mm, farthest)
        period = min(2.0 * pair.reach_mm, pair.reach_mm + abs(pair.shift_mm) + steepest) + fade
        counts.append(max(math.ceil(period / pair.pitch_mm - 1e-9), source.shape[axis]))
    return tuple(counts)


def fast_count(count: int) -> int:
    """Next size at which Fourier transforms are fast."""
    return int(scipy.fft.next_fast_len(count))
