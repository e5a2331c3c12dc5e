"""Fourier transforms of columns of a plane without a copy of the plane, sixteen columns at once.

They are for planes of which only columns are transformed. If rows are transformed as well,
:mod:`wavesim.runtime.fourier.panels` is faster.
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
    """Transform the columns of an array, and write the result to another array.

    Parameters
    ----------
    source, target
        Arrays of equal shape and type. The values of a row must be contiguous; rows may have gaps between
        them.
    inverse
        True for the inverse transform (positive sign of the exponents), which is not divided by the number
        of rows.
    """
    count, kind = len(source), source.dtype.name
    steps = steps_for(count, kind)
    samples = thread_buffer("columns", (count * SAMPLE,), kind)
    real = source.real.dtype
    cells.transform_columns(
        source.view(real), target.view(real), steps, inverse, samples, buffers_for(count, kind)
    )


def bytes_of_columns(count: int, dtype: DTypeLike) -> int:
    """Return the memory that all threads together keep for transforms of columns with `count` samples."""
    buffers, wide = buffers_shape(count)
    return threads.THREADS * (count + buffers * wide) * (SAMPLE // 2) * np.dtype(dtype).itemsize
