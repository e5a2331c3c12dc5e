"""Checks of the sampling of free-space propagation, and the warnings of the wave engines.

The checks estimate the fraction of the field's energy that the samples cannot represent, from the spectrum of
the field and the geometric paths of its plane waves. A fraction below `WARNED` is accepted. A fraction up to
`REFUSED` raises a :class:`SamplingWarning`. A larger one raises a :class:`~lensdesign.errors.SamplingError`,
whose message says what to change.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.field import Field, Grid
from wavesim.fields.plane_waves import (
    TURN,
    Pad,
    PlaneWaves,
    Samples,
    along,
    fft_frequencies,
    largest_lateral_shift_mm,
    padded_shape,
    phasor_of,
    sampling_windows,
)
from wavesim.fields.tilted_planes import WIDEST, RotatedSpectrum

WARNED = 1e-5
"""Fraction of the energy above which a loss causes a warning: an error of about 0.4 % of the field."""
REFUSED = 1e-2
"""Fraction of the energy above which a propagation is refused: an error of about 15 %."""
EDGE = 0.8
"""Start of the edge of the Nyquist band. Aliased light may cancel near the end of the band, hence the
margin."""
MOST_SAMPLES = 2**27
"""Most samples of a spectrum (2 GiB); a propagation that needs more is refused."""


class SamplingWarning(UserWarning):
    """Warning that a grid loses a small fraction of a field's energy, which the message states.

    A large loss raises a :class:`~lensdesign.errors.SamplingError` instead.

    Examples
    --------
    Samples of 1 um are a little too coarse for this beam. Treat the warning as an error:

    >>> import warnings
    >>> import numpy as np
    >>> from wavesim import Field, Grid, SamplingWarning, propagate
    >>> grid = Grid((64, 64), 1e-3, 0.0)
    >>> beam = Field(grid, np.exp(-grid.radius_squared_mm2() / 0.0016**2), wavelength_um=0.532)
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", SamplingWarning)
    ...     try:
    ...         behind = propagate(beam, 0.01)
    ...     except SamplingWarning:
    ...         print("use a finer grid")
    use a finer grid
    """


@dataclass(frozen=True)
class PropagationCheck:
    """Fractions of a field's energy that a propagation would not represent correctly.

    Attributes
    ----------
    edge : float
        Energy at the edge of the Nyquist band (its outer fifth). About as much lies beyond it and is aliased.
    decaying : float
        Energy in evanescent waves that are still noticeable at the target. The propagation omits them.
    wrapped : float
        Energy that falls, or should fall, into the output window but wraps around because of the padding,
        relative to the energy in the window.
    coarse : float
        Energy in the output window at frequencies above the Nyquist limit of its pitch. The samples are
        correct, but too coarse to interpolate the field.
    landing : float
        Energy that geometrically falls into the output window.
    """

    edge: float
    decaying: float
    wrapped: float
    coarse: float
    landing: float

    @property
    def relative_error(self) -> float:
        """Estimated relative L2 error of the output samples."""
        return math.sqrt(2.0 * self.edge + self.decaying + 2.0 * self.wrapped)


def critical_distance_mm(
    grid: Grid, wavelength_um: float, index: float = 1.0, pad: tuple[int, ...] | None = None
) -> float:
    """Return the largest distance at which a grid samples the transfer function over its whole band.

    At small angles it is count pitch^2 / wavelength (Matsushima and Shimobaba 2009). It is 0 where the pitch
    samples waves at 90 degrees.

    Examples
    --------
    >>> from wavesim.fields import Grid, critical_distance_mm
    >>> round(critical_distance_mm(Grid((1024, 1024), 3.2e-3, 0.0), 0.532), 1)
    19.6
    """
    slope = largest_lateral_shift_mm(grid, wavelength_um, index, 1.0)
    return 0.5 * min(pad or grid.shape) * grid.pitch_mm / slope


def measure_propagation(
    field: Field, to: Grid | float, *, pad: Pad = "auto", band_limit: bool = True
) -> PropagationCheck:
    """Estimate the energy that a propagation would not represent correctly, without propagating the field.

    Parameters
    ----------
    field
        Field to be propagated.
    to
        Target grid, or the distance along the axis in mm, as in :func:`wavesim.propagate`.
    pad, band_limit
        Padding and band limit, as in :func:`wavesim.propagate`.

    Raises
    ------
    InputError
        If the field has values that are not finite.
    """
    target = field.grid.target_grid(to)
    distance_mm = target.z_mm - field.grid.z_mm
    power = abs(scipy.fft.fftn(field.values, workers=-1)) ** 2
    total = float(np.sum(power))
    if not math.isfinite(total):
        raise InputError("the field has values that are not finite")
    if total == 0.0:
        return PropagationCheck(0.0, 0.0, 0.0, 0.0, 0.0)
    waves = PlaneWaves.of(field.grid, field.wavelength_um, field.index)
    cycles, propagating, shifts_mm = (
        waves.cycles_per_mm,
        waves.propagating,
        waves.lateral_shift_mm(distance_mm),
    )

    none = propagating & ~propagating
    edge, fine, lands = none, none, propagating
    astray = np.zeros_like(power)
    # Diffraction blurs the geometric arrival point by about this width.
    blur = math.sqrt(1e-3 * field.wavelength_um / field.index * abs(distance_mm))
    counts = pad
    if counts == "auto":
        counts = padded_shape(field.grid, target, field.wavelength_um, field.index, distance_mm)
    pairs = sampling_windows(field.grid, target)
    for axis, (across, shift_mm, pair) in enumerate(zip(cycles, shifts_mm, pairs, strict=True)):
        edge = edge | (abs(across) > EDGE * 0.5 / field.grid.pitch_mm)
        fine = fine | (abs(across) > 0.5 / target.pitch_mm * (1.0 + 1e-9))
        centre, half = _extent_mm(field, axis)
        arrival = abs(shift_mm + centre - pair.shift_mm)
        inside = arrival < pair.half_out_mm + half
        strays = arrival > counts[axis] * pair.pitch_mm - pair.half_out_mm - half - 0.5 * blur
        passed = pair.band_limit(counts[axis]).weight(shift_mm) if band_limit else np.ones_like(shift_mm)
        wrong = np.where(strays, passed**2, 0.0) + np.where(inside, (1.0 - passed) ** 2, 0.0)
        lands, astray = lands & inside, astray + wrong
    squared = sum((2.0 * math.pi * across) ** 2 for across in cycles)
    decay = np.exp(
        -2.0 * abs(distance_mm) * np.sqrt(np.clip(squared - field.wavenumber_per_mm**2, 0.0, None))
    )

    def fraction(mask: Any, weights: Any = power) -> float:
        return float(np.sum(np.where(mask, weights, np.zeros_like(weights)))) / total

    landing = fraction(lands)
    return PropagationCheck(
        edge=fraction(edge),
        decaying=fraction(~propagating, power * decay),
        wrapped=min(fraction(propagating, power * astray) / max(landing, 1e-300), 1.0),
        coarse=fraction(fine & lands),
        landing=landing,
    )


def _extent_mm(field: Field, axis: int) -> tuple[float, float]:
    """Return centre and half-width of the field's bright part along an axis, from the grid's centre."""
    power = abs(field.values) ** 2
    rows = np.sum(power, axis=1 - axis) if power.ndim == 2 else power
    at = Samples(0.0, field.grid.pitch_mm, field.grid.shape[axis]).points()
    # Intensity, relative to the brightest row, below which a row of the field counts as dark.
    dark = 1e-8
    bright = rows > dark * np.max(rows)
    low = float(np.min(np.where(bright, at, np.max(at))))
    high = float(np.max(np.where(bright, at, np.min(at))))
    return 0.5 * (low + high), 0.5 * (high - low)


def check_propagation(
    field: Field,
    to: Grid | float,
    *,
    pad: Pad = "auto",
    band_limit: bool = True,
    coarse_output: bool = False,
) -> PropagationCheck:
    """Check the sampling of a propagation; warn of a small error and refuse a large one.

    Parameters
    ----------
    field, to, pad, band_limit
        As in :func:`measure_propagation`.
    coarse_output
        Whether to accept an output pitch that is too coarse to interpolate the field.

    Returns
    -------
    PropagationCheck
        The measured fractions.

    Raises
    ------
    InputError
        If the field has values that are not finite.
    SamplingError
        If more than `REFUSED` of the energy would be wrong.

    Warns
    -----
    SamplingWarning
        If more than `WARNED` of the energy would be wrong.
    """
    found = measure_propagation(field, to, pad=pad, band_limit=band_limit)
    source, target = field.grid, field.grid.target_grid(to)
    distance_mm = target.z_mm - source.z_mm
    nyquist = 0.5 / source.pitch_mm
    report_loss(
        found.edge,
        f"lies between {EDGE * nyquist:.4g} and {nyquist:.4g} cycles/mm, the edge of the Nyquist band of a "
        f"pitch of {1e3 * source.pitch_mm:.4g} µm, so about as much beyond it may be aliased",
        "sample the field more finely, or smooth its edges",
    )
    report_loss(
        found.decaying,
        f"is in evanescent waves that have not decayed over {abs(distance_mm):.4g} mm and are omitted",
        "smooth the field to features above half a wavelength, or propagate it farther",
    )
    counts = padded_shape(source, target, field.wavelength_um, field.index, distance_mm)
    critical = critical_distance_mm(source, field.wavelength_um, field.index, None if pad == "auto" else pad)
    report_loss(
        found.wrapped,
        f"wraps around or is cut over {abs(distance_mm):.4g} mm with {_sides(pad)} samples (the transfer "
        f"function is sampled correctly up to {critical:.4g} mm)",
        f"pad to {_sides(counts)} samples or more (pad='auto'), and leave the band limit on",
    )
    if not coarse_output:
        report_loss(
            found.coarse,
            f"reaches the output above {0.5 / target.pitch_mm:.4g} cycles/mm, the Nyquist limit of its "
            f"pitch of {1e3 * target.pitch_mm:.4g} µm",
            "give a finer output pitch, or accept coarse samples (coarse_output=True)",
        )
    if 0.0 < found.landing < WARNED or (found.landing == 0.0 and field.energy > 0.0):
        _warn(
            f"only {100.0 * found.landing:.2g} % of the field's energy reaches the output window, which is "
            f"centred at {target.centre_mm} mm: move the window into the light"
        )
    return found


def measure_tilted_propagation(method: RotatedSpectrum, values: Any) -> dict[str, float]:
    """Return the fractions of the field's energy that the samples cannot represent, by name."""
    dimensions = len(method.source.shape)
    for axis, (n, carrier) in enumerate(zip(method.source.shape, method.carrier, strict=True)):
        x = Samples(0.0, method.source.pitch_mm, n).offsets()
        values = values * along(phasor_of(-TURN * carrier * x), axis, dimensions)
    power = abs(scipy.fft.fftn(values, workers=-1)) ** 2
    total = float(np.sum(power))
    if not math.isfinite(total):
        raise InputError("the field has values that are not finite")
    base = fft_frequencies(method.source.shape, method.source.pitch_mm)
    cycles = [f + carrier for f, carrier in zip(base, method.carrier, strict=True)]
    turned, axial, forwards = method.directions(cycles, method.rotation.T)
    lost = (axial <= 0.0) | (forwards <= 0.0)
    edge, fine, wide = lost & ~lost, lost & ~lost, lost & ~lost
    cosine = float(method.rotation[2, 2])
    half_in = max(w + abs(c) for w, c in zip(method.source.half_widths_mm, method.centre_in, strict=True))
    for axis, (across, out) in enumerate(zip(base, turned, strict=True)):
        edge = edge | (abs(across) > EDGE * 0.5 / method.source.pitch_mm)
        fine = fine | (abs(out) > 0.5 / method.target.pitch_mm * (1.0 + 1e-9))
        slope = abs(out) / np.where(lost, np.ones_like(forwards), forwards)
        reach = half_in * (1.0 + slope * math.sqrt(1.0 - cosine**2))
        wide = wide | (reach > method.half_field_mm(axis))

    masks = {"edge": edge, "lost": lost, "wide": wide & ~lost, "fine": fine & ~lost}
    none = np.zeros_like(power)
    return {
        name: float(np.sum(np.where(mask, power, none))) / max(total, 1e-300) for name, mask in masks.items()
    }


