"""Speed of this machine, measured once in a process, for the predicted costs of the engines."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import cache

import numpy as np
import scipy.fft

SIDE, LINE = 256, 1 << 15
FFT_CALL_SECONDS, CALL_SECONDS = 2e-5, 2e-6
"""Least time of one transform, and of one other array operation."""


def _fastest(work: Callable[[], object]) -> float:
    times = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


@cache
def _fft_unit(line: bool) -> float:
    """Return seconds per sample and doubling of the number of samples."""
    field = np.ones(LINE if line else (SIDE, SIDE), complex)
    return _fastest(lambda: scipy.fft.fftn(field, workers=-1)) / (field.size * math.log2(field.size))


@cache
def _pass_unit() -> float:
    """Return seconds per sample of a complex product."""
    field = np.ones((2 * SIDE, 2 * SIDE), complex)
    return _fastest(lambda: field * field) / field.size


@cache
def _exponential_unit() -> float:
    """Return seconds per sample of cosine and sine of an array."""
    phase = np.linspace(0.0, 10.0, SIDE * SIDE)
    return _fastest(lambda: (np.cos(phase), np.sin(phase))) / phase.size


def fft_seconds(samples: int, line: bool = False) -> float:
    """Return the time of a complex Fourier transform of a number of samples; a line uses only one core."""
    return FFT_CALL_SECONDS + _fft_unit(line) * samples * math.log2(max(samples, 2))


def pass_seconds(samples: int) -> float:
    """Return the time of a complex product of arrays with a number of samples."""
    return CALL_SECONDS + _pass_unit() * samples


def exponential_seconds(samples: int) -> float:
    """Return the time to compute an array of complex exponentials."""
    return CALL_SECONDS + _exponential_unit() * samples
