"""Mean intensity on the pixels of a sensor, from a field whose rows come band by band.

Exact for light that its samples hold. The reconstruction's square
(:mod:`wavesim.reconstruction.recording.pixel_means`) is another on purpose: what is reconstructed from
simulated frames shall not rest on the very model that made them. On a frame of the 1/32 twin the two differ
by 0.05 %.
"""

from __future__ import annotations

from enum import Flag, auto
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import DTypeLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Sensor
from wavesim.runtime.inventory import ArrayGroup
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import row_blocks


class Phase(Flag):
    """What imaging does at one time: make the light, or carry it through the lens and record it."""

    LIGHTING = auto()
    CARRYING = auto()


class PixelLight:
    """Adds up a field's intensity over the squares of pixels: along rows as they come, along columns at last.

    Light of a field in single precision is kept so: of a whole sensor, all else would take gigabytes.

    Parameters
    ----------
    sensor : Sensor
        Pitch and number of pixels.
    dtype : numpy dtype
        Of the field.
    oversampling : int
        Samples per pixel along each axis.
    fill_factor : float
        Side of a pixel's photosensitive square, as a share of the pitch.
    scratch : Scratch, optional
        Where the light lies.

    Attributes
    ----------
    caught : float
        Sum of |u|^2 over all samples so far.
    """

    def __init__(
        self,
        sensor: Sensor,
        dtype: DTypeLike,
        oversampling: int,
        fill_factor: float,
        scratch: Scratch | None = None,
    ) -> None:
        self._oversampling, self._fill_factor = oversampling, fill_factor
        across, down = sensor.pixels
        self._shape = (down, across)
        light = light_across(sensor, dtype, oversampling)
        self._kept = light.dtype
        self._across = (scratch or Scratch()).make(light)
        self.caught = 0.0

    def add(self, rows: slice, values: NDArray[np.complexfloating[Any, Any]]) -> None:
        """Take some rows of samples.

        Parameters
        ----------
        rows
            Of the sensor's samples.
        values
            The field there, over the sensor's width.
        """
        for block in row_blocks(len(values)):
            intensity = np.abs(values[block]).astype(float) ** 2
            self.caught += float(intensity.sum())
            means = means_over_pixels(intensity, self._oversampling, self._fill_factor)
            self._across[rows.start + block.start : rows.start + block.stop] = means

    def means(self) -> Array:
        """Mean intensity on each pixel's square, shape (ny, nx), once all rows are there."""
        means = np.empty(self._shape, self._kept)
        for columns in row_blocks(self._shape[1]):
            lines = self._across[:, columns].T.astype(float)
            means[:, columns] = means_over_pixels(lines, self._oversampling, self._fill_factor).T
        # Means of a band-limited function that is never negative may pass 0 by rounding and at clipped edges.
        return np.maximum(means, 0.0, out=means)


def light_across(sensor: Sensor, dtype: DTypeLike, oversampling: int) -> ArrayGroup:
    """Light of a field of a type, summed along rows alone."""
    (across, down), single = sensor.pixels, np.dtype(dtype) == np.complex64
    shape, kept = (down * oversampling, across), np.float32 if single else np.float64
    return ArrayGroup("light on rows of pixels", shape, kept, Phase.CARRYING, lies="scratch")


def means_over_pixels(fine: Array, oversampling: int, fill_factor: float) -> Array:
    """Means over pixels along the last axis, by the pixel's transfer on a cosine series.

    The series continues the light mirrored at the window's borders, so that nothing wraps around. At the
    pixels' middles cosines of higher order than there are pixels look like lower ones: these are summed.
    """
    if oversampling == 1:
        return fine
    pixels = fine.shape[-1] // oversampling
    order = np.arange(fine.shape[-1])
    series = scipy.fft.dct(fine, axis=-1) * np.sinc(0.5 * fill_factor * order / pixels)
    folded = np.zeros((*fine.shape[:-1], pixels))
    for part in range(oversampling):
        block = series[..., part * pixels : (part + 1) * pixels]
        sign = (1.0, -1.0, -1.0, 1.0)[part % 4]
        if part % 2:
            folded[..., 1:] += sign * block[..., :0:-1]
        else:
            folded += sign * block
            if part:  # the series counts its constant once, all others twice
                folded[..., 0] += sign * block[..., 0]
    return np.asarray(scipy.fft.idct(folded, axis=-1) / oversampling)
