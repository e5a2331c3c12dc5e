"""Reader of Zygo's Mx files (``.datx``), which are HDF5.

A file of HDF5 can name other files: links, raw data outside the file, and virtual datasets. It can also state
sizes that no machine can hold. All of this is checked before an array is read.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError

LENGTHS_MM = {
    "Meters": 1e3,
    "CentiMeters": 10.0,
    "MilliMeters": 1.0,
    "MicroMeters": 1e-3,
    "NanoMeters": 1e-6,
    "Angstroms": 1e-7,
    "Inches": 25.4,
    "MilliInches": 25.4e-3,
    "MicroInches": 25.4e-6,
}
"""Length in mm of each unit of Mx."""

MOST_POINTS = 2**25
"""Largest number of points of a map."""

LARGEST_ATTRIBUTE = 4096
"""Largest number of values of an attribute."""


def read_datx(path: str | os.PathLike[str]) -> tuple[Array, float | None]:
    """Read the heights of a map and the distance between its points.

    Parameters
    ----------
    path
        A file of Mx.

    Returns
    -------
    height_mm : ndarray, shape (rows, columns)
        Heights in mm; NaN where nothing was measured.
    spacing_mm : float or None
        Distance between neighbouring points; None if the file states none.

    Raises
    ------
    InputError
        If the file refers to other files, its sizes exceed the limits, its units are unknown, or it has
        another structure.
    """
    import h5py

    with h5py.File(path, "r") as file:
        surfaces = _member(_member(file, "Data", path), "Surface", path)
        map_name = next(iter(surfaces), None)
        if map_name is None:
            raise InputError(f"{path}: Data/Surface contains no map")
        surface = _dataset(_member(surfaces, map_name, path), path)
        attributes = surface.attrs
        unit = _text(attributes, "Unit", path)
        factor_mm = _height_factor_mm(attributes, unit, path)
        no_data = _number(attributes, "No Data", path)
        height = np.asarray(surface[()], float)
        unmeasured = height >= no_data if no_data > 0.0 else height <= no_data
        height[~np.isfinite(height) | unmeasured] = np.nan
        return factor_mm * height, _spacing_mm(_member(file, "Attributes", path), path)


def _height_factor_mm(attributes: Any, unit: str, path: Any) -> float:
    """Return the height in mm of a stored value of 1."""
    if unit == "Fringes":
        scale = _number(attributes, "Interferometric Scale Factor", path)
        obliquity = _number(attributes, "Obliquity Factor", path)
        wavelength_mm = 1e3 * _number(attributes, "Wavelength", path)
        shortest_mm, longest_mm = 1e-4, 2e-2
        if not shortest_mm <= wavelength_mm <= longest_mm:
            raise InputError(
                f"{path}: Wavelength = {1e-3 * wavelength_mm:g} m: must be 1e-7 to 2e-5 m, because heights "
                "are in fringes"
            )
        return scale * obliquity * wavelength_mm
    if unit not in LENGTHS_MM:
        raise InputError(
            f"{path}: heights in {unit[:40]!r}: must be in Fringes or {', '.join(LENGTHS_MM)}; export the "
            "map in another unit"
        )
    return LENGTHS_MM[unit]


def _spacing_mm(groups: Any, path: Any) -> float | None:
    """Return the lateral resolution, which stands in the last group of attributes."""
    names = list(groups)
    if not names:
        return None
    attributes = _member(groups, names[-1], path).attrs
    for name in ("Data Context.Lateral Resolution", "Data Context.Data Attributes.Resolution"):
        if f"{name}:Value" not in attributes:
            continue
        # Files without a unit are in m.
        unit = _text(attributes, f"{name}:Unit", path) if f"{name}:Unit" in attributes else "Meters"
        if unit not in LENGTHS_MM:
            raise InputError(
                f"{path}: {name.rpartition('.')[2]} in {unit[:40]!r}: must be in {', '.join(LENGTHS_MM)}; "
                "calibrate the map laterally, or give spacing_mm"
            )
        return _number(attributes, f"{name}:Value", path) * LENGTHS_MM[unit]
    return None


def _member(group: Any, name: str, path: Any) -> Any:
    """Return a member of a group that lies in the same file."""
    import h5py

    if not isinstance(group, h5py.Group) or name not in group:
        raise InputError(
            f"{path}: no {name[:40]} in {getattr(group, 'name', '?')}: not the structure of a .datx"
        )
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise InputError(f"{path}: {group.name}/{name[:40]} is a link; a map must be contained in its file")
    return group[name]


def _dataset(item: Any, path: Any) -> Any:
    """Return a dataset after checks of its storage, type and declared size."""
    import h5py

    if not isinstance(item, h5py.Dataset):
        raise InputError(f"{path}: {item.name} is no array")
    if item.external or item.is_virtual:
        raise InputError(f"{path}: {item.name} is stored in other files; a map must be contained in its file")
    if item.dtype.kind not in "fiu":
        raise InputError(f"{path}: {item.name} has values of type {item.dtype}: must be real numbers")
    chunk = item.chunks or ()
    if item.ndim != 2 or not 0 < item.size <= MOST_POINTS or int(np.prod(chunk, dtype=float)) > MOST_POINTS:
        raise InputError(
            f"{path}: {item.name} has the shape {item.shape}: must be (rows, columns), with at most "
            f"{MOST_POINTS} points"
        )
    return item


def _attribute(attributes: Any, name: str, path: Any) -> Any:
    """Return the first value of an attribute after checks of its type and size."""
    if name not in attributes:
        raise InputError(f"{path}: states no {name}")
    stored = attributes.get_id(name)
    if stored.shape is None or not 0 < int(np.prod(stored.shape, dtype=float)) <= LARGEST_ATTRIBUTE:
        raise InputError(f"{path}: {name} has the shape {stored.shape}: must be a single value")
    return np.ravel(attributes[name])[0]


def _number(attributes: Any, name: str, path: Any) -> float:
    value = _attribute(attributes, name, path)
    if not isinstance(value, np.integer | np.floating) or not np.isfinite(value):
        raise InputError(f"{path}: {name} = {str(value)[:40]}: must be a finite number")
    return float(value)


def _text(attributes: Any, name: str, path: Any) -> str:
    value = _attribute(attributes, name, path)
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    if not isinstance(text, str):
        raise InputError(f"{path}: {name} = {str(value)[:40]}: must be a text")
    return text.strip("\0 ")
