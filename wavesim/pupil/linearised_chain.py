"""How much of an object a reconstruction by the nominal lens is expected to lose, from the linearised chain.

Random objects on a meridian (:mod:`wavesim.pupil.meridian`), under even light in a field stop, give
amplitudes A = |E t| on the sensor's planes, with shot noise. About each object the reconstruction is linear:
amplitudes that are off by dA change what it finds by

    dt = (J* W J + 1 / tau^2)^-1 J* W dA,     J = Re(conj(E t) E / |E t|),

with weights W by the noise of each plane, tau how far objects scatter, and dt real for an amplitude object.
The scale of the amplitudes is free. dA is not linearised: it is that of the perturbed lens's full phases. So
what intensities cannot tell, such as phase that depends on the sensor's point alone, costs nothing; what the
object takes up is lost; what it cannot take up, the phase of an amplitude object, costs little. Light and
field stop are known: where they seem to move, the object suffers, though an object alone might as well be
elsewhere.

The loss is 1 less the correlation of found and true object, their means taken out, as the lens passes them,
registered sideways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_choice, validate_positive
from wavesim.pupil.meridian import Meridian
from wavesim.pupil.pupil import ComplexArray
from wavesim.scene.settings import Kind

OBJECTS, SEED = 6, 0
"""Random objects over which the loss is averaged."""

BARS_UM, BAR_EVERY_UM = (0.7, 3.0), 10.0
"""Widths of bars, three of a kind, and how many such sets there are along the line."""

WITHIN, JUDGED = 0.72, 0.92
"""Shares of the line in which sets of bars are, and in which objects are compared."""

DEPTH, PHASE_RAD, CLEAR = 0.9, 1.2, 0.4
"""Amplitude that bars of an amplitude object take; phase and amplitude that those of a complex one do."""

FINER = 8
"""Places at which objects are registered, for each sample."""

DARK = 1e-9
"""Of the largest amplitude: below it an amplitude has no direction."""


@dataclass(frozen=True, eq=False)
class LinearisedChain:
    """The chain on a meridian, from random objects to what a reconstruction finds.

    Attributes
    ----------
    meridian : Meridian
        Lens, line and planes.
    kind : {"amplitude", "complex"}
        Of the object.
    electrons : float
        In the brightest pixel of each plane.

    Raises
    ------
    InputError
        If a value is not usable.
    """

    meridian: Meridian
    kind: Kind = "amplitude"
    electrons: float = 1e4

    def __post_init__(self) -> None:
        validate_choice("kind", self.kind, ("amplitude", "complex"))
        validate_positive("electrons", self.electrons)

    @cached_property
    def objects(self) -> Array | ComplexArray:
        """Bars of many widths at random, shape (samples, objects)."""
        x_um, random = 1e3 * self.meridian.coordinates_mm, np.random.default_rng(SEED)
        length_um = 1e3 * self.meridian.length_mm
        bars = np.zeros((len(x_um), OBJECTS))
        for one in bars.T:
            for _ in range(max(2, int(length_um / BAR_EVERY_UM))):
                width, depth = random.uniform(*BARS_UM), random.uniform(CLEAR, 1.0)
                away = np.abs(x_um - random.uniform(-0.5, 0.5) * WITHIN * length_um)
                bar = (away < 0.5 * width) | (np.abs(away - 2.0 * width) < 0.5 * width)
                one[bar] = depth
        if self.kind == "amplitude":
            return 1.0 - DEPTH * bars
        return np.asarray((1.0 - CLEAR * bars) * np.exp(1j * PHASE_RAD * bars))

    @cached_property
    def noise(self) -> tuple[float, ...]:
        """Standard deviation of amplitudes on each plane, whose brightest pixel the light alone makes."""
        light = [np.abs(plane.matrix.sum(axis=1)).max() for plane in self.meridian.planes]
        return tuple(float(0.5 * brightest / np.sqrt(self.electrons)) for brightest in light)

    @cached_property
    def nominal(self) -> Array:
        """Amplitudes through the nominal lens, shape (pixels of all planes, objects)."""
        return self.amplitudes(None)

    def amplitudes(self, waves: Sequence[Array] | None) -> Array:
        """Amplitudes of all objects, with a change of path (:meth:`Meridian.waves`) or none."""
        parts = []
        for number, plane in enumerate(self.meridian.planes):
            matrix = plane.matrix
            if waves is not None:
                matrix = matrix * np.exp(2j * np.pi * waves[number])
            parts.append(np.abs(matrix @ self.objects))
        return np.concatenate(parts)

    @cached_property
    def passed(self) -> ComplexArray:
        """Part of an object that the lens transmits, shape (samples, samples)."""
        planes = self.meridian.planes
        return np.asarray(sum(p.matrix.conj().T @ p.matrix for p in planes) / len(planes))

    @cached_property
    def solutions(self) -> list[Array | ComplexArray]:
        """Change of each reconstructed object for a change of amplitudes; shape (samples, pixels)."""
        planes = self.meridian.planes
        matrix = np.concatenate([plane.matrix for plane in planes])
        counts = [len(plane.matrix) for plane in planes]
        weights = np.repeat(1.0 / np.array(self.noise), counts)
        # Standard deviation of objects about what one expects.
        object_deviation = 0.3
        prior = np.append(
            np.full(matrix.shape[1] * (1 if self.kind == "amplitude" else 2), object_deviation**-2), 0.0
        )
        found = []
        for values, amplitude in zip(self.objects.T, self.nominal.T, strict=True):
            field = matrix @ values
            along = field.conj() / np.maximum(amplitude, DARK * amplitude.max())
            slope = along[:, None] * matrix
            parts = [slope.real] if self.kind == "amplitude" else [slope.real, -slope.imag]
            # The last column is the unknown scale.
            slopes = np.column_stack([*parts, amplitude]) * weights[:, None]
            solved = np.linalg.solve(slopes.T @ slopes + np.diag(prior), slopes.T) * weights
            count = matrix.shape[1]
            found.append(solved[:count] if len(parts) == 1 else solved[:count] + 1j * solved[count:-1])
        return found

    def visible(self, waves: Sequence[Array]) -> Array:
        """Change of path that affects intensities: minus its mean over the object at each pixel, weighted.

        Returns
        -------
        ndarray, shape (elements of all planes,)
        """
        parts = []
        for plane, noise, path in zip(self.meridian.planes, self.noise, waves, strict=True):
            weights = np.abs(plane.matrix) ** 2
            total = np.maximum(weights.sum(axis=1, keepdims=True), np.finfo(float).tiny)
            mean = np.sum(weights * path, axis=1, keepdims=True) / total
            parts.append((np.abs(plane.matrix) / noise * (path - mean)).ravel())
        return np.concatenate(parts)

    def correlations(self, waves: Sequence[Array]) -> Array:
        """Correlation of each object with what is found of it through a lens with a change of path."""
        changes = (self.amplitudes(waves) - self.nominal).T
        x = self.meridian.coordinates_mm
        judged = np.abs(x) <= 0.5 * JUDGED * self.meridian.length_mm
        passed = self.passed[judged]
        pairs: tuple[list[Array], list[Array]] = [], []
        for values, change, solution in zip(self.objects.T, changes, self.solutions, strict=True):
            for own, signal in zip(pairs, (values + solution @ change, values), strict=True):
                own.append(passed @ signal)
        found, true = (np.array(own) - np.mean(own, axis=1, keepdims=True) for own in pairs)
        return registered_correlations(found, true)


def expected_loss(chains: Sequence[LinearisedChain], waves: Sequence[Sequence[Array]]) -> float:
    """1 less the correlation that is expected of an object in the plane.

    Errors of meridians at right angles to each other add.

    Parameters
    ----------
    chains
        One for each meridian.
    waves
        Change of path of each, as of :meth:`Meridian.waves`.

    Returns
    -------
    float
        From 0 to 1.
    """
    if not chains:
        raise InputError("expected_loss: needs one meridian at least")
    errors = [
        np.mean(chain.correlations(path)) ** -2 - 1.0 for chain, path in zip(chains, waves, strict=True)
    ]
    return float(1.0 - 1.0 / np.sqrt(1.0 + max(sum(errors), 0.0)))


def registered_correlations(found: Array | ComplexArray, true: Array | ComplexArray) -> Array:
    """Return the largest correlation of pairs of signals over the shift between them.

    Parameters
    ----------
    found, true : ndarray, shape (pairs, samples)
    """
    count, width = found.shape
    product = np.fft.fft(found, 2 * width) * np.fft.fft(true, 2 * width).conj()
    padded = np.zeros((count, 2 * FINER * width), complex)
    padded[:, :width], padded[:, -width:] = product[:, :width], product[:, width:]
    sizes = np.linalg.norm(found, axis=1) * np.linalg.norm(true, axis=1)
    largest = FINER * np.abs(np.fft.ifft(padded)).max(axis=1)
    return np.asarray(np.where(sizes > 0.0, largest / np.maximum(sizes, np.finfo(float).tiny), 0.0))
