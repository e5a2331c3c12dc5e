"""Exposures: from intensity to the counts of a sensor and back, of one exposure or of several of one plane.

Electrons scatter as a Poisson law says, are clipped at full well, gain the amplifier's noise, and are rounded
to counts: the linear camera model of EMVA standard 1288. Of several exposures the long ones tell the faint
light and the short ones the bright light, in which the long ones are clipped.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices
from pydantic import Field as Setting

from lensdesign.common.arrays import Array
from lensdesign.common.section import Positive, Section
from lensdesign.errors import InputError, validate_positive
from wavesim.runtime.threads import row_blocks
from wavesim.sensor.frames import Bits, Counts, Frame, NotNegative, Offset
from wavesim.sensor.pixels import kernel
from wavesim.sensor.pixels.errors import PixelPattern

Seed = int | np.random.SeedSequence

CLEAR = 5.0
"""Standard deviations of read noise by which a pixel must stay below full well to count as not clipped. Of a
bright spot in a long exposure, next to none of the clipped pixels may pass for a thousandth of its light."""


class SaturationWarning(UserWarning):
    """A stated number of pixels is clipped, so that their intensity is only known to be larger."""


class Electronics(Section):
    """How a sensor turns light into counts.

    Attributes
    ----------
    full_well_electrons
        Most electrons that a pixel holds.
    read_noise_electrons
        Standard deviation of the amplifier's noise.
    bits
        Of a count.
    offset_counts
        Added to all counts, so that read noise of dark pixels is not clipped at 0.
    gain_electrons_per_count
        Electrons that raise a pixel by one count; if left out, full well reaches the top count.
    fill_factor
        Linear fill factor of a pixel: side of its photosensitive square over the pitch. 0 is a point. Files
        may also call it `active_width`.
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
        room = 2**self.bits - 1 - self.offset_counts
        if room <= 0.0:
            raise InputError(f"offset_counts = {self.offset_counts:g}: {self.bits} bits leave none for light")
        return self.full_well_electrons / room

    @property
    def saturation_counts(self) -> int:
        """From which count on a pixel may have been clipped, at full well or at the top count."""
        clear = self.full_well_electrons - CLEAR * self.read_noise_electrons
        return int(min(max(math.floor(self.offset_counts + clear / self.gain), 1), 2**self.bits - 1))


def exposure_for(intensity: Array, brightest_electrons: float) -> float:
    """Electrons per unit of intensity at which the brightest pixel is to hold a given number.

    Raises
    ------
    InputError
        If there is no light, or the number is not usable.
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
    """Counts of pixels on which a mean intensity falls.

    Parameters
    ----------
    intensity
        Not negative.
    exposure
        Electrons per unit of intensity.
    electronics
        Full well, noise and quantisation.
    seed
        Of the noise; None gives the counts of the mean, rounded, without noise.
    pattern
        Of pixels that are not alike.

    Returns
    -------
    ndarray of uint16, of the shape of `intensity`

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
        held, dark = (intensity[rows], 0.0) if pattern is None else pattern.of(intensity, rows)
        counts[rows], number = _exposed(held, dark, exposure, electronics, random)
        clipped += number
    if clipped:
        warnings.warn(
            f"{clipped} of {counts.size} pixels are saturated: expose less", SaturationWarning, stacklevel=2
        )
    return counts


def _exposed(
    intensity: Array,
    dark_electrons: Array | float,
    exposure: float,
    electronics: Electronics,
    random: np.random.Generator | None,
) -> tuple[Counts, int]:
    """Counts, and how many of them are clipped."""
    electrons = intensity.astype(float) * exposure
    if not (np.all(np.isfinite(electrons)) and np.all(electrons >= 0.0)):
        raise InputError("the electrons to expect must be finite and not negative in all pixels")
    full, top = electronics.full_well_electrons, 2**electronics.bits - 1
    if random is not None:
        # Beyond twice full well all is clipped, and Poisson numbers have no upper end.
        electrons = random.poisson(np.minimum(electrons, 2.0 * full + 100.0)).astype(float)
    electrons = electrons + dark_electrons
    clipped = electrons > full
    electrons = np.minimum(electrons, full)
    if random is not None:
        electrons += electronics.read_noise_electrons * random.standard_normal(electrons.shape)
    counts = np.rint(electrons / electronics.gain + electronics.offset_counts)
    number = int(np.count_nonzero(clipped | (counts > top)))
    return np.clip(counts, 0, top).astype(np.uint16), number


def _generator(seed: Seed) -> np.random.Generator:
    try:
        return np.random.Generator(np.random.PCG64(seed))
    except (TypeError, ValueError):
        raise InputError(f"seed = {seed!r}: must be a whole number from 0, or a SeedSequence") from None


def plane_seeds(seed: Seed | None, planes: int) -> Sequence[Seed | None]:
    """Independent seeds for frames of several planes: one seed for all would repeat the noise."""
    if seed is None:
        return [None] * planes
    return (seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)).spawn(planes)


def exposure_seeds(seed: Seed | None, exposures: int) -> Sequence[Seed | None]:
    """Independent seeds for several exposures of a plane, from the plane's; a single one takes that itself.

    Raises
    ------
    InputError
        If the seed is not usable.
    """
    if seed is None or exposures == 1:
        return [seed] * exposures
    _generator(seed)
    start = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    return start.spawn(exposures)


