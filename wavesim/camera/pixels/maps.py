"""Maps of a camera's pixels: gain from a flat, dark signal from a dark frame, and bad pixels."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.array_files import read_arrays
from lensdesign.common.arrays import Array
from lensdesign.common.input_files import TABLE_BYTES, check_input
from lensdesign.errors import InputError

Mask = NDArray[np.bool_]

MOST_BAD = 0.2
"""Share of the pixels that may be bad."""


@dataclass(frozen=True, eq=False)
class PixelMaps:
    """What is known of each pixel; None where all are alike.

    Attributes
    ----------
    gain : ndarray, optional
        Relative to the mean, shape (ny, nx).
    dark_electrons : ndarray, optional
        Signal without light beyond the dark count.
    bad : ndarray of bool, optional
        Pixels that tell nothing.
    """

    gain: Array | None = None
    dark_electrons: Array | None = None
    bad: Mask | None = None


def read_map(path: str | os.PathLike[str]) -> Array:
    """Values of a map: a grey TIFF or PNG of whole numbers, or an array in an .npy file.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no picture of finite numbers.
    """
    from PIL import Image

    place = Path(path)
    check_input(place, TABLE_BYTES)
    values: Any
    try:
        if place.suffix.lower() == ".npy":
            (values,) = read_arrays(place, TABLE_BYTES, named="the map").values()
        else:
            with Image.open(place, formats=["TIFF", "PNG"]) as picture:
                values = np.asarray(picture)
        values = np.asarray(values, np.float64)
    except InputError:
        raise
    # Of damaged files the readers raise errors of many kinds.
    except Exception as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"cannot read the map {place}: {reason}") from error
    if values.ndim != 2 or not values.size or not np.all(np.isfinite(values)):
        raise InputError(f"map {place}: of shape {values.shape}: must be one grey picture of finite numbers")
    return values


def read_pixel_maps(
    shape: tuple[int, ...],
    offset_counts: float,
    gain_electrons_per_count: float,
    *,
    flat: Path | None = None,
    dark: Path | None = None,
    bad: Path | None = None,
) -> PixelMaps | None:
    """Maps from frames of even light (flat) and of none (dark), and of bad pixels, which are not 0.

    Parameters
    ----------
    shape
        Of the frames.
    offset_counts, gain_electrons_per_count
        As of :class:`wavesim.FrameSettings`; those of the maps are the same.
    flat, dark
        In counts; means of many frames serve best, as .npy.
    bad
        Of bad pixels.

    Raises
    ------
    InputError
        If a map cannot be read or is of another size, the flat is not above 0, or too many pixels are bad.
    """
    if flat is None and dark is None and bad is None:
        return None
    mask = None if bad is None else _of_shape(bad, shape) != 0.0
    if mask is not None and mask.mean() > MOST_BAD:
        raise InputError(
            f"{bad}: marks {100.0 * mask.mean():.3g} % of the pixels as bad; at most {100.0 * MOST_BAD:g} % "
            "may be: bad pixels are those that are not 0"
        )
    black = np.full(shape, offset_counts) if dark is None else _of_shape(dark, shape)
    gain = None if flat is None else _gain(flat, _of_shape(flat, shape) - black, mask)
    signal = None if dark is None else (black - offset_counts) * gain_electrons_per_count
    return PixelMaps(gain, signal, mask)


def _of_shape(path: Path, shape: tuple[int, ...]) -> Array:
    values = read_map(path)
    if values.shape != tuple(shape):
        (rows, columns), (down, across) = values.shape, shape
        raise InputError(
            f"{path}: {columns} x {rows} pixels; the frames have {across} x {down}: must be a map of "
            "the same pixels"
        )
    return values


def _gain(path: Path, light: Array, bad: Mask | None) -> Array:
    """Relative gain, 1 in bad pixels."""
    known = np.ones(light.shape, bool) if bad is None else ~bad
    lacking = int(np.count_nonzero(light[known] <= 0.0))
    if lacking:
        raise InputError(
            f"{path}: {lacking} pixels show no light beyond the dark count: a flat must be above it "
            "everywhere; mark dead pixels as bad"
        )
    return np.where(known, light / light[known].mean(), 1.0)
