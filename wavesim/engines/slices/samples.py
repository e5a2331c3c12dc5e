"""Samples of the slices of a surface, and their complex factors.

A slice is the part of the surface between two neighbouring planes (Eq. C2), for any shape; for a surface of
revolution it is an annulus (Eqs. C1, C5). Two images over the square that light reaches hold the slice index
and the factor of each sample. They are computed some rows at a time.
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
"""Samples that one thread computes at a time."""


@dataclass(frozen=True)
class IlluminatedArea:
    """The part of a grid that light may reach on a surface: a disc about its centre, and the enclosing
    square.

    Attributes
    ----------
    scene : Scene
        Scene with the lens.
    surface : int
        Index of the surface, from 0.
    grid : Grid
        Grid of the surface.
    reach_mm : float
        Largest distance from the centre at which light meets the surface.
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
        """Number of rows of a block."""
        return max(BLOCK // self.shape[1], 1)

    def axes_mm(self, first: int, stop: int) -> tuple[Array, Array]:
        """Return y of some rows of the square, and x of its columns."""
        return self.grid.y_mm[self._inside(1)][first:stop], self.grid.x_mm[self._inside(0)]

    def heights(self, first: int, stop: int) -> tuple[Array, Array]:
        """Return the height of the surface in some rows, and the weights of the samples, 0 in the dark."""
        y, x = self.axes_mm(first, stop)
        found = surface_map(self.scene.system, self.surface, *np.broadcast_arrays(x, y[:, None]))
        middle = self.grid.centre_mm
        away = np.hypot(x - middle[0], y[:, None] - middle[1])
        lit = rim_weight(np.minimum(found.inwards_mm, self.reach_mm - away), self.grid.pitch_mm)
        return found.z_mm, np.where(np.isfinite(found.z_mm), lit, 0.0)

    def span_mm(self) -> tuple[float, float]:
        """Return the height of the lowest and the highest sample.

        Raises
        ------
        SamplingError
            If no sample lies on the surface.
        """

        def ends(first: int, stop: int) -> tuple[float, float]:
            z, lit = self.heights(first, stop)
            illuminated = z[lit > 0.0]
            return (
                (float(illuminated.min()), float(illuminated.max()))
                if len(illuminated)
                else (np.inf, -np.inf)
            )

        found = for_blocks(ends, self.shape[0], self.rows_at_once) if min(self.shape) > 0 else []
        low, high = (min([f[0] for f in found], default=np.inf), max([f[1] for f in found], default=-np.inf))
        if low > high:
            raise SamplingError(
                f"no sample of the working grid of {self.grid.pitch_mm:g} mm lies on surface "
                f"{self.surface + 1}"
            )
        return low, high

    def _inside(self, which: int) -> slice:
        """Return the illuminated samples along x (0) or y (1)."""
        points = self.grid.y_mm if which else self.grid.x_mm
        away = np.abs(points - self.grid.centre_mm[which])
        near = np.flatnonzero(away <= self.reach_mm + self.grid.pitch_mm)
        return slice(int(near[0]), int(near[-1]) + 1) if len(near) else slice(0, 0)


class ImageRegion(NamedTuple):
    """Rows and columns of an image."""

    rows: slice
    columns: slice


@dataclass(frozen=True, eq=False)
class SlicedSurface:
    """Samples of a surface by slice; slices without samples are omitted.

    Attributes
    ----------
    corner : (int, int)
        First row and column of the images in the grid; a line is one column.
    indices : ndarray of int, shape (rows, columns)
        Index of the slice of each sample; the highest value of the type marks samples without a slice.
    factors : ndarray of complex, shape (rows, columns)
        Phase compensation (Eqs. C3, C6) and transmission.
    labels : list of int
        Index in the image of each slice that has samples.
    boxes : list of ImageRegion
        Position of each slice in the images.
    before_mm, behind_mm : ndarray
        z at which each slice receives light from the medium in front, and emits it into the one behind.
    """

    corner: tuple[int, int]
    indices: NDArray[np.unsignedinteger[Any]]
    factors: NDArray[np.complexfloating[Any, Any]]
    labels: list[int]
    boxes: list[ImageRegion]
    before_mm: Array
    behind_mm: Array


def index_type(slices: int) -> np.dtype[Any]:
    """Return the data type of an image of slice indices, with one further value."""
    return np.min_scalar_type(slices)


def sliced(
    area: IlluminatedArea, compensation: Compensation, planes_mm: Array, dtype: DTypeLike
) -> SlicedSurface:
    """Sample a surface by slice.

    Parameters
    ----------
    area
        Illuminated samples of the surface.
    compensation
        Phase compensation and transmission of the surface.
    planes_mm
        Cutting planes.
    dtype
        Data type of the factors.
    """
    low, high = compensation.ends_mm(planes_mm)
    count, shape = len(low), area.shape
    kind = index_type(count)
    indices = np.full(shape, np.iinfo(kind).max, kind)
    factors = np.zeros(shape, dtype)
    k = area.scene.wavenumber_per_mm

    def work(first: int, stop: int) -> tuple[Array, Array]:
        z, lit = area.heights(first, stop)
        inside = lit > 0.0
        y, x = area.axes_mm(first, stop)
        before, behind, amplitude, phase = compensation.at(y, x, inside)
        z, amplitude = z[inside], amplitude * lit[inside]
        which = slice_of(planes_mm, z)
        # Exponents of Eqs. C3 and C6 over k: n1 (g - z_p) + n2 (z_(p+1) - g).
        path = before * (z - low[which]) + behind * (high[which] - z)
        factors[first:stop][inside] = amplitude.astype(factors.real.dtype) * phasor_of(
            k * path + phase, factors.dtype
        )
        indices[first:stop][inside] = which
        return _extents(np.nonzero(inside), which, count, first)

    with one_blas_thread():
        parts = for_blocks(work, shape[0], area.rows_at_once)
    least = np.min([p[0] for p in parts], axis=0)
    most = np.max([p[1] for p in parts], axis=0)
    full = np.flatnonzero(most[0] >= 0)
    boxes = [
        ImageRegion(*(slice(int(least[axis, q]), int(most[axis, q]) + 1) for axis in (0, 1))) for q in full
    ]
    return SlicedSurface(area.corner, indices, factors, full.tolist(), boxes, low[full], high[full])


def _extents(
    positions: tuple[NDArray[np.intp], ...], which: NDArray[np.intp], count: int, first: int
) -> tuple[Array, Array]:
    """Return first and last row and column of each slice; shape (2, count)."""
    least, most = np.full((2, count), np.iinfo(np.intp).max), np.full((2, count), -1)
    for axis, position in enumerate(positions):
        np.minimum.at(least[axis], which, position + (first if axis == 0 else 0))
        np.maximum.at(most[axis], which, position + (first if axis == 0 else 0))
    return least, most
