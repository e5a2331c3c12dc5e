"""Free space between parallel planes: the angular spectrum of plane waves.

Band-limited (Matsushima and Shimobaba 2009), also onto a window beside the input's (Matsushima 2010). Waves
that decay along z are left out, so that carrying a field back is the exact adjoint of carrying it forward.
For another pitch or number of samples see :mod:`wavesim.fields.windowed`.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.field import Field, Grid
from wavesim.fields.guards import WARNED, Pad, SamplingWarning, check_propagation
from wavesim.fields.plane_waves import (
    Passage,
    axial_wavenumbers,
    fast_count,
    fft_frequencies,
    period_counts,
    transfer,
    windows,
)
from wavesim.runtime.arrays import array_module, fftn, ifftn

MOST_SAMPLES = 2**27
"""Padded samples beyond which a propagation is refused: 2 GiB for one spectrum."""


def axial_wavenumber_per_mm(
    shape: tuple[int, ...], pitch_mm: float, wavelength_um: float, index: float, xp: Any = np
) -> tuple[Any, Any]:
    """Component along z of the wave vector of each plane wave on a grid.

    Parameters
    ----------
    shape : (ny,) or (ny, nx)
        Of the grid.
    pitch_mm, wavelength_um, index
        Of the grid, in vacuum, and of the medium.
    xp
        Array module to compute in.

    Returns
    -------
    kz : array of float64
        In FFT order (zero frequency first); 0 where the wave decays.
    propagating : array of bool
        Where it does not decay.
    """
    return axial_wavenumbers(fft_frequencies(shape, pitch_mm, xp), wavelength_um, index, xp)


def transfer_function(
    shape: tuple[int, ...],
    pitch_mm: float,
    wavelength_um: float,
    index: float,
    distance_mm: float,
    *,
    band_limit: bool = True,
    xp: Any = np,
) -> Any:
    """Factor of each plane wave over a distance: complex128, in FFT order.

    With `band_limit`, waves that walk farther than half the grid's width are left out: their factor is not
    sampled finely enough (Matsushima and Shimobaba 2009, Eq. 13, here for each axis without approximation).
    """
    passages = [Passage(0.0, 0.5 * n * pitch_mm, 0.5 * n * pitch_mm) for n in shape]
    cycles = fft_frequencies(shape, pitch_mm, xp)
    return transfer(cycles, wavelength_um, index, distance_mm, passages if band_limit else None, xp)


def propagate(
    field: Field,
    distance_mm: float,
    *,
    centre_mm: tuple[float, float] | None = None,
    pad: Pad = "auto",
    band_limit: bool = True,
    check: bool = True,
) -> Field:
    """Carry a field to a parallel plane.

    Linear in the field: the padding depends on the grid, wavelength and distance alone.

    Parameters
    ----------
    field
        Single precision stays single; the phases are formed in double.
    distance_mm
        How far; negative to carry the field back.
    centre_mm : (x, y), optional
        Of the output window, which has the input's samples and pitch; the input's own if left out.
    pad
        Samples along each axis to pad to, at least the grid's, or "auto": as many as keep every copy of the
        field away from the output window.
    band_limit
        Whether waves are left out that walk too far for the padding.
    check
        Whether to judge the sampling first (:func:`wavesim.fields.guards.check_propagation`).

    Returns
    -------
    Field
        In the other plane.

    Raises
    ------
    SamplingError
        If the samples cannot hold the field on its way, or the padded grid would be too large.
    InputError
        If the distance or the padding is not usable.

    Warns
    -----
    SamplingWarning
        If a small part of the energy is lost, in the sampling or, when `centre_mm` is left out, because it
        leaves the window.
    """
    source = field.grid
    if not math.isfinite(distance_mm):
        raise InputError(f"distance_mm = {distance_mm!r}: must be finite")
    target = replace(source, z_mm=source.z_mm + distance_mm, centre_mm=centre_mm or source.centre_mm)
    counts = _padded(field, target, distance_mm, pad)
    if check:
        check_propagation(field, distance_mm, target, pad=pad, band_limit=band_limit)
    xp = array_module(field.values)
    pairs = windows(source, target)
    passages = [pair.passage(n) for pair, n in zip(pairs, counts, strict=True)]
    if not band_limit:
        passages = [Passage(pair.shift_mm, math.inf, math.inf) for pair in pairs]
    cycles = fft_frequencies(counts, source.pitch_mm, xp)
    factor = transfer(cycles, field.wavelength_um, field.index, distance_mm, passages, xp)
    spectrum = fftn(field.values, counts)
    spectrum = spectrum * xp.asarray(factor, dtype=spectrum.dtype)
    values = ifftn(spectrum, overwrite=True)
    result = Field(target, values[tuple(slice(0, n) for n in source.shape)], field.wavelength_um, field.index)
    if check and centre_mm is None:
        _tell_escape(field, result)
    return result


def propagate_adjoint(
    field: Field,
    distance_mm: float,
    *,
    centre_mm: tuple[float, float] | None = None,
    pad: Pad = "auto",
    band_limit: bool = True,
) -> Field:
    """Exact adjoint of :func:`propagate` over the same distance with the same padding, unchecked.

    `centre_mm` is that of the window which :func:`propagate` started from.
    """
    return propagate(
        field,
        -distance_mm,
        centre_mm=centre_mm,
        pad=pad,
        band_limit=band_limit,
        check=False,
    )


def _padded(field: Field, target: Grid, distance_mm: float, pad: Pad) -> tuple[int, ...]:
    shape = field.grid.shape
    if pad == "auto":
        counts = period_counts(field.grid, target, field.wavelength_um, field.index, distance_mm)
        counts = tuple(fast_count(n) for n in counts)
    else:
        counts = pad
        if len(counts) != len(shape) or any(n < m for n, m in zip(counts, shape, strict=True)):
            raise InputError(f"pad = {pad}: must be 'auto', or at least {shape} samples")
    if math.prod(counts) > MOST_SAMPLES:
        sides = " x ".join(str(n) for n in counts)
        raise SamplingError(
            f"{abs(distance_mm):.4g} mm at a pitch of {1e3 * field.grid.pitch_mm:.4g} um takes {sides} "
            f"samples with padding, more than {MOST_SAMPLES:.3g}: give a smaller window or a coarser "
            "pitch, or use wavesim.propagate_to, which samples only the part of the spectrum that arrives"
        )
    return counts


def _tell_escape(field: Field, result: Field) -> None:
    before = field.energy
    lost = 1.0 - result.energy / before if before > 0.0 else 0.0
    if lost > WARNED:
        warnings.warn(
            f"{100.0 * lost:.2g} % of the field's energy leaves the window on its way over "
            f"{abs(result.grid.z_mm - field.grid.z_mm):.4g} mm: the samples inside it stand; give a larger "
            "window if all of the light is wanted",
            SamplingWarning,
            stacklevel=3,
        )
