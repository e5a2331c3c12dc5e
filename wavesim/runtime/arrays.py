"""Fourier transforms by `scipy.fft` in all threads, or in a given number."""

from __future__ import annotations

from typing import Any, Literal

import scipy.fft

Norm = Literal["ortho"] | None


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
