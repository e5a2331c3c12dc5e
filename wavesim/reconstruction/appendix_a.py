"""One iteration of the paper's dual-plane phase retrieval, equation by equation (Appendix A).

The paper's symbols have the following names in the code. The index n counts the planes and k the iterations.

==================  =====================================================================
Symbol              Code
==================  =====================================================================
u^k, u^(k-1)        `now`, `previous`: the field sought, and that of the iteration before
sqrt(I_n), H_n      `plane.amplitude`, and the distance within `plane.propagator`
C_n, then g_n       `field`, which every equation changes in place
P_H, P_-H           `plane.propagator.propagate`, and its adjoint
a, b, t             `feedback`, `tv_step`
CC                  `AmplitudeMatch.correlation`
==================  =====================================================================

At the size of a sensor a field fills hundreds of megabytes. Planes are therefore processed one after the
other, and everything but the Fourier transforms is done in blocks of rows that fit into a core's cache. Sums
over blocks are added in a fixed order, so that results do not depend on the number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.field import Grid
from wavesim.runtime.threads import for_blocks, rows_in
from wavesim.sensor.measurement import Measurement

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
T = TypeVar("T")

FAINTEST = 1e-30
"""Modulus below which an amplitude is not divided by it, since the quotient might overflow."""


@dataclass(frozen=True, eq=False)
class Plane:
    """A measured plane; arrays have the shape (rows, columns), and a line is one row.

    Attributes
    ----------
    amplitude : ndarray
        Measured amplitudes sqrt(I_n).
    known : ndarray of bool or None
        Pixels with valid data; None where all are valid.
    propagator : TransferFunction
        Transfer function over the distance H_n from the plane sought.
    """

    amplitude: Array
    known: NDArray[np.bool_] | None
    propagator: TransferFunction


@dataclass(frozen=True)
class AmplitudeMatch:
    """Agreement of a field's moduli with the amplitudes of a plane.

    Attributes
    ----------
    correlation : float
        Correlation A6; 0 where either amplitude is constant.
    residual : float
        L2 norm of the difference over that of the measured amplitude.
    """

    correlation: float
    residual: float


def rows_of(values: NDArray[Any]) -> NDArray[Any]:
    """Return samples as rows and columns; those of a line are one row."""
    return np.ascontiguousarray(values).reshape(-1, values.shape[-1])


def plane_for(grid: Grid, wavelength_um: float, measurement: Measurement, dtype: Any) -> Plane:
    """Return a measured plane for fields of a complex type on a grid."""
    amplitude = rows_of(measurement.amplitude).astype(np.zeros(0, dtype).real.dtype, copy=False)
    known = None if measurement.known is None else rows_of(measurement.known)
    return Plane(amplitude, known, TransferFunction(grid, wavelength_um, measurement.distance_mm, dtype))


def iterate(
    planes: Sequence[Plane],
    now: ComplexArray,
    previous: ComplexArray,
    feedback: tuple[float, float] | None,
    tv_step: float,
) -> AmplitudeMatch:
    """Do one iteration, and write u^(k+1) to the array of u^(k-1).

    Parameters
    ----------
    planes
        Measured planes.
    now, previous
        Fields u^k and u^(k-1), shape (rows, columns), C-contiguous.
    feedback
        Weights a and b of A5; None for the first iterations, whose result is the mean over planes.
    tv_step
        Step t of A4.

    Returns
    -------
    AmplitudeMatch
        Agreement of u^k with the first plane.
    """
    # A5: u^(k+1) = (1 + a + b) (mean over n of g_n) - a u^k - b u^(k-1)
    a, b = feedback or (0.0, 0.0)
    _subtract_feedback(now, previous, a, b)
    match, field = None, np.empty_like(now)
    for plane in planes:
        plane.propagator.propagate(now, field)  # A1
        if match is None:
            match = compare(field, plane)  # A6
        replace_amplitude(field, plane.amplitude, plane.known)  # A2
        plane.propagator.propagate(field, field, adjoint=True)  # A3
        _add_smoothed(field, tv_step, (1.0 + a + b) / len(planes), previous)  # A4
    assert match is not None
    return match


def replace_amplitude(field: ComplexArray, amplitude: Array, known: NDArray[np.bool_] | None = None) -> None:
    """Set C_n to sqrt(I_n) C_n / |C_n| in valid pixels, in place (A2).

    Where the field vanishes it gets the phase 0.
    """

    def block(rows: slice) -> None:
        values, target = field[rows], amplitude[rows]
        modulus = np.abs(values)
        if known is not None:
            target = np.where(known[rows], target, modulus)
        faint = modulus < FAINTEST
        # Phases of faint values are computed in double precision.
        values[faint] = np.exp(1j * np.angle(values[faint].astype(complex)))
        modulus[faint] = 1.0
        values *= target / modulus

    _for_rows(block, field)


def compare(field: ComplexArray, plane: Plane) -> AmplitudeMatch:
    """Return the agreement of |C_n| with sqrt(I_n) in valid pixels (A6)."""

    def block(rows: slice) -> tuple[float, ...]:
        known = slice(None) if plane.known is None else plane.known[rows]
        x, y = (v[known].astype(float).ravel() for v in (np.abs(field[rows]), plane.amplitude[rows]))
        products = ((x, x), (y, y), (x, y), (x - y, x - y))
        return len(x), float(x.sum()), float(y.sum()), *(float(np.einsum("i,i", *p)) for p in products)

    sums = zip(*_for_rows(block, field), strict=True)
    count, sx, sy, sxx, syy, sxy, squared_difference = map(math.fsum, sums)
    x_variance, y_variance = sxx - sx * sx / count, syy - sy * sy / count
    # Variance over mean square below which amplitudes count as constant.
    tolerance = 1e-12
    is_constant = x_variance <= tolerance * sxx or y_variance <= tolerance * syy
    correlation = 0.0 if is_constant else (sxy - sx * sy / count) / math.sqrt(x_variance * y_variance)
    return AmplitudeMatch(correlation, math.sqrt(squared_difference / syy) if syy > 0.0 else math.inf)


def _add_smoothed(field: ComplexArray, tv_step: float, weight: float, total: ComplexArray) -> None:
    """Add g_n + t/2 div(grad g_n / |g_n|), times a weight, to the total (A4).

    The border of the field is continued with constant values.
    """
    parts = field.view(field.real.dtype)
    power = math.fsum(_for_rows(lambda rows: float(np.einsum("ij,ij", parts[rows], parts[rows])), field))
    # A small fraction of the root mean square is added to each modulus by which A4 divides.
    floor = 1e-6 * math.sqrt(power / field.size) + float(np.finfo(field.dtype).tiny)

    def block(rows: slice) -> None:
        result = total[rows]
        # Rows of the block, with a row on either side where there is one.
        first = max(rows.start - 1, 0)
        g = field[first : rows.stop + 1]
        own = slice(rows.start - first, rows.stop - first)
        result += weight * g[own]
        if tv_step == 0.0:
            return
        step = 0.5 * tv_step * weight / (np.abs(g) + floor)
        flow = step[own, :-1] * np.diff(g[own], axis=1)
        result[:, :-1] += flow
        result[:, 1:] -= flow
        flow = step[:-1] * np.diff(g, axis=0)
        below, above = flow[own.start :], flow[: own.stop - 1]
        result[: len(below)] += below
        result[len(result) - len(above) :] -= above

    _for_rows(block, field)


def _subtract_feedback(now: ComplexArray, previous: ComplexArray, a: float, b: float) -> None:
    """Replace u^(k-1) by -a u^k - b u^(k-1) (part of A5)."""

    def block(rows: slice) -> None:
        values = previous[rows]
        values *= -b
        values -= a * now[rows]

    _for_rows(block, now)


def _for_rows(work: Callable[[slice], T], field: ComplexArray) -> list[T]:
    """Return the results of a function for all blocks of rows, in order."""
    return for_blocks(lambda start, stop: work(slice(start, stop)), len(field), rows_in(field[0].nbytes))
