"""Model of a camera: from the intensity on the pixels to counts, with shot noise, read noise and rounding.

The linear camera model of EMVA standard 1288 applies. Electrons have a Poisson distribution and are clipped
at full well; the amplifier adds noise; counts are rounded.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import AliasChoices
from pydantic import Field as Setting

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FrozenModel, Positive
from lensdesign.errors import InputError, validate_positive
from wavesim.runtime.threads import row_blocks
from wavesim.sensor.frames import Bits, Counts, NotNegative, Offset
from wavesim.sensor.pixels.non_uniformity import PixelPattern

Seed = int | np.random.SeedSequence


class SaturationWarning(UserWarning):
    """Warning that pixels are clipped, so that only a lower bound of their intensity is known."""


class Electronics(FrozenModel):
    """Conversion of light into counts by a sensor, after the linear camera model of EMVA standard 1288.

    Attributes
    ----------
    full_well_electrons
        Largest number of electrons in a pixel.
    read_noise_electrons
        Standard deviation of the amplifier's noise, in electrons.
    bits
        Bits of a count, 1 to 16; the largest count is 2**bits - 1.
    offset_counts
        Offset of all counts, which prevents clipping of dark noise at 0.
    gain_electrons_per_count
        Electrons that raise a pixel by one count. Default: full well gives the largest count.
    fill_factor
        Linear fill factor of a pixel (0 to 1): side of its photosensitive square over the pitch. A pixel of
        fill factor 0 is a point. Files may also use the key `active_width`.

    Examples
    --------
    >>> from wavesim import Electronics
    >>> camera = Electronics(full_well_electrons=10_000, bits=10, offset_counts=64)
    >>> round(camera.gain, 1), camera.saturation_counts
    (10.4, 1022)
    """

    full_well_electrons: Positive = 10_000.0
    read_noise_electrons: NotNegative = 2.0
    bits: Bits = 12
    offset_counts: Offset = 64.0
    gain_electrons_per_count: Positive | None = None
    fill_factor: Annotated[
        float, Setting(ge=0.0, le=1.0, validation_alias=AliasChoices("fill_factor", "active_width"))
    ] = 1.0

    @property
    def gain(self) -> float:
        """Electrons that raise a pixel by one count.

        Raises
        ------
        InputError
            If the offset leaves no counts for light.
        """
        if self.gain_electrons_per_count is not None:
            return self.gain_electrons_per_count
        available_counts = 2**self.bits - 1 - self.offset_counts
        if available_counts <= 0.0:
            raise InputError(
                f"offset_counts = {self.offset_counts:g}: must be below {2**self.bits - 1}, the "
                f"largest count of {self.bits} bits"
            )
        return self.full_well_electrons / available_counts

    @property
    def top_electrons(self) -> float:
        """Electrons of the largest count, for a linear response."""
        return (2**self.bits - 1 - self.offset_counts) * self.gain

    @property
    def saturation_counts(self) -> int:
        """Lowest count at which a pixel may be clipped: by full well, or by the largest count."""
        # Standard deviations of read noise that separate the clipping threshold from full well, so that read
        # noise hardly ever hides a clipped pixel.
        deviations = 5.0
        clear = self.full_well_electrons - deviations * self.read_noise_electrons
        return int(min(max(math.floor(self.offset_counts + clear / self.gain), 1), 2**self.bits - 1))


def exposure_for(intensity: Array, brightest_electrons: float) -> float:
    """Return the exposure, in electrons per unit of intensity, for a given number in the brightest pixel.

    Raises
    ------
    InputError
        If there is no light, or `brightest_electrons` is not positive.
    """
    validate_positive("brightest_electrons", brightest_electrons)
    brightest = float(np.max(intensity, initial=0.0))
    exposure = brightest_electrons / brightest if brightest > 0.0 else math.inf
    if not (math.isfinite(exposure) and exposure > 0.0):
        raise InputError(f"the brightest pixel's intensity is {brightest:g}: no light to expose for")
    return exposure


def expose(
    intensity: Array,
    exposure: float,
    electronics: Electronics,
    seed: Seed | None,
    pattern: PixelPattern | None = None,
) -> Counts:
    """Return the counts of pixels for a mean intensity.

    Parameters
    ----------
    intensity
        Mean intensity on each pixel, not negative.
    exposure
        Electrons per unit of intensity.
    electronics
        Full well, noise and quantisation.
    seed
        Seed of the noise; None gives the rounded mean counts without noise.
    pattern
        Gain, dark signal and linearity of each pixel; default: identical, linear pixels.

    Returns
    -------
    ndarray of uint16
        Counts, in the shape of `intensity`.

    Raises
    ------
    InputError
        If the electrons are negative or not finite, or the seed is invalid.

    Warns
    -----
    SaturationWarning
        If pixels are clipped, at full well or at the top count.
    """
    intensity = np.asarray(intensity)
    random = None if seed is None else _generator(seed)
    counts = np.empty(intensity.shape, np.uint16)
    clipped = 0
    for rows in row_blocks(len(intensity)):
        effective, dark = (intensity[rows], 0.0) if pattern is None else pattern.of(intensity, rows)
        electrons = _true_electrons(effective, exposure, electronics, random) + dark
        if pattern is not None:
            electrons = pattern.signal(electrons, electronics.top_electrons)
        counts[rows], clipped_in_rows = _read_out(electrons, electronics, random)
        clipped += clipped_in_rows
    if clipped:
        warnings.warn(
            f"{clipped} of {counts.size} pixels are saturated: reduce the exposure",
            SaturationWarning,
            stacklevel=2,
        )
    return counts


def _true_electrons(
    intensity: Array, exposure: float, electronics: Electronics, random: np.random.Generator | None
) -> Array:
    """Return the electrons that light releases in the pixels."""
    electrons = intensity.astype(float) * exposure
    if not (np.all(np.isfinite(electrons)) and np.all(electrons >= 0.0)):
        raise InputError("the expected electrons must be finite and not negative in all pixels")
    if random is not None:
        # Above twice full well every pixel clips; the limit keeps Poisson numbers in range.
        most = 2.0 * electronics.full_well_electrons + 100.0
        electrons = random.poisson(np.minimum(electrons, most)).astype(float)
    return electrons


def _read_out(
    electrons: Array, electronics: Electronics, random: np.random.Generator | None
) -> tuple[Counts, int]:
    """Return counts and the number of clipped pixels."""
    full, top = electronics.full_well_electrons, 2**electronics.bits - 1
    clipped = electrons > full
    electrons = np.minimum(electrons, full)
    if random is not None:
        electrons += electronics.read_noise_electrons * random.standard_normal(electrons.shape)
    counts = np.rint(electrons / electronics.gain + electronics.offset_counts)
    clipped_pixels = int(np.count_nonzero(clipped | (counts > top)))
    return np.clip(counts, 0, top).astype(np.uint16), clipped_pixels


def _generator(seed: Seed) -> np.random.Generator:
    try:
        return np.random.Generator(np.random.PCG64(seed))
    except (TypeError, ValueError):
        raise InputError(f"seed = {seed!r}: must be a whole number from 0, or a SeedSequence") from None


def plane_seeds(seed: Seed | None, planes: int) -> Sequence[Seed | None]:
    """Return independent seeds for the frames of several planes, so that their noise does not repeat."""
    if seed is None:
        return [None] * planes
    return (seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)).spawn(planes)


def exposure_seeds(seed: Seed | None, exposures: int) -> Sequence[Seed | None]:
    """Return independent seeds for the exposures of a plane; a single exposure uses the plane's seed.

    Raises
    ------
    InputError
        If the seed is invalid.
    """
    if seed is None or exposures == 1:
        return [seed] * exposures
    _generator(seed)
    start = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    return start.spawn(exposures)
