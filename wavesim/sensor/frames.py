"""Recorded frames: counts of an intensity picture, with the settings that convert them to intensity.

A frame file is a 16-bit grey TIFF whose ImageDescription contains the settings as JSON. TIFF and PNG files of
a camera can be read as well if the caller supplies their settings.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import model_validator

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.frozen_model import Finite, FrozenModel, Positive
from lensdesign.common.toml_files import did_you_mean, validate
from lensdesign.errors import InputError
from wavesim.fields.picture_files import FRAME_FORMATS, PictureFile
from wavesim.scene.settings import SettingError
from wavesim.scene.system_state import LARGEST_NONLINEARITY
from wavesim.sensor.colour_filters import ColourFilters
from wavesim.sensor.pixels.maps import PixelMaps

Counts = NDArray[np.uint16]
Bits = Annotated[int, Setting(ge=1, le=16)]
Offset = Annotated[float, Setting(ge=0.0, le=65535.0)]
Nonlinearity = Annotated[float, Setting(ge=-LARGEST_NONLINEARITY, le=LARGEST_NONLINEARITY)]
NotNegative = Annotated[float, Setting(ge=0.0, le=1e9, allow_inf_nan=False)]

KEY = "transferlens_frame"
"""JSON key of the settings in the ImageDescription of a file."""


class AssumedWarning(UserWarning):
    """Warning that a frame does not state how it was recorded, so that values of the design are used."""


class FrameSettings(FrozenModel):
    """Recording conditions of a frame.

    Attributes
    ----------
    pixel_pitch_um
        Pixel pitch in um.
    plane_distance_mm
        Distance in mm from the exit vertex to the plane of the frame, as the stage states it.
    wavelength_um
        Vacuum wavelength in um; the first one if several are recorded at once.
    exposure
        Electrons in a pixel for an intensity of 1. For a real camera, any number proportional to the exposure
        time, in the same unit for all frames that are used together.
    bits
        Bits of a count, 1 to 16; the largest count is 2**bits - 1.
    offset_counts
        Count of a dark pixel.
    gain_electrons_per_count
        Electrons that raise a pixel by one count.
    read_noise_electrons
        Standard deviation of a dark pixel in electrons, without quantisation noise.
    saturation_counts
        Lowest count of a pixel that may be clipped; default: the largest count.
    nonlinearity
        Relative increase of the light over that of a linear response, at the largest count. It decreases in
        proportion to the signal; positive values belong to a camera that saturates gradually.
    title
        Free text.
    colours
        Wavelengths that were recorded at once, and the responses of the pixels; default: one wavelength.

    Examples
    --------
    >>> from wavesim import FrameSettings
    >>> settings = FrameSettings(
    ...     pixel_pitch_um=3.2, plane_distance_mm=2.0, wavelength_um=0.532, exposure=1.0,
    ...     bits=12, offset_counts=64, gain_electrons_per_count=2.5,
    ... )
    >>> settings.top_counts, settings.replaced(saturation_counts=4000).clipped_counts
    (4095, 4000)
    """

    pixel_pitch_um: Positive
    plane_distance_mm: Finite
    wavelength_um: Positive
    exposure: Annotated[float, Setting(ge=1e-150, le=1e150, allow_inf_nan=False)]
    bits: Bits
    offset_counts: Offset
    gain_electrons_per_count: Positive
    read_noise_electrons: NotNegative = 0.0
    saturation_counts: Annotated[int, Setting(gt=0, le=65535)] | None = None
    nonlinearity: Nonlinearity = 0.0
    title: str = ""
    colours: ColourFilters | None = None

    @model_validator(mode="after")
    def _within_bits(self) -> Self:
        for name in ("offset_counts", "saturation_counts"):
            if (getattr(self, name) or 0) > self.top_counts:
                raise ValueError(
                    f"{name} = {getattr(self, name):g}: must be at most {self.top_counts} at {self.bits} bits"
                )
        if self.colours is not None and self.colours.wavelengths_um[0] != self.wavelength_um:
            raise ValueError(
                f"wavelength_um = {self.wavelength_um:g}: must be the first wavelength of colours, "
                f"{self.colours.wavelengths_um[0]:g}"
            )
        return self

    @property
    def wavelengths_um(self) -> tuple[float, ...]:
        """Wavelengths that the frame has recorded, in um."""
        return (self.wavelength_um,) if self.colours is None else self.colours.wavelengths_um

    def key_text(self) -> str:
        """Return the settings as JSON for digests, which are the same as before for a single wavelength."""
        return self.model_dump_json(exclude={"colours"} if self.colours is None else None)

    @property
    def top_counts(self) -> int:
        """Largest count, 2**bits - 1."""
        return int(2**self.bits - 1)

    @property
    def top_electrons(self) -> float:
        """Electrons of the largest count, for a linear response."""
        return (self.top_counts - self.offset_counts) * self.gain_electrons_per_count

    @property
    def clipped_counts(self) -> int:
        """Lowest count of a pixel that may be clipped: `saturation_counts`, or the largest count."""
        return self.saturation_counts or self.top_counts


@dataclass(frozen=True, eq=False)
class Frame:
    """A recorded intensity picture.

    Attributes
    ----------
    counts : ndarray of uint16, shape (ny, nx)
        Counts of the pixels. Rows lie along y and columns along x, both increasing, as in a
        :class:`~wavesim.fields.field.Grid`.
    settings : FrameSettings
        Recording conditions.
    maps : PixelMaps, optional
        Known gain, dark signal and bad pixels. They are not stored in the file.

    Raises
    ------
    InputError
        If the counts are not a 2D array of uint16, or exceed the largest count.

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim import Frame, FrameSettings
    >>> settings = FrameSettings(
    ...     pixel_pitch_um=3.2, plane_distance_mm=2.0, wavelength_um=0.532, exposure=1.0,
    ...     bits=12, offset_counts=64, gain_electrons_per_count=2.5,
    ... )
    >>> frame = Frame(np.array([[64, 900], [2000, 4095]], np.uint16), settings)
    >>> frame.saturated.tolist()
    [[False, False], [False, True]]
    """

    counts: Counts
    settings: FrameSettings
    maps: PixelMaps | None = None

    def __post_init__(self) -> None:
        counts = self.counts
        if counts.ndim != 2 or counts.size == 0 or counts.dtype != np.uint16:
            raise InputError(
                f"frame counts are {counts.dtype} of shape {counts.shape}: must be uint16 (ny, nx)"
            )
        top, bits = self.settings.top_counts, self.settings.bits
        if int(counts.max()) > top:
            aligned = bits < 16 and not np.any(counts % (1 << (16 - bits)))
            hint = (
                f"; all are multiples of {1 << (16 - bits)}, so they are stored in the upper bits: give "
                f"bits = 16, {1 << (16 - bits)} times the offset and 1/{1 << (16 - bits)} of the gain"
            )
            raise InputError(
                f"frame counts reach {int(counts.max())}: bits = {bits} allows {top}{hint if aligned else ''}"
            )

    @property
    def bad(self) -> NDArray[np.bool_] | None:
        """Mask of bad pixels, shape (ny, nx); None if none are known."""
        return None if self.maps is None else self.maps.bad

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Mask of pixels that may be clipped, shape (ny, nx)."""
        return np.asarray(self.counts >= self.settings.clipped_counts)


