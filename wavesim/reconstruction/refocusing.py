"""Digital refocusing: the object distance at which a reconstruction is sharpest (Eqs. 5 and 6).

The singular values of the gradient's modulus, averaged, are the SVFG (singular value fusion of the gradient).
Their sum grows as edges sharpen and is largest in focus where fine detail abounds; a chart with few fine bars
on a dark ground has other maxima, which may be higher.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.linalg import svdvals

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from wavesim.fields.angular_spectrum import AngularSpectrum
from wavesim.fields.field import Field
from wavesim.fields.propagator import propagate

PADDING = 2
"""Times the field's samples, so that what leaves one side stays off the other."""

MOST_JUDGED = 1024
"""Samples along a side whose sharpness is asked for: singular values of more would take minutes each."""

SOFT = 0.05
"""Of such a middle's side, over which it fades at its borders."""

REFINED_MM = 1e-5
"""To which the peak is followed between the samples of the curve."""


@dataclass(frozen=True, eq=False)
class Refocusing:
    """A field at its best distance, and the curve that told.

    Attributes
    ----------
    field : Field
        Carried to the best distance.
    distance_mm : float
        How far it was carried, along +z.
    distances_mm, svfg : ndarray
        The curve.
    """

    field: Field
    distance_mm: float
    distances_mm: Array
    svfg: Array


def svfg(values: NDArray[np.complexfloating]) -> float:
    """Singular value fusion of the gradient (Eqs. 5 and 6).

    Parameters
    ----------
    values
        Complex amplitude, shape (ny, nx), at least 2 each way.

    Returns
    -------
    float
        Sum of the singular values of the gradient's modulus, over the mean number of samples along a side; in
        units of the amplitude.

    Raises
    ------
    InputError
        If the shape does not fit.
    """
    if values.ndim != 2 or min(values.shape) < 2:
        raise InputError(f"SVFG of values of shape {values.shape}: must be a plane of at least 2 x 2 samples")
    down, across = np.gradient(values)
    modulus = np.sqrt(np.abs(down) ** 2 + np.abs(across) ** 2)
    return float(np.sum(svdvals(modulus))) / math.sqrt(values.size)


def refocus_field(
    field: Field,
    interval_mm: tuple[float, float],
    step_mm: float = 2e-3,
    progress: Callable[[int, int], None] | None = None,
) -> Refocusing:
    """Carry a reconstruction to the distance at which it is sharpest.

    Of a field of more than `MOST_JUDGED` samples along a side, its middle tells how sharp it is.

    Parameters
    ----------
    field
        Reconstructed complex amplitude on a plane.
    interval_mm
        From where to where to look, along +z from the field's plane; (-0.2, 0.2) covers a working distance
        that is off by up to 0.2 mm. It must hold the focus: far from it the curve has no slope to follow.
    step_mm
        Of the curve; about a depth of focus, wavelength / NA^2.
    progress
        Called with the number of samples of the curve done, and that of all.

    Raises
    ------
    InputError
        If the interval or the step is not usable, or the field is no plane.
    """
    from scipy.optimize import minimize_scalar

    low, high = interval_mm
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"interval_mm = {interval_mm}: must be finite, the first below the second")
    if not (math.isfinite(step_mm) and 0.0 < step_mm < high - low):
        raise InputError(f"step_mm = {step_mm!r}: must be above 0 and below the interval's {high - low:g} mm")
    if field.grid.is_line:
        raise InputError("refocusing by SVFG: needs a field on a plane")
    judged = _middle(field)
    carried = _carrier(judged)
    distances = np.linspace(low, high, math.ceil((high - low) / step_mm) + 1)
    curve = np.empty(len(distances))
    for i, distance in enumerate(distances):
        curve[i] = svfg(carried(float(distance)))
        if progress is not None:
            progress(i + 1, len(distances))
    top = int(np.argmax(curve))
    around = (float(distances[max(top - 1, 0)]), float(distances[min(top + 1, len(distances) - 1)]))
    fine = minimize_scalar(
        lambda d: -svfg(carried(float(d))), bounds=around, method="bounded", options={"xatol": REFINED_MM}
    )
    best = float(fine.x) if -float(fine.fun) >= curve[top] else float(distances[top])
    if judged is field:
        found = Field(field.grid.at(field.grid.z_mm + best), carried(best), field.wavelength_um, field.index)
    else:
        found = propagate(field, best, check=False)
    return Refocusing(found, best, distances, curve)


def _middle(field: Field) -> Field:
    """The middle of a large field, softly cut out."""
    rows, columns = (min(count, MOST_JUDGED) for count in field.grid.shape)
    if (rows, columns) == field.grid.shape:
        return field
    part = tuple(
        slice((whole - own) // 2, (whole - own) // 2 + own)
        for whole, own in zip(field.grid.shape, (rows, columns), strict=True)
    )
    down, across = _fading(rows), _fading(columns)
    values = (field.values[part] * down[:, None] * across).astype(field.values.dtype)
    return Field(replace(field.grid, shape=(rows, columns)), values, field.wavelength_um, field.index)


def _carrier(field: Field) -> Callable[[float], NDArray[np.complexfloating]]:
    """The field at any distance; its spectrum is formed once."""
    shape, grid = field.grid.shape, field.grid
    padded = tuple(scipy.fft.next_fast_len(PADDING * n) for n in shape)
    wide = replace(grid, shape=padded)
    spectrum = scipy.fft.fftn(field.values, padded, workers=-1)

    def carried(distance_mm: float) -> NDArray[np.complexfloating]:
        there = wide.at(grid.z_mm + distance_mm)
        way = AngularSpectrum(wide, there, field.wavelength_um, field.index, padded, band_limit=True)
        values = scipy.fft.ifftn(spectrum * way.factor(spectrum.dtype), workers=-1, overwrite_x=True)
        return np.asarray(values[: shape[0], : shape[1]])

    return carried


def _fading(count: int) -> Array:
    """1, but for both ends, where it rises from 0."""
    away = np.minimum(np.arange(count), np.arange(count)[::-1])
    return np.asarray(np.sin(0.5 * np.pi * np.clip(away / (SOFT * count), 0.0, 1.0)) ** 2)
