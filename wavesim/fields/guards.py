"""Warnings of the wave engines, and the guard of free space: can these samples hold the field on its way?

What is measured are parts of the field's energy, from its spectrum and from where its light goes by
geometry: under `WARNED` nothing is said, up to `REFUSED` the part is stated in a :class:`SamplingWarning`,
and beyond it a :class:`~lensdesign.errors.SamplingError` says what to change.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.field import Field, Grid
from wavesim.fields.plane_waves import (
    Samples,
    axial_wavenumbers,
    fft_frequencies,
    largest_lateral_shift_mm,
    lateral_shift_mm,
    period_counts,
    windows,
)
from wavesim.runtime.arrays import array_module, fftn

Pad = Literal["auto"] | tuple[int, ...]

WARNED = 1e-5
"""Part of the energy from which on a loss is told: an error of about 0.4 % of the field."""
REFUSED = 1e-2
"""Part of the energy from which on a field is refused: an error of about 15 %."""
EDGE = 0.8
"""Start of what counts as the edge of the Nyquist band: what is folded back may cancel close to its end."""
DARK = 1e-8
"""Intensity, relative to the brightest row, under which a row of the field counts as dark."""
MOST_SAMPLES = 2**27
"""Of a spectrum, beyond which a propagation is refused: 2 GiB."""


class SamplingWarning(UserWarning):
    """A grid loses a small stated part of a field's energy."""


@dataclass(frozen=True)
class PropagationCheck:
    """Parts of a field's energy that a propagation would get wrong.

    Attributes
    ----------
    edge : float
        At the edge of the Nyquist band (its outer fifth): about as much lies beyond it and was folded back.
    decaying : float
        In waves that decay along z and would still be alive after the distance; they are left out.
    wrapped : float
        Falls, or should fall, into the output window, but the padding takes it elsewhere; relative to all
        that falls there.
    coarse : float
        Falls into the output window with more cycles per mm than its pitch can show. The samples are right,
        but not enough to tell the field between them.
    landing : float
        Falls into the output window, by geometry.
    """

    edge: float
    decaying: float
    wrapped: float
    coarse: float
    landing: float

    @property
    def relative_error(self) -> float:
        """Estimate of the output samples' relative L2 error."""
        return math.sqrt(2.0 * self.edge + self.decaying + 2.0 * self.wrapped)


def critical_distance_mm(
    grid: Grid, wavelength_um: float, index: float = 1.0, pad: tuple[int, ...] | None = None
) -> float:
    """Farthest that a transfer function on this grid is sampled finely enough over its whole band.

    For small angles count pitch^2 / wavelength (Matsushima and Shimobaba 2009); 0 where the pitch holds waves
    at 90 degrees.
    """
    walk = largest_lateral_shift_mm(grid, wavelength_um, index, 1.0)
    return 0.5 * min(pad or grid.shape) * grid.pitch_mm / walk


