"""Information of frames about an object: how many of its unknowns the frames determine, against their noise.

The measured amplitudes, divided by their standard deviations, are linearised about an object::

    d(amplitude / sigma) = J x,   x = L w,   w ~ N(0, a^2)

L limits independent random numbers w to the band of the lens and then to the field stop. This is the prior:
nothing is known about the object but its band, its stop and its strength. Frames determine a direction of w
with the singular value s of J L better than the prior if s a > 1. The best linear estimate leaves the
variance a^2 / (1 + s^2 a^2) of it [1]_. The sum of s^2 a^2 / (1 + s^2 a^2) over all directions is the number
of degrees of freedom for signal. Each direction is weighted here by its energy inside the stop, so that the
total is the number of unknowns. The mean squared error, as a fraction of the object's variance, is then

    error = 1 - determined / unknowns,   correlation = sqrt(1 - error).

No estimate that uses this prior alone can be better on average. The correlation is a limit by noise: it holds
near the true object, and says nothing on whether iterations find it.

J is too large for its singular values where an object has thousands of unknowns. The error is a quadratic
form of (1 + a^2 L* J* J L)^-1 with a random vector. `LANCZOS_STEPS` steps of the Lanczos method give lower
and upper bounds of it by Gauss and Gauss-Radau quadrature [2]_. :func:`singular_values` computes all of them
for small objects.

References
----------
.. [1] C. D. Rodgers, "Inverse Methods for Atmospheric Sounding", World Scientific (2000), chapter 2.
.. [2] G. H. Golub and G. Meurant, "Matrices, Moments and Quadrature with Applications", Princeton University
   Press (2010), chapter 7.
.. [3] D. L. Donoho and I. M. Johnstone, "Ideal spatial adaptation by wavelet shrinkage", Biometrika 81, 425
   (1994): the risk of a threshold is at most 1 + threshold^2 times the variance of the noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.analysis.oversampling import ObjectKind, real_unknowns
from lensdesign.errors import validate_choice
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.linear_model import LinearModel
from wavesim.scene.engine import Engine
from wavesim.sensor.measurement import Measurement

LANCZOS_STEPS = 30
"""Steps of the Lanczos method, each with one forward and one adjoint use of the engine."""


@dataclass(frozen=True)
class Information:
    """Information of frames about an object.

    Attributes
    ----------
    unknowns : float
        Real unknowns of the object in the field stop.
    error, error_bound : float
        Lower and upper bound of the mean squared error that noise leaves, over the variance of the object.
    """

    unknowns: float
    error: float
    error_bound: float

    @property
    def fraction(self) -> float:
        """Fraction of the unknowns that the frames determine; the middle of its bounds."""
        return 1.0 - 0.5 * (self.error + self.error_bound)

    @property
    def determined(self) -> float:
        """Number of unknowns that the frames determine (degrees of freedom for signal)."""
        return self.unknowns * self.fraction

    @property
    def correlation(self) -> float:
        """Correlation at the middle of the bounds of the error, for an object without structure."""
        return math.sqrt(max(self.fraction, 0.0))

    @property
    def least_correlation(self) -> float:
        """Correlation at the upper bound of the error."""
        return math.sqrt(max(1.0 - self.error_bound, 0.0))

    def as_dict(self) -> dict[str, float]:
        """Return all values for JSON."""
        return {
            "unknowns": self.unknowns,
            "determined": self.determined,
            "fraction_determined": self.fraction,
            "least_error": math.sqrt(max(self.error, 0.0)),
            "correlation_of_noise": self.correlation,
        }


class WhitenedJacobian:
    """Derivative of measured amplitudes, over their standard deviations, with respect to random numbers w.

    Parameters
    ----------
    engine, illumination, recorded, fill_factor
        See :func:`wavesim.reconstruct`. All planes need standard deviations.
    transmission
        The object about which the chain is linearised.
    kind
        "amplitude", "phase" or "complex".
    inside
        Mask of the samples inside the field stop.
    """

    def __init__(
        self,
        engine: Engine,
        illumination: Field,
        recorded: Sequence[Measurement],
        transmission: Field,
        kind: ObjectKind,
        inside: NDArray[np.bool_],
        fill_factor: float = 1.0,
    ) -> None:
        validate_choice("kind", kind, ("amplitude", "phase", "complex"))
        self.kind, self.inside, self.scene = kind, inside, engine.scene
        values = np.where(inside, transmission.values, 0.0).astype(illumination.values.dtype)
        model = ChannelModel.of_source(engine, illumination, recorded, None, fill_factor)
        fitted = LinearModel(model, values, fits_scale=True)
        self.linear = LinearModel(model.with_scale(fitted.scale), values, fits_scale=False)
        weights = [
            np.ones(p.amplitude.shape) if w is None else w
            for p, w in zip(recorded, model.weights, strict=True)
        ]
        roots = np.sqrt(np.stack(weights))
        sigma = np.stack([np.asarray(plane.sigma) for plane in recorded])
        # The linear model returns root of the weight times amplitude over its size.
        known = roots > 0.0  # the deviation of other pixels is infinite
        self._whitening = np.divide(
            self.linear.size, roots * np.where(known, sigma, 1.0), out=np.zeros(roots.shape), where=known
        ).astype(np.float32)
        lens, grid = engine.scene.lens, engine.scene.object_grid
        cutoff = 1e3 * lens.object.numerical_aperture / engine.scene.wavelength_um
        frequencies = [scipy.fft.fftfreq(count, grid.pitch_mm) for count in grid.shape]
        self.band: NDArray[np.bool_] = np.add.outer(frequencies[0] ** 2, frequencies[1] ** 2) <= cutoff**2
        own = values[inside]
        self._unit = 1j * np.exp(1j * np.angle(values)) if kind == "phase" else None
        if kind == "phase":
            angles = np.angle(own / (np.mean(own) or 1.0))
            variance = float(np.var(angles))
        else:
            variance = float(np.mean(np.abs(own - np.mean(own)) ** 2))
        parts = 2.0 if kind == "complex" else 1.0
        self.deviation = math.sqrt(variance / parts / float(self.band.mean()))
        """Standard deviation of the random numbers that gives the variance of the object."""

    def limited(self, numbers: NDArray[Any]) -> NDArray[Any]:
        """Return L w: numbers limited to the band, and then to the stop."""
        values = scipy.fft.ifft2(np.where(self.band, scipy.fft.fft2(numbers), 0.0))
        return np.where(self.inside, values if self.kind == "complex" else values.real, 0.0)

    def limited_adjoint(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the adjoint of :meth:`limited`."""
        found = scipy.fft.ifft2(np.where(self.band, scipy.fft.fft2(np.where(self.inside, values, 0.0)), 0.0))
        return found if self.kind == "complex" else found.real

    def forward(self, numbers: NDArray[Any]) -> NDArray[np.floating[Any]]:
        """Return a J L w for numbers w of unit deviation."""
        change = self.deviation * self.limited(numbers)
        if self._unit is not None:
            change = self._unit * change
        changes = self.linear.jacobian_times_object(change.astype(np.complex64))
        return np.asarray(self._whitening * changes)

    def adjoint(self, changes: NDArray[np.floating[Any]]) -> NDArray[Any]:
        """Return the adjoint of :meth:`forward`."""
        on_object = self.linear.adjoint_to_object((self._whitening * changes).astype(np.float32))
        if self._unit is not None:
            on_object = np.conj(self._unit) * on_object
        return self.deviation * self.limited_adjoint(on_object if self.kind == "complex" else on_object.real)


