"""Reader of picture files: frames, objects, dark frames, flat fields and maps of pixels.

All kinds of picture pass the same checks. Pixels are oriented upright by the TIFF tag or EXIF data, as in
viewers. The reader reports whether white is zero, the number of pictures, and the kind of samples; the caller
decides what it accepts. tifffile reads TIFF files, and Pillow all other formats.
"""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.input_files import TABLE_BYTES, read_input
from lensdesign.errors import InputError

FRAME_FORMATS = ("TIFF", "PNG")
"""Lossless formats of cameras."""

MOST_PIXELS = 2**27
"""Largest number of pixels of a picture: twice that of a 65-megapixel sensor."""

MOST_PICTURES = 10_000
"""Largest number of pictures in a file."""

ORIENTATION, PHOTOMETRIC = 274, 262
"""TIFF tags; EXIF also has the first one."""

Kind = Literal["grey", "palette", "colours"]
"""Kind of the stored samples."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A stored picture, oriented upright.

    Attributes
    ----------
    path : Path
        The file.
    format : str
        Format, such as "TIFF" or "PNG".
    kind : {"grey", "palette", "colours"}
        Kind of the stored samples.
    bits : int
        Bits of a stored sample.
    values : ndarray, shape (rows, columns)
        Stored values of one channel; for colours and palettes the luma of ITU-R BT.601, as whole numbers.
    full_scale : int
        Largest possible value; 0 for floating-point numbers.
    white_is_zero : bool
        Whether the value 0 means white.
    is_opaque : bool
        Whether no pixel is even partly transparent.
    states_alpha : bool
        Whether the file has an alpha channel or a transparent colour.
    """

    path: Path
    format: str
    kind: Kind
    bits: int
    values: NDArray[Any]
    full_scale: int
    white_is_zero: bool
    is_opaque: bool
    states_alpha: bool

    @property
    def is_grey(self) -> bool:
        """True if `values` are the stored values of one channel."""
        return self.kind == "grey" and not self.states_alpha

    @property
    def has_counts(self) -> bool:
        """True if `values` are whole numbers of at most 16 bits, without a sign."""
        return self.values.dtype.kind == "u" and self.bits <= 16

    def __str__(self) -> str:
        numbers = {"f": "floating-point numbers", "i": "numbers with a sign", "b": "black and white"}
        samples = numbers.get(self.values.dtype.kind, f"samples of {self.bits} bits")
        return f"a {self.format}, {self.kind}, {samples}{', with transparency' if self.states_alpha else ''}"


