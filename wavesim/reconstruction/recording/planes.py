"""What a plane recorded, the field behind the lens as planes see it, and what they change of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.fields.tilted_propagator import Way
from wavesim.reconstruction.recording.kernel import change_pixels, change_samples, weighted_products
from wavesim.reconstruction.recording.pixel_means import PixelMeans
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import for_blocks
from wavesim.sensor.measurement import Measurement

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]

DARK = 1e-6
"""Of a plane's mean intensity: added to recorded and modelled means of pixels, to bound their ratio."""

ROWS = 64
"""Of a plane, for a thread at a time."""

EVERY_ROW = slice(None)
"""Of the field on the exit grid, for planes that are reached from all of it."""


class Told(NamedTuple):
    """Of some pixels: the misfit, and weighted sums of modelled times recorded amplitudes, and of powers."""

    missed: float
    met: float = 0.0
    own: float = 0.0


def total_of(parts: Iterable[Told]) -> Told:
    """Added up in their order."""
    return Told(*(sum(column) for column in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class PlaneRecord:
    """What was recorded on a plane, in the model's precision; a line is one row.

    `rows` of the field behind the lens are what the plane sees of it, the way from there included.
    `sigma` has no samples where all pixels are alike, `background` where there is none; up to `least` sigma
    weighs 1.
    """

    way: Way
    rows: slice
    amplitude: RealArray
    sigma: RealArray
    background: RealArray
    least: float

    @classmethod
    def of(
        cls, one: Measurement, way: Way, rows: slice, least: float, dtype: np.dtype[Any], scratch: Scratch
    ) -> PlaneRecord:
        def kept(values: RealArray, what: str) -> RealArray:
            values = np.atleast_2d(values)
            if values.dtype == dtype:
                return values
            result = scratch.array(values.shape, dtype, what)
            result[:] = values
            return result

        none = np.empty((0, 0), dtype)
        sigma = none if one.sigma is None else kept(one.sigma, "the standard deviations")
        background = none if one.background is None else kept(one.background, "the backgrounds")
        return cls(way, rows, kept(one.amplitude, "the recorded amplitudes"), sigma, background, least)

    @property
    def energy(self) -> float:
        """Weighted sum of squared amplitudes."""
        return sum(self._by_rows(lambda part: self._products(self.amplitude[part] ** 2, part)[0]))

    def products(self, seen: NDArray[Any]) -> tuple[float, float]:
        """Weighted sums of modelled times recorded amplitudes without background, and of modelled powers.

        `seen` are intensities, or a field at points.
        """
        found = self._by_rows(lambda part: self._products(_power(seen[part]), part))
        return sum(met for met, _ in found), sum(own for _, own in found)

    def change_pixels(self, intensity: RealArray, scale: float) -> float:
        """Replace pixels' mean intensities by the relative changes wanted; gives the misfit."""
        change = self.pixel_change(scale)
        return total_of(self._by_rows(lambda part: change(intensity[part], part.start))).missed

    def pixel_change(self, scale: float, *, weighs: bool = False) -> Callable[[RealArray, int], Told]:
        """What :meth:`change_pixels` does, of rows from a number on; it may tell :meth:`products`."""
        real = self.amplitude.dtype.type
        mean = float(np.vdot(self.amplitude, self.amplitude)) / self.amplitude.size / scale**2
        dark = real(DARK * mean)

        def rows(intensity: RealArray, first: int) -> Told:
            part = slice(first, first + len(intensity))
            products = self._products(intensity, part) if weighs else (0.0, 0.0)
            told = (*self._recorded(part), real(scale), dark, self._background(part))
            return Told(float(change_pixels(intensity, *told)), *products)

        return rows

    def change_samples(self, field: ComplexArray, scale: float) -> float:
        """Replace a field by the change wanted; gives the misfit."""
        factor = self.amplitude.dtype.type(scale)

        def rows(part: slice) -> float:
            told = (*self._recorded(part), factor, self._background(part))
            return float(change_samples(field[part], *told))

        return sum(self._by_rows(rows))

    def _products(self, intensity: RealArray, part: slice) -> tuple[float, float]:
        amplitude, *others = self._recorded(part)
        if self.background.size:
            amplitude = np.sqrt(np.maximum(amplitude * amplitude - self.background[part], 0.0))
        return weighted_products(intensity, amplitude, *others)

    def _background(self, part: slice) -> RealArray:
        return self.background[part] if self.background.size else self.background

    def _recorded(self, part: slice) -> tuple[RealArray, RealArray, Any]:
        return self.amplitude[part], self.sigma[part], self.amplitude.dtype.type(self.least)

    def _by_rows(self, work: Callable[[slice], Any]) -> list[Any]:
        return for_blocks(lambda start, stop: work(slice(start, stop)), len(self.amplitude), ROWS)


class ExitField:
    """The field on the exit grid, seen on one plane after the other, and what planes change of it.

    Parameters
    ----------
    values
        Of the field; used up.
    pixels
        None for samples at points.
    """

    def __init__(self, values: ComplexArray, pixels: PixelMeans | None) -> None:
        self.pixels = pixels
        self.values: ComplexArray | None = np.atleast_2d(values)
        self._spectrum: ComplexArray | None = None
        self._change: ComplexArray | None = None
        self._spectrum_change: ComplexArray | None = None
        self._done: ComplexArray | None = None
        self._rows: tuple[ComplexArray, ComplexArray] | None = None
        if pixels is not None:
            self._spectrum, self.values = self.spectrum, None

    @property
    def spectrum(self) -> ComplexArray:
        """Of the field; computed where it is first needed."""
        if self._spectrum is None:
            assert self.values is not None
            # The values themselves go where pixels integrate, for then no plane needs them.
            self._spectrum = scipy.fft.fftn(self.values, workers=-1, overwrite_x=self.pixels is not None)
        return self._spectrum

    def intensity(self, plane: PlaneRecord) -> RealArray:
        """On a plane: pixels' means, or at points."""
        if self.pixels is not None:
            self._rows = self.pixels.carried(self.spectrum, plane.way, self._rows)
            return self.pixels.intensity(self._rows)
        return _power(self._samples(plane))

    def replace(self, plane: PlaneRecord, scale: float, *, weighs: bool = False) -> Told:
        """Take the amplitudes recorded on a plane, and tell the misfit before, or products, too."""
        if self.pixels is not None:
            self._rows = self.pixels.carried(self.spectrum, plane.way, self._rows)
            if self._spectrum_change is None:
                self._spectrum_change = np.zeros_like(self.spectrum)
            change = plane.pixel_change(scale, weighs=weighs)
            return total_of(self.pixels.changed(self._rows, change, plane.way, self._spectrum_change))
        field = self._samples(plane)
        products = plane.products(field) if weighs else (0.0, 0.0)
        told = Told(plane.change_samples(field, scale), *products)
        if plane.rows != EVERY_ROW:
            if self._change is None:
                self._change = np.zeros_like(self.values)
            self._change[plane.rows] += field
        elif plane.way.is_none:
            self._change = _added(self._change, field)
        else:
            self._spectrum_change = _added(self._spectrum_change, plane.way.back(field))
        return told

    def go_on(self, share: float) -> None:
        """Go a share of the change, which counts as done, and begin a new one."""
        if self.pixels is not None:
            assert self._spectrum_change is not None
            change, field = self._spectrum_change, self.spectrum
            self._spectrum_change = None
        else:
            assert self.values is not None
            change, field = self._added_up(), self.values
            self._spectrum = None
        add_share(field, change, share)
        self._done = _added(self._done, change)

    def changed(self) -> ComplexArray:
        """The sum of all changes, at the exit; uses up all else, and keeps nothing."""
        self.values = self._spectrum = self._rows = None
        done, self._done = self._done, None
        if done is None:
            return self._added_up()
        if self.pixels is None:
            return _added(done, self._added_up())
        assert self._spectrum_change is not None
        done += self._spectrum_change
        self._spectrum_change = None
        return np.asarray(scipy.fft.ifftn(done, workers=-1, overwrite_x=True))

    def _added_up(self) -> ComplexArray:
        """What planes change, at the exit; keeps nothing of it."""
        change, spectrum = self._change, self._spectrum_change
        self._change = self._spectrum_change = None
        if spectrum is None:
            assert change is not None
            return change
        return _added(change, scipy.fft.ifftn(spectrum, workers=-1, overwrite_x=True))

    def _samples(self, plane: PlaneRecord) -> ComplexArray:
        if plane.way.is_none:
            assert self.values is not None
            return self.values[plane.rows].copy()
        return plane.way.there(self.spectrum)


def _power(seen: NDArray[Any]) -> RealArray:
    """Of a field; an intensity is one already."""
    return np.asarray(seen.real**2 + seen.imag**2 if np.iscomplexobj(seen) else seen)


def _added(total: ComplexArray | None, part: ComplexArray) -> ComplexArray:
    return part if total is None else np.add(total, part, out=total)


def add_share(total: ComplexArray, part: ComplexArray, share: float) -> None:
    """Add a share of a part, in blocks of rows: its product would be one more field."""
    factor = total.real.dtype.type(share)

    def rows(start: int, stop: int) -> None:
        total[start:stop] += factor * part[start:stop]

    for_blocks(rows, len(total), ROWS)