def measure_propagation(
    field: Field, to: Grid | float, *, pad: Pad = "auto", band_limit: bool = True
) -> PropagationCheck:
    """What a propagation would get wrong, without doing it.

    Parameters
    ----------
    field
        What is to be carried.
    to, pad, band_limit
        As of :func:`wavesim.propagate`.
    """
    target = field.grid.towards(to)
    distance_mm = target.z_mm - field.grid.z_mm
    xp = array_module(field.values)
    power = abs(fftn(field.values)) ** 2
    total = float(xp.sum(power))
    if not math.isfinite(total):
        raise InputError("the field has values that are not finite")
    if total == 0.0:
        return PropagationCheck(0.0, 0.0, 0.0, 0.0, 0.0)
    cycles = fft_frequencies(field.grid.shape, field.grid.pitch_mm, xp)
    kz, propagating = axial_wavenumbers(cycles, field.wavelength_um, field.index, xp)
    walks = lateral_shift_mm(cycles, kz, distance_mm, xp)

    none = propagating & ~propagating
    edge, fine, lands = none, none, propagating
    astray = xp.zeros_like(power)
    # Light spreads about where geometry takes it.
    blur = math.sqrt(1e-3 * field.wavelength_um / field.index * abs(distance_mm))
    counts = pad
    if counts == "auto":
        counts = period_counts(field.grid, target, field.wavelength_um, field.index, distance_mm)
    for axis, (across, walk, pair) in enumerate(zip(cycles, walks, windows(field.grid, target), strict=True)):
        edge = edge | (abs(across) > EDGE * 0.5 / field.grid.pitch_mm)
        fine = fine | (abs(across) > 0.5 / target.pitch_mm * (1.0 + 1e-9))
        middle, half = _extent_mm(field, axis)
        place = abs(walk + middle - pair.shift_mm)
        inside = place < pair.half_out_mm + half
        strays = place > counts[axis] * pair.pitch_mm - pair.half_out_mm - half - 0.5 * blur
        passed = pair.pass_band(counts[axis]).weight(walk, xp) if band_limit else xp.ones_like(walk)
        wrong = xp.where(strays, passed**2, 0.0 * walk) + xp.where(inside, (1.0 - passed) ** 2, 0.0 * walk)
        lands, astray = lands & inside, astray + wrong
    squared = sum((2.0 * math.pi * across) ** 2 for across in cycles)
    decay = xp.exp(
        -2.0 * abs(distance_mm) * xp.sqrt(xp.clip(squared - field.wavenumber_per_mm**2, 0.0, None))
    )

    def part(mask: Any, weights: Any = power) -> float:
        return float(xp.sum(xp.where(mask, weights, xp.zeros_like(weights)))) / total

    landing = part(lands)
    return PropagationCheck(
        edge=part(edge),
        decaying=part(~propagating, power * decay),
        wrapped=min(part(propagating, power * astray) / max(landing, 1e-300), 1.0),
        coarse=part(fine & lands),
        landing=landing,
    )


def _extent_mm(field: Field, axis: int) -> tuple[float, float]:
    """Middle and half-width of the field's bright part along an axis, from the grid's centre."""
    xp = array_module(field.values)
    power = abs(field.values) ** 2
    rows = xp.sum(power, axis=1 - axis) if power.ndim == 2 else power
    at = Samples(0.0, field.grid.pitch_mm, field.grid.shape[axis]).points(xp)
    bright = rows > DARK * xp.max(rows)
    low = float(xp.min(xp.where(bright, at, xp.max(at))))
    high = float(xp.max(xp.where(bright, at, xp.min(at))))
    return 0.5 * (low + high), 0.5 * (high - low)


def check_propagation(
    field: Field,
    to: Grid | float,
    *,
    pad: Pad = "auto",
    band_limit: bool = True,
    coarse_output: bool = False,
) -> PropagationCheck:
    """Warn of what a propagation would get wrong, or refuse it.

    Parameters
    ----------
    field, to, pad, band_limit
        As of :func:`measure_propagation`.
    coarse_output
        Whether an output pitch too coarse for the field that falls there is asked for.

    Returns
    -------
    PropagationCheck
        What was measured.

    Raises
    ------
    SamplingError
        If more than `REFUSED` of the energy would be wrong.

    Warns
    -----
    SamplingWarning
        If more than `WARNED` of it would be.
    """
    found = measure_propagation(field, to, pad=pad, band_limit=band_limit)
    source, target = field.grid, field.grid.towards(to)
    distance_mm = target.z_mm - source.z_mm
    nyquist = 0.5 / source.pitch_mm
    tell(
        found.edge,
        f"lies between {EDGE * nyquist:.4g} and {nyquist:.4g} cycles/mm, the edge of what a pitch of "
        f"{1e3 * source.pitch_mm:.4g} um holds, so that as much may have been folded back",
        "sample the field more finely, or smooth its edges",
    )
    tell(
        found.decaying,
        f"is in waves that decay along z and have not died out over {abs(distance_mm):.4g} mm; they are left "
        "out",
        "smooth the field to features above half a wavelength, or carry it farther",
    )
    counts = period_counts(source, target, field.wavelength_um, field.index, distance_mm)
    critical = critical_distance_mm(source, field.wavelength_um, field.index, None if pad == "auto" else pad)
    tell(
        found.wrapped,
        f"wraps around or is cut over {abs(distance_mm):.4g} mm with {_sides(pad)} samples (the transfer "
        f"function is sampled finely enough up to {critical:.4g} mm)",
        f"pad to {_sides(counts)} samples or more (pad='auto'), and leave the band limit on",
    )
    if not coarse_output:
        tell(
            found.coarse,
            f"reaches the output with more than {0.5 / target.pitch_mm:.4g} cycles/mm, the most that its "
            f"pitch of {1e3 * target.pitch_mm:.4g} um shows",
            "give a finer output pitch, or ask for coarse samples (coarse_output=True)",
        )
    if 0.0 < found.landing < WARNED or (found.landing == 0.0 and field.energy > 0.0):
        _warn(
            f"{found.landing:.2g} of the field's energy reaches the output window: the window at "
            f"{target.centre_mm} mm lies beside the light"
        )
    return found


