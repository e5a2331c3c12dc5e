"""Measured sag-error maps (surface figures): grid files and the figures of a design's surfaces.

A grid file is CSV text. It starts with two lines ``# spacing_mm = 0.1`` and ``# unit = um``; other lines that
start with # are comments. One line for each row of the grid follows: x increases along each line, y from line
to line. The middle of the grid is the vertex. ``nan`` or an empty entry marks a point that was not measured,
and so does the value of a line ``# no_data = -9999``. A height far from all others is refused, because it may
be such a value; ``# no_data = none`` states that it is a height.
"""

from __future__ import annotations

import math
import os
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.tables import read_grid_row, read_number, validate_no_comma_pairs
from lensdesign.common.toml_files import read_text, unknown_key
from lensdesign.errors import InputError
from lensdesign.lens.height_maps import implausible_heights, validate_heights, validate_spacing
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface import Surface
from lensdesign.lens.surface_figure import (
    SurfaceFigure,
    surface_figure_from_grid,
    surface_figure_from_zernike,
)
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM, SurfaceFigureSource

UNITS_MM = {"mm": 1.0, "um": 1e-3, "nm": 1e-6, "waves_633nm": 1e-3 * TEST_WAVELENGTH_UM}
"""Length in mm of each unit that a grid file may use."""

KEYS = ("spacing_mm", "unit")
"""Keys that the header of a grid file must contain."""

NO_DATA = "no_data"
"""Key of the header that states the value of points that were not measured, or "none"."""


def surface_figure(surface: Surface) -> SurfaceFigure | None:
    """Return the figure of a surface from its grid file or Zernike coefficients; None if it has none.

    Parameters
    ----------
    surface
        A surface of a design.

    Returns
    -------
    SurfaceFigure or None
        Sag error over the clear aperture.

    Raises
    ------
    InputError
        If the grid file cannot be read, or does not cover the surface's clear aperture.
    """
    source = surface.figure
    if source is None:
        return None
    assert surface.semi_diameter_mm is not None  # ensured by the validator
    if source.file is None:
        return _zernike_figure(source)
    try:
        status = source.file.stat()
    except OSError as error:
        raise InputError(f"cannot read {source.file}: {error.strerror or error}") from error
    return _grid_figure(source.file, surface.semi_diameter_mm, status.st_mtime_ns, status.st_size)


def check_surface_figures(lens: Lens) -> None:
    """Check that every figure of a lens can be read.

    Raises
    ------
    InputError
        If a grid file cannot be read, or does not cover its surface's clear aperture. The message names the
        surface.
    """
    for index, surface in enumerate(lens.surfaces, start=1):
        try:
            surface_figure(surface)
        except InputError as error:
            raise type(error)(f"surface {index}: {error}") from error


@lru_cache(maxsize=32)
def _zernike_figure(source: SurfaceFigureSource) -> SurfaceFigure:
    assert source.semi_diameter_mm is not None  # ensured by the validator
    return surface_figure_from_zernike(source.coefficients_um, source.semi_diameter_mm)


@lru_cache(maxsize=32)
def _grid_figure(path: Path, semi_diameter_mm: float, _mtime_ns: int, _size: int) -> SurfaceFigure:
    values, spacing_mm = read_surface_figure_grid(path)
    try:
        return surface_figure_from_grid(values, spacing_mm, semi_diameter_mm)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def read_surface_figure_grid(path: str | os.PathLike[str]) -> tuple[Array, float]:
    """Read a measured sag-error map from a grid file.

    Parameters
    ----------
    path
        A grid file in the format that :mod:`lensdesign.files.surface_figures` describes.

    Returns
    -------
    sag_error_mm : ndarray, shape (rows, columns)
        Sag error in mm, positive along +z; NaN where it was not measured. y increases with the row, x with
        the column.
    spacing_mm : float
        Distance between neighbouring points in mm.

    Raises
    ------
    InputError
        If the file cannot be read or does not hold a grid; the message names file and line.
    """
    path = Path(path)
    header: dict[str, str] = {}
    rows: list[list[float]] = []
    texts: list[tuple[str, str]] = []
    for count, line in enumerate(read_text(path).splitlines(), start=1):
        location, text = f"{path}, line {count}", line.strip()
        if text.startswith("#"):
            _read_header(text[1:], header, location)
        elif text:
            rows.append(_row(text, location))
            texts.append((text, location))
            if len(rows[-1]) != len(rows[0]):
                raise InputError(
                    f"{location}: {len(rows[-1])} values, but the first row holds {len(rows[0])}: "
                    "must be equal"
                )
    missing = [key for key in KEYS if key not in header]
    if missing:
        raise InputError(f"{path}: no line '# {missing[0]} = ...' before the grid")
    if not rows:
        raise InputError(f"{path}: holds no values")
    validate_no_comma_pairs(texts)
    return _heights_mm(np.array(rows), header, path), float(header["spacing_mm"])