def estimate_intensity(frame: Frame) -> tuple[Array, Array]:
    """Intensity on each pixel and the variance of its error, from a frame.

    The variance is that of shot noise, read noise and rounding (one twelfth of a count squared). The
    estimate may be negative where it is dark, so that means are not biased.

    Returns
    -------
    intensity, variance : ndarray, shape (ny, nx)
        The variance is infinite in pixels that may have been clipped.
    """
    return merged_intensity((frame,))


def merged_intensity(frames: Sequence[Frame], rows: slice = slice(None)) -> tuple[Array, Array]:
    """Intensity on each pixel and the variance of its error, from one frame or several of one plane.

    Each frame in which a pixel is not clipped counts by the inverse of its variance there. That variance is
    taken from all of them, electrons over exposures, and not from each frame's own count: where few electrons
    fall, low counts would seem to be the surer ones, and the mean would come out too dark.

    A pixel that a long exposure just does not clip is known where its noise is low and left out where that
    is high: its mean is too dark by less than the standard deviation stated.

    Parameters
    ----------
    frames
        Of one size and plane; exposures, electronics and settings may differ.
    rows
        That are wanted.

    Returns
    -------
    intensity, variance : ndarray, shape (ny, nx)
        The variance is infinite in pixels that may have been clipped in all frames; the intensity there is
        that of the shortest exposure, which the true one exceeds.

    Raises
    ------
    InputError
        If there are no frames, or their sizes differ.
    """
    if not frames or len({frame.counts.shape for frame in frames}) > 1:
        raise InputError("frames of one plane: must be one at least, all of the same size")
    return stacked(frames, rows).merged()


class Stack(NamedTuple):
    """Rows of frames of one plane, the shortest exposure first.

    Attributes
    ----------
    electrons : ndarray, shape (n, ny, nx)
    known : ndarray of bool, shape (n, ny, nx)
        Neither clipped nor bad.
    shares : ndarray, shape (n, ny, nx)
        Exposure times gain in units of the longest exposure, so that squares of exposures of any unit stay
        finite.
    fixed : ndarray, shape (n,)
        Variance of electrons without light.
    longest : float
        Exposure.
    """

    electrons: Array
    known: NDArray[np.bool_]
    shares: Array
    fixed: Array
    longest: float

    def merged(self) -> tuple[Array, Array]:
        """As :func:`merged_intensity`."""
        intensity, variance = np.empty((2, *self.electrons.shape[1:]))
        kernel.merged(self.electrons, self.known, self.shares, self.fixed, intensity, variance)
        return intensity / self.longest, variance / self.longest / self.longest

    def contradicting(self, far: float, unlike: float) -> NDArray[np.bool_]:
        """Pixels whose intensity in an exposure and the next longer one differs too far.

        Parameters
        ----------
        far
            Standard deviations by which two may differ.
        unlike
            Share of the larger one by which they may differ beside that.
        """
        found = kernel.contradicting(self.electrons, self.known, self.shares, self.fixed, far, unlike)
        return np.asarray(found)


def stacked(frames: Sequence[Frame], rows: slice = slice(None)) -> Stack:
    """Frames of one plane and size, pixel by pixel."""
    ordered = sorted(frames, key=lambda frame: frame.settings.exposure)
    longest = ordered[-1].settings.exposure
    electrons = np.stack([electrons_of(frame, rows) for frame in ordered])
    shares = np.empty_like(electrons)
    for share, frame in zip(shares, ordered, strict=True):
        share[...] = frame.settings.exposure / longest * gain_of(frame, rows)
    known = np.stack([known_in(frame, rows) for frame in ordered])
    return Stack(electrons, known, shares, np.array([fixed_variance(frame) for frame in ordered]), longest)


def electrons_of(frame: Frame, rows: slice = slice(None)) -> Array:
    """Electrons that a frame's counts stand for, less the dark signal; below 0 where noise is."""
    settings = frame.settings
    electrons = (
        frame.counts[rows].astype(float) - settings.offset_counts
    ) * settings.gain_electrons_per_count
    if frame.maps is not None and frame.maps.dark_electrons is not None:
        electrons -= frame.maps.dark_electrons[rows]
    return electrons


def gain_of(frame: Frame, rows: slice = slice(None)) -> Array | float:
    """Gain of a frame's pixels over that of their mean."""
    return 1.0 if frame.maps is None or frame.maps.gain is None else frame.maps.gain[rows]


def known_in(frame: Frame, rows: slice = slice(None)) -> NDArray[np.bool_]:
    """Pixels of a frame that are not clipped, nor bad."""
    known = frame.counts[rows] < frame.settings.clipped_counts
    return np.asarray(known if frame.bad is None else known & ~frame.bad[rows])


def fixed_variance(frame: Frame) -> float:
    """Variance of a dark pixel's electrons: of read noise and of rounding."""
    settings = frame.settings
    return settings.read_noise_electrons**2 + settings.gain_electrons_per_count**2 / 12.0


def rounding_fraction(frame: Frame) -> float:
    """Fraction of a dark pixel's variance that comes from rounding to counts."""
    return frame.settings.gain_electrons_per_count**2 / 12.0 / fixed_variance(frame)


def clipped_in_all(frames: Sequence[Frame]) -> NDArray[np.bool_]:
    """Pixels that may have been clipped in every one of some frames, shape (ny, nx)."""
    return np.asarray(np.logical_and.reduce([frame.saturated for frame in frames]))