def check_sample_count(counts: Sequence[int], what: str) -> None:
    """Refuse more than `MOST_SAMPLES` of a spectrum."""
    if math.prod(counts) > MOST_SAMPLES:
        raise SamplingError(
            f"{what} takes {_sides(tuple(counts))} samples of the spectrum, more than {MOST_SAMPLES:.3g}: "
            "give smaller windows or a coarser pitch"
        )


def predicted_relative_error(
    grid: Grid,
    wavelength_um: float,
    numerical_aperture: float,
    distance_mm: float,
    *,
    pad: Pad = "auto",
) -> float:
    """Relative L2 error with which a grid carries a Gaussian beam from its waist in the grid's middle.

    Told from the sizes alone: what lies beyond the Nyquist band, outside the grid at the waist, in decaying
    waves, and what wraps around.

    Parameters
    ----------
    grid, wavelength_um, distance_mm, pad
        As of :class:`wavesim.fields.propagator.FreeSpacePropagator`.
    numerical_aperture
        Sine of the angle at which the intensity is 1/e^2 of that on the axis.

    Returns
    -------
    float
        1 at most.
    """
    spread = 1e3 * numerical_aperture / wavelength_um
    waist = 1.0 / (math.pi * spread)

    def beam(half: float) -> float:
        # The spectrum is Gaussian in the sine, so that the beam is wider the farther out it is asked for.
        return math.hypot(waist, numerical_aperture * math.hypot(half, distance_mm))

    counts = pad
    if counts == "auto":
        counts = period_counts(grid, grid, wavelength_um, 1.0, distance_mm)
    lost = 0.0
    for count, half in zip(counts, grid.half_widths_mm, strict=True):
        lost += 2.0 * _outside(0.5 / grid.pitch_mm, spread) + _outside(1e3 / wavelength_um, spread)
        lost += _outside(half, waist)
        if count * grid.pitch_mm < 4.0 * half:
            farthest = count * grid.pitch_mm - half
            inside = 1.0 - _outside(half, beam(half))
            lost += 2.0 * _outside(farthest, beam(farthest)) / max(inside, 1e-300)
    return min(math.sqrt(lost), 1.0)


def _outside(half: float, radius: float) -> float:
    """Part of a Gaussian's energy outside +-half, along one axis; `radius` where the intensity is 1/e^2."""
    return math.erfc(math.sqrt(2.0) * half / radius)


def _sides(counts: Pad) -> str:
    return counts if isinstance(counts, str) else " x ".join(str(n) for n in counts)


def tell(part: float, what: str, cure: str) -> None:
    """Say nothing, warn, or refuse, by how large a part of the energy is lost."""
    if part > REFUSED:
        raise SamplingError(f"{100.0 * part:.2g} % of the field's energy {what}: {cure}")
    if part > WARNED:
        _warn(f"{100.0 * part:.2g} % of the field's energy {what}: {cure}")


def _warn(message: str) -> None:
    warnings.warn(message, SamplingWarning, stacklevel=4)
