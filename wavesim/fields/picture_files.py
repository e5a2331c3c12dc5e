"""Reader of picture files: frames, objects, dark frames, flat fields and maps of pixels.

All kinds of picture pass the same checks. Pixels are oriented upright by the TIFF tag or EXIF data, as in
viewers. The reader reports whether white is zero, the number of pictures, and the storage of samples; the
caller decides what it accepts.
"""

from __future__ import annotations

import io
import logging
import math
import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.input_files import TABLE_BYTES, read_input
from lensdesign.errors import InputError

FRAME_FORMATS = ("TIFF", "PNG")
"""Lossless formats of cameras."""

ORIENTATION, PHOTOMETRIC = 274, 262
"""TIFF tags; EXIF also has the first one."""

GREY_MODES = ("1", "L", "I;16", "I;16L", "I;16B", "I", "F")
"""Pillow's names for one channel."""

COUNT_MODES = ("L", "I;16", "I;16L", "I;16B")
"""Pillow's names for unsigned integers of at most 16 bits."""

_UNSIGNED, _SIGNED, _FLOAT = 1, 2, 3


@dataclass(frozen=True, eq=False)
class Picture:
    """A stored picture, oriented upright.

    Attributes
    ----------
    path : Path
        The file.
    format : str
        Format, such as "TIFF" or "PNG".
    mode : str
        Kind of pixels, by Pillow's name.
    bits : int
        Bits of a stored sample.
    values : ndarray, shape (rows, columns)
        Stored values of one channel; for colours, palettes and pictures with alpha the 8-bit luma of ITU-R
        BT.601.
    white_is_zero : bool
        Whether the value 0 means white.
    is_opaque : bool
        Whether no pixel is even partly transparent.
    states_alpha : bool
        Whether the file has an alpha channel or a transparent colour.
    """

    path: Path
    format: str
    mode: str
    bits: int
    values: NDArray[Any]
    white_is_zero: bool
    is_opaque: bool
    states_alpha: bool

    @property
    def is_grey(self) -> bool:
        """True if `values` are the stored values of one channel."""
        return self.mode in GREY_MODES and not self.states_alpha


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
        If the file cannot be read, is damaged, has another format, or contains fewer pictures than it states.
    """

    def __init__(self, path: Path, named: str = "", formats: tuple[str, ...] | None = None) -> None:
        self.path, self._named, self._formats = path, named, formats
        self._data = read_input(path, 4 * TABLE_BYTES, InputError, named)
        self.description = ""
        self._contiguous: NDArray[Any] | None = None
        # First bytes of a TIFF and of a BigTIFF file.
        tiff_starts = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
        if self._data[:4] in tiff_starts:
            with self._reported():
                self._read_structure()
        else:
            with self._reported(), self._opened() as image:
                self.count = int(getattr(image, "n_frames", 1))
                orientation = int(image.getexif().get(ORIENTATION, 1))
                self._pages = [_Page(n, orientation, False, 8, _UNSIGNED) for n in range(self.count)]

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
                f"{self._who}: contains {self.count} pictures: must contain one; save the wanted picture in "
                "a file of its own"
            )
        return self.picture(0, channel)

    def picture(self, index: int, channel: int | None = None) -> Picture:
        """Return one of the pictures by its index from 0.

        Raises
        ------
        InputError
            If the picture is damaged, or of an unsupported kind.
        """
        with self._reported(), self._opened() as image:
            page = self._pages[0 if self._contiguous is not None else index]
            if page.index:
                image.seek(page.index)
            mode, bits = image.mode, page.bits
            if image.format == "PNG":
                png_depth_at = 24
                bits = self._data[png_depth_at]
            states_alpha = mode in ("LA", "La", "PA", "RGBA", "RGBa") or "transparency" in image.info
            if self._contiguous is not None:
                if not len(self._contiguous):
                    raise InputError(
                        f"{self._who}: states that it contains {self.count} pictures, but only the first can "
                        "be found; save the file again"
                    )
                values, is_opaque = self._contiguous[index], True
            else:
                is_opaque = not states_alpha or _is_opaque(image)
                if mode in GREY_MODES:
                    values = np.asarray(image)
                elif channel is None:
                    values = np.asarray(image.convert("L"))
                else:
                    values = np.asarray(image.convert("RGB"))[..., channel]
            if page.sample == _UNSIGNED and values.dtype == np.int32:
                values = values.view(np.uint32)
            return Picture(
                path=self.path,
                format=image.format or "",
                mode=mode,
                bits=bits,
                values=upright(values, page.orientation),
                white_is_zero=page.white_is_zero,
                is_opaque=is_opaque,
                states_alpha=states_alpha,
            )

    @property
    def _who(self) -> str:
        return f"{self._named.removeprefix('the ')} {self.path}" if self._named else str(self.path)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        from PIL import Image

        with Image.open(io.BytesIO(self._data), formats=self._formats) as image:
            yield image

    @contextmanager
    def _reported(self) -> Iterator[None]:
        """Convert all exceptions of the readers to an InputError that names the file."""
        from PIL import Image, UnidentifiedImageError

        start = f"cannot read {self._named} {self.path}: " if self._named else f"{self.path}: "
        with warnings.catch_warnings(), _without_log():
            warnings.simplefilter("ignore")
            try:
                yield
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
                raise InputError(f"{start}damaged {kinds}: {message}") from None

    def _read_structure(self) -> None:
        """Read the directories of a TIFF, and neutralize its tags for orientation and white."""
        from tifffile import TiffFile

        if self._formats is not None and "TIFF" not in self._formats:
            raise InputError(f"{self._who}: is a TIFF; allowed: {', '.join(self._formats)}")
        with TiffFile(io.BytesIO(self._data)) as file:
            # Most pictures in a file.
            most_pictures = 10_000
            if len(file.pages) > most_pictures:
                raise InputError(
                    f"{self._who}: has more than {most_pictures} directories, the largest number allowed"
                )
            directories = [file.pages[n].aspage() for n in range(len(file.pages))]
            whole = [n for n, own in enumerate(directories) if not own.is_reduced] or [0]
            first = directories[whole[0]]
            self.description = str(getattr(first, "description", "") or "")
            changed = bytearray(self._data)
            pages = []
            for n in whole:
                page, edits = _page(n, directories[n], file.byteorder, self._who)
                pages.append(page)
                for place, content in edits:
                    changed[place : place + len(content)] = content
            self._pages, self.count = pages, len(pages)
            stated = max(_stated_pictures(file, first), _imagej_pictures(self.description))
            if stated > self.count:
                if len(directories) > 1:
                    raise InputError(
                        f"{self._who}: states that it contains {stated} pictures, but contains {self.count}; "
                        "save the file again"
                    )
                self.count, self._contiguous = stated, _contiguous(file, first, stated)
            self._data = bytes(changed) if changed != self._data else self._data


@dataclass(frozen=True)
class _Page:
    """Properties of a picture from its directory."""

    index: int
    orientation: int
    white_is_zero: bool
    bits: int
    sample: int


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


def _page(index: int, page: Any, order: str, who: str) -> tuple[_Page, list[tuple[int, bytes]]]:
    """Return a directory's properties, and edits of the file so that Pillow returns the stored pixels."""
    if PHOTOMETRIC not in page.tags:
        raise InputError(
            f"{who}: a TIFF without its photometric tag, which states whether black or white is zero"
        )
    photometric = int(page.tags[PHOTOMETRIC].value)
    # Supported photometric interpretations.
    photometrics = {0: "grey", 1: "grey", 2: "RGB", 3: "palette", 6: "YCbCr"}
    if photometric not in photometrics:
        raise InputError(
            f"{who}: a TIFF of photometric interpretation {photometric}: must be grey, RGB or with a palette"
        )
    orientation = int(page.tags[ORIENTATION].value) if ORIENTATION in page.tags else 1
    edits = []
    format_of_tag = {1: "B", 3: "H", 4: "I", 16: "Q"}
    for code, value, wanted in ((ORIENTATION, orientation, 1), (PHOTOMETRIC, photometric, 1)):
        if code not in page.tags or (code == PHOTOMETRIC and photometric != 0) or value == wanted:
            continue
        tag = page.tags[code]
        kind = format_of_tag.get(int(tag.dtype))
        if kind is None or tag.count != 1:
            raise InputError(f"{who}: damaged: tag {code} is not a whole number")
        edits.append((int(tag.valueoffset), struct.pack(f"{order}{kind}", wanted)))
    sample = page.sampleformat
    whole = _Page(
        index,
        orientation,
        photometric == 0,
        int(page.bitspersample),
        int(_UNSIGNED if sample is None else sample),
    )
    return whole, edits


