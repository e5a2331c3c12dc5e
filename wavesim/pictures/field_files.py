"""Files of fields: complex arrays, 32-bit grey TIFF; and folders whose files change together at the end."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.input_files import check_input
from lensdesign.errors import InputError
from wavesim.fields.field import Array, Field
from wavesim.pictures.pyramid import write_pyramid


@contextmanager
def new_results(folder: Path) -> Iterator[Path]:
    """Give an empty folder to write to, and rename its files into `folder` at the end.

    A failure leaves `folder` as it was; other files in it stay.

    Yields
    ------
    Path
        A temporary folder within `folder`.

    Raises
    ------
    InputError
        If the folder or its files cannot be written.
    """
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        place = Path(tempfile.mkdtemp(prefix=".new.", dir=folder))
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(f"cannot make the folder {folder}: a file stands in its place") from error
    except OSError as error:
        raise InputError(f"cannot write to the folder {folder}: {error.strerror or error}") from error
    try:
        yield place
        for path in sorted(place.iterdir()):
            os.replace(path, folder / path.name)
    except OSError as error:
        raise InputError(f"cannot write to the folder {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(place, ignore_errors=True)
        if made and not any(folder.iterdir()):
            folder.rmdir()


def refuse_no_folder(folder: Path) -> None:
    """Refuse, before anything is computed, a place where no folder can stand.

    Raises
    ------
    InputError
        If a file stands there.
    """
    for place in (folder, *folder.parents):
        if place.exists():
            if not place.is_dir():
                raise InputError(f"--output = {str(folder)!r}: {place} is no folder")
            return


def write_field(path: Path, field: Field, **numbers: float) -> None:
    """Write complex values with their pitch and wavelength, as `measured_field` reads them (.npz).

    Parameters
    ----------
    path
        File to write.
    field
        On a plane.
    **numbers
        What else is to stand beside the values.
    """
    np.savez_compressed(
        path,
        values=np.asarray(field.values, np.complex64),
        pitch_um=1e3 * field.grid.pitch_mm,
        wavelength_um=field.wavelength_um,
        **numbers,  # type: ignore[arg-type]
    )


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


def write_tiff(path: Path, values: Array, pitch_um: float, quantity: str) -> None:
    """Write one quantity of a field as a grey TIFF of 32-bit floating point numbers, in tiles that zoom.

    Parameters
    ----------
    path
        File to write; its first row is that of the smallest y.
    values
        Real, or complex values of which the quantity is taken, shape (ny, nx).
    pitch_um
        Of the samples.
    quantity
        "amplitude", "phase_rad" or another, as in :func:`wavesim.pictures.pyramid.write_pyramid`.
    """
    write_pyramid(path, values, pitch_um, (quantity,))


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write one JSON object."""
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")
