"""The one reader of pictures in files: frames, objects, darks, flats and maps of pixels.

All kinds of picture pass the same checks. Pixels are turned upright by the orientation that a TIFF tag or
EXIF states, as viewers show them. Whether white is zero, how many pictures a file holds, and how its samples
are stored is stated to the caller, who accepts or refuses it.
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
"""Formats of cameras: without loss."""

MOST_BYTES = 4 * TABLE_BYTES
"""Most bytes of a file of pictures."""

MOST_PICTURES = 10_000
"""Most pictures in a file."""

TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF and of a BigTIFF file."""

ORIENTATION, PHOTOMETRIC = 274, 262
"""TIFF tags; EXIF has the first one too."""

PHOTOMETRICS = {0: "grey", 1: "grey", 2: "RGB", 3: "palette", 6: "YCbCr"}
"""Photometric interpretations that are read."""

GREY_MODES = ("1", "L", "I;16", "I;16L", "I;16B", "I", "F")
"""Pillow's names for one channel."""

COUNT_MODES = ("L", "I;16", "I;16L", "I;16B")
"""Pillow's names for whole numbers without sign, of 16 bits at most."""

_FORMAT_OF_TAG = {1: "B", 3: "H", 4: "I", 16: "Q"}
_UNSIGNED, _SIGNED, _FLOAT = 1, 2, 3
_PNG_DEPTH_AT = 24


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture as a file holds it, turned upright.

    Attributes
    ----------
    path : Path
        The file.
    format : str
        "TIFF", "PNG" and so on.
    mode : str
        Kind of pixels, by Pillow's name.
    bits : int
        Bits of a stored sample.
    values : ndarray, shape (rows, columns)
        Stored values of one channel; of colours, palettes and pictures with alpha the luma of ITU-R BT.601,
        of 8 bits.
    white_is_zero : bool
        Whether the value 0 shows white.
    is_opaque : bool
        Whether no pixel is transparent, not even in part.
    states_alpha : bool
        Whether the file says of its pixels how transparent they are.
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
        """Whether `values` are the stored values of one channel."""
        return self.mode in GREY_MODES and not self.states_alpha


class PictureFile:
    """A file of pictures.

    Parameters
    ----------
    path
        The file.
    named
        What messages call it, before its path: "the map"; nothing for a frame.
    formats
        Formats that are read, by Pillow's names; all that Pillow reads where left out.

    Attributes
    ----------
    count : int
        Number of pictures.
    description : str
        ImageDescription of a TIFF; else empty.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, is none of these formats, or does not hold as many pictures as
        it states.
    """

    def __init__(self, path: Path, named: str = "", formats: tuple[str, ...] | None = None) -> None:
        self.path, self._named, self._formats = path, named, formats
        self._data = read_input(path, MOST_BYTES, InputError, named)
        self.description = ""
        self._contiguous: NDArray[Any] | None = None
        if self._data[:4] in TIFF_STARTS:
            with self._reported():
                self._read_structure()
        else:
            with self._reported(), self._opened() as image:
                self.count = int(getattr(image, "n_frames", 1))
                orientation = int(image.getexif().get(ORIENTATION, 1))
                self._pages = [_Page(n, orientation, False, 8, _UNSIGNED) for n in range(self.count)]

    def only(self) -> Picture:
        """The picture of a file that holds one.

        Raises
        ------
        InputError
            If it holds several, or the picture is damaged.
        """
        if self.count != 1:
            raise InputError(
                f"{self._who}: holds {self.count} pictures: must hold one; save the one that is meant by "
                "itself"
            )
        return self.picture(0)

    def picture(self, index: int) -> Picture:
        """One of the pictures, counted from 0.

        Raises
        ------
        InputError
            If it is damaged, or of a kind that is not read.
        """
        with self._reported(), self._opened() as image:
            page = self._pages[0 if self._contiguous is not None else index]
            if page.index:
                image.seek(page.index)
            mode, bits = image.mode, page.bits
            if image.format == "PNG":
                bits = self._data[_PNG_DEPTH_AT]
            states_alpha = mode in ("LA", "La", "PA", "RGBA", "RGBa") or "transparency" in image.info
            if self._contiguous is not None:
                if not len(self._contiguous):
                    raise InputError(
                        f"{self._who}: states that it holds {self.count} pictures, of which only the first "
                        "can be found; save it anew"
                    )
                values, is_opaque = self._contiguous[index], True
            else:
                is_opaque = not states_alpha or _is_opaque(image)
                values = np.asarray(image if mode in GREY_MODES else image.convert("L"))
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
        """Turn whatever the readers raise into one error that names the file."""
        from PIL import Image, UnidentifiedImageError

        start = f"cannot read {self._named} {self.path}: " if self._named else f"{self.path}: "
        with warnings.catch_warnings(), _without_log():
            warnings.simplefilter("ignore")
            try:
                yield
            except InputError:
                raise
            except UnidentifiedImageError:
                allowed = " or ".join(self._formats) if self._formats else "known kind of"
                raise InputError(
                    f"{start}no {allowed} picture, or damaged at its start, or of samples that are not read"
                ) from None
            except Image.DecompressionBombError as error:
                raise InputError(f"{start}{error}") from None
            except Exception as error:  # of damaged files the readers raise errors of many kinds
                said = str(error) or type(error).__name__
                kinds = " or ".join(self._formats) if self._formats else "picture"
                raise InputError(f"{start}damaged {kinds}: {said}") from None

    def _read_structure(self) -> None:
        """What the directories of a TIFF state; its bytes then say nothing of orientation and white."""
        from tifffile import TiffFile

        if self._formats is not None and "TIFF" not in self._formats:
            raise InputError(f"{self._who}: is a TIFF; allowed: {', '.join(self._formats)}")
        with TiffFile(io.BytesIO(self._data)) as file:
            if len(file.pages) > MOST_PICTURES:
                raise InputError(f"{self._who}: more than {MOST_PICTURES} directories")
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
                        f"{self._who}: states that it holds {stated} pictures, and holds {self.count}; save "
                        "it anew"
                    )
                self.count, self._contiguous = stated, _contiguous(file, first, stated)
            self._data = bytes(changed) if changed != self._data else self._data