def _heights_mm(values: Array, header: dict[str, str], path: Path) -> Array:
    """Return the heights in mm, after checks of values that may mark points without data."""
    stated, unit = header.get(NO_DATA), header["unit"]
    if stated is not None and stated != "none":
        values[values == float(stated)] = np.nan
    heights = values * UNITS_MM[unit]
    suspicious = implausible_heights(heights)
    if stated is None and np.any(suspicious):
        row, column = np.argwhere(suspicious)[0]
        others = np.ptp(values[~suspicious & np.isfinite(values)])
        raise InputError(
            f"{path}: row {row + 1}, column {column + 1} of the grid: {values[row, column]:g} {unit} "
            f"lies far from all other heights, whose range is {others:.3g} {unit} "
            f"({np.count_nonzero(suspicious)} such points). If it marks points that were not measured, "
            f"add the line '# {NO_DATA} = {values[row, column]:g}' to the header; "
            f"if it is a height, '# {NO_DATA} = none'"
        )
    validate_heights(heights, str(path))
    return heights


def write_surface_figure_grid(
    sag_error_mm: ArrayLike, spacing_mm: float, path: str | os.PathLike[str]
) -> None:
    """Write a sag-error map to a grid file for :func:`read_surface_figure_grid`.

    Parameters
    ----------
    sag_error_mm
        Sag error in mm, shape (rows, columns), positive along +z; NaN where it was not measured.
    spacing_mm
        Distance between neighbouring points in mm.
    path
        File to write.

    Raises
    ------
    InputError
        If the values are not a two-dimensional grid, or the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from lensdesign.files import read_surface_figure_grid, write_surface_figure_grid
    >>> path = Path(tempfile.mkdtemp()) / "figure.csv"
    >>> write_surface_figure_grid([[0.0, 1e-4], [2e-4, 3e-4]], 0.5, path)
    >>> read_surface_figure_grid(path)[1]
    0.5
    """
    values = np.asarray(sag_error_mm, float)
    if values.ndim != 2 or not values.size:
        raise InputError(f"sag_error_mm has shape {values.shape}: must be (rows, columns)")
    lines = [f"# spacing_mm = {float(spacing_mm)!r}", "# unit = um", f"# {NO_DATA} = none"]
    lines += [",".join(repr(float(v)) for v in row) for row in 1e3 * values]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _read_header(text: str, header: dict[str, str], location: str) -> None:
    """Store a `key = value` of the header; other text is a comment."""
    key, equals, value = (piece.strip() for piece in text.partition("="))
    if not equals:
        return
    if key not in (*KEYS, NO_DATA):
        raise InputError(f"{location}: {key}: {unknown_key(key, (*KEYS, NO_DATA))}")
    if key in header:
        raise InputError(f"{location}: {key} is given twice")
    if key == "unit" and value not in UNITS_MM:
        raise InputError(f"{location}: unit = {value}: allowed: {', '.join(UNITS_MM)}")
    if key == "spacing_mm":
        validate_spacing(read_number(value, location, key), f"{location}: spacing_mm")
    if key == NO_DATA and value != "none":
        read_number(value, location, key)
    header[key] = value


def _row(text: str, location: str) -> list[float]:
    values = read_grid_row(text, location)
    if any(math.isinf(value) for value in values):
        raise InputError(f"{location}: inf is not a valid sag error; write nan for a point without data")
    return values
