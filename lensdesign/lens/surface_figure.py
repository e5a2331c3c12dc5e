"""Figure of a surface: its sag error, the departure of the made shape from the designed one.

Every figure is stored as a bicubic B-spline on a uniform grid, whether it was given as a grid or by Zernike
coefficients. Its second derivatives are continuous, so that rays and waves use the same height and slope.
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
"""Smallest number of nodes along each side of a measured grid."""


@dataclass(frozen=True, eq=False)
class SurfaceFigure:
    """Sag error over a disc in a surface's own frame, positive along +z; it adds to the sag.

    Outside the grid the error keeps the value that it has at the nearest edge of the grid.

    Attributes
    ----------
    semi_diameter_mm : float
        Semi-diameter of the disc around the vertex over which the error is defined.
    spacing_mm : float
        Distance between neighbouring nodes of the grid, which is centred on the vertex.
    coefficients : ndarray, shape (rows + 2, columns + 2) or (trials, rows + 2, columns + 2)
        B-spline coefficients in mm; rows follow y and columns x, both increasing. There is one coefficient
        more than nodes on each side. A leading axis holds the figures of many perturbed copies of one
        surface.
    """

    semi_diameter_mm: float
    spacing_mm: float
    coefficients: NDArray[np.float64]

    @property
    def trials(self) -> int | None:
        """Number of perturbed copies; None for a single figure."""
        return len(self.coefficients) if self.coefficients.ndim == 3 else None

    @property
    def nodes(self) -> tuple[int, int]:
        """Number of nodes along y and x."""
        rows, columns = self.coefficients.shape[-2:]
        return rows - 2, columns - 2

    def trial(self, index: int) -> SurfaceFigure:
        """Return the figure of one copy; a single figure applies to every copy."""
        if self.trials is None:
            return self
        return SurfaceFigure(self.semi_diameter_mm, self.spacing_mm, self.coefficients[index])

    def sag(self, x_mm: ArrayLike, y_mm: ArrayLike) -> Array:
        """Return the sag error in mm at transverse points, broadcast together; a trial axis comes first."""
        return self._evaluate(x_mm, y_mm, ((0, 0),))[0]

    def sag_and_slopes(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the sag error in mm and its slopes along x and y (dimensionless)."""
        z, dx, dy = self._evaluate(x_mm, y_mm, ((0, 0), (0, 1), (1, 0)))
        return z, dx, dy

    def _evaluate(
        self, x_mm: ArrayLike, y_mm: ArrayLike, derivatives: tuple[tuple[int, int], ...]
    ) -> list[Array]:
        """Return derivatives, each given by its order along y and along x, computed block by block."""
        block = 1 << 15  # points at a time; bounds the memory of the intermediate arrays
        x, y = np.broadcast_arrays(np.asarray(x_mm), np.asarray(y_mm))
        leading = self.coefficients.shape[:-2]
        kind = np.result_type(x, y, float)
        results = [np.empty((*leading, x.size), kind) for _ in derivatives]
        across, down = x.reshape(-1), y.reshape(-1)
        for start in range(0, x.size, block):
            points = slice(start, start + block)
            column, by_x = self._basis(across[points], self.nodes[1])
            row, by_y = self._basis(down[points], self.nodes[0])
            values = [np.zeros((*leading, len(column)), kind) for _ in derivatives]
            for j in range(4):
                for i in range(4):
                    local = self.coefficients[..., row + j, column + i]
                    for value, (order_y, order_x) in zip(values, derivatives, strict=True):
                        value += by_y[order_y][j] * by_x[order_x][i] * local
            for result, value in zip(results, values, strict=True):
                result[..., points] = value
        return [result.reshape((*leading, *x.shape)) for result in results]

    def _basis(self, at_mm: Array, nodes: int) -> tuple[NDArray[np.intp], tuple[list[Array], list[Array]]]:
        """Return the cell of each coordinate and the values and derivatives of the four B-splines there."""
        u = at_mm / self.spacing_mm + 0.5 * (nodes - 1)
        within = (np.real(u) >= 0.0) & (np.real(u) <= nodes - 1)
        u = np.where(within, u, np.clip(np.real(u), 0.0, nodes - 1))
        # A NaN coordinate gets any cell: its weights are NaN, so the result is NaN too.
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
class PackedSurfaceFigures:
    """Figures of all surfaces as flat arrays, the form that compiled ray tracing reads.

    Attributes
    ----------
    first : ndarray of int, shape (surfaces + 1,)
        Figures first[s] to first[s + 1] - 1 belong to surface s.
    layout : ndarray of int, shape (figures, 4)
        For each figure: its start in `coefficients`, the step from trial to trial, rows and columns.
    per_mm : ndarray, shape (figures,)
        Reciprocal of the grid spacing.
    coefficients : ndarray, shape (n,)
        B-spline coefficients of all figures, in mm.
    """

    first: NDArray[np.int64]
    layout: NDArray[np.int64]
    per_mm: NDArray[np.float64]
    coefficients: NDArray[np.float64]


