"""The array module of an array, and Fourier transforms by `scipy.fft` of whatever arrays its back end takes.

All threads are used unless said otherwise; their number is not given as an argument, since back ends for
other arrays refuse it. For CuPy arrays say `scipy.fft.set_global_backend(cupyx.scipy.fft)` once, for other
array libraries set `SCIPY_ARRAY_API=1` before SciPy is imported.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, Literal

import numpy as np
import scipy.fft

Norm = Literal["ortho"] | None


def array_module(values: Any) -> Any:
    """NumPy, CuPy or whatever library of the array API an array comes from."""
    if hasattr(values, "__array_namespace__"):
        return values.__array_namespace__()
    return import_module(type(values).__module__.partition(".")[0])


def in_double(values: Any) -> Any:
    """NumPy's arrays in double precision; those of other libraries as they are."""
    return np.asarray(values, complex) if isinstance(values, np.ndarray) else values


def fft(
    values: Any, count: int | None = None, axis: int = -1, *, overwrite: bool = False, workers: int = -1
) -> Any:
    """Along one axis, padded with zeros to `count`; by one worker where threads share the work already."""
    with scipy.fft.set_workers(workers):
        return scipy.fft.fft(values, n=count, axis=axis, overwrite_x=overwrite)


def ifft(values: Any, axis: int = -1, *, overwrite: bool = False, workers: int = -1) -> Any:
    """Back, along one axis."""
    with scipy.fft.set_workers(workers):
        return scipy.fft.ifft(values, axis=axis, overwrite_x=overwrite)


def fftn(
    values: Any, shape: tuple[int, ...] | None = None, *, norm: Norm = None, overwrite: bool = False
) -> Any:
    """Along all axes, padded with zeros to `shape`; with "ortho" a unitary transform."""
    with scipy.fft.set_workers(-1):
        return scipy.fft.fftn(values, s=shape, norm=norm, overwrite_x=overwrite)


def ifftn(values: Any, *, norm: Norm = None, overwrite: bool = False) -> Any:
    """Back, along all axes."""
    with scipy.fft.set_workers(-1):
        return scipy.fft.ifftn(values, norm=norm, overwrite_x=overwrite)
