"""Digital refocusing: the object distance at which a reconstruction is sharpest (Eqs. 5 and 6).

The measure of sharpness is the mean singular value of the modulus of the gradient, the singular value fusion
of the gradient (SVFG). It grows as edges sharpen, and is largest in focus where fine detail abounds. A chart
with few fine bars on a dark ground has other maxima, which may be higher.
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

MOST_JUDGED = 1024
"""Largest number of samples along a side for the SVFG; the singular values of more would take minutes
each.
"""


@dataclass(frozen=True, eq=False)
class Refocusing:
    """A field at its best distance, and the sharpness at all distances.

    Attributes
    ----------
    field : Field
        Field propagated to the best distance.
    distance_mm : float
        Best distance along +z, in mm.
    distances_mm, svfg : ndarray, shape (n,)
        Distances in mm, and the SVFG at each of them.
    """

    field: Field
    distance_mm: float
    distances_mm: Array
    svfg: Array


def svfg(values: NDArray[np.complexfloating]) -> float:
    """Return the singular value fusion of the gradient (Eqs. 5 and 6).

    Parameters
    ----------
    values
        Complex amplitude, shape (ny, nx), at least 2 samples along each axis.

    Returns
    -------
    float
        Sum of the singular values of the gradient's modulus over the mean number of samples along a side, in
        the unit of the amplitude.

    Raises
    ------
    InputError
        If the shape is not that of a plane of at least 2 x 2 samples.

    Examples
    --------
    A sharp edge has a larger SVFG than a soft one:

    >>> import numpy as np
    >>> from wavesim.reconstruction import svfg
    >>> x = np.linspace(-1.0, 1.0, 64)
    >>> sharp, soft = (np.outer(np.ones(64), np.tanh(x / width) + 0j) for width in (0.01, 0.5))
    >>> bool(svfg(sharp) > svfg(soft))
    True
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
    """Propagate a reconstruction to the distance at which it is sharpest.

    The measure of sharpness is the singular value fusion of the gradient (:func:`svfg`, Eqs. 5 and 6 of the
    paper). For a field of more than `MOST_JUDGED` samples along a side, only its middle is measured.

    Parameters
    ----------
    field
        Reconstructed complex amplitude on a plane.
    interval_mm
        Smallest and largest distance along +z from the field's plane, in mm; (-0.2, 0.2) covers an error of
        the working distance of up to 0.2 mm. The interval must contain the focus, since the curve of
        sharpness is flat far from it.
    step_mm
        Step of the distances in mm, about a depth of focus (wavelength / NA^2).
    progress
        Callback `progress(completed, total)` with the number of distances.

    Returns
    -------
    Refocusing
        The field at the best distance, and the curve of sharpness.

    Raises
    ------
    InputError
        If the interval or the step is invalid, or the field is on a line.

    Examples
    --------
    A chart that was reconstructed 20 um behind its plane:

    >>> from wavesim import Field, Grid, propagate, refocus_field, usaf_chart
    >>> from wavesim.targets import usaf_elements
    >>> grid = Grid((256, 256), 2.5e-4, 0.0)
    >>> chart = Field(grid, usaf_chart(grid, usaf_elements([8]), "dark"), wavelength_um=0.532)
    >>> blurred = propagate(chart, 0.02, check=False)
    >>> round(refocus_field(blurred, (-0.03, -0.01)).distance_mm, 3)
    -0.02
    """
    from scipy.optimize import minimize_scalar

    low, high = interval_mm
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"interval_mm = {interval_mm}: must be finite, the first below the second")
    if not (math.isfinite(step_mm) and 0.0 < step_mm < high - low):
        raise InputError(f"step_mm = {step_mm!r}: must be above 0 and below the interval's {high - low:g} mm")
    if field.grid.is_line:
        raise InputError("refocusing by SVFG: needs a field on a plane")
    middle = _middle(field)
    propagated = _propagator_of(middle)
    distances = np.linspace(low, high, math.ceil((high - low) / step_mm) + 1)
    curve = np.empty(len(distances))
    for i, distance in enumerate(distances):
        curve[i] = svfg(propagated(float(distance)))
        if progress is not None:
            progress(i + 1, len(distances))
    peak = int(np.argmax(curve))
    bracket = (float(distances[max(peak - 1, 0)]), float(distances[min(peak + 1, len(distances) - 1)]))
    refined = minimize_scalar(
        lambda d: -svfg(propagated(float(d))), bounds=bracket, method="bounded", options={"xatol": 1e-5}
    )
    best = float(refined.x) if -float(refined.fun) >= curve[peak] else float(distances[peak])
    if middle is field:
        refocused = Field(
            field.grid.at(field.grid.z_mm + best), propagated(best), field.wavelength_um, field.index
        )
    else:
        refocused = propagate(field, best, check=False)
    return Refocusing(refocused, best, distances, curve)


def _middle(field: Field) -> Field:
    """Return the middle of a large field with soft borders."""
    rows, columns = (min(count, MOST_JUDGED) for count in field.grid.shape)
    if (rows, columns) == field.grid.shape:
        return field
    window = tuple(
        slice((total - count) // 2, (total - count) // 2 + count)
        for total, count in zip(field.grid.shape, (rows, columns), strict=True)
    )
    down, across = _fading(rows), _fading(columns)
    values = (field.values[window] * down[:, None] * across).astype(field.values.dtype)
    return Field(replace(field.grid, shape=(rows, columns)), values, field.wavelength_um, field.index)


def _propagator_of(field: Field) -> Callable[[float], NDArray[np.complexfloating]]:
    """Return a function that gives the field at any distance; its spectrum is computed once."""
    shape, grid = field.grid.shape, field.grid
    # Padded samples over the field's samples, so that light that leaves one side does not enter the other.
    padding = 2
    padded = tuple(scipy.fft.next_fast_len(padding * n) for n in shape)
    wide = replace(grid, shape=padded)
    spectrum = scipy.fft.fftn(field.values, padded, workers=-1)

    def propagated(distance_mm: float) -> NDArray[np.complexfloating]:
        target = wide.at(grid.z_mm + distance_mm)
        propagator = AngularSpectrum(wide, target, field.wavelength_um, field.index, padded, band_limit=True)
        return np.asarray(propagator.from_spectrum(spectrum)[: shape[0], : shape[1]])

    return propagated


def _fading(count: int) -> Array:
    """Return 1, except at both ends, where the values rise smoothly from 0."""
    distance = np.minimum(np.arange(count), np.arange(count)[::-1])
    border = 0.05 * count
    return np.asarray(np.sin(0.5 * np.pi * np.clip(distance / border, 0.0, 1.0)) ** 2)
