"""Plane waves of a grid: frequencies, lateral shifts over a distance, and transfer functions.

Over a distance z a plane wave at an angle theta carries its light sideways by z tan(theta). Its transfer
factor exp(i kz z) is sampled finely enough while this lateral shift, relative to the output window, stays
below half the period that the sampled spectrum gives the field (Matsushima and Shimobaba 2009; for windows
off the axis, Matsushima 2010). Waves with larger shifts reach no output sample. They are attenuated smoothly
over a few Fresnel zones, since a sharp cut would cause ripples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.raytrace.plane_plate import PlanePlate
from wavesim.fields.field import Grid

Pad = Literal["auto"] | tuple[int, ...]

TURN = 2.0 * math.pi
FADE_ZONES = 6.0
"""Width of the smooth attenuation in Fresnel lengths sqrt(wavelength * distance)."""


@dataclass(frozen=True)
class Samples:
    """Evenly spaced points on one axis.

    Attributes
    ----------
    centre, step : float
        Centre of the points, and the distance between neighbours.
    count : int
        Number of points.
    """

    centre: float
    step: float
    count: int

    def offsets(self) -> Any:
        """Return the points relative to their centre, in float64."""
        return self.step * (np.arange(self.count, dtype=np.float64) - 0.5 * (self.count - 1))

    def points(self) -> Any:
        """Return the points, in float64."""
        return self.offsets() + self.centre


def along(values: Any, axis: int, dimensions: int) -> Any:
    """Reshape a 1-D array so that it lies along one axis of several."""
    return np.reshape(values, (1,) * axis + (-1,) + (1,) * (dimensions - axis - 1))


def fft_frequencies(shape: tuple[int, ...], pitch_mm: float) -> list[Any]:
    """Return cycles per mm along each axis, in FFT order, shaped so that they broadcast to `shape`."""
    result = []
    for axis, n in enumerate(shape):
        order = np.arange(n, dtype=np.float64)
        cycles = np.where(order > (n - 1) // 2, order - n, order) / (n * pitch_mm)
        result.append(along(cycles, axis, len(shape)))
    return result


@dataclass(frozen=True)
class BandLimit:
    """Lateral shifts along one axis that a transfer function transmits.

    Attributes
    ----------
    shift_mm : float
        Offset of the output window's centre from the input window's.
    passed_mm, stopped_mm : float
        Waves whose lateral shift differs from `shift_mm` by less than `passed_mm` are transmitted, and those
        beyond `stopped_mm` are blocked. The cut is sharp where both are equal.
    """

    shift_mm: float
    passed_mm: float
    stopped_mm: float

    def weight(self, lateral_shift_mm: Any) -> Any:
        """Return the transmission (0 to 1) for each lateral shift."""
        away = abs(lateral_shift_mm - self.shift_mm)
        if self.stopped_mm <= self.passed_mm:
            return np.asarray(away <= self.passed_mm, dtype=np.float64)
        inner = (self.stopped_mm - away) / (self.stopped_mm - self.passed_mm)
        inner = np.clip(inner, 0.0, 1.0)
        return np.sin(0.5 * math.pi * np.sin(0.5 * math.pi * inner) ** 2) ** 2


def phasor_of(phase: Any, dtype: Any = None) -> Any:
    """Return exp(i phase) of phases in float64, as complex64 if that is the `dtype`, else complex128.

    The phase is reduced to one turn before it is rounded to single precision.
    """
    kind = np.complex64 if dtype == np.complex64 else np.complex128
    if kind == np.complex64:
        phase = np.asarray(phase - TURN * np.round(phase / TURN), dtype=np.float32)
    result = np.empty(phase.shape, dtype=kind)
    np.cos(phase, out=result.real)
    np.sin(phase, out=result.imag)
    return result


@dataclass(frozen=True, eq=False)
class PlaneWaves:
    """Plane waves in a homogeneous medium, and their transfer function.

    Attributes
    ----------
    cycles_per_mm : sequence of ndarray
        Frequencies along each axis (y, then x), shaped so that they broadcast.
    wavelength_um, index : float
        Vacuum wavelength in um, and refractive index.
    smallest_kz_per_mm : float
        Axial wavenumber up to which waves are omitted; 0 omits evanescent waves only.
    """

    cycles_per_mm: Sequence[Any]
    wavelength_um: float
    index: float = 1.0
    smallest_kz_per_mm: float = 0.0

    @classmethod
    def of(
        cls, grid: Grid, wavelength_um: float, index: float = 1.0, smallest_kz_per_mm: float = 0.0
    ) -> PlaneWaves:
        """Return the plane waves that a grid samples, in FFT order."""
        return cls(fft_frequencies(grid.shape, grid.pitch_mm), wavelength_um, index, smallest_kz_per_mm)

    @cached_property
    def kz(self) -> Any:
        """Axial wavenumbers (1/mm); omitted waves have the smallest one."""
        squared = np.asarray((2e3 * math.pi * self.index / self.wavelength_um) ** 2)
        for cycles in self.cycles_per_mm:
            squared = squared - (2.0 * math.pi * cycles) ** 2
        # In place, because these arrays are the largest of some engines.
        np.maximum(squared, 0.0, out=squared)
        np.sqrt(squared, out=squared)
        return np.maximum(squared, self.smallest_kz_per_mm, out=squared)

    @property
    def propagating(self) -> NDArray[np.bool_]:
        """Mask of the waves that are not omitted."""
        return np.asarray(self.kz > self.smallest_kz_per_mm)

    @property
    def transverse(self) -> list[Any]:
        """Transverse wavenumbers (1/mm) along each axis (y, then x)."""
        return [2.0 * math.pi * cycles for cycles in self.cycles_per_mm]

    def kz_in(self, plate: PlanePlate) -> Any:
        """Return the axial wavenumbers (1/mm) of the waves inside a plate; 0 for evanescent ones."""
        return PlaneWaves(self.cycles_per_mm, self.wavelength_um, float(plate.index[0])).kz

    def lateral_shift_mm(self, distance_mm: float, plate: PlanePlate | None = None) -> Iterator[Any]:
        """Yield the lateral shift along each axis over a distance; meaningless where kz is 0.

        With a plate, its thickness is part of the distance.
        """
        safe = np.where(self.kz > 0.0, self.kz, np.ones_like(self.kz))
        lengths = distance_mm / safe
        if plate is not None:
            inside = np.maximum(self.kz_in(plate), np.finfo(float).tiny)
            lengths = lengths + plate.thickness_mm * (1.0 / inside - 1.0 / safe)
        for cycles in self.cycles_per_mm:
            yield 2.0 * math.pi * cycles * lengths

    def transfer_function(
        self,
        distance_mm: float,
        bands: Sequence[BandLimit] | None = None,
        *,
        plate: PlanePlate | None = None,
        dtype: Any = None,
    ) -> Any:
        """Return the factor exp(i kz z) of each wave over a distance, 0 for omitted waves.

        With `bands` the factor refers to the shifted output window, and waves outside the bands are blocked.
        With a plate of thickness t, whose faces transmit all light, a part t of the distance lies in its
        glass: the factor is multiplied by exp(i t (kz_glass - kz)). The position of the plate has no effect.
        The result is complex128, or complex64 if that is the `dtype`.
        """
        phase = self.kz * distance_mm
        if plate is not None:
            phase += plate.thickness_mm * (self.kz_in(plate) - self.kz)
        if bands is None:
            factor = phasor_of(phase, dtype)
            factor[~self.propagating] = 0.0
            return factor
        weight = self.propagating.astype(float)
        for cycles, shift_mm, band in zip(
            self.cycles_per_mm, self.lateral_shift_mm(distance_mm, plate), bands, strict=True
        ):
            weight *= band.weight(shift_mm)
            phase += TURN * band.shift_mm * cycles
        factor = phasor_of(phase, dtype)
        del phase
        factor *= np.asarray(weight, factor.real.dtype)
        return factor


def largest_lateral_shift_mm(grid: Grid, wavelength_um: float, index: float, distance_mm: float) -> float:
    """Return the lateral shift of the steepest wave that a grid samples; infinite at 90 degrees."""
    sine = wavelength_um / (2e3 * index * grid.pitch_mm)
    cosine_squared = 1.0 - len(grid.shape) * sine * sine
    if distance_mm == 0.0:
        return 0.0
    return abs(distance_mm) * sine / math.sqrt(cosine_squared) if cosine_squared > 0.0 else math.inf


def fresnel_length_mm(
    wavelength_um: float, index: float, distance_mm: float, lateral_shift_mm: float
) -> float:
    """Return the diffraction width of a wave's arrival point: sqrt(wavelength distance / cos^3)."""
    distance = abs(distance_mm)
    # Least cosine in the Fresnel length: steeper waves carry too little light to widen the period.
    steepest_cosine = 0.3
    cosine = max(distance / math.hypot(distance, lateral_shift_mm), steepest_cosine) if distance else 1.0
    return math.sqrt(1e-3 * wavelength_um / index * distance / cosine**3)


