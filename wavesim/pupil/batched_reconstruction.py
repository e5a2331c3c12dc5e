"""The linearised reconstruction for many lenses whose path changes are polynomials, with derivatives.

The path change on a meridian is a polynomial in the object coordinate x and the nominal cosine p for each
plane (:mod:`wavesim.pupil.meridian`). If its coefficients are known, a perturbed lens needs no rays.
Correlations of found and true object are those of
:meth:`wavesim.pupil.linearised_reconstruction.LinearisedReconstruction.correlations`, in single precision.
Their derivatives with respect to the coefficients follow by adjoint differentiation. Intensities depend on a
part of the path change, to which a calibration fits its parameters. The square of this part is a quadratic
form of the coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.pupil.linearised_reconstruction import DARK, FINER, JUDGED, LinearisedReconstruction
from wavesim.pupil.meridian import ORDERS, MeridianPlane
from wavesim.pupil.pupil import ComplexArray

TERMS = (ORDERS[0] + 1) * (ORDERS[1] + 1)
"""Number of polynomial terms x^i p^j of one plane; i runs fastest."""


def polynomial_terms(x: Array, p: Array) -> Array:
    """Return the terms x^i p^j at some points, shape (points, TERMS).

    Parameters
    ----------
    x : ndarray, shape (points,)
        Object coordinate over half the length of the line.
    p : ndarray, shape (points,)
        Nominal direction cosine over the numerical aperture.
    """
    return np.stack([x**i * p**j for j in range(ORDERS[1] + 1) for i in range(ORDERS[0] + 1)], axis=1)


@dataclass(frozen=True, eq=False)
class BatchedReconstruction:
    """The reconstruction on a meridian for a batch of lenses.

    The lenses are given by the coefficients of their path changes in waves. The coefficients of all planes
    follow each other, `TERMS` for each plane.

    Attributes
    ----------
    reconstruction : LinearisedReconstruction
        The reconstruction on the meridian.
    """

    reconstruction: LinearisedReconstruction

    def correlations(self, coefficients: Array, derivatives: bool = False) -> tuple[Array, Array]:
        """Return the mean correlation of found and true objects for each lens.

        Parameters
        ----------
        coefficients : ndarray, shape (lenses, terms)
            Path change of each lens, in waves.
        derivatives : bool
            Whether to compute derivatives, which take twice the time of the correlations.

        Returns
        -------
        correlations : ndarray, shape (lenses,)
        by : ndarray, shape (lenses, terms)
            Derivatives with respect to the coefficients; zeros if they are not computed.
        """
        found, by = np.empty(len(coefficients)), np.zeros(coefficients.shape)
        # Lenses whose fields are held at one time.
        block = 16
        for start in range(0, len(coefficients), block):
            part = slice(start, start + block)
            found[part], by[part] = self._block(coefficients[part], derivatives)
        return found, by

    @cached_property
    def visible(self) -> Array:
        """Quadratic form of the squared visible path change (:meth:`LinearisedReconstruction.visible`)."""
        reconstruction = self.reconstruction
        pairs = zip(reconstruction.meridian.planes, reconstruction.noise, strict=True)
        blocks = [self._visible(plane, noise) for plane, noise in pairs]
        total = np.zeros((TERMS * len(blocks),) * 2)
        for k, block in enumerate(blocks):
            own = slice(k * TERMS, (k + 1) * TERMS)
            total[own, own] = block
        return total

    def _block(self, coefficients: Array, derivatives: bool) -> tuple[Array, Array]:
        own = coefficients.reshape(len(coefficients), len(self._planes), ORDERS[1] + 1, ORDERS[0] + 1)
        fields = [[plane.field(c) for plane, c in zip(self._planes, one, strict=True)] for one in own]
        sums = [[p.phasors @ p.plane.objects for p in one] for one in fields]
        changes = np.array([np.concatenate([np.abs(s) for s in one]) for one in sums]) - self._nominal
        signals = self._true[:, :, None] + self._finding @ changes.transpose(2, 1, 0)
        correlations, by_signal = registered(signals, self._true)
        if not derivatives:
            return correlations.mean(axis=0), np.zeros(coefficients.shape)
        # Derivatives of the mean correlation with respect to all amplitudes, shape (objects, pixels, lenses).
        by_amplitude = np.real(np.swapaxes(self._finding, 1, 2) @ by_signal.conj()) / len(self._true)
        by = []
        for k, (one, field) in enumerate(zip(fields, sums, strict=True)):
            first, parts = 0, []
            for plane, values in zip(one, field, strict=True):
                rows = slice(first, first + len(values))
                parts.append(plane.by_coefficients(values, by_amplitude[:, rows, k].T))
                first = rows.stop
            by.append(np.concatenate(parts))
        return correlations.mean(axis=0), np.array(by)

    @cached_property
    def _planes(self) -> list[_SinglePlane]:
        return [_SinglePlane(plane, self.reconstruction) for plane in self.reconstruction.meridian.planes]

    @cached_property
    def _nominal(self) -> Array:
        return np.concatenate([np.abs(plane.matrix @ plane.objects) for plane in self._planes])

    @cached_property
    def _passed(self) -> ComplexArray:
        """Transmitted objects where they are compared, minus the mean; shape (judged, samples)."""
        meridian = self.reconstruction.meridian
        judged = np.abs(meridian.coordinates_mm) <= 0.5 * JUDGED * meridian.length_mm
        passed = self.reconstruction.passed[judged]
        return np.asarray(passed - passed.mean(axis=0))

    @cached_property
    def _true(self) -> ComplexArray:
        """Each object as it is compared, shape (objects, judged)."""
        return np.asarray((self._passed @ self.reconstruction.objects).T)

    @cached_property
    def _finding(self) -> ComplexArray:
        """Change of each reconstructed object due to amplitude changes; shape (objects, judged, pixels)."""
        return np.stack([(self._passed @ one).astype(np.complex64) for one in self.reconstruction.solutions])

    def _visible(self, plane: MeridianPlane, noise: float) -> Array:
        weights = np.abs(plane.matrix) ** 2 / noise**2
        total = np.maximum(weights.sum(axis=1), np.finfo(float).tiny)
        across, down = ORDERS[0] + 1, ORDERS[1] + 1
        meridian, moments = self.reconstruction.meridian, []
        powers = np.vander(meridian.coordinates_mm / (0.5 * meridian.length_mm), 2 * ORDERS[0] + 1, True)
        for order in range(2 * ORDERS[1] + 1):
            if order:
                weights = weights * plane.cosines
            moments.append(weights @ powers)
        sums = np.array([one.sum(axis=0) for one in moments])
        j, i = (part.ravel() for part in np.mgrid[:down, :across])
        means = np.concatenate([one[:, :across] for one in moments[:down]], axis=1) / np.sqrt(total)[:, None]
        return np.asarray(sums[j[:, None] + j, i[:, None] + i] - means.T @ means)


def registered(found: ComplexArray, true: ComplexArray) -> tuple[Array, ComplexArray]:
    """Return the largest correlation of signals with true ones over the shift between them.

    Parameters
    ----------
    found : ndarray, shape (objects, samples, lenses)
    true : ndarray, shape (objects, samples)

    Returns
    -------
    correlations : ndarray, shape (objects, lenses)
    by : ndarray, shape (objects, samples, lenses)
        Derivatives with respect to the real part of the found signals, plus i times those with respect to the
        imaginary part.
    """
    width = true.shape[1]
    spectrum = np.fft.fft(true, 2 * width)[:, :, None]
    product = np.fft.fft(found, 2 * width, axis=1) * spectrum.conj()
    padded = np.zeros((len(true), 2 * FINER * width, found.shape[2]), product.dtype)
    padded[:, :width], padded[:, -width:] = product[:, :width], product[:, width:]
    likeness = FINER * np.fft.ifft(padded, axis=1)
    places = np.argmax(np.abs(likeness), axis=1)[:, None]
    peak = np.take_along_axis(likeness, places, axis=1)
    size, own = (np.maximum(np.linalg.norm(a, axis=1), 1e-30) for a in (found, true))
    correlations = np.abs(peak[:, 0]) / (size * own[:, None])
    turns = np.fft.fftfreq(2 * width)[:, None] * places / FINER
    moved = np.fft.ifft(spectrum * np.exp(-2j * np.pi * turns), axis=1)[:, :width]
    phase = peak / np.maximum(np.abs(peak), 1e-30)
    by = phase * moved / (size * own[:, None])[:, None] - (correlations / size**2)[:, None] * found
    return correlations, np.asarray(by)


@dataclass(frozen=True, eq=False)
class _Field:
    """Elements of a plane's matrix through one perturbed lens."""

    plane: _SinglePlane
    phasors: ComplexArray

    def by_coefficients(self, fields: ComplexArray, by_amplitude: Array) -> Array:
        """Return derivatives by the coefficients from those by the amplitudes, shape (pixels, objects)."""
        size = np.abs(fields)
        along = by_amplitude * fields.conj() / np.maximum(size, DARK * size.max())
        both = along.astype(np.complex64) @ self.plane.objects.T
        both *= self.phasors
        slopes, found = np.ascontiguousarray(-both.imag), []
        for order in range(ORDERS[1] + 1):
            if order:
                slopes *= self.plane.cosines
            found.append(slopes.sum(axis=0) @ self.plane.powers)
        return 2.0 * np.pi * np.concatenate(found)


class _SinglePlane:
    """Model of one plane in single precision."""

    def __init__(self, plane: MeridianPlane, reconstruction: LinearisedReconstruction) -> None:
        meridian = reconstruction.meridian
        self.matrix = plane.matrix.astype(np.complex64)
        self.cosines = plane.cosines.astype(np.float32)
        self.objects = reconstruction.objects.astype(np.complex64)
        self.powers = np.vander(meridian.coordinates_mm / (0.5 * meridian.length_mm), ORDERS[0] + 1, True)

    def field(self, coefficients: Array) -> _Field:
        """Return the elements through a lens, for coefficients of shape (orders of p, orders of x)."""
        along = (2.0 * np.pi * coefficients @ self.powers.T).astype(np.float32)
        path = np.empty(self.cosines.shape, np.float32)
        path[...] = along[-1]
        for row in along[-2::-1]:
            path *= self.cosines
            path += row
        phasors: ComplexArray = np.zeros(path.shape, np.complex64)
        np.cos(path, out=phasors.real)
        np.sin(path, out=phasors.imag)
        phasors *= self.matrix
        return _Field(self, phasors)
