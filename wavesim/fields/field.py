"""Grids and fields: where a wave is sampled, and its samples.

A grid lies in a plane perpendicular to the axis. It is a whole plane, or one meridional line along y. On a
line the problem is two-dimensional: nothing varies along x, and point sources are line sources. Lines serve
long parameter sweeps and exact solutions.

Fields vary in time as exp(-i w t), so that a wave along +z is exp(+i k z). A field u is scaled so that
`|u|^2` times refractive index and cosine of the angle to the axis is the flux through the plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive

Orientation = Literal["x", "y"]


@dataclass(frozen=True)
class Grid:
    """Evenly spaced samples on a line or a plane perpendicular to the axis.

    Attributes
    ----------
    shape : (ny,) or (ny, nx)
        Number of samples: one number for a meridional line along y, two for a plane.
    pitch_mm : float
        Distance between neighbouring samples in mm.
    z_mm : float
        Position of the plane along the axis in mm. The front vertex of a lens lies at z = 0.
    centre_mm : (x, y)
        Centre of the samples in mm; x is 0 for a line.

    Raises
    ------
    InputError
        If a number is not finite, the shape is empty, or the pitch is not above 0.

    Examples
    --------
    >>> from wavesim import Grid
    >>> grid = Grid((4, 4), 0.5, 10.0)
    >>> grid.x_mm.tolist()
    [-0.75, -0.25, 0.25, 0.75]
    """

    shape: tuple[int, ...]
    pitch_mm: float
    z_mm: float
    centre_mm: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        whole = all(isinstance(n, int | np.integer) and n > 0 for n in self.shape)
        if len(self.shape) not in (1, 2) or not whole:
            raise InputError(f"grid shape = {self.shape}: must be one or two whole numbers from 1")
        validate_positive("grid pitch_mm", self.pitch_mm)
        if not (math.isfinite(self.z_mm) and all(math.isfinite(c) for c in self.centre_mm)):
            raise InputError(f"grid z_mm = {self.z_mm!r}, centre_mm = {self.centre_mm!r}: must be finite")
        if self.is_line and self.centre_mm[0] != 0.0:
            raise InputError(
                f"grid centre_mm = {self.centre_mm!r}: must have x = 0, where a meridional line lies"
            )

    @property
    def is_line(self) -> bool:
        """True if the grid is a meridional line."""
        return len(self.shape) == 1

    @property
    def size(self) -> int:
        """Number of samples."""
        return math.prod(self.shape)

    @property
    def cell(self) -> float:
        """Length (mm) or area (mm^2) of one sample."""
        return float(self.pitch_mm ** len(self.shape))

    @property
    def half_widths_mm(self) -> tuple[float, ...]:
        """Half of each side in mm, to the outer edges of the cells, in the order of `shape`."""
        return tuple(0.5 * n * self.pitch_mm for n in self.shape)

    @cached_property
    def y_mm(self) -> Array:
        """y of each row in mm, shape (ny,)."""
        return _samples(self.shape[0], self.pitch_mm, self.centre_mm[1])

    @cached_property
    def x_mm(self) -> Array:
        """x of each column in mm, shape (nx,); the single value 0 for a line."""
        if self.is_line:
            return np.zeros(1)
        return _samples(self.shape[1], self.pitch_mm, self.centre_mm[0])

    def radius_squared_mm2(self) -> Array:
        """Return the squared distance of each sample from the axis in mm^2, with the grid's shape."""
        if self.is_line:
            return self.y_mm**2
        return self.y_mm[:, None] ** 2 + self.x_mm**2

    def at(self, z_mm: float) -> Grid:
        """Return the same samples in the plane at another z (mm)."""
        return replace(self, z_mm=z_mm)

    def target_grid(self, to: Grid | float) -> Grid:
        """Return the target grid: the given one, or the same samples at a distance (mm) along the axis."""
        return to if isinstance(to, Grid) else self.at(self.z_mm + to)

    def samples_among(self, wider: Grid) -> tuple[slice, slice] | None:
        """Return the rows and columns of these samples in a wider grid; None if it lacks some of them."""
        if (wider.z_mm, wider.pitch_mm) != (self.z_mm, self.pitch_mm):
            return None
        found = []
        # Largest distance from a sample, in pitches, at which a point counts as lying on it.
        tolerance = 1e-6
        for wide, narrow in ((wider.y_mm, self.y_mm), (wider.x_mm, self.x_mm)):
            start = (narrow[0] - wide[0]) / self.pitch_mm
            first = round(start)
            if abs(start - first) > tolerance or first < 0 or first + len(narrow) > len(wide):
                return None
            found.append(slice(first, first + len(narrow)))
        return found[0], found[1]


def _samples(count: int, pitch_mm: float, centre_mm: float) -> Array:
    return np.asarray(centre_mm + pitch_mm * (np.arange(count) - 0.5 * (count - 1)), float)


@dataclass(frozen=True, eq=False)
class Field:
    """A monochromatic scalar wave on a grid.

    Fields vary in time as exp(-i w t), so that a wave along +z is exp(+i k z).

    Attributes
    ----------
    grid : Grid
        Positions of the samples.
    values : complex array of the grid's shape
        Complex amplitudes, from NumPy or from a library that follows the array API.
    wavelength_um : float
        Vacuum wavelength in um.
    index : float
        Refractive index of the medium around the grid.

    Raises
    ------
    InputError
        If the shapes differ, or the wavelength is not finite and above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim import Field, Grid
    >>> Field(Grid((2, 2), 0.5, 0.0), np.ones((2, 2)), wavelength_um=0.532).energy
    1.0
    """

    grid: Grid
    values: Any
    wavelength_um: float
    index: float = 1.0

    def __post_init__(self) -> None:
        if tuple(self.values.shape) != self.grid.shape:
            raise InputError(
                f"field values have shape {tuple(self.values.shape)}: must have the grid's, {self.grid.shape}"
            )
        validate_positive("wavelength_um", self.wavelength_um)

    @property
    def wavenumber_per_mm(self) -> float:
        """Wavenumber in the medium in 1/mm: 2 pi times the index over the vacuum wavelength."""
        return 2e3 * math.pi * self.index / self.wavelength_um

    @property
    def energy(self) -> float:
        """Integral of `|u|^2` over the grid: sum of `|u|^2` times the cell in mm (line) or mm^2 (plane)."""
        return float(np.sum(abs(self.values) ** 2)) * self.grid.cell

    def with_values(self, values: Any) -> Field:
        """Return a field with other values on the same grid."""
        return replace(self, values=values)


def relative_error(field: Any, truth: Any) -> float:
    """Return the L2 norm of the difference over that of the truth; no scale or phase is fitted."""
    return float(np.linalg.norm(np.ravel(field - truth)) / np.linalg.norm(np.ravel(truth)))


def correlation(field: Any, truth: Any) -> float:
    """Return the modulus of the normalized inner product of two fields; 1 if they are proportional."""
    a, b = np.ravel(field), np.ravel(truth)
    return float(abs(np.vdot(a, b)) / (np.linalg.norm(a) * np.linalg.norm(b)))


def axis_of(orientation: str) -> int:
    """Return 0 for "x" and 1 for "y"; raise InputError for anything else."""
    if orientation not in ("x", "y"):
        raise InputError(f"orientation = {orientation!r}: must be 'x' or 'y', the axis along which it varies")
    return int(orientation == "y")
