"""Tiled OME-TIFF pyramids of large pictures, with each level half the size of the previous one.

A picture of a whole field has 50 million samples. QuPath, napari, Fiji and Bio-Formats read only the tiles
that they show, from the level that suits the screen.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError, validate_positive

TILE = 512
"""Side of a tile, in samples."""

STRIP = 2 * TILE
"""Rows that are halved at once, which keeps temporary arrays small."""

CLASSIC_BYTES = 2**32 - 2**25
"""Largest size of a classic TIFF, whose offsets have 32 bits; larger files are BigTIFFs."""

KEY = "transferlens_field"
"""Key of the description of the values in a file's metadata."""

Function = Callable[[Any], Any]


@dataclass(frozen=True, eq=False)
class Level:
    """A level of a picture.

    Attributes
    ----------
    stored : ndarray, shape (ny, nx)
        Real or complex values from which the next level is computed.
    shown : function
        Function from stored values to the real values that are shown.
    """

    stored: Any
    shown: Function

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        rows, columns = self.stored.shape
        return rows, columns

    def tiles(self, side: int = TILE) -> Iterator[Any]:
        """Yield the shown values tile by tile, in rows. Tiles at the far borders may be smaller."""
        rows, columns = self.shape
        for y in range(0, rows, side):
            for x in range(0, columns, side):
                yield self.shown(self.stored[y : y + side, x : x + side])


def halved(values: Any, transform: Function | None = None) -> Any:
    """Return means over 2 x 2 samples in single precision; over fewer at the far border of an odd size.

    Parameters
    ----------
    values
        Real or complex values, shape (ny, nx).
    transform
        Function that is applied before the mean. Default: none.

    Returns
    -------
    ndarray, shape (ceil(ny / 2), ceil(nx / 2))
        float32 or complex64.
    """
    rows, columns = values.shape
    strips = []
    for start in range(0, rows, STRIP):
        strip = values[start : start + STRIP]
        strip = strip if transform is None else transform(strip)
        kind = np.complex64 if np.iscomplexobj(strip) else np.float32
        odd = strip.shape[0] % 2, columns % 2
        if any(odd):
            strip = np.pad(strip, ((0, odd[0]), (0, odd[1])), mode="edge")
        across = np.add(strip[:, 0::2], strip[:, 1::2], dtype=kind)
        strips.append(kind(0.25) * (across[0::2] + across[1::2]))
    return np.concatenate(strips)


def picture_levels(values: Any, quantity: str, least: int = TILE) -> list[Level]:
    """Return a picture of values and its halvings, down to a single tile.

    Parameters
    ----------
    values
        Complex or real, shape (ny, nx).
    quantity
        "amplitude": the modulus; further levels are its means. "phase_rad": the angle of complex values, or
        real values as angles; further levels are the angle of the complex mean, since angles have no mean.
        Any other name: the real values and their means.
    least
        Largest side of the last level.
    """
    plain: Function = np.asarray
    # How samples are shown, the transform before the first halving, and how halvings are shown.
    kinds: dict[str, tuple[Function, Function | None, Function]] = {
        "amplitude": (np.abs, np.abs, plain),
        "phase_rad": (np.angle, None, np.angle) if np.iscomplexobj(values) else (plain, _phasors, np.angle),
    }
    shown, transform, shown_halved = kinds.get(quantity, (plain, None, plain))
    levels = [Level(values, shown)]
    while max(levels[-1].shape) > least:
        levels.append(Level(halved(levels[-1].stored, transform if len(levels) == 1 else None), shown_halved))
    return levels


def _phasors(angles: Any) -> Any:
    return np.exp(np.complex64(1j) * np.asarray(angles, np.float32))


