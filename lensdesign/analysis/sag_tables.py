"""Sag of one surface over its radial height, with the best-fit sphere, for metrology in the workshop."""

from __future__ import annotations

import csv
import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError, validate_positive
from lensdesign.files.surface_figures import surface_figure
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.intersection import SagError
from lensdesign.lens.surface import Surface

COLUMNS = ("radial_height_mm", "sag_mm", "slope", "departure_mm", "best_fit_radius_mm")


@dataclass(frozen=True, eq=False)
class SagTable:
    """Sag of one surface from its vertex to its clear semi-diameter.

    A measured figure, and a shape that is not rotationally symmetric, are represented by their rotationally
    symmetric part: the mean over all azimuths at each radial height.

    Attributes
    ----------
    surface
        Index of the surface in its lens, from 0.
    radial_height_mm, sag_mm, slope, departure_mm : ndarray, shape (n,)
        Radial height, from 0 to the semi-diameter inclusive; sag, positive along +z; derivative of the sag;
        sag minus that of the best-fit sphere. The slope is very large where the tangent is parallel to the
        axis.
    best_fit_radius_mm
        Radius of the best-fit sphere, signed as in a design; inf for a plane. Of all spheres through the
        vertex, it has the smallest mean square departure along z over the area of the clear aperture.
    asymmetric_rms_mm
        Root mean square, over that area, of the part that is not rotationally symmetric and therefore not in
        the table.

    Examples
    --------
    See :func:`sag_table`.
    """

    surface: int
    radial_height_mm: Array
    sag_mm: Array
    slope: Array
    departure_mm: Array
    best_fit_radius_mm: float
    asymmetric_rms_mm: float

    @property
    def best_fit_text(self) -> str:
        """Description of the best-fit sphere; a plane has no radius."""
        if math.isinf(self.best_fit_radius_mm):
            return "a plane, which fits best"
        return f"the best-fit sphere of {self.best_fit_radius_mm:.6g} mm"


def sag_table(lens: Lens, surface: int, spacing_mm: float) -> SagTable:
    """Return the sag of a surface at equally spaced radial heights.

    Parameters
    ----------
    lens
        The lens.
    surface
        Index of the surface, from 0.
    spacing_mm
        Distance between radial heights. The last step, to the semi-diameter, may be shorter.

    Returns
    -------
    SagTable

    Raises
    ------
    InputError
        If the surface does not exist, has no semi_diameter_mm, or has a figure that cannot be read, or if the
        spacing is not above 0 or results in more than a million rows.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> table = sag_table(lens, 0, spacing_mm=4.0)
    >>> table.radial_height_mm.tolist(), [round(z, 4) for z in table.sag_mm.tolist()]
    ([0.0, 4.0, 8.0, 8.26], [0.0, 0.1895, 0.7634, 0.8143])
    """
    if not 0 <= surface < len(lens.surfaces):
        raise InputError(f"surface {surface + 1}: must be from 1 to {len(lens.surfaces)}")
    own = lens.surfaces[surface]
    semi = own.semi_diameter_mm
    if semi is None:
        raise InputError(
            f"surface {surface + 1} has no semi_diameter_mm; give it one, at which the table ends"
        )
    r = radial_heights_mm(semi, spacing_mm)
    nodes, weights = np.polynomial.legendre.leggauss(256)
    at = 0.5 * semi * (nodes + 1.0)
    sag, slope, _ = _symmetric(own, r)
    fitted, _, asymmetric = _symmetric(own, at)
    curvature = _best_fit_curvature(at, fitted, weights * at, semi)
    return SagTable(
        surface=surface,
        radial_height_mm=r,
        sag_mm=sag,
        slope=slope,
        departure_mm=sag - _sphere(r, curvature),
        best_fit_radius_mm=1.0 / curvature if curvature else math.inf,
        asymmetric_rms_mm=math.sqrt(np.average(asymmetric, weights=weights * at)),
    )


