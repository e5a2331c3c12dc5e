"""The way from the exit grid to a recorded plane: a factor of each plane wave."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import fft_frequencies, transfer

ComplexArray = NDArray[np.complexfloating[Any, Any]]


class PlaneWay:
    """Free space between parallel planes, as a factor of a field's spectrum: `spectrum * way`.

    The factor is the same for a frequency and its negative along each axis: a quarter of it is kept.

    Parameters
    ----------
    grid
        Of the field, on either plane.
    wavelength_um
        Vacuum wavelength.
    distance_mm
        From the first plane to the second.
    dtype
        Of the factor.

    Attributes
    ----------
    factor : ndarray
        For frequencies that are not negative; one sample, 1, where the way changes nothing.
    rows, columns : ndarray of int
        Which row and column of the factor belong to each row and column of a spectrum; a line is one row.
    is_none : bool
        Whether the way changes nothing.
    """

    __array_ufunc__ = None  # a product with an array is ours to make

    def __init__(self, grid: Grid, wavelength_um: float, distance_mm: float, dtype: DTypeLike) -> None:
        shape = (1, *grid.shape)[-2:]
        halves = [
            part[tuple(slice(0, n // 2 + 1) for n in part.shape)]
            for part in fft_frequencies(grid.shape, grid.pitch_mm)
        ]
        factor = np.atleast_2d(transfer(halves, wavelength_um, 1.0, distance_mm, None))
        self.is_none = bool(np.all(factor == 1.0))
        if self.is_none:
            factor = np.ones((1, 1))
        self.factor: ComplexArray = np.ascontiguousarray(factor, dtype=dtype)
        orders = [np.minimum(np.arange(n), n - np.arange(n)) for n in shape]
        self.rows, self.columns = (np.zeros_like(order) if self.is_none else order for order in orders)

    def __rmul__(self, spectrum: ComplexArray) -> ComplexArray:
        return self.times(spectrum.copy())

    def times(self, spectrum: ComplexArray, *, back: bool = False) -> ComplexArray:
        """A spectrum on the second plane, in place; `back`: from it to the first."""
        if self.is_none:
            return spectrum
        factor = self.factor.conj() if back else self.factor
        for row, values in zip(self.rows, np.atleast_2d(spectrum), strict=True):
            values *= factor[row, self.columns]
        return spectrum