class PictureFile:
    """A file of pictures.

    Parameters
    ----------
    path
        The file.
    named
        Name in messages before the path, such as "the map"; empty for a frame.
    formats
        Allowed formats, by Pillow's names. Default: all that Pillow reads.

    Attributes
    ----------
    count : int
        Number of pictures.
    description : str
        ImageDescription of a TIFF; else empty.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, has another format, contains fewer pictures than it states, or
        states more than 2**27 pixels for one.
    """

    def __init__(self, path: Path, named: str = "", formats: tuple[str, ...] | None = None) -> None:
        self.path, self._named, self._formats = path, named, formats
        data = read_input(path, 4 * TABLE_BYTES, InputError, named)
        # First bytes of a TIFF and of a BigTIFF file.
        tiff_starts = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
        with self._reported() as errors:
            if data[:4] not in tiff_starts:
                self._pictures: _Pictures = _PillowPictures(data, formats)
            elif formats is None or "TIFF" in formats:
                self._pictures = _TiffPictures(data, errors)
            else:
                raise InputError(f"{self._who}: is a TIFF; allowed: {', '.join(formats)}")
        self.count, self.description = self._pictures.count, self._pictures.description

    def single_picture(self, channel: int | None = None) -> Picture:
        """Return the picture of a file with a single picture.

        Parameters
        ----------
        channel
            Index of a channel of colours (red, green, blue); default: their luma.

        Raises
        ------
        InputError
            If the file contains several pictures, or the picture is damaged.
        """
        if self.count != 1:
            raise InputError(
                f"{self._who}: contains {self.count} pictures{self._pictures.remark}: must contain one; save "
                "the wanted picture in a file of its own"
            )
        return self.picture(0, channel)

    def picture(self, index: int, channel: int | None = None) -> Picture:
        """Return one of the pictures by its index from 0.

        Raises
        ------
        InputError
            If the picture is damaged, or of an unsupported kind.
        """
        with self._reported():
            stored = self._pictures.stored(index)
            samples, bits = stored.samples, stored.bits
            kind: Kind = "palette" if stored.has_palette else "grey" if samples.ndim == 2 else "colours"
            if samples.ndim == 3:
                samples = _luma(samples) if channel is None else samples[..., channel]
            dtype = samples.dtype
            stated_scale = {"b": 1, "f": 0}.get(dtype.kind)
            full_scale = 2 ** min(bits, 8 * dtype.itemsize) - 1 if stated_scale is None else stated_scale
            return Picture(
                path=self.path,
                format=stored.format,
                kind=kind,
                bits=bits,
                values=upright(samples, stored.orientation),
                full_scale=stored.full_scale or full_scale,
                white_is_zero=stored.white_is_zero,
                is_opaque=stored.is_opaque,
                states_alpha=stored.states_alpha,
            )

    @property
    def _who(self) -> str:
        return f"{self._named.removeprefix('the ')} {self.path}" if self._named else str(self.path)

    @contextmanager
    def _reported(self) -> Iterator[list[str]]:
        """Convert all exceptions of the readers to an InputError that names the file.

        tifffile logs errors that it does not raise. They are collected in a list, and not shown.
        """
        from PIL import Image, UnidentifiedImageError

        start = f"cannot read {self._named} {self.path}: " if self._named else f"{self.path}: "
        with warnings.catch_warnings(), _logged_errors() as errors:
            warnings.simplefilter("ignore")
            try:
                yield errors
            except _UnsupportedError as error:
                raise InputError(f"{self._who}: {error}") from None
            except InputError:
                raise
            except UnidentifiedImageError:
                allowed = " or ".join(self._formats) if self._formats else "supported"
                raise InputError(
                    f"{start}not a {allowed} picture, damaged at its start, or of an unsupported sample type"
                ) from None
            except Image.DecompressionBombError as error:
                raise InputError(f"{start}{error}") from None
            except Exception as error:  # the readers raise many kinds of errors for damaged files
                message = str(error) or type(error).__name__
                kinds = " or ".join(self._formats) if self._formats else "picture"
                raise InputError(f"{start}damaged {kinds}: {message:.200}") from None


class _UnsupportedError(Exception):
    """A file of a kind that is not read; the message says what to do."""


@dataclass(frozen=True, eq=False)
class _Stored:
    """A picture as its file contains it: samples (rows, columns) or (rows, columns, channels)."""

    format: str
    samples: NDArray[Any]
    bits: int
    orientation: int = 1
    white_is_zero: bool = False
    states_alpha: bool = False
    is_opaque: bool = True
    has_palette: bool = False
    full_scale: int = 0


class _PillowPictures:
    """Pictures of a file that Pillow reads."""

    description = remark = ""

    def __init__(self, data: bytes, formats: tuple[str, ...] | None) -> None:
        self._data, self._formats = data, formats
        with self._opened() as image:
            self.count = int(getattr(image, "n_frames", 1))
            self._orientation = int(image.getexif().get(ORIENTATION, 1))
        _check_pictures(self.count)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        from PIL import Image

        formats = tuple(one for one in self._formats if one != "TIFF") if self._formats else None
        with Image.open(io.BytesIO(self._data), formats=formats) as image:
            _check_size(*image.size[::-1])
            yield image

    def stored(self, index: int) -> _Stored:
        """Return a picture by its index."""
        with self._opened() as image:
            if index:
                image.seek(index)
            png_depth_at = 24
            bits = self._data[png_depth_at] if image.format == "PNG" else 8
            is_grey = image.mode in ("1", "L", "I;16", "I;16L", "I;16B", "I", "F")
            mode = "L" if image.mode in ("LA", "La") else "RGB"
            samples = np.asarray(image if is_grey else image.convert(mode))
            return _Stored(
                image.format or "",
                samples,
                bits,
                self._orientation,
                states_alpha=image.has_transparency_data,
                is_opaque=not image.has_transparency_data or _is_opaque(image),
                has_palette=image.mode == "P",
                # Pillow converts counts of fewer bits to 8 bits.
                full_scale=0 if samples.dtype.kind in "bf" else int(np.iinfo(samples.dtype).max),
            )