def write_frame(frame: Frame, path: str | os.PathLike[str]) -> None:
    """Write a frame as a 16-bit grey TIFF, without loss of counts or settings.

    The first row of the file, which viewers show at the top, has the smallest y.

    Parameters
    ----------
    frame
        The frame. Its pixel maps are not written.
    path
        File to write; an existing file is replaced.

    Raises
    ------
    InputError
        If the file cannot be written; an existing file is then unchanged.

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim import Frame, FrameSettings, write_frame
    >>> from wavesim.sensor import read_frame
    >>> settings = FrameSettings(
    ...     pixel_pitch_um=3.2, plane_distance_mm=2.0, wavelength_um=0.532, exposure=1.0,
    ...     bits=12, offset_counts=64, gain_electrons_per_count=2.5,
    ... )
    >>> write_frame(Frame(np.full((3, 4), 900, np.uint16), settings), folder / "frame.tif")  # any folder
    >>> read_frame(folder / "frame.tif").settings == settings
    True
    """
    from PIL import Image

    settings = frame.settings.model_dump(mode="json", exclude_none=True)
    pixels_per_cm = 1e4 / frame.settings.pixel_pitch_um
    with atomic_path(path) as temporary:
        # Number of the TIFF tag ImageDescription.
        image_description = 270
        Image.fromarray(np.ascontiguousarray(frame.counts)).save(
            temporary,
            format="TIFF",
            tiffinfo={image_description: json.dumps({KEY: settings})},
            resolution_unit="cm",
            x_resolution=pixels_per_cm,
            y_resolution=pixels_per_cm,
        )


