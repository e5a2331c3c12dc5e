"""Files of fields: complex values, their pitch, and where they lie (.npz)."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.array_files import array_names, read_arrays
from lensdesign.errors import InputError
from wavesim.fields.field import Field

FIELD_ARRAYS = ("values", "pitch_um")
"""Arrays that every field has."""


def write_field(field: Field, path: Path, **numbers: float) -> None:
    """Write complex values with their pitch and wavelength, as `measured_field` reads them (.npz).

    Parameters
    ----------
    field
        On a plane.
    path
        File to write.
    **numbers
        What else is to stand beside the values.
    """
    write_arrays(
        path,
        values=np.asarray(field.values, np.complex64),
        pitch_um=1e3 * field.grid.pitch_mm,
        wavelength_um=field.wavelength_um,
        **numbers,
    )


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write arrays by name (.npz), packed in a quarter of NumPy's time, and a little larger."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, values in arrays.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(values), allow_pickle=False)


def read_field(path: Path) -> tuple[Any, float]:
    """Values and pitch (um) of a field, as `write_field` writes them.

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
        If the file cannot be read, is damaged, or holds no such field.
    """
    held = read_arrays(path, named="the field", only=FIELD_ARRAYS)
    if "values" not in held or "pitch_um" not in held:
        if not zipfile.is_zipfile(path):
            raise InputError(f"cannot read the field {path}: no .npz file, or damaged")
        lacking = [name for name in FIELD_ARRAYS if name not in held]
        raise InputError(
            f"field {path}: has no {' and no '.join(lacking)}; it holds {sorted(array_names(path))}"
        )
    values, pitch = held["values"], held["pitch_um"]
    if values.ndim != 2 or values.size == 0 or values.dtype.kind not in "fc":
        raise InputError(
            f"field {path}: has {values.dtype} values of shape {values.shape}: must be complex or real, "
            "(ny, nx)"
        )
    if pitch.size != 1 or pitch.dtype.kind not in "fiu" or not 0.0 < float(pitch.item()) < math.inf:
        raise InputError(f"field {path}: `pitch_um` must be one number, finite and greater than 0")
    values = values.astype(np.complex64 if values.dtype.kind == "c" else np.float32, copy=False)
    if not all(np.all(np.isfinite(row)) for row in values):
        raise InputError(f"field {path}: has values that are not finite")
    return values, float(pitch.item())


def read_centre_um(path: Path) -> tuple[float, float]:
    """Middle (x, y) of a field that `read_field` reads; the axis, unless its file says otherwise.

    Raises
    ------
    InputError
        If it cannot be read, or says no finite numbers.
    """
    names = ("centre_x_mm", "centre_y_mm")
    held = read_arrays(path, 1000, named="the field", only=names)
    if not all(held[name].size == 1 and held[name].dtype.kind in "fiu" for name in held):
        raise InputError(f"field {path}: `centre_x_mm` and `centre_y_mm` must be one number each")
    x, y = (float(held[name].item()) if name in held else 0.0 for name in names)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"field {path}: `centre_x_mm` and `centre_y_mm` must be finite")
    return 1e3 * x, 1e3 * y
