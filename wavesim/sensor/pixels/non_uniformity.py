"""Simulated errors of pixels: their gain, dark signal and linearity, and hot and dead pixels.

The terms are those of EMVA standard 1288: PRNU is the spread of the gain, DSNU that of the dark signal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from wavesim.scene.system_state import validate_nonlinearity

LEAST_HOT = 0.1
"""Least dark signal of a hot pixel, as a fraction of full well; the largest is full well."""


@dataclass(frozen=True, eq=False)
class PixelPattern:
    """Gain, dark signal and linearity of each pixel, equal in every frame.

    Attributes
    ----------
    gain : ndarray, shape (ny, nx)
        Gain relative to that of an ideal pixel.
    dark_electrons : ndarray, shape (ny, nx)
        Dark signal relative to the mean dark count, in electrons; can be negative.
    nonlinearity : float
        Nonlinearity of all pixels, see :class:`wavesim.FrameSettings`.
    """

    gain: Array
    dark_electrons: Array
    nonlinearity: float = 0.0

    def of(self, intensity: Array, rows: slice) -> tuple[Array, Array]:
        """Return the intensity times gain, and the dark electrons, of a range of rows."""
        return intensity[rows] * self.gain[rows], self.dark_electrons[rows]

    def signal(self, electrons: Array, largest: float) -> Array:
        """Return the electrons that the camera seems to record.

        Parameters
        ----------
        electrons
            True electrons.
        largest
            Electrons of the largest count.
        """
        if not self.nonlinearity:
            return electrons
        root = np.sqrt(np.maximum(1.0 + 4.0 * self.nonlinearity / largest * electrons, 0.0))
        return np.asarray(2.0 * electrons / (1.0 + root))


@dataclass(frozen=True)
class PixelErrors:
    """Statistics of the errors of a sensor's pixels.

    Attributes
    ----------
    prnu : float
        Relative standard deviation of the gain.
    dsnu_electrons : float
        Standard deviation of the dark signal, in electrons.
    hot_share, dead_share : float
        Fractions of hot and dead pixels. Without light, hot pixels have a signal between the fraction
        `LEAST_HOT` of full well and full well. Dead pixels have no signal.
    seed : int
        Seed of the pattern.
    nonlinearity : float
        Nonlinearity of all pixels, see :class:`wavesim.FrameSettings`.

    Raises
    ------
    InputError
        If a value is outside its range.
    """

    prnu: float = 0.0
    dsnu_electrons: float = 0.0
    hot_share: float = 0.0
    dead_share: float = 0.0
    seed: int = 0
    nonlinearity: float = 0.0

    def __post_init__(self) -> None:
        for name, limit in (("prnu", 1.0), ("dsnu_electrons", math.inf)):
            if not 0.0 <= getattr(self, name) < limit:
                raise InputError(f"{name} = {getattr(self, name)!r}: must be from 0 to below {limit:g}")
        validate_nonlinearity(self.nonlinearity)
        if not (min(self.hot_share, self.dead_share) >= 0.0 and self.hot_share + self.dead_share <= 1.0):
            raise InputError(
                f"hot_share = {self.hot_share!r}, dead_share = {self.dead_share!r}: must be fractions of "
                "the pixels, together at most 1"
            )

    def pattern(self, shape: tuple[int, ...], full_well_electrons: float) -> PixelPattern | None:
        """Return the pattern of a sensor of a shape (ny, nx); None if all pixels are ideal."""
        if self == replace(ALIKE, seed=self.seed):
            return None
        # A separate random stream, because the noise of the frames uses the same seed.
        random = np.random.Generator(np.random.PCG64(np.random.SeedSequence((self.seed, 1288))))
        gain = np.maximum(1.0 + self.prnu * random.standard_normal(shape), 0.0)
        dark = self.dsnu_electrons * random.standard_normal(shape)
        drawn = random.random(shape)
        hot, dead = drawn < self.hot_share, drawn > 1.0 - self.dead_share
        levels = random.uniform(LEAST_HOT, 1.0, shape) * full_well_electrons
        dark = np.where(hot, levels, np.where(dead, 0.0, dark))
        return PixelPattern(np.where(dead, 0.0, gain), dark, self.nonlinearity)


ALIKE = PixelErrors()
"""Errors of a sensor with ideal pixels: none."""
