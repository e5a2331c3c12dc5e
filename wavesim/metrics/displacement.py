"""Displacements of a transmission: measured and removed, to a fraction of a sample, and their derivative."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.runtime.threads import row_blocks

Complex = NDArray[np.complexfloating[Any, Any]]


def displacement_samples(
    found: Complex, true: Complex, inside: NDArray[np.bool_]
) -> tuple[float, float] | None:
    """Return the displacement (x, y) of a transmission from another one, in samples.

    At this displacement the correlation of both is largest, over the samples that lie inside the mask before
    and after they are displaced. Only the middle of large fields is used.

    Parameters
    ----------
    found, true
        Complex transmissions, shape (ny, nx).
    inside
        Mask of the lit samples, shape (ny, nx).

    Returns
    -------
    tuple of float or None
        Displacement in samples; None if the transmissions do not determine it.
    """
    part = _middle(inside)
    known = inside[part]
    one, other = _without_mean(found[part], known), _without_mean(true[part], known)
    if one is None or other is None:
        return None
    # Largest displacement along each axis in samples; for small fields a quarter of their side.
    most_shift = 64
    reach = [min(most_shift, count // 4) for count in known.shape]
    overlap = _Overlap(one, other, known, reach)
    row, column, correlation = overlap.peak()
    # Smallest correlation of the displaced fields that determines their displacement.
    least_correlation = 0.3
    if not correlation >= least_correlation:
        return None
    return overlap.between_samples(row, column)


def displaced_back(values: Complex, displacement: tuple[float, float]) -> None:
    """Shift a field by minus a displacement (x, y) in samples, in place, with its Fourier series."""
    for axis, samples in enumerate(displacement[::-1]):
        count = values.shape[axis]
        ramp = np.exp(2j * np.pi * samples * scipy.fft.fftfreq(count))
        lines = values if axis == 1 else values.T
        for block in row_blocks(len(lines)):
            lines[block] = scipy.fft.ifft(scipy.fft.fft(lines[block], axis=1) * ramp, axis=1)


def displacement_changes(values: NDArray[Any], orders: int = 1) -> NDArray[Any]:
    """Return the change of a transmission per sample of displacement along x, and along y.

    The transmission goes on beyond its samples as in a mirror. The changes are derivatives of its cosine
    series, so that no detail within the band of the samples is weakened.

    Parameters
    ----------
    values : ndarray, shape (ny, nx)
        Real or complex transmission.
    orders
        Number of orders: the second has the Laplacians of the displacements, the third those of the second.

    Returns
    -------
    ndarray, shape (2 * orders, ny, nx)
        Changes for x and y, order by order.
    """
    angles = [(math.pi / n * np.arange(n)).astype(values.real.dtype) for n in values.shape]
    series = scipy.fft.dctn(values)
    laplacian = -(angles[0][:, None] ** 2 + angles[1] ** 2)
    changes = []
    for order in range(orders):
        for axis in (1, 0):
            # A sine series has no constant term: its coefficients begin with the second one.
            sines = np.roll(series * (angles[1] if axis == 1 else angles[0][:, None]), -1, axis=axis)
            np.moveaxis(sines, axis, 0)[-1] = 0.0
            changes.append(scipy.fft.idst(scipy.fft.idct(sines, axis=1 - axis), axis=axis))
        if order + 1 < orders:
            series = series * laplacian
    return np.stack(changes)


def inside_both(inside: NDArray[np.bool_], displacement: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the mask of samples that lie inside before and after they are displaced."""
    result = inside.copy()
    for axis, samples in enumerate(displacement[::-1]):
        steps = math.ceil(abs(samples)) * (1 if samples > 0.0 else -1)
        for step in {0, steps}:
            result &= np.roll(inside, -step, axis)
    x, y = (math.ceil(abs(one)) * (1 if one > 0.0 else -1) for one in displacement)
    return np.asarray(result & np.roll(inside, (-y, -x), (0, 1)))


