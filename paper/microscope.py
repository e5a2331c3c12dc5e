"""What a microscope shows of an object: an objective, and light of one direction or of a condenser."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim import Field
from wavesim.targets import band_limit

DIRECTIONS = 6
"""Along the diameter of the condenser's pupil."""


@dataclass(frozen=True)
class Objective:
    """An objective without aberrations.

    Attributes
    ----------
    name
        As it is sold.
    aperture
        Numerical aperture.
    """

    name: str
    aperture: float

    def coherent(self, behind: Field) -> Array:
        """Intensity of an object's light that is all of one direction, in the object's own scale."""
        return np.asarray(np.abs(_passed(behind, self.aperture)) ** 2)

    def partially_coherent(self, behind: Field, coherence: float) -> Array:
        """Intensity with a condenser of `coherence` times the objective's aperture, evenly lit (Abbe).

        Directions of the condenser do not interfere: their intensities add up.
        """
        grid, wavelength_mm = behind.grid, 1e-3 * behind.wavelength_um
        total = np.zeros(grid.shape)
        sines = _directions(coherence * self.aperture)
        for across, down in sines:
            x = np.exp(2j * math.pi * across / wavelength_mm * grid.x_mm)
            y = np.exp(2j * math.pi * down / wavelength_mm * grid.y_mm)
            tilted = behind.with_values(behind.values * y[:, None] * x)
            total += np.abs(_passed(tilted, self.aperture)) ** 2
        return total / len(sines)


def _passed(field: Field, aperture: float) -> NDArray[np.complexfloating]:
    return band_limit(field.values, field.grid, field.wavelength_um, aperture)


def _directions(largest: float) -> list[tuple[float, float]]:
    """Sines of even directions within a cone."""
    at = largest * ((np.arange(DIRECTIONS) + 0.5) / (0.5 * DIRECTIONS) - 1.0)
    return [(float(x), float(y)) for x in at for y in at if math.hypot(x, y) <= largest]
