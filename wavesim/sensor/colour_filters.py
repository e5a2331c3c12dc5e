"""Colour filter arrays: the pattern of filters on the pixels, and their responses to wavelengths.

A response is the fraction of a wavelength's light that a pixel measures, relative to the largest of a table.
Filters of real sensors pass a part of all wavelengths (spectral crosstalk). A file has the form::

    wavelengths_um = [0.45, 0.532, 0.635]
    pattern = ["RG", "GB"]

    [responses]
    R = [0.04, 0.12, 0.90]
    G = [0.10, 0.95, 0.20]
    B = [0.92, 0.12, 0.03]

A monochrome sensor has a pattern of one letter. The first letter of the first row stands on the first pixel
of a frame, which has the smallest x and y.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import field_validator, model_validator

from lensdesign.common.frozen_model import FrozenModel, Positive
from lensdesign.common.toml_files import read_toml, validate
from lensdesign.errors import InputError
from wavesim.scene.settings import SettingError

BAYER, MONOCHROME = ("RG", "GB"), ("M",)

TYPICAL_UM = (0.40, 0.45, 0.50, 0.532, 0.55, 0.60, 0.635, 0.70)
TYPICAL_RESPONSES = {
    "R": (0.05, 0.04, 0.06, 0.12, 0.16, 0.85, 0.90, 0.80),
    "G": (0.06, 0.10, 0.65, 0.95, 0.93, 0.40, 0.20, 0.25),
    "B": (0.70, 0.92, 0.55, 0.12, 0.08, 0.04, 0.03, 0.06),
}
"""Responses of the filters of a typical colour sensor, as an example: no data of a certain product.

