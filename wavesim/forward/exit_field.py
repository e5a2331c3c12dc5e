"""The field behind the lens on the exit grid, measured data of planes, and the changes that planes
require.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.fields.propagator import PlanePropagator
from wavesim.forward.pixel_kernel import change_pixels, change_samples, weighted_products
from wavesim.forward.pixel_means import PixelMeans
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import for_blocks
from wavesim.sensor.measurement import Measurement

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]

ROWS = 64
"""Rows of a plane that a thread processes at a time."""

ALL_ROWS = slice(None)
"""Rows of the exit grid for planes that are reached through free space from the whole grid."""


class FitSums(NamedTuple):
    """Sums over some pixels.

    Attributes
    ----------
    squared_misfit : float
        Weighted sum of squared differences between modelled and measured amplitudes.
    cross, power : float
        Weighted sums of modelled times measured amplitudes, and of modelled intensities.
    """

    squared_misfit: float
    cross: float = 0.0
    power: float = 0.0


def sum_of_parts(parts: Iterable[FitSums]) -> FitSums:
    """Return the sums over all parts, added in their order."""
    return FitSums(*(sum(column) for column in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class PlaneRecord:
    """Measured data of a plane, in the model's precision; a line is one row.

    Attributes
    ----------
    propagator : TransferFunction or TiltedPropagator
        Propagator from the exit grid to the plane.
    rows : slice
        Rows of the exit grid that belong to the plane.
    amplitude, sigma, background : ndarray
        Measured amplitudes, their standard deviations (empty where all are equal) and background intensity
        (empty where there is none).
    full_weight_sigma : float
        Largest standard deviation of a pixel with weight 1.
    """

    propagator: PlanePropagator
    rows: slice
    amplitude: RealArray
    sigma: RealArray
    background: RealArray
    full_weight_sigma: float

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        propagator: PlanePropagator,
        rows: slice,
        full_weight_sigma: float,
        dtype: np.dtype[Any],
        scratch: Scratch,
    ) -> PlaneRecord:
        """Return the record of a measurement; arrays of another type are converted and lie in `scratch`."""

        def stored(values: RealArray, what: str) -> RealArray:
            values = np.atleast_2d(values)
            if values.dtype == dtype:
                return values
            result = scratch.array(values.shape, dtype, what)
            result[:] = values
            return result

        none = np.empty((0, 0), dtype)
        sigma = none if measurement.sigma is None else stored(measurement.sigma, "the standard deviations")
        background = (
            none if measurement.background is None else stored(measurement.background, "the backgrounds")
        )
        return cls(
            propagator,
            rows,
            stored(measurement.amplitude, "the recorded amplitudes"),
            sigma,
            background,
            full_weight_sigma,
        )

    @property
    def energy(self) -> float:
        """Weighted sum of squared measured amplitudes."""
        return sum(
            self._map_row_blocks(
                lambda block_rows: self._products(self.amplitude[block_rows] ** 2, block_rows)[0]
            )
        )

    def products(self, modelled: NDArray[Any]) -> tuple[float, float]:
        """Return weighted sums of modelled times measured amplitudes (without background), and of modelled
        powers.

        `modelled` holds intensities, or a field at points.
        """
        found = self._map_row_blocks(
            lambda block_rows: self._products(_power(modelled[block_rows]), block_rows)
        )
        return sum(cross for cross, _ in found), sum(power for _, power in found)

    def change_pixels(self, intensity: RealArray, scale: float) -> float:
        """Replace mean intensities of pixels by the relative changes of amplitude; return the squared
        misfit.
        """
        change = self.pixel_change(scale)
        return sum_of_parts(
            self._map_row_blocks(lambda block_rows: change(intensity[block_rows], block_rows.start))
        ).squared_misfit

    def pixel_change(
        self, scale: float, *, with_products: bool = False
    ) -> Callable[[RealArray, int], FitSums]:
        """Return a function that does the same as :meth:`change_pixels` for rows from a given index on.

        The function also returns the sums of :meth:`products` if `with_products` is set.
        """
        real = self.amplitude.dtype.type
        mean = float(np.vdot(self.amplitude, self.amplitude)) / self.amplitude.size / scale**2
        # It is added to measured and modelled means of pixels to bound their ratio.
        dark = real(1e-6 * mean)

        def rows(intensity: RealArray, first: int) -> FitSums:
            block_rows = slice(first, first + len(intensity))
            products = self._products(intensity, block_rows) if with_products else (0.0, 0.0)
            arguments = (*self._recorded(block_rows), real(scale), dark, self._background(block_rows))
            return FitSums(float(change_pixels(intensity, *arguments)), *products)

        return rows

    def change_samples(self, field: ComplexArray, scale: float) -> float:
        """Replace a field by the change that gives it the measured amplitudes; return the squared misfit."""
        factor = self.amplitude.dtype.type(scale)

        def rows(block_rows: slice) -> float:
            arguments = (*self._recorded(block_rows), factor, self._background(block_rows))
            return float(change_samples(field[block_rows], *arguments))

        return sum(self._map_row_blocks(rows))

    def _products(self, intensity: RealArray, block_rows: slice) -> tuple[float, float]:
        amplitude, *others = self._recorded(block_rows)
        if self.background.size:
            amplitude = np.sqrt(np.maximum(amplitude * amplitude - self.background[block_rows], 0.0))
        return weighted_products(intensity, amplitude, *others)

    def _background(self, block_rows: slice) -> RealArray:
        return self.background[block_rows] if self.background.size else self.background

    def _recorded(self, block_rows: slice) -> tuple[RealArray, RealArray, Any]:
        return (
            self.amplitude[block_rows],
            self.sigma[block_rows],
            self.amplitude.dtype.type(self.full_weight_sigma),
        )

    def _map_row_blocks(self, work: Callable[[slice], Any]) -> list[Any]:
        return for_blocks(lambda start, stop: work(slice(start, stop)), len(self.amplitude), ROWS)


class ExitField:
    """The field on the exit grid, and the changes that planes require, processed plane by plane.

    Parameters
    ----------
    values
        Values of the field; they are overwritten.
    pixels
        Pixels that integrate; None for samples at points.
    """

    def __init__(self, values: ComplexArray, pixels: PixelMeans | None) -> None:
        self.pixels = pixels
        self.values: ComplexArray | None = np.atleast_2d(values)
        self._spectrum: ComplexArray | None = None
        self._change: ComplexArray | None = None
        self._spectrum_change: ComplexArray | None = None
        self._total_change: ComplexArray | None = None
        self._pixel_rows: tuple[ComplexArray, ComplexArray] | None = None
        if pixels is not None:
            self._spectrum, self.values = self.spectrum, None

    @property
    def spectrum(self) -> ComplexArray:
        """Spectrum of the field, computed when it is first needed."""
        if self._spectrum is None:
            assert self.values is not None
            # Where pixels integrate, no plane needs the values themselves: the transform overwrites them.
            self._spectrum = scipy.fft.fftn(self.values, workers=-1, overwrite_x=self.pixels is not None)
        return self._spectrum

    def intensity(self, plane: PlaneRecord) -> RealArray:
        """Return the mean intensities of pixels on a plane, or those at points."""
        if self.pixels is not None:
            self._pixel_rows = self.pixels.propagate(self.spectrum, plane.propagator, self._pixel_rows)
            return self.pixels.intensity(self._pixel_rows)
        return _power(self._samples(plane))

    def replace_amplitudes(self, plane: PlaneRecord, scale: float, *, with_products: bool = False) -> FitSums:
        """Impose the amplitudes measured on a plane; return the squared misfit before, and sums of
        products.
        """
        if self.pixels is not None:
            self._pixel_rows = self.pixels.propagate(self.spectrum, plane.propagator, self._pixel_rows)
            if self._spectrum_change is None:
                self._spectrum_change = np.zeros_like(self.spectrum)
            change = plane.pixel_change(scale, with_products=with_products)
            return sum_of_parts(
                self.pixels.apply_change(self._pixel_rows, change, plane.propagator, self._spectrum_change)
            )
        field = self._samples(plane)
        products = plane.products(field) if with_products else (0.0, 0.0)
        sums = FitSums(plane.change_samples(field, scale), *products)
        if plane.rows != ALL_ROWS:
            if self._change is None:
                self._change = np.zeros_like(self.values)
            self._change[plane.rows] += field
        elif plane.propagator.is_identity:
            self._change = _sum_of(self._change, field)
        else:
            self._spectrum_change = _sum_of(self._spectrum_change, plane.propagator.adjoint(field))
        return sums

    def advance(self, fraction: float, weight: float = 1.0) -> None:
        """Move the field by a fraction of the collected change, and begin to collect a new one.

        The collected change enters the sum of all changes with a weight.
        """
        if self.pixels is not None:
            assert self._spectrum_change is not None
            change, field = self._spectrum_change, self.spectrum
            self._spectrum_change = None
        else:
            assert self.values is not None
            change, field = self._take_new_change(), self.values
            self._spectrum = None
        add_fraction(field, change, fraction)
        if weight != 1.0:
            change *= change.real.dtype.type(weight)
        self._total_change = _sum_of(self._total_change, change)

    def take_change(self) -> ComplexArray:
        """Return the sum of all changes on the exit grid; all arrays of this object are given up."""
        self.values = self._spectrum = self._pixel_rows = None
        total_change, self._total_change = self._total_change, None
        if total_change is None:
            return self._take_new_change()
        has_new = self._change is not None or self._spectrum_change is not None
        if self.pixels is None:
            return _sum_of(total_change, self._take_new_change()) if has_new else total_change
        if self._spectrum_change is not None:
            total_change += self._spectrum_change
            self._spectrum_change = None
        return np.asarray(scipy.fft.ifftn(total_change, workers=-1, overwrite_x=True))

    def _take_new_change(self) -> ComplexArray:
        """Return the change collected from the planes, on the exit grid, and clear it."""
        change, spectrum = self._change, self._spectrum_change
        self._change = self._spectrum_change = None
        if spectrum is None:
            assert change is not None
            return change
        return _sum_of(change, scipy.fft.ifftn(spectrum, workers=-1, overwrite_x=True))

    def _samples(self, plane: PlaneRecord) -> ComplexArray:
        if plane.propagator.is_identity:
            assert self.values is not None
            return self.values[plane.rows].copy()
        return plane.propagator.forward(self.spectrum)


def _power(modelled: NDArray[Any]) -> RealArray:
    """Return |field|^2; real values are intensities already."""
    return np.asarray(modelled.real**2 + modelled.imag**2 if np.iscomplexobj(modelled) else modelled)


def _sum_of(total: ComplexArray | None, change: ComplexArray) -> ComplexArray:
    return change if total is None else np.add(total, change, out=total)


def add_fraction(total: ComplexArray, change: ComplexArray, fraction: float) -> None:
    """Add a fraction of an array in blocks of rows, which need less memory than the product."""
    factor = total.real.dtype.type(fraction)

    def rows(start: int, stop: int) -> None:
        total[start:stop] += factor * change[start:stop]

    for_blocks(rows, len(total), ROWS)
