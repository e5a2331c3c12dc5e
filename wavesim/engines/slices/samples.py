"""The samples of each slice of a surface, and what light gains there.

A slice is where the surface lies between two neighbouring planes (Eq. C2), whatever its shape; that of a
surface of revolution is an annulus (Eq. C1). Which slice a sample belongs to, and its factor, stand in two
images over the square that light reaches, made some rows at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import SamplingError
from wavesim.engines.slices.compensation import Compensation, slice_of
from wavesim.engines.surfaces.samples import rim_weight
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import phasor_of
from wavesim.rays.interfaces import surface_map
from wavesim.runtime.threads import for_blocks, one_blas_thread
from wavesim.scene.scene import Scene

BLOCK = 1 << 18
"""Samples that are made at one time by one thread."""


@dataclass(frozen=True)
class IlluminatedArea:
    """The part of a grid that light may reach on a surface: a disc about its middle, and the square about it.

    Attributes
    ----------
    scene : Scene
        Whose lens it is.
    surface : int
        Index from 0.
    grid : Grid
        Of the surface.
    reach_mm : float
        Up to which light meets it.
    """

    scene: Scene
    surface: int
    grid: Grid
    reach_mm: float

    @property
    def corner(self) -> tuple[int, int]:
        """First row and column of the square."""
        return self._inside(1).start, self._inside(0).start

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the square."""
        rows, columns = self._inside(1), self._inside(0)
        return rows.stop - rows.start, columns.stop - columns.start

    @property
    def rows_at_once(self) -> int:
        """In a block."""
        return max(BLOCK // self.shape[1], 1)

    def axes_mm(self, first: int, stop: int) -> tuple[Array, Array]:
        """y of some rows of the square, x of its columns."""
        return self.grid.y_mm[self._inside(1)][first:stop], self.grid.x_mm[self._inside(0)]

    def heights(self, first: int, stop: int) -> tuple[Array, Array]:
        """Height of the surface in some rows, and what samples count for: nothing where no light gets."""
        y, x = self.axes_mm(first, stop)
        found = surface_map(self.scene.system, self.surface, *np.broadcast_arrays(x, y[:, None]))
        middle = self.grid.centre_mm
        away = np.hypot(x - middle[0], y[:, None] - middle[1])
        lit = rim_weight(np.minimum(found.inwards_mm, self.reach_mm - away), self.grid.pitch_mm)
        return found.z_mm, np.where(np.isfinite(found.z_mm), lit, 0.0)

    def span_mm(self) -> tuple[float, float]:
        """Lowest and highest sample.

        Raises
        ------
        SamplingError
            If there are none.
        """

        def ends(first: int, stop: int) -> tuple[float, float]:
            z, lit = self.heights(first, stop)
            there = z[lit > 0.0]
            return (float(there.min()), float(there.max())) if len(there) else (np.inf, -np.inf)

        found = for_blocks(ends, self.shape[0], self.rows_at_once) if min(self.shape) > 0 else []
        low, high = (min([f[0] for f in found], default=np.inf), max([f[1] for f in found], default=-np.inf))
        if low > high:
            raise SamplingError(
                f"no sample of the working grid of {self.grid.pitch_mm:g} mm lies on surface "
                f"{self.surface + 1}"
            )
        return low, high

    def _inside(self, which: int) -> slice:
        """Along x (0) or y (1)."""
        points = self.grid.y_mm if which else self.grid.x_mm
        away = np.abs(points - self.grid.centre_mm[which])
        near = np.flatnonzero(away <= self.reach_mm + self.grid.pitch_mm)
        return slice(int(near[0]), int(near[-1]) + 1) if len(near) else slice(0, 0)


class Box(NamedTuple):
    """Rows and columns of an image."""

    rows: slice
    columns: slice


@dataclass(frozen=True, eq=False)
class SlicedSurface:
    """Samples of a surface by slice; slices without samples are left out.

    Attributes
    ----------
    corner : (int, int)
        First row and column of the images in the grid; a line is one column.
    numbers : ndarray of int, shape (rows, columns)
        To which slice each sample belongs; the highest that the type holds is none.
    factors : ndarray of complex, shape (rows, columns)
        Phase compensation and transmission.
    labels : list of int
        Number of each slice in the image.
    boxes : list of Box
        Where each slice lies in the images.
    before_mm, behind_mm : ndarray
        z at which each slice's light is taken from the medium in front, and given to the one behind.
    """

    corner: tuple[int, int]
    numbers: NDArray[np.unsignedinteger[Any]]
    factors: NDArray[np.complexfloating[Any, Any]]
    labels: list[int]
    boxes: list[Box]
    before_mm: Array
    behind_mm: Array


def number_type(slices: int) -> np.dtype[Any]:
    """Of an image of slice numbers, with one to spare."""
    return np.min_scalar_type(slices)


def sliced(
    reached: IlluminatedArea, given: Compensation, planes_mm: Array, middle: bool, dtype: DTypeLike
) -> SlicedSurface:
    """Samples of a surface by slice.

    Parameters
    ----------
    reached
        Samples of the surface.
    given
        What light gains there.
    planes_mm
        That cut it.
    middle
        Whether the light of a slice is taken and given in its middle, or at its lower and upper plane.
    dtype
        Of the factors.
    """
    low, high = planes_mm[:-1], planes_mm[1:]
    if middle:
        low = high = 0.5 * (low + high)
    count, shape = len(low), reached.shape
    kind = number_type(count)
    numbers = np.full(shape, np.iinfo(kind).max, kind)
    factors = np.zeros(shape, dtype)
    k = reached.scene.wavenumber_per_mm

    def work(first: int, stop: int) -> tuple[Array, Array]:
        z, lit = reached.heights(first, stop)
        inside = lit > 0.0
        y, x = reached.axes_mm(first, stop)
        before, behind, amplitude = given.at(y, x, inside)
        z, amplitude = z[inside], amplitude * lit[inside]
        which = slice_of(planes_mm, z)
        path = before * (z - low[which]) + behind * (high[which] - z)
        factors[first:stop][inside] = amplitude.astype(factors.real.dtype) * phasor_of(
            k * path, factors.dtype
        )
        numbers[first:stop][inside] = which
        return _extents(np.nonzero(inside), which, count, first)

    with one_blas_thread():
        parts = for_blocks(work, shape[0], reached.rows_at_once)
    least = np.min([p[0] for p in parts], axis=0)
    most = np.max([p[1] for p in parts], axis=0)
    full = np.flatnonzero(most[0] >= 0)
    boxes = [Box(*(slice(int(least[axis, q]), int(most[axis, q]) + 1) for axis in (0, 1))) for q in full]
    return SlicedSurface(reached.corner, numbers, factors, full.tolist(), boxes, low[full], high[full])


def _extents(
    places: tuple[NDArray[np.intp], ...], which: NDArray[np.intp], count: int, first: int
) -> tuple[Array, Array]:
    """First and last row and column of each slice; shape (2, count)."""
    least, most = np.full((2, count), np.iinfo(np.intp).max), np.full((2, count), -1)
    for axis, place in enumerate(places):
        np.minimum.at(least[axis], which, place + (first if axis == 0 else 0))
        np.maximum.at(most[axis], which, place + (first if axis == 0 else 0))
    return least, most
