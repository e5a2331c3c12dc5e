"""Objects at several wavelengths: channels of a colour picture, and films that delay the light."""

from __future__ import annotations

import math

import numpy as np

from lensdesign.errors import validate_positive
from wavesim.fields.field import Field

BLUE_GREEN_UM, GREEN_RED_UM = 0.49, 0.58
"""Wavelengths that separate the channels of a colour picture."""

FILM_INDEX = 1.5
"""Refractive index of a film for which none is stated, such as that of a resist or of glass."""


def channel_of(wavelength_um: float) -> int:
    """Return the index of the channel (0 red, 1 green, 2 blue) that belongs to a wavelength.

    Examples
    --------
    >>> [channel_of(one) for one in (0.45, 0.532, 0.635)]
    [2, 1, 0]
    """
    return 2 if wavelength_um < BLUE_GREEN_UM else 1 if wavelength_um < GREEN_RED_UM else 0


def film(shape: Field, thickness_um: float, index: float, wavelength_um: float) -> Field:
    """Return the transmission of a clear film in air, exp(2 pi i (n - 1) h / wavelength).

    Parameters
    ----------
    shape
        Field whose modulus is the thickness h over the largest thickness.
    thickness_um
        Thickness where the modulus is 1.
    index
        Refractive index n of the film.
    wavelength_um
        Vacuum wavelength.

    Raises
    ------
    InputError
        If the thickness is not positive.
    """
    validate_positive("thickness_um", thickness_um)
    height_um = thickness_um * np.abs(shape.values)
    phase = 2.0 * math.pi * (index - 1.0) / wavelength_um * height_um.astype(float)
    return Field(shape.grid, np.exp(1j * phase).astype(np.complex64), wavelength_um)
