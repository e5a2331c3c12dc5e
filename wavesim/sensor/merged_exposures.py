"""Intensity and its variance from the counts of a plane's frames, for one exposure or several.

With several exposures, the long ones measure faint light, and the short ones measure bright light that clips
the long ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from wavesim.sensor.frames import Frame
from wavesim.sensor.pixels import kernel


def estimate_intensity(frame: Frame) -> tuple[Array, Array]:
    """Return the intensity on each pixel and its variance, from one frame.

    The variance includes shot noise, read noise and rounding (one twelfth of a count squared). The estimate
    can be negative in dark pixels, so that means are unbiased.

    Returns
    -------
    intensity, variance : ndarray, shape (ny, nx)
        The variance is infinite in pixels that may be clipped.
    """
    return merged_intensity((frame,))


def merged_intensity(frames: Sequence[Frame], rows: slice = slice(None)) -> tuple[Array, Array]:
    """Return the intensity on each pixel and its variance, merged from one or more frames of one plane.

    Each frame in which a pixel is not clipped counts by the inverse of its variance there. That variance is
    taken from all of them, electrons over exposures, and not from each frame's own count: where few electrons
    fall, low counts would seem to be the surer ones, and the mean would come out too dark.

    A pixel that a long exposure just does not clip is known where its noise is low and left out where that
    is high: its mean is too dark by less than the standard deviation stated.

    Parameters
    ----------
    frames
        Frames of one size and plane; exposures and electronics may differ.
    rows
        Rows to return; default: all.

    Returns
    -------
    intensity, variance : ndarray, shape (ny, nx)
        The variance is infinite in pixels that may be clipped in all frames. Their intensity is that of the
        shortest exposure, a lower bound of the true one.

    Raises
    ------
    InputError
        If there are no frames, or their sizes differ.
    """
    if not frames or len({frame.counts.shape for frame in frames}) > 1:
        raise InputError("frames of one plane: must be one at least, all of the same size")
    return stacked(frames, rows).merged()


def fraction_per_intensity(frames: Sequence[Frame], rows: slice = slice(None)) -> Array:
    """Return the fraction of the camera's largest signal per unit of intensity, on each pixel.

    Several exposures are averaged by their shot noise, so that the longest one in which a pixel is known
    counts most. The result is 0 in pixels that are not known.

    Parameters
    ----------
    frames
        Frames of one plane.
    rows
        Rows to return; default: all.
    """
    total = weight = np.zeros(frames[0].counts[rows].shape)
    for frame in frames:
        settings, known = frame.settings, known_in(frame, rows)
        total = total + known * settings.exposure**2 / settings.top_electrons
        weight = weight + known * settings.exposure
    return np.divide(total, weight, out=np.zeros(total.shape), where=weight > 0.0)


class Stack(NamedTuple):
    """Pixels of all frames of one plane, ordered by exposure, shortest first.

    Attributes
    ----------
    electrons : ndarray, shape (n, ny, nx)
        Electrons without offset and dark signal.
    known : ndarray of bool, shape (n, ny, nx)
        True in pixels that are neither clipped nor bad.
    relative_exposures : ndarray, shape (n, ny, nx)
        Exposure times relative gain, in units of the longest exposure. This keeps squares finite.
    fixed : ndarray, shape (n,)
        Variance of the electrons of a dark pixel in each frame.
    longest : float
        Longest exposure.
    """

    electrons: Array
    known: NDArray[np.bool_]
    relative_exposures: Array
    fixed: Array
    longest: float

    def merged(self) -> tuple[Array, Array]:
        """Return intensity and variance, see :func:`merged_intensity`."""
        intensity, variance = np.empty((2, *self.electrons.shape[1:]))
        kernel.merged(self.electrons, self.known, self.relative_exposures, self.fixed, intensity, variance)
        return intensity / self.longest, variance / self.longest / self.longest

    def contradicting(self, far: float, unlike: float) -> NDArray[np.bool_]:
        """Return the mask of pixels whose intensities in two consecutive exposures contradict each other.

        Parameters
        ----------
        far
            Allowed difference in standard deviations of the noise.
        unlike
            Additional allowed difference, as a fraction of the larger intensity.
        """
        found = kernel.contradicting(
            self.electrons, self.known, self.relative_exposures, self.fixed, far, unlike
        )
        return np.asarray(found)


def stacked(frames: Sequence[Frame], rows: slice = slice(None)) -> Stack:
    """Return the stacked pixels of frames of one plane and size."""
    ordered = sorted(frames, key=lambda frame: frame.settings.exposure)
    longest = ordered[-1].settings.exposure
    electrons = np.stack([electrons_of(frame, rows) for frame in ordered])
    relative = np.empty_like(electrons)
    for values, frame in zip(relative, ordered, strict=True):
        values[...] = frame.settings.exposure / longest * gain_of(frame, rows)
    known = np.stack([known_in(frame, rows) for frame in ordered])
    return Stack(electrons, known, relative, np.array([fixed_variance(frame) for frame in ordered]), longest)


def electrons_of(frame: Frame, rows: slice = slice(None)) -> Array:
    """Return the electrons of a frame's pixels without dark signal, as a linear response would count them.

    Noise can make them negative.
    """
    settings = frame.settings
    electrons = (
        frame.counts[rows].astype(float) - settings.offset_counts
    ) * settings.gain_electrons_per_count
    if settings.nonlinearity:
        electrons *= 1.0 + settings.nonlinearity / settings.top_electrons * electrons
    if frame.maps is not None and frame.maps.dark_electrons is not None:
        electrons -= frame.maps.dark_electrons[rows]
    return electrons


def gain_of(frame: Frame, rows: slice = slice(None)) -> Array | float:
    """Return the gain of a frame's pixels relative to their mean."""
    return 1.0 if frame.maps is None or frame.maps.gain is None else frame.maps.gain[rows]


def known_in(frame: Frame, rows: slice = slice(None)) -> NDArray[np.bool_]:
    """Return the mask of pixels that are neither clipped nor bad."""
    known = frame.counts[rows] < frame.settings.clipped_counts
    return np.asarray(known if frame.bad is None else known & ~frame.bad[rows])


def fixed_variance(frame: Frame) -> float:
    """Return the variance of a dark pixel's electrons: read noise and rounding."""
    settings = frame.settings
    return settings.read_noise_electrons**2 + settings.gain_electrons_per_count**2 / 12.0


def rounding_fraction(frame: Frame) -> float:
    """Return the fraction of a dark pixel's variance that is due to rounding."""
    return frame.settings.gain_electrons_per_count**2 / 12.0 / fixed_variance(frame)


def clipped_in_all(frames: Sequence[Frame]) -> NDArray[np.bool_]:
    """Return the mask of pixels that may be clipped in all frames, shape (ny, nx)."""
    return np.asarray(np.logical_and.reduce([frame.saturated for frame in frames]))
