"""Figure of a surface: its sag error, the departure of the made shape from the designed one.

However it was given, a figure is held as one thing: a bicubic B-spline on a uniform grid, with continuous
second derivatives, so that rays and waves see the same height and slope.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.errors import InputError, validate_positive
from lensdesign.lens.zernikes import zernike, zernike_orders

Array = NDArray[Any]

FEWEST_POINTS = 8
"""Nodes along each side of a measured grid."""

_NODES_PER_ORDER_SQUARED = 2.6
"""From the vertex to the rim: the spline then misses a polynomial of root mean square 1 by less than 1e-6."""

_MARGIN = 12
"""Nodes beyond the rim for which Zernike polynomials go on, so that nothing behind reaches back inside."""

_BLOCK = 1 << 15
"""Points evaluated at one time."""


@dataclass(frozen=True, eq=False)
class SurfaceFigure:
    """Sag error over a disc in a surface's own frame, positive along +z; it adds to the sag.

    Beyond its grid the error goes on as it stands at the edge.

    Attributes
    ----------
    semi_diameter_mm : float
        Of the disc about the vertex over which it is stated.
    spacing_mm : float
        Between the nodes of the grid, which is centred on the vertex.
    coefficients : ndarray, shape (rows + 2, columns + 2) or (trials, rows + 2, columns + 2)
        B-spline coefficients in mm; row: y, column: x, both rising. One more on each side than nodes. With a
        leading axis, figures of many perturbed copies of one surface.
    """

    semi_diameter_mm: float
    spacing_mm: float
    coefficients: NDArray[np.float64]

    @property
    def trials(self) -> int | None:
        """Number of copies; None for a single figure."""
        return len(self.coefficients) if self.coefficients.ndim == 3 else None

    @property
    def nodes(self) -> tuple[int, int]:
        """Number of nodes along y and x."""
        rows, columns = self.coefficients.shape[-2:]
        return rows - 2, columns - 2

    def trial(self, number: int) -> SurfaceFigure:
        """The figure of one copy; a single figure is that of every copy."""
        if self.trials is None:
            return self
        return SurfaceFigure(self.semi_diameter_mm, self.spacing_mm, self.coefficients[number])

    def sag(self, x_mm: ArrayLike, y_mm: ArrayLike) -> Array:
        """Sag error in mm at transverse points, broadcast together; trials, if any, come first."""
        return self._evaluate(x_mm, y_mm, ((0, 0),))[0]

    def sag_and_slopes(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Array, Array, Array]:
        """Sag error in mm, and its slopes along x and y (dimensionless)."""
        z, dx, dy = self._evaluate(x_mm, y_mm, ((0, 0), (0, 1), (1, 0)))
        return z, dx, dy

    def _evaluate(
        self, x_mm: ArrayLike, y_mm: ArrayLike, derivatives: tuple[tuple[int, int], ...]
    ) -> list[Array]:
        """Derivatives (order along y, order along x), block by block."""
        x, y = np.broadcast_arrays(np.asarray(x_mm), np.asarray(y_mm))
        leading = self.coefficients.shape[:-2]
        kind = np.result_type(x, y, float)
        results = [np.empty((*leading, x.size), kind) for _ in derivatives]
        across, down = x.reshape(-1), y.reshape(-1)
        for start in range(0, x.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            column, by_x = self._basis(across[part], self.nodes[1])
            row, by_y = self._basis(down[part], self.nodes[0])
            values = [np.zeros((*leading, len(column)), kind) for _ in derivatives]
            for j in range(4):
                for i in range(4):
                    local = self.coefficients[..., row + j, column + i]
                    for value, (order_y, order_x) in zip(values, derivatives, strict=True):
                        value += by_y[order_y][j] * by_x[order_x][i] * local
            for result, value in zip(results, values, strict=True):
                result[..., part] = value
        return [result.reshape((*leading, *x.shape)) for result in results]

    def _basis(self, at_mm: Array, nodes: int) -> tuple[NDArray[np.intp], tuple[list[Array], list[Array]]]:
        """Cell of each coordinate, and the four B-splines there: values and derivatives."""
        u = at_mm / self.spacing_mm + 0.5 * (nodes - 1)
        within = (np.real(u) >= 0.0) & (np.real(u) <= nodes - 1)
        u = np.where(within, u, np.clip(np.real(u), 0.0, nodes - 1))
        # A point that is no number has no cell; its weights are no numbers either.
        cell = np.clip(np.nan_to_num(np.real(u)), 0, nodes - 2).astype(np.intp)
        t = u - cell
        values = [
            (1.0 - t) ** 3 / 6.0,
            (4.0 + t * t * (3.0 * t - 6.0)) / 6.0,
            (1.0 + t * (3.0 + t * (3.0 - 3.0 * t))) / 6.0,
            t**3 / 6.0,
        ]
        scale = np.where(within, 1.0 / self.spacing_mm, 0.0)
        slopes = [
            -0.5 * scale * (1.0 - t) ** 2,
            0.5 * scale * t * (3.0 * t - 4.0),
            0.5 * scale * (1.0 + t * (2.0 - 3.0 * t)),
            0.5 * scale * t * t,
        ]
        return cell, (values, slopes)


@dataclass(frozen=True, eq=False)
class PackedFigures:
    """Figures of all surfaces as flat arrays.

    Attributes
    ----------
    first : ndarray of int, shape (surfaces + 1,)
        Figures first[s] to first[s + 1] - 1 are those of surface s.
    layout : ndarray of int, shape (figures, 4)
        Start in `coefficients`, step from trial to trial, rows and columns.
    per_mm : ndarray, shape (figures,)
        One over the spacing.
    coefficients : ndarray, shape (n,)
        Of all B-splines, in mm.
    """

    first: NDArray[np.int64]
    layout: NDArray[np.int64]
    per_mm: NDArray[np.float64]
    coefficients: NDArray[np.float64]


def packed_figures(figures: Sequence[Sequence[SurfaceFigure]]) -> PackedFigures:
    """Lay out the figures of each surface."""
    every = [figure for own in figures for figure in own]
    sizes = [figure.coefficients.size for figure in every]
    layout = [
        [start, 0 if f.trials is None else size // f.trials, *f.coefficients.shape[-2:]]
        for f, start, size in zip(every, np.cumsum(sizes) - sizes, sizes, strict=True)
    ]
    return PackedFigures(
        first=np.cumsum([0, *(len(own) for own in figures)]),
        layout=np.array(layout, np.int64).reshape(-1, 4),
        per_mm=np.array([1.0 / figure.spacing_mm for figure in every]),
        coefficients=np.concatenate([np.empty(0), *(figure.coefficients.ravel() for figure in every)]),
    )


def figure_from_grid(sag_error_mm: ArrayLike, spacing_mm: float, semi_diameter_mm: float) -> SurfaceFigure:
    """A figure through the points of a uniform grid.

    Points that were not measured (NaN) may lie outside the disc only; they take the nearest measured value.

    Parameters
    ----------
    sag_error_mm
        Sag error, positive along +z, shape (rows, columns) or (trials, rows, columns); row: y, column: x,
        both rising, the grid centred on the vertex.
    spacing_mm
        Between neighbouring points, along x and y.
    semi_diameter_mm
        Of the disc over which it is stated, usually the clear aperture.

    Raises
    ------
    InputError
        If the grid does not cover the disc, holds points inside it that were not measured, or is no grid.
    """
    values = np.array(sag_error_mm, float)
    for name, size in (("spacing_mm", spacing_mm), ("semi_diameter_mm", semi_diameter_mm)):
        if not (math.isfinite(size) and size > 0.0):
            raise InputError(f"figure: {name} = {size!r}: must be finite and above 0")
    if values.ndim not in (2, 3) or min(values.shape[-2:], default=0) < FEWEST_POINTS:
        raise InputError(
            f"figure: the grid has shape {values.shape}: must be (rows, columns), both at least "
            f"{FEWEST_POINTS}"
        )
    half = 0.5 * spacing_mm * (min(values.shape[-2:]) - 1)
    if half < semi_diameter_mm * (1.0 - 1e-9):
        raise InputError(
            f"figure: the grid reaches {half:g} mm from the vertex, less than the semi-diameter of "
            f"{semi_diameter_mm:g} mm; measure all of the clear aperture, or lower semi_diameter_mm"
        )
    y, x = (spacing_mm * (np.arange(n) - 0.5 * (n - 1)) for n in values.shape[-2:])
    inside = x * x + y[:, None] ** 2 <= (semi_diameter_mm * (1.0 + 1e-9)) ** 2
    measured = np.isfinite(values[..., inside])
    if not np.all(measured):
        raise InputError(
            f"figure: {np.count_nonzero(~measured)} of {measured.size} points inside the semi-diameter of "
            f"{semi_diameter_mm:g} mm were not measured (not finite); fill them in, or lower semi_diameter_mm"
        )
    return SurfaceFigure(float(semi_diameter_mm), float(spacing_mm), _spline(_filled(values)))


def figure_from_zernike(coefficients_um: Mapping[int, ArrayLike], semi_diameter_mm: float) -> SurfaceFigure:
    """A figure from Zernike coefficients; the spline keeps them to 1e-6.

    Parameters
    ----------
    coefficients_um
        Root mean square sag error in um of each polynomial, by OSA/ANSI index
        (:mod:`lensdesign.lens.zernikes`). Arrays of shape (trials,) give figures of many copies.
    semi_diameter_mm
        Of the disc over which the polynomials are normalized.

    Raises
    ------
    InputError
        If an index does not exist, a value is not finite, or arrays differ in length.
    """
    validate_positive("figure: semi_diameter_mm", semi_diameter_mm)
    given = {index: np.asarray(value, float) for index, value in coefficients_um.items()}
    lengths = {value.shape for value in given.values() if value.ndim}
    if len(lengths) > 1 or any(value.ndim > 1 for value in given.values()):
        raise InputError(
            f"figure: Zernike coefficients of shapes {sorted(lengths)}: must be numbers or (trials,)"
        )
    for index, value in given.items():
        if not np.all(np.isfinite(value)):
            raise InputError(f"figure: Zernike coefficient {index} is not finite")
    order = max((zernike_orders(index)[0] for index in given), default=0)
    across = max(FEWEST_POINTS, math.ceil(_NODES_PER_ORDER_SQUARED * order**2))
    at = np.arange(-across - _MARGIN, across + _MARGIN + 1) / across
    rho = np.minimum(np.hypot(at, at[:, None]), at[-1])
    theta = np.arctan2(at[:, None], at)
    values = np.zeros((*next(iter(lengths), ()), len(at), len(at)))
    for index, value in given.items():
        values += 1e-3 * value[..., None, None] * zernike(index, rho, theta)
    return SurfaceFigure(float(semi_diameter_mm), semi_diameter_mm / across, _spline(values))


def _filled(values: Array) -> Array:
    """Points that are not finite take the value of the nearest that is."""
    from scipy.ndimage import distance_transform_edt

    for plane in values.reshape(-1, *values.shape[-2:]):
        missing = ~np.isfinite(plane)
        if np.any(missing):
            rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
            plane[...] = plane[rows, columns]
    return values


def _spline(values: Array) -> Array:
    """Coefficients of the cubic B-spline through the last two axes, not-a-knot at the ends (de Boor)."""
    from scipy.linalg import solve_banded

    for axis in (-1, -2):
        along = np.moveaxis(values, axis, 0)
        n = len(along)
        bands = np.zeros((9, n + 2))  # bands[4 + i - j, j] is the matrix at (i, j)
        fourth = (1.0, -4.0, 6.0, -4.0, 1.0)
        bands[4 - np.arange(5), np.arange(5)] = fourth
        bands[4 + np.arange(5), n + 1 - np.arange(5)] = fourth
        inner = np.arange(1, n + 1)
        for offset, weight in ((-1, 1.0), (0, 4.0), (1, 1.0)):
            bands[4 - offset, inner + offset] = weight / 6.0
        right = np.zeros((n + 2, *along.shape[1:]))
        right[1:-1] = along
        solved = solve_banded((4, 4), bands, right.reshape(n + 2, -1)).reshape(right.shape)
        values = np.moveaxis(solved, 0, axis)
    return np.ascontiguousarray(values)