@dataclass(frozen=True)
class _Page:
    """What a directory states of its picture."""

    index: int
    orientation: int
    white_is_zero: bool
    bits: int
    sample: int


def upright(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Pixels as viewers show them, of a picture that is stored in an orientation of TIFF or EXIF.

    Parameters
    ----------
    values
        Stored pixels, shape (rows, columns).
    orientation
        1 to 8; other numbers count as 1.
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
    """A directory, and what to write into the file so that Pillow gives its pixels as they are stored."""
    if PHOTOMETRIC not in page.tags:
        raise InputError(f"{who}: a TIFF that does not state whether black or white is zero (photometric)")
    photometric = int(page.tags[PHOTOMETRIC].value)
    if photometric not in PHOTOMETRICS:
        raise InputError(
            f"{who}: a TIFF of photometric interpretation {photometric}: must be grey, RGB or with a palette"
        )
    orientation = int(page.tags[ORIENTATION].value) if ORIENTATION in page.tags else 1
    edits = []
    for code, value, wanted in ((ORIENTATION, orientation, 1), (PHOTOMETRIC, photometric, 1)):
        if code not in page.tags or (code == PHOTOMETRIC and photometric != 0) or value == wanted:
            continue
        tag = page.tags[code]
        kind = _FORMAT_OF_TAG.get(int(tag.dtype))
        if kind is None or tag.count != 1:
            raise InputError(f"{who}: damaged: tag {code} is no whole number")
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
    """Number of pictures that the metadata of a file state, whatever program wrote them."""
    try:
        one = page.imagelength * page.imagewidth * page.samplesperpixel
        whole = [own for own in file.series if not own.keyframe.is_reduced]
        found = sum(math.prod(own.shape) for own in whole if own.keyframe.shape == page.shape)
    except Exception:  # metadata of many programs, damaged or of another version
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
    """Number of pictures that ImageJ's text states: images, or channels times slices times frames."""
    if not description.startswith("ImageJ"):
        return 1
    held = dict(re.findall(r"^(images|channels|slices|frames)=([0-9]{1,9})\s*$", description, re.MULTILINE))
    sizes = [max(1, int(held.get(name, 1))) for name in ("channels", "slices", "frames")]
    return max(int(held.get("images", 1)), math.prod(sizes))


def _contiguous(file: Any, page: Any, count: int) -> NDArray[Any]:
    """Pictures that lie one behind the other, of which only the first has a directory."""
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
        # Only a caller who takes several pictures needs them; the others refuse the number.
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
    """Keep tifffile from writing of damaged files what the error says anyway."""
    log = logging.getLogger("tifffile")
    was = log.disabled
    log.disabled = True
    try:
        yield
    finally:
        log.disabled = was