@dataclass(frozen=True)
class SamplingWindow:
    """An input and an output window along one axis.

    Attributes
    ----------
    pitch_mm : float
        Pitch of the input samples.
    shift_mm : float
        Offset of the output window's centre from the input window's.
    half_in_mm, half_out_mm : float
        Half-widths of the windows.
    """

    pitch_mm: float
    shift_mm: float
    half_in_mm: float
    half_out_mm: float

    @property
    def reach_mm(self) -> float:
        """Half the sum of the widths: the largest difference from the shift at which light ends inside."""
        return self.half_in_mm + self.half_out_mm

    def band_limit(self, count: int) -> BandLimit:
        """Return the shifts to transmit if a period of the field has `count` samples."""
        period = count * self.pitch_mm
        if period >= 2.0 * self.reach_mm:
            return BandLimit(self.shift_mm, self.reach_mm, period - self.reach_mm)
        return BandLimit(self.shift_mm, 0.5 * period, 0.5 * period)


def sampling_windows(source: Grid, target: Grid) -> list[SamplingWindow]:
    """Return the sampling windows of all axes."""
    return [
        SamplingWindow(source.pitch_mm, target_centre - source_centre, half_in, half_out)
        for source_centre, target_centre, half_in, half_out in zip(
            centres_mm(source), centres_mm(target), source.half_widths_mm, target.half_widths_mm, strict=True
        )
    ]


def centres_mm(grid: Grid) -> tuple[float, ...]:
    """Return the centre of a grid in the order of its shape."""
    return grid.centre_mm[::-1][: len(grid.shape)]


def padded_shape(
    source: Grid,
    target: Grid,
    wavelength_um: float,
    index: float,
    distance_mm: float,
    plate: PlanePlate | None = None,
) -> tuple[int, ...]:
    """Return the samples of a period along each axis for which no copy of the field reaches the output."""
    counts = []
    if plate is not None:
        # The lateral shift lies between those of the distance with and without the plate's thickness.
        distance_mm = max(abs(distance_mm), abs(distance_mm - plate.thickness_mm))
    steepest = largest_lateral_shift_mm(source, wavelength_um, index, distance_mm)
    for axis, pair in enumerate(sampling_windows(source, target)):
        farthest = min(pair.reach_mm + abs(pair.shift_mm), steepest)
        fade = FADE_ZONES * fresnel_length_mm(wavelength_um, index, distance_mm, farthest)
        period = min(2.0 * pair.reach_mm, pair.reach_mm + abs(pair.shift_mm) + steepest) + fade
        counts.append(max(math.ceil(period / pair.pitch_mm - 1e-9), source.shape[axis]))
    return tuple(counts)