def information_of(
    jacobian: WhitenedJacobian, *, shrinkage: float = 0.0, steps: int = LANCZOS_STEPS, seed: int = 0
) -> Information:
    """Return the information of frames about an object.

    Parameters
    ----------
    jacobian
        Derivative of the measured amplitudes.
    shrinkage
        Threshold, in standard deviations of the noise, below which an estimate such as the total variation
        removes detail. The variance of the noise counts 1 + shrinkage^2 times [3]_.
    steps
        Steps of the Lanczos method.
    seed
        Seed of the random vector. The error of the result by this draw is about (2 / unknowns)^(1/2).
    """
    random = np.random.default_rng(seed)
    shape = jacobian.inside.shape
    draw: NDArray[Any] = random.standard_normal(shape)
    if jacobian.kind == "complex":
        draw = draw + 1j * random.standard_normal(shape)
    start = jacobian.limited_adjoint(draw)
    diagonal, off_diagonal = _lanczos(lambda w: jacobian.adjoint(jacobian.forward(w)), start, steps)
    scene = jacobian.scene
    # Diameter of the disc with the area of all samples inside the stop.
    diameter_mm = 2.0 * math.sqrt(np.count_nonzero(jacobian.inside) * scene.object_grid.cell / math.pi)
    unknowns = real_unknowns(
        jacobian.kind, diameter_mm, scene.lens.object.numerical_aperture, (scene.wavelength_um,)
    )
    lower, upper = _quadratures(*(part / (1.0 + shrinkage**2) for part in (diagonal, off_diagonal)))
    return Information(unknowns, lower, upper)