def write_pyramid(
    values: Any,
    path: str | os.PathLike[str],
    pitch_um: float,
    quantities: Sequence[str] = ("amplitude", "phase_rad"),
    **description: Any,
) -> None:
    """Write a field or a picture as a tiled OME-TIFF pyramid, for viewers that zoom.

    Samples are 32-bit floating point numbers, with one channel for each quantity. Each level has half the
    size of the previous one, and is stored as a SubIFD in deflated tiles of 512 x 512 samples. A file of more
    than 4 GB is a BigTIFF. The first row, which viewers show at the top, has the smallest y.

    Parameters
    ----------
    values
        Complex or real values, shape (ny, nx).
    path
        File to write, such as `field.ome.tif`.
    pitch_um
        Sample pitch in um.
    quantities
        Names of the channels. "amplitude" and "phase_rad" are computed from the values
        (:func:`picture_levels`). A channel of any other name contains the real values themselves.
    **description
        Further entries of the file's description (JSON).

    Raises
    ------
    InputError
        If the values are not a plane of numbers, the quantities do not suit them, or the file cannot be
        written.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from wavesim import write_pyramid
    >>> wave = np.exp(1j * np.linspace(0.0, 6.0, 300 * 400).reshape(300, 400))
    >>> write_pyramid(wave, folder / "wave.ome.tif", pitch_um=0.5)  # any folder
    >>> tifffile.imread(folder / "wave.ome.tif").shape
    (2, 300, 400)
    """
    _check_values(values, pitch_um, quantities)
    channels = [picture_levels(values, quantity) for quantity in quantities]
    with atomic_path(path) as temporary:
        _write(temporary, channels, _metadata(values, pitch_um, quantities, description), 1e4 / pitch_um)


def _check_values(values: Any, pitch_um: float, quantities: Sequence[str]) -> None:
    if values.ndim != 2 or values.size == 0 or values.dtype.kind not in "biufc":
        raise InputError(
            f"a picture of {values.dtype} values of shape {values.shape}: must be real or complex (ny, nx)"
        )
    validate_positive("pitch_um", pitch_um)
    if not quantities or len(set(quantities)) < len(quantities):
        raise InputError(f"quantities = {list(quantities)}: must be one or more different names")
    plain = [name for name in quantities if name not in ("amplitude", "phase_rad")]
    if plain and np.iscomplexobj(values):
        raise InputError(f"quantities = {list(quantities)}: allowed for complex values: amplitude, phase_rad")


def _metadata(values: Any, pitch_um: float, quantities: Sequence[str], entries: dict[str, Any]) -> Any:
    about = {"quantities": list(quantities), "pitch_um": pitch_um, **entries}
    description = json.dumps({KEY: about}, allow_nan=False)
    # The UUID follows from the values, so that the same values give the same file.
    digest = hashlib.blake2b(description.encode(), digest_size=16)
    for start in range(0, values.shape[0], STRIP):
        digest.update(np.ascontiguousarray(values[start : start + STRIP]).data)
    size = {f"PhysicalSize{axis}": pitch_um for axis in "XY"}
    return {
        "axes": "CYX",
        "UUID": str(uuid.UUID(bytes=digest.digest(), version=5)),
        "Description": description,
        "Channel": {"Name": list(quantities)},
        **size,
        **{f"{name}Unit": "µm" for name in size},
    }


def _write(path: Any, channels: Sequence[Sequence[Level]], metadata: Any, samples_per_cm: float) -> None:
    from tifffile import TiffWriter

    levels = list(zip(*channels, strict=True))
    count = 4 * len(channels) * sum(math.prod(level.shape) for level in channels[0])
    with TiffWriter(path, bigtiff=count > CLASSIC_BYTES, ome=True) as file:
        for number, level in enumerate(levels):
            first: dict[str, Any] = {"subifds": len(levels) - 1, "metadata": metadata}
            file.write(
                _tiles(level),
                shape=(len(level), *level[0].shape),
                dtype=np.float32,
                tile=(TILE, TILE),
                photometric="minisblack",
                compression="zlib",
                compressionargs={"level": 1},  # Noisy numbers hardly shrink at higher levels.
                resolution=(samples_per_cm * 0.5**number,) * 2,
                resolutionunit="CENTIMETER",
                **(first if number == 0 else {"subfiletype": 1, "metadata": None}),
            )


def _tiles(channels: Sequence[Level]) -> Iterator[Any]:
    for channel in channels:
        for tile in channel.tiles():
            yield np.ascontiguousarray(tile, np.float32)