def _stated_pictures(file: Any, page: Any) -> int:
    """Return the number of pictures that the metadata of a file state, for files of any program."""
    try:
        one = page.imagelength * page.imagewidth * page.samplesperpixel
        whole = [own for own in file.series if not own.keyframe.is_reduced]
        found = sum(math.prod(own.shape) for own in whole if own.keyframe.shape == page.shape)
    except Exception:  # metadata may be damaged or of an unknown version
        return 1
    stated = max(1, found // one)
    depth = int(getattr(page, "imagedepth", 1) or 1)
    shaped = re.match(r'\s*\{.*"shape":\s*\[([0-9,\s]*)\]', page.description or "")
    if shaped:
        sizes = [int(size) for size in shaped[1].split(",") if size.strip()]
        stated = max(stated, math.prod(sizes) // one if sizes else 1)
    if file.is_ome:
        sizes = [int(n) for n in re.findall(r'\bSize[ZCT]="([0-9]+)"', page.description or "")]
        planes = math.prod(sizes[:3]) if sizes else 1
        stated = max(stated, planes // max(1, int(page.samplesperpixel)))
    return max(stated, depth)


def _imagej_pictures(description: str) -> int:
    """Return the number of pictures in ImageJ's text: images, or channels times slices times frames."""
    if not description.startswith("ImageJ"):
        return 1
    held = dict(re.findall(r"^(images|channels|slices|frames)=([0-9]{1,9})\s*$", description, re.MULTILINE))
    sizes = [max(1, int(held.get(name, 1))) for name in ("channels", "slices", "frames")]
    return max(int(held.get("images", 1)), math.prod(sizes))


def _contiguous(file: Any, page: Any, count: int) -> NDArray[Any]:
    """Return contiguous pictures of which only the first has a directory."""
    rows, columns = page.imagelength, page.imagewidth
    dtype = page.dtype
    start, each = int(page.dataoffsets[0]), rows * columns * (0 if dtype is None else dtype.itemsize)
    is_plain = (
        page.compression == 1
        and page.samplesperpixel == 1
        and dtype is not None
        and page.bitspersample == 8 * dtype.itemsize
        and page.is_contiguous
    )
    file.filehandle.seek(0, 2)
    held = (int(file.filehandle.tell()) - start) // each if is_plain and each else 1
    if held < count:
        # Only callers that accept several pictures need them; the others reject their number.
        return np.empty((0, rows, columns), np.uint8)
    file.filehandle.seek(start)
    data = np.frombuffer(
        file.filehandle.read(count * each), dtype.newbyteorder(file.byteorder), count * rows * columns
    )
    return data.reshape(count, rows, columns).astype(dtype)


def _is_opaque(image: Any) -> bool:
    clear = image.info.get("transparency")
    if image.mode in ("L", "I;16", "I", "1") and isinstance(clear, int):
        return not bool(np.any(np.asarray(image) == clear))
    return bool(image.convert("RGBA").getextrema()[3][0] == 255)


@contextmanager
def _without_log() -> Iterator[None]:
    """Suppress log messages of tifffile, whose content is in the error."""
    log = logging.getLogger("tifffile")
    was = log.disabled
    log.disabled = True
    try:
        yield
    finally:
        log.disabled = was
