"""Mean intensity on the pixels of a sensor, from a field whose rows come band by band.

The integration is exact for light that is sampled adequately. The reconstruction deliberately uses another
model (:mod:`wavesim.forward.pixel_means`), so that a reconstruction of simulated frames does
not rely on the model that simulated them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import DTypeLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Sensor
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import row_blocks


class PixelLight:
    """Integrator of intensity over pixels: along rows as they arrive, and along columns at the end.

    Light of a single-precision field stays in single precision, which saves gigabytes for a whole sensor.

    Parameters
    ----------
    sensor : Sensor
        Pitch and number of pixels.
    dtype : numpy dtype
        Type of the field.
    oversampling : int
        Samples per pixel along each axis.
    fill_factor : float
        Linear fill factor of a pixel (0 to 1).
    scratch : Scratch, optional
        Storage of the light; default: memory.
    blur_pixels : float
        Standard deviation of a blur along x and y, in pixels, such as by vibration.

    Attributes
    ----------
    caught : float
        Sum of `|u|^2` over all samples so far.
    """

    def __init__(
        self,
        sensor: Sensor,
        dtype: DTypeLike,
        oversampling: int,
        fill_factor: float,
        scratch: Scratch | None = None,
        blur_pixels: float = 0.0,
    ) -> None:
        self._oversampling, self._fill_factor, self._blur_pixels = oversampling, fill_factor, blur_pixels
        across, down = sensor.pixels
        self._shape = (down, across)
        self._dtype = np.float32 if np.dtype(dtype) == np.complex64 else np.float64
        self._across = (scratch or Scratch()).array(
            (down * oversampling, across), self._dtype, "light on rows of pixels"
        )
        self.caught = 0.0

    def add(self, rows: slice, values: NDArray[np.complexfloating[Any, Any]]) -> None:
        """Add rows of samples.

        Parameters
        ----------
        rows
            Range of rows among the sensor's samples.
        values
            Field on these rows, over the sensor's width.
        """
        for block in row_blocks(len(values)):
            intensity = np.abs(values[block]).astype(float) ** 2
            self.caught += float(intensity.sum())
            means = self._means_along_rows(intensity)
            self._across[rows.start + block.start : rows.start + block.stop] = means

    def means(self) -> Array:
        """Return the mean intensity on each pixel's square, shape (ny, nx), after all rows were added."""
        means = np.empty(self._shape, self._dtype)
        for columns in row_blocks(self._shape[1]):
            lines = self._across[:, columns].T.astype(float)
            means[:, columns] = self._means_along_rows(lines).T
        # Rounding and clipped edges can make means of a non-negative function slightly negative.
        return np.maximum(means, 0.0, out=means)

    def _means_along_rows(self, fine: Array) -> Array:
        return means_over_pixels(fine, self._oversampling, self._fill_factor, self._blur_pixels)


def means_over_pixels(fine: Array, oversampling: int, fill_factor: float, blur_pixels: float = 0.0) -> Array:
    """Return means over pixels along the last axis: a cosine series times the transfer function of a pixel
    and of a blur.

    The cosine series continues the light by reflection at the window's borders, so that nothing wraps around.
    Sampled at the pixel centres, orders above the number of pixels are aliases of lower ones and are added.
    """
    if oversampling == 1:
        return fine
    pixels = fine.shape[-1] // oversampling
    cycles = 0.5 * np.arange(fine.shape[-1]) / pixels
    transfer = np.sinc(fill_factor * cycles) * np.exp(-2.0 * (np.pi * blur_pixels * cycles) ** 2)
    series = scipy.fft.dct(fine, axis=-1) * transfer
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