def packed_surface_figures(figures: Sequence[Sequence[SurfaceFigure]]) -> PackedSurfaceFigures:
    """Return the figures of all surfaces, one sequence per surface, as flat arrays."""
    every = [figure for own in figures for figure in own]
    sizes = [figure.coefficients.size for figure in every]
    layout = [
        [start, 0 if f.trials is None else size // f.trials, *f.coefficients.shape[-2:]]
        for f, start, size in zip(every, np.cumsum(sizes) - sizes, sizes, strict=True)
    ]
    return PackedSurfaceFigures(
        first=np.cumsum([0, *(len(own) for own in figures)]),
        layout=np.array(layout, np.int64).reshape(-1, 4),
        per_mm=np.array([1.0 / figure.spacing_mm for figure in every]),
        coefficients=np.concatenate([np.empty(0), *(figure.coefficients.ravel() for figure in every)]),
    )


def surface_figure_from_grid(
    sag_error_mm: ArrayLike, spacing_mm: float, semi_diameter_mm: float
) -> SurfaceFigure:
    """Return a figure that interpolates the points of a uniform grid.

    Points that were not measured (NaN) may lie outside the disc only. They take the nearest measured value.

    Parameters
    ----------
    sag_error_mm
        Sag error in mm, positive along +z, shape (rows, columns) or (trials, rows, columns). Rows follow y
        and columns x, both increasing; the grid is centred on the vertex.
    spacing_mm
        Distance between neighbouring points, the same along x and y.
    semi_diameter_mm
        Semi-diameter of the disc over which the error is defined, usually the clear aperture.

    Returns
    -------
    SurfaceFigure

    Raises
    ------
    InputError
        If the grid does not cover the disc, has fewer than 8 points along a side, or contains points inside
        the disc that were not measured.

    Examples
    --------
    >>> import numpy as np
    >>> figure = surface_figure_from_grid(np.full((9, 9), 1e-4), spacing_mm=1.0, semi_diameter_mm=4.0)
    >>> round(float(figure.sag(0.5, -1.2)), 9)
    0.0001
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


def surface_figure_from_zernike(
    coefficients_um: Mapping[int, ArrayLike], semi_diameter_mm: float
) -> SurfaceFigure:
    """Return a figure from Zernike coefficients; the spline reproduces the polynomials to 1e-6.

    Parameters
    ----------
    coefficients_um
        Root mean square sag error in um of each polynomial, by OSA/ANSI index
        (:mod:`lensdesign.lens.zernikes`). Arrays of shape (trials,) give the figures of many copies.
    semi_diameter_mm
        Semi-diameter of the disc over which the polynomials are normalized.

    Returns
    -------
    SurfaceFigure

    Raises
    ------
    InputError
        If an index does not exist, a value is not finite, or the arrays differ in length.

    Examples
    --------
    Defocus of 0.1 um root mean square has a sag error of sqrt(3) times as much at the rim:

    >>> figure = surface_figure_from_zernike({4: 0.1}, semi_diameter_mm=5.0)
    >>> round(1e3 * float(figure.sag(5.0, 0.0)), 4)
    0.1732
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
    # So many nodes from vertex to rim keep the spline within 1e-6 of a polynomial of root mean square 1. The
    # polynomials continue for some nodes beyond the rim, so that the spline's end conditions do not act
    # inside.
    across, margin = max(FEWEST_POINTS, math.ceil(2.6 * order**2)), 12
    at = np.arange(-across - margin, across + margin + 1) / across
    rho = np.minimum(np.hypot(at, at[:, None]), at[-1])
    theta = np.arctan2(at[:, None], at)
    values = np.zeros((*next(iter(lengths), ()), len(at), len(at)))
    for index, value in given.items():
        values += 1e-3 * value[..., None, None] * zernike(index, rho, theta)
    return SurfaceFigure(float(semi_diameter_mm), semi_diameter_mm / across, _spline(values))


def _filled(values: Array) -> Array:
    """Fill points that are not finite with the value of the nearest finite point."""
    from scipy.ndimage import distance_transform_edt

    for plane in values.reshape(-1, *values.shape[-2:]):
        missing = ~np.isfinite(plane)
        if np.any(missing):
            rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
            plane[...] = plane[rows, columns]
    return values


def _spline(values: Array) -> Array:
    """Return the cubic B-spline coefficients along the last two axes, not-a-knot at the ends (de Boor)."""
    from scipy.linalg import solve_banded

    for axis in (-1, -2):
        along = np.moveaxis(values, axis, 0)
        n = len(along)
        bands = np.zeros((9, n + 2))  # banded storage: bands[4 + i - j, j] is matrix element (i, j)
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
