"""How fast this machine is, measured once in a process, for the predictions of the engines' cost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import cache

import numpy as np
import scipy.fft

REPEATS = 5
SIDE, LINE = 256, 1 << 15
FFT_CALL_SECONDS, CALL_SECONDS = 2e-5, 2e-6
"""What one transform, and one other array operation, takes at the least."""


def _fastest(work: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


@cache
def _fft_unit(line: bool) -> float:
    """Seconds per sample and doubling of the number of samples."""
    field = np.ones(LINE if line else (SIDE, SIDE), complex)
    return _fastest(lambda: scipy.fft.fftn(field, workers=-1)) / (field.size * math.log2(field.size))


@cache
def _pass_unit() -> float:
    """Seconds per sample of a complex product."""
    field = np.ones((2 * SIDE, 2 * SIDE), complex)
    return _fastest(lambda: field * field) / field.size


@cache
def _exponential_unit() -> float:
    """Seconds per sample of cosine and sine of an array."""
    phase = np.linspace(0.0, 10.0, SIDE * SIDE)
    return _fastest(lambda: (np.cos(phase), np.sin(phase))) / phase.size


def fft_seconds(samples: int, line: bool = False) -> float:
    """One complex Fourier transform of so many samples in all; of one line, which has no use of two cores."""
    return FFT_CALL_SECONDS + _fft_unit(line) * samples * math.log2(max(samples, 2))


def pass_seconds(samples: int) -> float:
    """One complex product of arrays of so many samples."""
    return CALL_SECONDS + _pass_unit() * samples


def exponential_seconds(samples: int) -> float:
    """One array of complex exponentials."""
    return CALL_SECONDS + _exponential_unit() * samples
