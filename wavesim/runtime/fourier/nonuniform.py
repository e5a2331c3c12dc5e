"""Nonuniform Fourier transforms by FINUFFT, or for several terms on a plane in single precision by
:mod:`wavesim.runtime.fourier.terms`; both have the same methods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Precision:
    """Precision of the computation of a part of a field.

    Attributes
    ----------
    dtype : numpy dtype
        complex64 or complex128.
    transform_error : float
        Relative error that is requested of the nonuniform Fourier transform. The rounding of single precision
        comes in addition (:func:`transform_error`).
    interpolation_error : float
        Relative error of the interpolation from a coarse grid.
    """

    dtype: np.dtype[Any]
    transform_error: float
    interpolation_error: float


def rounding_error(modes: int) -> float:
    """Return an upper bound of the relative error due to rounding of a transform in single precision.

    Points are angles that are rounded to single precision, and FINUFFT computes in it. The error of a point's
    phase grows with the mode number. Against double precision, errors are 0.45 times the rounding unit and
    the number of modes, and up to 0.9 times on the coarser grid of larger requested errors, for 256 to 2048
    modes along an axis.

    Parameters
    ----------
    modes
        Largest number of modes along an axis.
    """
    return float(np.finfo(np.float32).eps) * modes


def transform_error(precision: Precision, modes: int) -> float:
    """Return an upper bound of the relative error of a transform.

    Parameters
    ----------
    precision
        Precision of the computation.
    modes
        Largest number of modes along an axis.
    """
    # FINUFFT exceeds a requested error of 1e-3 by this factor, as measured with its coarser grid.
    requested = 1.7 * precision.transform_error
    return math.hypot(requested, rounding_error(modes)) if precision.dtype == np.complex64 else requested


def plan_of_terms(kind: int, shape: tuple[int, ...], precision: Precision, threads: int = 1) -> Any:
    """Return the fastest transform for a number of threads; parameters as in :func:`fourier_plan`."""
    # With more threads than three, FINUFFT is faster than one thread of the other transform.
    if precision.dtype != np.complex64 or len(shape) != 3 or threads > 3:
        return fourier_plan(kind, shape, precision, threads)
    from wavesim.runtime.fourier.terms import TermsTransform

    return TermsTransform(kind, shape, precision.transform_error)


def fourier_plan(kind: int, shape: tuple[int, ...], precision: Precision, threads: int = 1) -> Any:
    """Return a plan of FINUFFT for a nonuniform Fourier transform of type 2 or 1.

    Type 2 computes values at points from modes; type 1 is its conjugate transpose.

    Parameters
    ----------
    kind
        Type of the transform, 2 or 1.
    shape
        Number of transforms, then of modes along each axis.
    precision
        Data type and error of the transform.
    threads
        Number of threads.
    """
    import finufft  # type: ignore[import-untyped]

    return finufft.Plan(
        kind,
        shape[1:],
        shape[0],
        precision.transform_error,
        -1 if kind == 2 else 1,
        dtype=precision.dtype.name,
        nthreads=threads,
        upsampfac=1.25 if precision.transform_error > 9e-5 else 2.0,
        showwarn=0,
    )


def sum_of_terms(plan: Any, values: Any, factors: Any, weights: Any) -> Any:
    """Return the sum over terms of weights times the transform (type 2) of factors times modes.

    Parameters
    ----------
    plan
        A transform whose points are set.
    values
        Modes that all terms share.
    factors
        Factors of the modes, shape (terms, modes).
    weights
        Weights of the points, shape (terms, points).
    """
    if hasattr(plan, "weighted"):
        return plan.weighted(values, factors, weights)
    modes = np.ascontiguousarray(factors * values)
    return (weights * plan.execute(modes if len(modes) > 1 else modes[0])).sum(axis=0)


def adjoint_of_terms(plan: Any, values: Any, factors: Any, weights: Any) -> Any:
    """Return modes from values at points: the conjugate transpose of :func:`sum_of_terms`, with type 1."""
    if hasattr(plan, "weighted"):
        return plan.weighted(values, factors, weights)
    strength = np.ascontiguousarray(weights.conj() * values)
    modes = plan.execute(strength if len(strength) > 1 else strength[0]).reshape(factors.shape)
    return (factors.conj() * modes).sum(axis=0)


def folded(angles: Any, dtype: np.dtype[Any]) -> Any:
    """Return angles folded to -pi ... pi, in the precision of `dtype`.

    They are folded in double precision, since large angles are inaccurate in single precision.
    """
    real = np.float32 if dtype == np.complex64 else np.float64
    return ((angles + np.pi) % (2.0 * np.pi) - np.pi).astype(real)
