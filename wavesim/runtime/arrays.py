"""Array modules, and Fourier transforms by `scipy.fft` for all arrays that its back end supports.

By default all threads are used. Their number is not an argument of the transforms, since back ends for other
arrays reject it. For CuPy arrays call `scipy.fft.set_global_backend(cupyx.scipy.fft)` once; for other array
libraries set `SCIPY_ARRAY_API=1` before SciPy is imported.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, Literal

import numpy as np
import scipy.fft

Norm = Literal["ortho"] | None


def array_module(values: Any) -> Any:
    """Return the module of an array: NumPy, CuPy, or another library of the array API."""
    if hasattr(values, "__array_namespace__"):
        return values.__array_namespace__()
    return import_module(type(values).__module__.partition(".")[0])


def in_double(values: Any) -> Any:
    """Return NumPy arrays in double precision, arrays of other libraries unchanged."""
    return np.asarray(values, complex) if isinstance(values, np.ndarray) else values


def fft(
    values: Any, count: int | None = None, axis: int = -1, *, overwrite: bool = False, workers: int = -1
) -> Any:
    """Transform along one axis, padded with zeros to `count`; use one worker inside threads."""
    with scipy.fft.set_workers(workers):
        return scipy.fft.fft(values, n=count, axis=axis, overwrite_x=overwrite)


def ifft(values: Any, axis: int = -1, *, overwrite: bool = False, workers: int = -1) -> Any:
    """Apply the inverse transform along one axis."""
    with scipy.fft.set_workers(workers):
        return scipy.fft.ifft(values, axis=axis, overwrite_x=overwrite)


def fftn(
    values: Any, shape: tuple[int, ...] | None = None, *, norm: Norm = None, overwrite: bool = False
) -> Any:
    """Transform along all axes, padded with zeros to `shape`; with "ortho" the transform is unitary."""
    with scipy.fft.set_workers(-1):
        return scipy.fft.fftn(values, s=shape, norm=norm, overwrite_x=overwrite)


def ifftn(values: Any, *, norm: Norm = None, overwrite: bool = False) -> Any:
    """Apply the inverse transform along all axes."""
    with scipy.fft.set_workers(-1):
        return scipy.fft.ifftn(values, norm=norm, overwrite_x=overwrite)
