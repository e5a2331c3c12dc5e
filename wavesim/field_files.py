"""Files of fields: complex arrays, 32-bit grey TIFF; and folders whose files change together at the end."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from wavesim.fields import Array, Field

KEY = "transferlens_field"
"""Under which a TIFF's ImageDescription holds what its values are."""
DESCRIPTION = 270


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


def write_tiff(path: Path, values: Array, pitch_um: float, **said: Any) -> None:
    """Write real values as a grey TIFF of 32-bit floating point numbers.

    Parameters
    ----------
    path
        File to write; its first row is that of the smallest y.
    values
        Shape (ny, nx).
    pitch_um
        Of the samples.
    **said
        What the values are, for the file's ImageDescription (JSON).
    """
    from PIL import Image

    Image.fromarray(np.ascontiguousarray(values, np.float32)).save(
        path,
        format="TIFF",
        tiffinfo={DESCRIPTION: json.dumps({KEY: {"pitch_um": pitch_um, **said}})},
        resolution_unit="cm",
        x_resolution=1e4 / pitch_um,
        y_resolution=1e4 / pitch_um,
    )


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write one JSON object."""
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")