def singular_values(jacobian: WhitenedJacobian) -> NDArray[np.float64]:
    """Return the singular values s a of the linearised chain, largest first, by a dense matrix.

    The matrix has a row for each pixel and a column for each real unknown of the grid. Use it for objects of
    some hundred unknowns.
    """
    shape, size = jacobian.inside.shape, jacobian.inside.size
    units: list[complex] = [1.0, 1j] if jacobian.kind == "complex" else [1.0]
    columns = []
    for unit in units:
        for index in range(size):
            numbers = np.zeros(size, complex if jacobian.kind == "complex" else float)
            numbers[index] = unit if jacobian.kind == "complex" else 1.0
            columns.append(jacobian.forward(numbers.reshape(shape)).ravel())
    matrix = np.stack(columns).astype(float)
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(matrix @ matrix.T)[::-1], 0.0)))


def _lanczos(
    operator: Callable[[NDArray[Any]], NDArray[Any]], start: NDArray[Any], steps: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return diagonal and off-diagonal of the tridiagonal matrix, with full reorthogonalisation."""
    vectors = [start / _length(start)]
    diagonal, off_diagonal = [], []
    for _ in range(steps):
        image = operator(vectors[-1])
        diagonal.append(_product(vectors[-1], image))
        for _ in range(2):
            for vector in vectors:
                image = image - _product(vector, image) * vector
        length = _length(image)
        off_diagonal.append(length)
        if length <= 1e-6 * max(diagonal):
            break
        vectors.append(image / length)
    return np.array(diagonal), np.array(off_diagonal)


def _quadratures(diagonal: NDArray[np.float64], off_diagonal: NDArray[np.float64]) -> tuple[float, float]:
    """Return lower and upper bound of the quadratic form of 1 / (1 + x).

    They are the Gauss and the Gauss-Radau quadrature with a node at 0.
    """
    count = len(diagonal)
    matrix = np.diag(diagonal) + np.diag(off_diagonal[:-1], 1) + np.diag(off_diagonal[:-1], -1)
    first = np.eye(count)[0]
    lower = float(np.linalg.solve(np.eye(count) + matrix, first)[0])
    if count == 1 or off_diagonal[-1] <= 1e-6 * float(diagonal.max()):
        return lower, lower
    # The last element of the extended matrix makes 0 one of its eigenvalues.
    last = float(off_diagonal[-1]) ** 2 * float(np.linalg.lstsq(matrix, np.eye(count)[-1], rcond=None)[0][-1])
    extended = np.zeros((count + 1, count + 1))
    extended[:count, :count], extended[count, count] = matrix, last
    extended[count, count - 1] = extended[count - 1, count] = off_diagonal[-1]
    upper = float(np.linalg.solve(np.eye(count + 1) + extended, np.eye(count + 1)[0])[0])
    return lower, min(max(upper, lower), 1.0)


def _product(one: NDArray[Any], other: NDArray[Any]) -> float:
    return float(np.vdot(one, other).real)


def _length(values: NDArray[Any]) -> float:
    return math.sqrt(_product(values, values))
