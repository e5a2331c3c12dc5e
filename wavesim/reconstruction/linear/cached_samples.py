"""What pixels see of many changes of one field: its own samples are made once.

Products with a change take the samples of both (:mod:`wavesim.reconstruction.recording.pixel_means`), and the
way back those of the field: half of all transforms along rows are of the field that stays as it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.fields.plane_waves import TransferFunction
from wavesim.fields.tilted_propagator import Way
from wavesim.reconstruction.recording.kernel import (
    add_halves,
    halves,
    means_along_columns,
    means_along_rows,
    multiply_spread,
)
from wavesim.reconstruction.recording.pixel_means import PixelMeans, add_rows_back, half_sample
from wavesim.runtime.threads import for_blocks, rows_in

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]
Rows = tuple[ComplexArray, ComplexArray]


class CachedSamples:
    """A field on the pixels of a plane.

    Parameters
    ----------
    pixels
        Of the plane.
    spectrum
        Of the field in front of the way.
    way
        To the plane.
    """

    def __init__(self, pixels: PixelMeans, spectrum: ComplexArray, way: Way) -> None:
        self.pixels, self.way = pixels, way
        self.rows: Rows = pixels.carried(spectrum, way)
        dtype, (height, width) = spectrum.dtype, spectrum.shape
        self._up, self._across = (half_sample(count, dtype) for count in (height, width))
        self._taps = np.array(pixels.taps, dtype.type(0).real.dtype)
        self._samples = tuple(self._sampled(part) for part in self.rows)

    def intensity(self) -> RealArray:
        """Each pixel's mean intensity, never negative."""
        return self._means(self._samples, 0.0)

    def products(self, spectrum: ComplexArray) -> RealArray:
        """Each pixel's mean of Re(conj(u) v), with the spectrum of a change v in front of the way."""
        return self.products_with(self.pixels.carried(spectrum, self.way))

    def products_with(self, others: Rows) -> RealArray:
        """The same, with a change on the plane itself, as :meth:`PixelMeans.carried` gives it."""
        return self._means(tuple(self._sampled(part) for part in others), -np.inf)

    def add_back(self, change: RealArray, total: ComplexArray) -> None:
        """Add the adjoint of :meth:`products` to a spectrum in front of the way."""
        if not isinstance(self.way, TransferFunction):
            self.pixels.add_back((self.rows[0].copy(), self.rows[1].copy()), change, self.way, total)
            return
        taps, half = 2 * self._taps, self._taps.dtype.type(0.5)
        spread: Rows = (np.empty_like(total), np.empty_like(total))
        for between, own, part in zip((False, True), self._samples, spread, strict=True):

            def block(
                start: int, stop: int, own: Rows = own, part: ComplexArray = part, between: bool = between
            ) -> None:
                even, odd = (samples[start:stop].copy() for samples in own)
                multiply_spread(even, odd, change, start, between, taps)
                even, odd = (scipy.fft.fft(one, axis=1, overwrite_x=True) for one in (even, odd))
                add_halves(even, odd, self._across, half, part[start:stop])

            for_blocks(block, len(part), rows_in(part[0].nbytes))
        add_rows_back(spread, self.way, self._up, total)

    def _sampled(self, part: ComplexArray) -> Rows:
        """In the middles of pixels and at their upper edges, from the spectrum along each row."""
        even, odd = np.empty_like(part), np.empty_like(part)

        def block(start: int, stop: int) -> None:
            own = part[start:stop]
            both = np.empty_like(own), np.empty_like(own)
            halves(own, self._across, *both)
            for one, samples in zip(both, (even, odd), strict=True):
                samples[start:stop] = scipy.fft.ifft(one, axis=1, overwrite_x=True)

        for_blocks(block, len(part), rows_in(part[0].nbytes))
        return even, odd

    def _means(self, others: tuple[Rows, ...], least: float) -> RealArray:
        along = tuple(np.empty(part.shape, self._taps.dtype) for part in self.rows)
        for own, theirs, means in zip(self._samples, others, along, strict=True):

            def block(
                start: int, stop: int, own: Rows = own, theirs: Rows = theirs, means: RealArray = means
            ) -> None:
                here = (one[start:stop] for one in (*own, *theirs))
                means_along_rows(*here, self._taps, means[start:stop])

            for_blocks(block, len(means), rows_in(self.rows[0][0].nbytes))
        result, bound = np.empty_like(along[0]), self._taps.dtype.type(least)
        for_blocks(lambda a, b: means_along_columns(*along, self._taps, bound, result, a, b), len(result), 64)
        return result