class _TiffPictures:
    """Pictures of a TIFF, which tifffile reads."""

    def __init__(self, data: bytes, errors: list[str]) -> None:
        from tifffile import TiffFile

        file = TiffFile(io.BytesIO(data))
        self.remark = ""
        _check_pictures(len(file.pages))
        directories: list[Any] = [file.pages[n].aspage() for n in range(len(file.pages))]
        whole = [own for own in directories if not own.is_reduced] or directories[:1]
        first = whole[0]
        self.description = str(getattr(first, "description", "") or "")
        for page in whole:
            _check_page(page, len(data))
        # Each picture is a directory, or one plane of a directory.
        self._places = [(page, plane) for page in whole for plane in _planes(page)]
        self.count = len(self._places)
        if self.count > len(whole):
            self.remark = " (or the planes of colours, which tifffile stores alike)"
        series: list[Any] = [one for one in file.series if not one.keyframe.is_reduced]
        if any("series" in error for error in errors):
            raise _UnsupportedError("is damaged: its metadata contradict its pictures; save the file again")
        size = int(first.imagelength * first.imagewidth * first.samplesperpixel)
        stated = sum(one.size for one in series if one.keyframe.shape == first.shape) // size
        # Several pictures of which only the first has a directory.
        self._series: Any = series[0] if stated > self.count else None
        if self._series is not None:
            if len(directories) > 1 or int(first.samplesperpixel) != 1:
                raise _UnsupportedError(
                    f"states that it contains {stated} pictures, but contains {self.count}; save the file "
                    "again"
                )
            _check_pictures(stated)
            self.count = stated

    @cached_property
    def _stack(self) -> NDArray[Any]:
        return np.asarray(self._series.asarray())

    def stored(self, index: int) -> _Stored:
        """Return a picture by its index."""
        page, plane = self._places[index if self._series is None else 0]
        bits, channels = int(page.bitspersample), int(page.samplesperpixel)
        about = (bits, int(page.tags.valueof(ORIENTATION, 1)))
        white_is_zero = int(page.photometric) == 0
        shape = (int(page.imagelength), int(page.imagewidth))
        if self._series is not None:
            return _Stored("TIFF", self._stack.reshape(self.count, *shape)[index], *about, white_is_zero)
        samples = page.asarray()
        if plane is not None:
            return _Stored("TIFF", samples.reshape(channels, *shape)[plane], *about)
        if channels == 1:
            samples = samples.reshape(shape)
            if int(page.photometric) != _PALETTE or page.colormap is None:
                return _Stored("TIFF", samples, *about, white_is_zero)
            palette = (np.asarray(page.colormap) >> 8).astype(np.uint8).T
            return _Stored("TIFF", palette[samples], *about, has_palette=True, full_scale=255)
        if int(page.planarconfig) == _SEPARATE:
            samples = np.moveaxis(samples.reshape(channels, *shape), 0, -1)
        samples = samples.reshape(*shape, channels)
        colours = 1 if int(page.photometric) in (0, 1) else 3
        states_alpha = channels > colours
        is_opaque = bool(np.all(samples[..., colours:] == 2**bits - 1))
        samples = samples[..., 0] if colours == 1 else samples[..., :3]
        return _Stored("TIFF", samples, *about, white_is_zero, states_alpha, is_opaque)


_Pictures = _PillowPictures | _TiffPictures

_SEPARATE, _PALETTE, _YCBCR, _JPEG = 2, 3, 6, (6, 7)
"""Values of TIFF tags: planes one after the other, palette, YCbCr, and compression by JPEG."""


def _check_size(rows: int, columns: int) -> None:
    if rows * columns > MOST_PIXELS:
        raise _UnsupportedError(
            f"states {columns} x {rows} pixels; at most {MOST_PIXELS} pixels are read; crop or bin "
            "the picture"
        )


def _check_pictures(count: int) -> None:
    if count > MOST_PICTURES:
        raise _UnsupportedError(f"has {count} pictures; at most {MOST_PICTURES} are read")