def _middle(inside: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns of the middle of a mask."""
    parts = []
    # Largest number of samples along a side of the part that is used.
    most_samples = 512
    for axis in (0, 1):
        used = np.flatnonzero(inside.any(axis=1 - axis))
        first, last = (int(used[0]), int(used[-1]) + 1) if used.size else (0, inside.shape[axis])
        start = max(first, (first + last - most_samples) // 2)
        parts.append(slice(start, min(last, start + most_samples)))
    return parts[0], parts[1]


def _without_mean(values: Complex, inside: NDArray[np.bool_]) -> Complex | None:
    """Return a field minus its mean inside a mask, and 0 outside; None if the field is constant."""
    own = np.where(inside, values, 0.0).astype(np.complex64)
    size = float(np.linalg.norm(own))
    own -= np.where(inside, own.sum(dtype=complex) / max(int(inside.sum()), 1), 0.0).astype(np.complex64)
    detail = float(np.linalg.norm(own))
    # Smallest norm without the mean, relative to the norm, that determines a displacement.
    least_detail = 1e-4
    return own if math.isfinite(detail) and detail > least_detail * size else None


class _Overlap:
    """Correlation of two fields for displacements of the first, over the samples that are inside in both."""

    def __init__(self, one: Complex, other: Complex, inside: NDArray[np.bool_], reach: list[int]) -> None:
        shape = [scipy.fft.next_fast_len(n + most) for n, most in zip(inside.shape, reach, strict=True)]
        self.shape, self.reach = shape, reach
        mask = np.conj(scipy.fft.fft2(inside.astype(np.float32), shape))
        self.products = scipy.fft.fft2(one, shape) * np.conj(scipy.fft.fft2(other, shape))
        self.sizes = (
            scipy.fft.fft2(np.abs(one) ** 2, shape) * mask,
            np.conj(scipy.fft.fft2(np.abs(other) ** 2, shape)) * np.conj(mask),
        )
        self.least_product = 0.3 * float(np.linalg.norm(one)) * float(np.linalg.norm(other))

    def peak(self) -> tuple[int, int, float]:
        """Return the displacement by whole samples, along y and x, with the largest correlation."""
        rows, columns = (
            np.r_[0 : most + 1, count - most : count]
            for most, count in zip(self.reach, self.shape, strict=True)
        )
        sought = np.ix_(rows, columns)
        product = np.abs(scipy.fft.ifft2(self.products)[sought])
        sizes = [np.maximum(scipy.fft.ifft2(one)[sought].real, 0.0) for one in self.sizes]
        # Where little of either field remains, the correlation would depend on chance.
        correlation = product / np.maximum(np.sqrt(sizes[0] * sizes[1]), self.least_product)
        row, column = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
        y, x = (
            int(at) - (count if at > most else 0)
            for at, count, most in zip((rows[row], columns[column]), self.shape, self.reach, strict=True)
        )
        return y, x, float(correlation[row, column])

    def between_samples(self, row: int, column: int) -> tuple[float, float]:
        """Return the peak (x, y) to a fraction of a sample, from the Fourier series of the correlation."""
        from scipy.optimize import minimize

        cycles = [scipy.fft.fftfreq(count) for count in self.shape]

        def series(spectrum: Complex, down: Complex, across: Complex) -> complex:
            return complex(down @ (spectrum @ across))

        def loss(position: Any) -> float:
            waves = [np.exp(2j * np.pi * f * p) for f, p in zip(cycles, position, strict=True)]
            sizes = [series(one, *waves).real for one in self.sizes]
            return -abs(series(self.products, *waves)) / math.sqrt(max(sizes[0] * sizes[1], 1e-300))

        start = np.array([row, column], float)
        simplex = start + np.array([[0.0, 0.0], [0.4, 0.0], [0.0, 0.4]])
        options: Any = {"initial_simplex": simplex, "xatol": 2e-3, "fatol": 1e-8, "maxfev": 80}
        y, x = (float(one) for one in minimize(loss, start, method="Nelder-Mead", options=options).x)
        return x, y