Between these wavelengths they are interpolated linearly. Crosstalk of 3 to 20 % is common in data sheets.
"""

Fraction = Annotated[float, Setting(ge=0.0, le=1.0, allow_inf_nan=False)]

LARGEST_PATTERN = 16
"""Largest number of rows and of columns of a pattern."""


class ColourFilters(FrozenModel):
    """Wavelengths that are recorded at once, and how the pixels respond to them.

    Attributes
    ----------
    wavelengths_um
        Vacuum wavelengths in um.
    pattern
        Rows of the pattern that repeats over the pixels; each letter names a filter.
    responses
        For each filter, the response to each wavelength, from 0 to 1.

    Examples
    --------
    >>> from wavesim.sensor import ColourFilters
    >>> filters = ColourFilters.bayer((0.45, 0.532, 0.635))
    >>> filters.responses["G"]
    (0.1, 0.95, 0.2)
    >>> filters.on_pixels((2, 4))[0].tolist()
    [[0.04, 0.1, 0.04, 0.1], [0.1, 0.92, 0.1, 0.92]]
    """

    wavelengths_um: tuple[Positive, ...]
    pattern: tuple[str, ...] = MONOCHROME
    responses: dict[str, tuple[Fraction, ...]]

    @field_validator("responses", mode="before")
    @classmethod
    def _rows_as_tuples(cls, rows: Any) -> Any:
        if not isinstance(rows, dict):
            return rows
        return {name: tuple(row) if isinstance(row, list) else row for name, row in rows.items()}

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        count = len(self.wavelengths_um)
        if count < 2 or len(set(self.wavelengths_um)) < count:
            given = ", ".join(f"{one:g}" for one in self.wavelengths_um)
            raise ValueError(f"wavelengths_um = {given}: must be two or more different wavelengths")
        widths = sorted({len(row) for row in self.pattern})
        sizes = (len(self.pattern), *widths)
        if len(widths) != 1 or not all(1 <= size <= LARGEST_PATTERN for size in sizes):
            raise ValueError(
                f"pattern = {list(self.pattern)}: must have 1 to {LARGEST_PATTERN} rows of the same 1 to "
                f"{LARGEST_PATTERN} letters, such as ['RG', 'GB']"
            )
        letters = sorted(set("".join(self.pattern)))
        if letters != sorted(self.responses):
            raise ValueError(
                f"responses of {', '.join(sorted(self.responses)) or 'no filter'}: must be those of the "
                f"pattern's filters {', '.join(letters)}"
            )
        for name, row in self.responses.items():
            if len(row) != count:
                raise ValueError(
                    f"responses of {name}: {len(row)} numbers; must be {count}, one for each wavelength"
                )
        for wavelength, column in zip(
            self.wavelengths_um, zip(*self.responses.values(), strict=True), strict=True
        ):
            if max(column) <= 0.0:
                raise ValueError(
                    f"wavelength {wavelength:g} um: no filter passes it: must be above 0 for one"
                )
        return self

    @classmethod
    def monochrome(cls, wavelengths_um: Sequence[float]) -> Self:
        """Return pixels without filters, which respond equally to all wavelengths."""
        return cls(wavelengths_um=tuple(wavelengths_um), responses={"M": (1.0,) * len(wavelengths_um)})

    @classmethod
    def bayer(cls, wavelengths_um: Sequence[float]) -> Self:
        """Return a Bayer pattern with the typical responses of `TYPICAL_RESPONSES`.

        Raises
        ------
        InputError
            If a wavelength lies outside their table.
        """
        for wavelength in wavelengths_um:
            if not TYPICAL_UM[0] <= wavelength <= TYPICAL_UM[-1]:
                raise SettingError(
                    f"{{wavelengths_um}} = {wavelength:g}: the typical Bayer filters are known from "
                    f"{TYPICAL_UM[0]:g} to {TYPICAL_UM[-1]:g} um; give a file with {{colour_filters}}"
                )
        responses = {
            name: tuple(round(float(np.interp(one, TYPICAL_UM, row)), 6) for one in wavelengths_um)
            for name, row in TYPICAL_RESPONSES.items()
        }
        return cls(wavelengths_um=tuple(wavelengths_um), pattern=BAYER, responses=responses)

    @property
    def is_monochrome(self) -> bool:
        """True if all pixels have the same responses."""
        return len(set(self.responses.values())) == 1

    def on_pixels(self, shape: tuple[int, int]) -> list[NDArray[np.float64]]:
        """Return, for each wavelength, the responses of pixels: one number if all are equal.

        Parameters
        ----------
        shape : (ny, nx)
            Number of pixels.
        """
        if self.is_monochrome:
            (row,) = set(self.responses.values())
            return [np.array(response) for response in row]
        letters = self.letters_on_pixels(shape)
        return [
            np.select(
                [letters == name for name in self.responses], [row[n] for row in self.responses.values()]
            )
            for n in range(len(self.wavelengths_um))
        ]

    def letters_on_pixels(self, shape: tuple[int, ...]) -> NDArray[np.str_]:
        """Return the letter of each pixel's filter.

        Parameters
        ----------
        shape : (ny, nx)
            Number of pixels.
        """
        pattern = np.array([list(row) for row in self.pattern])
        rows, columns = np.arange(shape[0]) % len(pattern), np.arange(shape[1]) % pattern.shape[1]
        return np.asarray(pattern[rows[:, None], columns[None, :]])


def colour_filters(name: str, wavelengths_um: Sequence[float]) -> ColourFilters:
    """Return the filters of a name ("monochrome" or "bayer") or of a file (TOML).

    Raises
    ------
    InputError
        If there is no such file, its table is wrong, or its wavelengths are not those of the light.
    """
    if name in ("monochrome", "bayer"):
        make = ColourFilters.bayer if name == "bayer" else ColourFilters.monochrome
        try:
            return make(wavelengths_um)
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            given = ",".join(f"{one:g}" for one in wavelengths_um)
            raise SettingError(
                f"{{wavelengths_um}} = {given}: must be two or more different wavelengths"
            ) from None
    path = Path(name)
    if not path.suffix and not path.exists():
        raise SettingError(f"{{colour_filters}} = {name!r}: must be monochrome, bayer, or a TOML file")
    table: dict[str, Any] = read_toml(path)
    filters = validate(ColourFilters, table, path)
    return _chosen(filters, wavelengths_um, path)


def _chosen(filters: ColourFilters, wavelengths_um: Sequence[float], path: Path) -> ColourFilters:
    """Return the filters with the responses to some of their wavelengths, in the order of these."""
    known, places = filters.wavelengths_um, list[int]()
    for wavelength in wavelengths_um:
        found = [n for n, one in enumerate(known) if math.isclose(one, wavelength, rel_tol=1e-4)]
        if not found:
            raise InputError(
                f"{path}: has no responses to {wavelength:g} um: wavelengths_um must hold all wavelengths of "
                f"the light; it has {', '.join(f'{one:g}' for one in known)}"
            )
        places.append(found[0])
    responses = {name: [row[n] for n in places] for name, row in filters.responses.items()}
    table = {"wavelengths_um": list(wavelengths_um), "pattern": filters.pattern, "responses": responses}
    return validate(ColourFilters, table, path)