def _check_page(page: Any, file_bytes: int) -> None:
    """Check what a directory of a TIFF states before its samples are decoded."""
    if PHOTOMETRIC not in page.tags:
        raise _UnsupportedError(
            "a TIFF without its photometric tag, which states whether black or white is zero"
        )
    photometric = int(page.photometric)
    supported = (0, 1, 2, _PALETTE, _YCBCR)
    if photometric not in supported or (photometric == _YCBCR and int(page.compression) not in _JPEG):
        raise _UnsupportedError(
            f"a TIFF of photometric interpretation {photometric}: must be grey, RGB or with a palette"
        )
    most_channels = 4
    channels, depth = int(page.samplesperpixel), int(page.imagedepth)
    if not 1 <= channels <= most_channels or page.dtype is None:
        raise _UnsupportedError(f"a TIFF with {channels} samples of {page.bitspersample} bits for each pixel")
    _check_size(int(page.imagelength) * depth * channels, int(page.imagewidth))
    if min(page.imagelength, page.imagewidth) < 1:
        raise _UnsupportedError("has no pixels")
    ends = [place + count for place, count in zip(page.dataoffsets, page.databytecounts, strict=True)]
    if not ends or max(ends) > file_bytes or min(page.databytecounts) < 1:
        raise _UnsupportedError("is cut short: it states samples beyond its end")
    uncompressed = 1
    row_bytes = -(-int(page.imagewidth) * channels * int(page.bitspersample) // 8)
    stated, found = int(page.imagelength) * depth * row_bytes, sum(page.databytecounts)
    if int(page.compression) == uncompressed and found < stated:
        raise _UnsupportedError(f"is damaged: contains {found} bytes of samples instead of {stated}")


def _planes(page: Any) -> list[int] | list[None]:
    """Return the planes of a directory that count as pictures; [None] if it is one picture.

    tifffile stores a stack of three or four pictures as one picture of separate planes of RGB, unless the
    program that calls it states otherwise. Colours in separate planes of other programs are one picture.
    """
    if int(page.samplesperpixel) == 1 or int(page.planarconfig) != _SEPARATE:
        return [None]
    is_stack = page.software.startswith("tifffile") or page.is_shaped
    return list(range(int(page.samplesperpixel))) if is_stack else [None]


def _luma(samples: NDArray[Any]) -> NDArray[Any]:
    """Return the luma of red, green and blue, rounded as Pillow does for 8 bits."""
    weights = np.array([19595, 38470, 7471], np.int64)
    if samples.dtype.kind == "f":
        return np.asarray(samples @ (weights / 65536.0))
    rounded = (samples.astype(np.int64) @ weights + 0x8000) >> 16
    return np.asarray(rounded.astype(samples.dtype))


def upright(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Return pixels upright, from a picture that is stored in an orientation of TIFF or EXIF.

    Parameters
    ----------
    values
        Stored pixels, shape (rows, columns).
    orientation
        Orientation from 1 to 8; other numbers count as 1.
    """
    turned = {
        2: lambda v: v[:, ::-1],
        3: lambda v: v[::-1, ::-1],
        4: lambda v: v[::-1],
        5: lambda v: v.T,
        6: lambda v: v[::-1].T,
        7: lambda v: v[::-1, ::-1].T,
        8: lambda v: v[:, ::-1].T,
    }
    return np.ascontiguousarray(turned[orientation](values) if orientation in turned else values)


def _is_opaque(image: Any) -> bool:
    clear = image.info.get("transparency")
    if image.mode in ("L", "I;16", "I", "1") and isinstance(clear, int):
        return not bool(np.any(np.asarray(image) == clear))
    return bool(image.convert("RGBA").getextrema()[3][0] == 255)


@contextmanager
def _logged_errors() -> Iterator[list[str]]:
    """Collect the errors that tifffile logs, and suppress all of its messages."""
    log, errors = logging.getLogger("tifffile"), list[str]()

    def collect(record: logging.LogRecord) -> bool:
        if record.levelno >= logging.ERROR:
            errors.append(record.getMessage())
        return False

    log.addFilter(collect)
    try:
        yield errors
    finally:
        log.removeFilter(collect)
