"""Files of fields: complex values, their pitch, and where they lie (.npz)."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.input_files import check_input
from lensdesign.errors import InputError
from wavesim.fields.field import Field


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
    check_input(path, named="the field")
    if not zipfile.is_zipfile(path):
        raise InputError(f"cannot read the field {path}: no .npz file, or damaged")
    try:
        with np.load(path, allow_pickle=False) as content:
            lacking = [name for name in ("values", "pitch_um") if name not in content.files]
            if lacking:
                raise InputError(
                    f"field {path}: has no {' and no '.join(lacking)}; it holds {sorted(content.files)}"
                )
            values, pitch = content["values"], content["pitch_um"]
    except InputError:
        raise
    except Exception as error:  # of damaged files NumPy and zipfile raise errors of many kinds
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"cannot read the field {path}: {reason}") from error
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
    try:
        with np.load(path, allow_pickle=False) as content:
            names = ("centre_x_mm", "centre_y_mm")
            x, y = (float(content[name].item()) if name in content.files else 0.0 for name in names)
    except Exception as error:  # as above
        raise InputError(f"field {path}: where it lies cannot be read: {error}") from error
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"field {path}: `centre_x_mm` and `centre_y_mm` must be finite")
    return 1e3 * x, 1e3 * y
