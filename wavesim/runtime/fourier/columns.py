"""Fourier transforms of some of a plane's columns, where they lie, sixteen at once.

Of transforms of nothing but columns: a plane whose rows are transformed, too, goes in panels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from wavesim.runtime import threads
from wavesim.runtime.fourier import cells
from wavesim.runtime.fourier.panels import buffers_for, buffers_shape, steps_for, thread_buffer
from wavesim.runtime.fourier.passes import SAMPLE

ComplexArray = NDArray[np.complexfloating[Any, Any]]


def transform_columns(source: ComplexArray, target: ComplexArray, inverse: bool) -> None:
    """Transform columns into those of another array, forward, or inverse without a factor.

    Parameters
    ----------
    source, target
        Of one shape and type; numbers of a row lie side by side, rows may lie apart.
    inverse
        Whether exponents have the positive sign.
    """
    count, kind = len(source), source.dtype.name
    steps = steps_for(count, kind)
    samples = thread_buffer("columns", (count * SAMPLE,), kind)
    real = source.real.dtype
    cells.transform_columns(
        source.view(real), target.view(real), steps, inverse, samples, buffers_for(count, kind)
    )


def bytes_of_columns(count: int, dtype: DTypeLike) -> int:
    """Return the memory that all threads keep for columns of a number of samples."""
    buffers, wide = buffers_shape(count)
    return threads.THREADS * (count + buffers * wide) * (SAMPLE // 2) * np.dtype(dtype).itemsize
