"""Files of fields: complex values, their pitch and their position (.npz)."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.array_files import array_names, read_arrays
from lensdesign.errors import InputError
from wavesim.fields.field import Field


def write_field(field: Field, path: Path, **numbers: float) -> None:
    """Write complex values with their pitch and wavelength to a file that `measured_field` reads (.npz).

    Parameters
    ----------
    field
        Field on a plane.
    path
        File to write.
    **numbers
        Further numbers to store with the values.
    """
    write_arrays(
        path,
        values=np.asarray(field.values, np.complex64),
        pitch_um=1e3 * field.grid.pitch_mm,
        wavelength_um=field.wavelength_um,
        **numbers,
    )


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write arrays by name (.npz) with fast compression: a quarter of NumPy's time, slightly larger files."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, values in arrays.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(values), allow_pickle=False)


def read_field(path: Path) -> tuple[Any, float]:
    """Read values and pitch of a field from a file that `write_field` has written.

    Parameters
    ----------
    path
        An .npz file with the complex or real array `values`, shape (ny, nx), and the number `pitch_um`.

    Returns
    -------
    ndarray, float
        Values in single precision, and their pitch in um.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or contains no field.
    """
    # Arrays that every file of a field contains.
    field_arrays = ("values", "pitch_um")
    arrays = read_arrays(path, named="the field", only=field_arrays)
    if "values" not in arrays or "pitch_um" not in arrays:
        if not zipfile.is_zipfile(path):
            raise InputError(f"cannot read the field {path}: it is not an .npz file, or is damaged")
        lacking = [name for name in field_arrays if name not in arrays]
        raise InputError(
            f"field {path}: has no {' and no '.join(lacking)}; it contains {sorted(array_names(path))}"
        )
    values, pitch = arrays["values"], stored_number(arrays, "pitch_um", f"field {path}")
    if values.ndim != 2 or values.size == 0 or values.dtype.kind not in "fc":
        raise InputError(
            f"field {path}: has {values.dtype} values of shape {values.shape}: must be complex or real, "
            "(ny, nx)"
        )
    if pitch <= 0.0:
        raise InputError(f"field {path}: `pitch_um` must be one number, finite and greater than 0")
    values = values.astype(np.complex64 if values.dtype.kind == "c" else np.float32, copy=False)
    if not all(np.all(np.isfinite(row)) for row in values):
        raise InputError(f"field {path}: has values that are not finite")
    return values, pitch


def read_centre_um(path: Path) -> tuple[float, float]:
    """Return the centre (x, y) of a stored field in um; the axis, unless its file states another one.

    Raises
    ------
    InputError
        If the file cannot be read, or states no finite numbers.
    """
    names = ("centre_x_mm", "centre_y_mm")
    arrays = read_arrays(path, 1000, named="the field", only=names)
    x, y = (stored_number(arrays, name, f"field {path}") if name in arrays else 0.0 for name in names)
    return 1e3 * x, 1e3 * y


def stored_number(arrays: Mapping[str, Any], name: str, location: str) -> float:
    """Return a number stored with a field; raise InputError if it is not a single finite one."""
    value = arrays[name]
    if value.size != 1 or value.dtype.kind not in "fiu" or not math.isfinite(value.item()):
        raise InputError(f"{location}: `{name}` must be one number, and finite")
    return float(value.item())
