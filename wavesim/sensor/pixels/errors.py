"""Pixels that are not alike: their gain, their dark signal, and those that are hot or dead.

The terms are those of EMVA standard 1288: PRNU, the spread of the gain, and DSNU, that of the dark signal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError

LEAST_HOT = 0.1
"""Share of full well that a hot pixel shows at least; others show up to all of it."""


@dataclass(frozen=True, eq=False)
class PixelPattern:
    """What each pixel makes of the light, alike in every frame.

    Attributes
    ----------
    gain : ndarray, shape (ny, nx)
        Electrons over those that a pixel as it should be holds.
    dark_electrons : ndarray, shape (ny, nx)
        Added to them; may be below 0, for the dark count is that of the mean.
    """

    gain: Array
    dark_electrons: Array

    def of(self, intensity: Array, rows: slice) -> tuple[Array, Array]:
        """Intensity as some rows of pixels take it, and their dark electrons."""
        return intensity[rows] * self.gain[rows], self.dark_electrons[rows]


@dataclass(frozen=True)
class PixelErrors:
    """How unlike a sensor's pixels are.

    Attributes
    ----------
    prnu : float
        Standard deviation of the gain, as a share of it.
    dsnu_electrons : float
        Standard deviation of the dark signal.
    hot_share, dead_share : float
        Of the pixels. Hot ones show from `LEAST_HOT` to all of full well without light, dead ones see none.
    seed : int
        Of the pattern.

    Raises
    ------
    InputError
        If a number is not usable.
    """

    prnu: float = 0.0
    dsnu_electrons: float = 0.0
    hot_share: float = 0.0
    dead_share: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, limit in (("prnu", 1.0), ("dsnu_electrons", math.inf)):
            if not 0.0 <= getattr(self, name) < limit:
                raise InputError(f"{name} = {getattr(self, name)!r}: must be from 0 to below {limit:g}")
        if not (min(self.hot_share, self.dead_share) >= 0.0 and self.hot_share + self.dead_share <= 1.0):
            raise InputError(
                f"hot_share = {self.hot_share!r}, dead_share = {self.dead_share!r}: must be shares of the "
                "pixels, together at most 1"
            )

    def pattern(self, shape: tuple[int, ...], full_well_electrons: float) -> PixelPattern | None:
        """Of a sensor with so many pixels; None where all are as they should be."""
        if not (self.prnu or self.dsnu_electrons or self.hot_share or self.dead_share):
            return None
        # A stream of its own: the frames' noise has the same seed.
        random = np.random.Generator(np.random.PCG64(np.random.SeedSequence((self.seed, 1288))))
        gain = np.maximum(1.0 + self.prnu * random.standard_normal(shape), 0.0)
        dark = self.dsnu_electrons * random.standard_normal(shape)
        drawn = random.random(shape)
        hot, dead = drawn < self.hot_share, drawn > 1.0 - self.dead_share
        levels = random.uniform(LEAST_HOT, 1.0, shape) * full_well_electrons
        return PixelPattern(np.where(dead, 0.0, gain), np.where(hot, levels, np.where(dead, 0.0, dark)))


ALIKE = PixelErrors()
"""A sensor whose pixels are all as they should be."""