def check_tilted_propagation(method: RotatedSpectrum, values: Any, coarse_output: bool) -> None:
    """Warn, or raise SamplingError, where the samples cannot represent the field."""
    parts = measure_tilted_propagation(method, values)
    pitch_in, pitch_out = 1e3 * method.source.pitch_mm, 1e3 * method.target.pitch_mm
    report_loss(
        parts["edge"],
        f"lies at the edge of the Nyquist band of a pitch of {pitch_in:.4g} µm",
        "sample the field more finely, or smooth its edges",
    )
    report_loss(
        parts["lost"], "is evanescent, or does not cross the tilted plane forwards", "use a smaller tilt"
    )
    report_loss(
        parts["wide"],
        f"reaches the tilted plane more than {WIDEST / 2:g} half-widths away",
        "use a smaller tilt or a narrower field",
    )
    if not coarse_output:
        report_loss(
            parts["fine"],
            f"has frequencies above the Nyquist limit of the output pitch of {pitch_out:.4g} µm",
            f"give a pitch of {1e3 * method.finest_pitch_mm:.4g} µm or less, or accept coarse samples "
            "(coarse_output=True)",
        )


def check_sample_count(counts: Sequence[int], what: str) -> None:
    """Raise SamplingError if a spectrum has more than `MOST_SAMPLES` samples."""
    if math.prod(counts) > MOST_SAMPLES:
        raise SamplingError(
            f"{what} needs {_sides(tuple(counts))} samples of the spectrum (allowed: {MOST_SAMPLES:.3g}): "
            "use smaller windows, as for a smaller patch (patch_mm) or nearer planes (plane_distance_mm), or "
            "a coarser pitch"
        )


