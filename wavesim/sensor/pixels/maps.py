"""Maps of a camera's pixels: gain from a flat, dark signal from a dark frame, and bad pixels."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.array_files import read_arrays
from lensdesign.common.arrays import Array
from lensdesign.common.input_files import TABLE_BYTES
from lensdesign.errors import InputError
from wavesim.fields.picture_files import FRAME_FORMATS, Picture, PictureFile

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PixelMaps:
    """Known properties of each pixel; None where all pixels are equal.

    Attributes
    ----------
    gain : ndarray, optional
        Gain relative to the mean of the pixels behind the same colour filter, shape (ny, nx).
    dark_electrons : ndarray, optional
        Dark signal above the dark count, in electrons.
    bad : ndarray of bool, optional
        Mask of bad pixels.
    """

    gain: Array | None = None
    dark_electrons: Array | None = None
    bad: Mask | None = None


def read_map(path: str | os.PathLike[str], *, several: bool = True) -> Array:
    """Return the values of a map: a grey TIFF or PNG, or an array in an .npy file.

    The orientation that a picture file states is applied.

    Parameters
    ----------
    path
        The file.
    several
        Whether several pictures (pages of a TIFF, or an array of shape (pictures, ny, nx)) are averaged, as
        for darks and flats. Otherwise the file must contain one picture.

    Raises
    ------
    InputError
        If the file cannot be read, or does not contain pictures of finite numbers of one size.
    """
    file = Path(path)
    values = _array(file) if file.suffix.lower() == ".npy" else _mean_picture(file, several)
    if values.ndim == 3 and len(values) and several:
        values = values.mean(axis=0)
    if values.ndim != 2 or not values.size or not np.all(np.isfinite(values)):
        raise InputError(f"map {file}: of shape {values.shape}: must be one grey picture of finite numbers")
    return values


def _array(path: Path) -> Array:
    """Return the real numbers of an .npy file."""
    (values,) = read_arrays(path, TABLE_BYTES, named="the map").values()
    if values.dtype.kind not in "biuf":
        raise InputError(f"map {path}: holds {values.dtype}: must be an array of real numbers")
    return np.asarray(values, np.float64)


def _mean_picture(path: Path, several: bool) -> Array:
    """Return the mean of the pictures of a file."""
    file = PictureFile(path, "the map", FRAME_FORMATS)
    if not several:
        return _numbers(file.single_picture())
    total = _numbers(file.picture(0))
    for index in range(1, file.count):
        values = _numbers(file.picture(index))
        if values.shape != total.shape:
            raise InputError(
                f"map {path}: picture {index + 1} has shape {values.shape}, the first {total.shape}: must be "
                "equal"
            )
        total = total + values
    return total / file.count


def _numbers(picture: Picture) -> Array:
    """Return the stored numbers of a grey picture."""
    if not picture.is_grey:
        raise InputError(f"map {picture.path}: {picture}: must be one grey picture of finite numbers")
    if picture.white_is_zero:
        raise InputError(
            f"map {picture.path}: a TIFF in which white is zero: must be one in which black is zero"
        )
    return np.asarray(picture.values, np.float64)


def read_pixel_maps(
    shape: tuple[int, ...],
    offset_counts: float,
    gain_electrons_per_count: float,
    *,
    flat: Path | None = None,
    dark: Path | None = None,
    bad: Path | None = None,
    filters: NDArray[np.str_] | None = None,
) -> PixelMaps | None:
    """Return pixel maps from a flat field, a dark frame, and a picture of bad pixels.

    Parameters
    ----------
    shape
        Shape (ny, nx) of the frames.
    offset_counts, gain_electrons_per_count
        Settings of frames and maps, see :class:`wavesim.FrameSettings`.
    flat, dark
        Files of frames in uniform light and without light, in counts. Pictures in a file are averaged.
    bad
        File of one picture that is not 0 in bad pixels.
    filters
        Letter of the colour filter on each pixel, whose transmission is no part of the gain. Default: all
        pixels have the same filter.

    Returns
    -------
    PixelMaps or None
        The maps; None if no file is given.

    Raises
    ------
    InputError
        If a map cannot be read or has another size, the flat is not positive, or too many pixels are bad.
    """
    if flat is None and dark is None and bad is None:
        return None
    mask = None if bad is None else _of_shape(bad, shape, several=False) != 0.0
    # Largest allowed fraction of bad pixels.
    most_bad = 0.2
    if mask is not None and mask.mean() > most_bad:
        raise InputError(
            f"{bad}: marks {100.0 * mask.mean():.3g} % of the pixels as bad; at most {100.0 * most_bad:g} % "
            "may be: bad pixels are those that are not 0"
        )
    black = np.full(shape, offset_counts) if dark is None else _of_shape(dark, shape)
    gain = None if flat is None else _gain(flat, _of_shape(flat, shape) - black, mask, filters)
    signal = None if dark is None else (black - offset_counts) * gain_electrons_per_count
    return PixelMaps(gain, signal, mask)


def _of_shape(path: Path, shape: tuple[int, ...], *, several: bool = True) -> Array:
    values = read_map(path, several=several)
    if values.shape != tuple(shape):
        (rows, columns), (down, across) = values.shape, shape
        raise InputError(
            f"{path}: {columns} x {rows} pixels; the frames have {across} x {down}: must be a map of "
            "the same pixels"
        )
    return values


def _gain(path: Path, light: Array, bad: Mask | None, filters: NDArray[np.str_] | None) -> Array:
    """Return the gain relative to the mean of pixels behind the same filter, 1 in bad pixels."""
    known = np.ones(light.shape, bool) if bad is None else ~bad
    dark = int(np.count_nonzero(light[known] <= 0.0))
    if dark:
        raise InputError(
            f"{path}: {dark} pixels show no light beyond the dark count: a flat must be above it "
            "everywhere; mark dead pixels as bad"
        )
    gain = np.ones(light.shape)
    masks = [known] if filters is None else [known & (filters == one) for one in np.unique(filters)]
    for mask in masks:
        if mask.any():
            gain[mask] = light[mask] / light[mask].mean()
    return gain
