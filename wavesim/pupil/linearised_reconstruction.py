"""Expected loss of an object's content in a reconstruction by the nominal lens, from a linearised model.

Random objects on a meridian (:mod:`wavesim.pupil.meridian`), under even light in a field stop, give
amplitudes `A = |E t|` on the sensor's planes, with shot noise. Near each object the reconstruction is linear:
an error dA of the amplitudes changes the object found by::

    dt = (J* W J + 1 / tau^2)^-1 J* W dA,     J = Re(conj(E t) E / |E t|).

W are weights by the noise of each plane, tau is the standard deviation of objects, and dt is real for an
amplitude object. The scale of the amplitudes is free. dA is not linearised: it follows from the full phases
of the perturbed lens. An effect that intensities cannot show, such as a phase that depends on the sensor
point only, therefore costs nothing. Information that the object absorbs is lost. An effect that the object
cannot absorb, such as phase for an amplitude object, costs little. Light and field stop are known. An
apparent displacement of both therefore reduces the correlation, although an object alone could be displaced.

The loss is 1 minus the correlation of found and true object. Both are compared as the lens transmits them,
without their means, and registered laterally.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_choice, validate_positive
from wavesim.fields.plane_waves import TURN, phasor_of
from wavesim.pupil.meridian import Meridian
from wavesim.pupil.pupil import ComplexArray
from wavesim.scene.settings import Kind

OBJECTS, SEED = 6, 0
"""Number of random objects over which the loss is averaged, and their seed."""

BARS_UM, BAR_EVERY_UM = (0.7, 3.0), 10.0
"""Range of the bars' widths, with three bars of each width, and length of the line for each set of bars."""

WITHIN, JUDGED = 0.72, 0.92
"""Fractions of the line that contain sets of bars, and in which objects are compared."""

DEPTH, PHASE_RAD, CLEAR = 0.9, 1.2, 0.4
"""Reduction of amplitude by bars of an amplitude object; phase and reduction by those of a complex one."""

FINER = 8
"""Number of trial shifts per sample in the registration of objects."""

DARK = 1e-9
"""Fraction of the largest amplitude below which the phase of an amplitude is undefined."""


@dataclass(frozen=True, eq=False)
class LinearisedReconstruction:
    """The linearised model on a meridian, from random objects to the objects that a reconstruction finds.

    Attributes
    ----------
    meridian : Meridian
        Lens, line and planes.
    kind : {"amplitude", "complex"}
        Kind of the object.
    electrons : float
        Electrons in the brightest pixel of each plane.

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    meridian: Meridian
    kind: Kind = "amplitude"
    electrons: float = 1e4

    def __post_init__(self) -> None:
        validate_choice("kind", self.kind, ("amplitude", "complex"))
        validate_positive("electrons", self.electrons)

    @cached_property
    def objects(self) -> Array | ComplexArray:
        """Random objects: bars of many widths, shape (samples, objects)."""
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
        """Standard deviation of the amplitudes of each plane, whose brightest pixel has `electrons`."""
        light = [np.abs(plane.matrix.sum(axis=1)).max() for plane in self.meridian.planes]
        return tuple(float(0.5 * brightest / np.sqrt(self.electrons)) for brightest in light)

    @cached_property
    def nominal(self) -> Array:
        """Amplitudes through the nominal lens, shape (pixels of all planes, objects)."""
        return self.amplitudes(None)

    def amplitudes(self, waves: Sequence[Array] | None) -> Array:
        """Return the amplitudes of all objects, with a path change (:meth:`Meridian.waves`) or without."""
        parts = []
        for number, plane in enumerate(self.meridian.planes):
            matrix = plane.matrix
            if waves is not None:
                matrix = matrix * phasor_of(TURN * waves[number], np.complex64)
            parts.append(np.abs(matrix @ self.objects))
        return np.concatenate(parts)

    @cached_property
    def passed(self) -> ComplexArray:
        """Matrix from an object to the part that the lens transmits, shape (samples, samples)."""
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
        """Return the part of a path change that affects intensities, weighted by the noise.

        It is the path change minus its mean over the object at each pixel.

        Parameters
        ----------
        waves
            Path change of each plane in waves (:meth:`Meridian.waves`).

        Returns
        -------
        ndarray, shape (elements of all planes,)
            Weighted path change.
        """
        parts = []
        for plane, noise, path in zip(self.meridian.planes, self.noise, waves, strict=True):
            weights = np.abs(plane.matrix) ** 2
            total = np.maximum(weights.sum(axis=1, keepdims=True), np.finfo(float).tiny)
            mean = np.sum(weights * path, axis=1, keepdims=True) / total
            parts.append((np.abs(plane.matrix) / noise * (path - mean)).ravel())
        return np.concatenate(parts)

    def correlations(self, waves: Sequence[Array]) -> Array:
        """Return the correlation of each object with the one found through a lens with a path change."""
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


def expected_loss(
    reconstructions: Sequence[LinearisedReconstruction], waves: Sequence[Sequence[Array]]
) -> float:
    """Return 1 minus the expected correlation of an object in the plane.

    The losses on perpendicular meridians add.

    Parameters
    ----------
    reconstructions
        One reconstruction for each meridian.
    waves
        Path change of each reconstruction in waves (:meth:`Meridian.waves`).

    Returns
    -------
    float
        Loss, 0 to 1.
    """
    if not reconstructions:
        raise InputError("expected_loss: needs one meridian at least")
    errors = [
        np.mean(one.correlations(path)) ** -2 - 1.0 for one, path in zip(reconstructions, waves, strict=True)
    ]
    return float(1.0 - 1.0 / np.sqrt(1.0 + max(sum(errors), 0.0)))


def registered_correlations(found: Array | ComplexArray, true: Array | ComplexArray) -> Array:
    """Return the largest correlation of pairs of signals over the shift between them.

    Parameters
    ----------
    found, true : ndarray, shape (pairs, samples)
        Signals without their means.
    """
    count, width = found.shape
    product = np.fft.fft(found, 2 * width) * np.fft.fft(true, 2 * width).conj()
    padded = np.zeros((count, 2 * FINER * width), complex)
    padded[:, :width], padded[:, -width:] = product[:, :width], product[:, width:]
    sizes = np.linalg.norm(found, axis=1) * np.linalg.norm(true, axis=1)
    largest = FINER * np.abs(np.fft.ifft(padded)).max(axis=1)
    return np.asarray(np.where(sizes > 0.0, largest / np.maximum(sizes, np.finfo(float).tiny), 0.0))