def read_frame(path: str | os.PathLike[str], assumed: Mapping[str, Any] | None = None, **given: Any) -> Frame:
    """Read a frame from a grey TIFF or PNG of 8, 12 or 16 bits with a single picture.

    The orientation that the file states is applied.

    Parameters
    ----------
    path
        The file.
    assumed
        Settings of the design, used where neither the file nor `given` states a required setting.
    **given
        Settings by their names in :class:`FrameSettings`. They override the settings in the file.

    Returns
    -------
    Frame
        Counts and settings of the frame.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged or not a grey picture of whole numbers, or if settings are
        missing or invalid.

    Warns
    -----
    AssumedWarning
        If values of `assumed` are used; the warning names them.
    """
    path = Path(path)
    counts, description = _read_picture(path)
    settings = _written_settings(description, path) | given
    fields = FrameSettings.model_fields
    for name in given:
        if name not in fields:
            raise InputError(f"{path}: {name}: unknown setting of a frame{did_you_mean(name, fields)}")
    missing = [name for name, field in fields.items() if field.is_required() and name not in settings]
    defaults = {name: assumed[name] for name in missing if name in assumed} if assumed else {}
    required = ", ".join(f"{{{name}}}" for name in missing if name not in defaults)
    if required:
        raise SettingError(f"{path}: does not state how it was recorded; give {required}")
    if defaults:
        values = ", ".join(f"{name} = {value:g}" for name, value in defaults.items())
        warnings.warn(
            f"{path}: does not state how it was recorded; taken from the design: {values}", AssumedWarning, 3
        )
        settings |= defaults
    try:
        return Frame(counts, validate(FrameSettings, settings, path))
    except InputError as error:
        message = str(error)
        raise InputError(message if message.startswith(str(path)) else f"{path}: {message}") from None


def _read_picture(path: Path) -> tuple[Counts, str]:
    """Return the counts of a grey TIFF or PNG, and the ImageDescription of a TIFF."""
    file = PictureFile(path, formats=FRAME_FORMATS)
    picture = file.single_picture()
    # Least number of bits of a stored count; readers rescale counts of fewer bits.
    least_bits = 8
    if not (picture.is_grey and picture.has_counts and picture.bits >= least_bits):
        raise InputError(f"{path}: {picture}: must be grey, with whole numbers of 8, 12 or 16 bits")
    if picture.white_is_zero:
        raise InputError(f"{path}: a TIFF in which white is zero: must be one in which black is zero")
    return picture.values.astype(np.uint16), file.description


def _written_settings(description: str, path: Path) -> dict[str, Any]:
    """Return the settings in a file; an empty dict if :func:`write_frame` did not write the file."""
    if KEY not in description:
        return {}
    try:
        settings = json.loads(description)[KEY]
        if isinstance(settings, dict):
            return settings
    except (ValueError, LookupError, TypeError, RecursionError):
        pass
    raise InputError(f"{path}: damaged: its ImageDescription is not a JSON object with {KEY!r}")