def predicted_relative_error(
    grid: Grid,
    wavelength_um: float,
    numerical_aperture: float,
    distance_mm: float,
    *,
    pad: Pad = "auto",
) -> float:
    """Predict the relative L2 error with which a grid propagates a Gaussian beam from its waist.

    The waist lies in the centre of the grid. The prediction uses the sizes only: it adds the energy beyond
    the Nyquist band, outside the grid at the waist, in evanescent waves, and in light that wraps around.

    Parameters
    ----------
    grid, wavelength_um, distance_mm, pad
        As in :class:`wavesim.fields.propagator.FreeSpacePropagator`.
    numerical_aperture
        Sine of the angle at which the intensity is 1/e^2 of that on the axis.

    Returns
    -------
    float
        Relative error, 1 at most.

    Examples
    --------
    >>> from wavesim.fields import Grid, predicted_relative_error
    >>> predicted_relative_error(Grid((1024, 1024), 1e-3, 0.0), 0.532, 0.1, 1.0) < 1e-3
    True
    """
    spread = 1e3 * numerical_aperture / wavelength_um
    waist = 1.0 / (math.pi * spread)

    def beam(half: float) -> float:
        # The spectrum is Gaussian in the sine, so that the beam radius grows faster than its distance.
        return math.hypot(waist, numerical_aperture * math.hypot(half, distance_mm))

    counts = pad
    if counts == "auto":
        counts = padded_shape(grid, grid, wavelength_um, 1.0, distance_mm)
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
    """Return the fraction of a Gaussian's energy outside +-half on one axis; `radius` is the 1/e^2 radius."""
    return math.erfc(math.sqrt(2.0) * half / radius)


def _sides(counts: Pad) -> str:
    return counts if isinstance(counts, str) else " x ".join(str(n) for n in counts)


def warn_of_escape(field: Field, result: Field) -> None:
    """Warn if a noticeable fraction of the energy of a field leaves its window."""
    before = field.energy
    lost = 1.0 - result.energy / before if before > 0.0 else 0.0
    if lost > WARNED:
        warnings.warn(
            f"{100.0 * lost:.2g} % of the field's energy leaves the window over a distance of "
            f"{abs(result.grid.z_mm - field.grid.z_mm):.4g} mm: the samples inside it are correct; use a "
            "larger window to include all light",
            SamplingWarning,
            stacklevel=3,
        )


def report_loss(fraction: float, what: str, remedy: str) -> None:
    """Accept, warn of, or refuse a loss by the fraction of the energy that is lost."""
    if fraction > REFUSED:
        raise SamplingError(f"{100.0 * fraction:.2g} % of the field's energy {what}: {remedy}")
    if fraction > WARNED:
        _warn(f"{100.0 * fraction:.2g} % of the field's energy {what}: {remedy}")


def _warn(message: str) -> None:
    warnings.warn(message, SamplingWarning, stacklevel=4)