def write_sag_table(table: SagTable, path: str | os.PathLike[str]) -> None:
    """Write a table as CSV.

    Each row has the radius of the best-fit sphere, which is empty for a plane. Numbers are written with full
    precision.

    Parameters
    ----------
    table
        The table.
    path
        Path of the file, which is overwritten.

    Raises
    ------
    InputError
        If the file cannot be written; an existing file then stays unchanged.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> column = np.array([0.0, 1.0])
    >>> table = SagTable(0, column, 0.0 * column, 0.0 * column, 0.0 * column, math.inf, 0.0)
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "plane.csv"
    >>> write_sag_table(table, path)
    >>> path.read_text(encoding="utf-8").splitlines()[1]
    '0.0,0.0,0.0,0.0,'
    """
    columns = [getattr(table, name) for name in COLUMNS[:-1]]
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        radius = "" if math.isinf(table.best_fit_radius_mm) else repr(float(table.best_fit_radius_mm))
        for row in zip(*columns, strict=True):
            writer.writerow([*(repr(float(value)) for value in row), radius])


def radial_heights_mm(semi_mm: float, spacing_mm: float) -> Array:
    """Return the radial heights of a table: multiples of a spacing, and the semi-diameter.

    Raises
    ------
    InputError
        If the spacing is not above 0, or results in too many rows.
    """
    validate_positive("spacing_mm", spacing_mm)
    most_rows = 1_000_000
    if semi_mm / spacing_mm > most_rows:
        raise InputError(
            f"spacing_mm = {spacing_mm:g}: results in more than {most_rows} rows up to the semi-diameter of "
            f"{semi_mm:g} mm; must be at least {semi_mm / most_rows:.3g}"
        )
    # The factor avoids a last step that is due to rounding only.
    steps = math.ceil(semi_mm / spacing_mm * (1.0 - 1e-12))
    return np.append(spacing_mm * np.arange(steps), semi_mm)


def _symmetric(surface: Surface, r: Array) -> tuple[Array, Array, Array]:
    """Return sag, slope, and the mean square in mm^2 of the part that is not rotationally symmetric."""
    angles, block_rows = 256, 128  # azimuths of the mean, and rows evaluated at a time, which bounds memory
    # Rounding must not place the rim of a whole hemisphere outside its edge.
    within = np.minimum(r, (1.0 - 1e-15) * surface.shape.edge_radius_mm)
    shape, figure = surface.shape, surface_figure(surface)
    asymmetric: list[SagError] = [] if figure is None else [figure.sag_and_slopes]
    if shape.ROTATIONAL:
        sag, slope = surface.sag_mm(within), surface.slope(within)
    else:
        sag, slope = np.zeros((2, len(r)))
        asymmetric.append(shape.sag_and_slopes)
    if not asymmetric:
        return sag, slope, np.zeros_like(r)
    angle = 2.0 * np.pi * np.arange(angles) / angles
    x, y = np.cos(angle), np.sin(angle)
    z, dr, square = (np.empty_like(r) for _ in range(3))

    for start in range(0, len(r), block_rows):
        block = slice(start, start + block_rows)
        points = within[block, None] * x, within[block, None] * y
        error, by_x, by_y = (
            sum(values) for values in zip(*(one(*points) for one in asymmetric), strict=True)
        )
        z[block], square[block] = np.mean(error, axis=1), np.var(error, axis=1)
        dr[block] = np.mean(by_x * x + by_y * y, axis=1)
    return sag + z, slope + dr, square


def _sphere(r: Array, curvature: float) -> Array:
    root = np.sqrt(np.maximum(1.0 - (curvature * r) ** 2, 0.0))
    return np.asarray(curvature * r * r / (1.0 + root))


def _best_fit_curvature(r: Array, sag: Array, weights: Any, semi_mm: float) -> float:
    """Return the curvature of the sphere through the vertex with the least weighted square departure.

    The derivative of the sphere's sag with respect to its curvature is r^2 / (w (1 + w)), with
    w = sqrt(1 - c^2 r^2). The smallest sphere is the hemisphere over the aperture.
    """
    from scipy.optimize import brentq

    def slope_of_squares(curvature: float) -> float:
        root = np.sqrt(1.0 - (curvature * r) ** 2)
        return float(np.sum(weights * (_sphere(r, curvature) - sag) * r * r / (root * (1.0 + root))))

    steepest = 1.0 / semi_mm
    if slope_of_squares(0.0) == 0.0:
        return 0.0
    if slope_of_squares(steepest) <= 0.0:
        return steepest
    if slope_of_squares(-steepest) >= 0.0:
        return -steepest
    relative = 4.0 * float(np.finfo(float).eps)
    return float(brentq(slope_of_squares, -steepest, steepest, xtol=1e-16 * steepest, rtol=relative))
