"""Position and diameter of the field stop, from the frames themselves, with an object that nobody knows.

The middle of the light on a plane moves with the place of the lit object and with the direction of its light.
A small stop, moved and tilted in the model, gives these movements; the middles of the recorded light on all
planes then give a first position by least squares.

The Fourier transform of a plane's intensity is about the autocorrelation of the light on the object: where
the spectrum ends tells the diameter, whatever the object is.

From there a pattern search goes down the misfit of short reconstructions over position and diameter. The
first stage takes the misfit of the object 1, which falls from far away. Later stages take some iterations,
which tell the rim to a part of a sample. A stop that is too small lacks light, and one that is too large
leaves the object too free for so few iterations: both leave more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from wavesim.fields.field import Field
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.from_object import reconstruct
from wavesim.scene.bench import LightErrors
from wavesim.scene.engine import Engine
from wavesim.scene.settings import Kind
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement, noise_misfit

Array = NDArray[np.floating[Any]]

PROBE = 0.12
"""Diameter of the stop that is moved in the model to calibrate the movements of the light, over the patch."""

FAINT = 0.02
"""Of a plane's brightest intensity, below which light does not count for its middle: background and noise."""

TILT_DEG, TRUST_DEG = 0.2, 0.5
"""Tilt that is tried, and standard deviation of the direction of the light that is expected."""

TRUST_PIXELS = 1.0
"""Standard deviation that is expected of the middle of the light on a plane."""

PROBE_WIDTH, BINS, ABOVE_FLOOR = 0.3, 200, 0.3
"""Of the spectra's ends: diameter of the first probe over the patch, samples of the radial spectrum for a
cycle per pixel, and decades above what the noise leaves."""

STEEP = 0.8
"""Decades by which a spectrum falls over the last 15 % before its end."""

SPECTRAL_ERROR, BESIDE = 0.2, (0.9, 1.0, 1.1)
"""Relative error of the diameter that spectra tell, and diameters beside it that are tried."""

ASTRAY = 3.0
"""Misfit over that of the noise, from which on the position is sought first."""

DIAMETERS = (0.12, 0.17, 0.24, 0.34, 0.48, 0.68, 1.0)
"""Of the first stops that are tried, over the patch."""

FIRST, STAGES = (1, 0.25), ((6, 0.15), (6, 0.06), (15, 0.03))
"""Iterations of each stage, and its first step over the diameter."""

BESIDE_SHARE = 0.1
"""Of the diameter, by which the middles of the light must lie beside a stop for another one to be sought."""

FALLS = 0.95
"""Ratio of misfits below which another stop explains frames better."""

LEAST_STEP = 0.3
"""Of a sample, below which steps are not made smaller."""

DIRECTIONS = np.array(
    [[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0, 1], [-0.5, 0, 1], [0, 0.5, 1], [0, -0.5, 1]]
)
"""Of steps in x, y and diameter: the whole stop, its diameter, or one side of its rim alone."""

MOST_TRIALS = 60
"""In each stage."""


class FieldStop(NamedTuple):
    """A round field stop: its diameter and its middle (x, y) from the axis, in mm."""

    width_mm: float
    at_mm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class StopSearch:
    """The search for the field stop behind which the frames were taken.

    Parameters
    ----------
    engine, recorded, kind, scale, fill_factor, modes
        As of :func:`wavesim.reconstruct`.
    light_of
        The light on the object behind a field stop.
    patch_mm
        Side of the patch, which holds the stop.
    progress
        Called with a text for each stop that is tried.
    """

    engine: Engine
    recorded: Sequence[Measurement]
    light_of: Callable[[FieldStop], Field]
    patch_mm: float
    kind: Kind
    scale: float | None = None
    fill_factor: float = 0.0
    modes: Sequence[SourceMode] = ()
    progress: Callable[[str], None] = lambda text: None
    _tried: dict[tuple[FieldStop, int], float] = field(default_factory=dict, init=False, repr=False)

    def run(self, width_mm: float | None = None, at_mm: tuple[float, float] | None = None) -> FieldStop:
        """The stop that explains the frames best.

        Parameters
        ----------
        width_mm, at_mm
            Diameter or position where one of them is known; it stays as it is.
        """
        begin = self.start() if at_mm is None else at_mm
        free = np.array((at_mm is None, at_mm is None, width_mm is None))
        seen = self.width() if width_mm is None else width_mm
        if width_mm is not None:
            widths = [width_mm]
        elif seen is not None:
            widths = [seen * ratio for ratio in BESIDE]
        else:
            widths = [self.patch_mm * share for share in DIAMETERS]
        stops = [self._within(np.array([*begin, width])) for width in widths]
        iterations, step = FIRST
        best = min(stops, key=lambda stop: self.misfit(stop, iterations))
        first = self._pattern_search(best, iterations, step, free)
        if seen is None or abs(first.width_mm / seen - 1.0) < SPECTRAL_ERROR:
            stops.append(first)
        # An object that is dark or bends much light is far from 1, and leads the first stage astray.
        best = min(stops, key=lambda stop: self.misfit(stop, STAGES[0][0]))
        noise = noise_misfit(self.recorded) or 0.0
        if self.misfit(best, STAGES[0][0]) > ASTRAY * noise and at_mm is None:
            best = self._pattern_search(best, *STAGES[0], free & np.array((True, True, False)))
        for iterations, step in STAGES[1:]:
            best = self._pattern_search(best, iterations, step, free)
            if self.misfit(best, iterations) < ASTRAY * noise:
                break
        return best

    def width(self) -> float | None:
        """Diameter by the spectra of the planes' intensities; None where pixels do not resolve their end.

        The Fourier transform of an intensity far behind the object is the autocorrelation of the light on
        the object, whatever that is: it ends at the stop's diameter. A stop of known diameter with grains of
        random phase, recorded with the same noise, says where.
        """
        random, probe_mm = np.random.default_rng(0), PROBE_WIDTH * self.patch_mm
        seen = [_spectrum_end(plane.amplitude, plane.known) for plane in self.recorded]
        here = max((end for end in seen if end is not None), key=lambda end: end.height, default=None)
        if here is None:
            return None
        number = seen.index(here)
        for _ in range(2):
            light = self.light_of(self._within(np.array([0.0, 0.0, probe_mm])))
            grains = np.exp(1j * gaussian_filter(random.standard_normal(light.grid.shape), 1.5) * 8.0)
            model = ForwardModel(self.engine, light, self.recorded, None, self.fill_factor)
            plane = self.recorded[number]
            made = model.amplitudes(grains.astype(light.values.dtype))[number].astype(float)
            made *= math.sqrt(float((plane.amplitude.astype(float) ** 2).sum() / (made**2).sum()))
            if plane.sigma is not None:
                noise = np.where(np.isfinite(plane.sigma), plane.sigma, 0.0)
                made += noise * random.standard_normal(made.shape)
            end = _spectrum_end(made, plane.known)
            if end is None:
                return None
            # Once more with a probe of that size: the lens's map is not quite linear.
            probe_mm *= here.cycles / end.cycles
        return probe_mm if probe_mm < self.patch_mm else None

    def run_beside(self, stop: FieldStop) -> FieldStop | None:
        """A stop that explains the frames better than one does, or None.

        None is sought where the middles of the light and the ends of the spectra agree with the one given.
        """
        start, width = self.start(), self.width()
        is_aside = math.dist(start, stop.at_mm) > BESIDE_SHARE * stop.width_mm
        is_other = width is not None and abs(width / stop.width_mm - 1.0) > SPECTRAL_ERROR
        if not (is_aside or is_other):
            return None
        here, found = self.misfit(stop, STAGES[0][0]), self.run()
        return found if self.misfit(found, STAGES[0][0]) < FALLS * here else None

    def start(self) -> tuple[float, float]:
        """Where the middles of the light on all planes say that the stop is."""
        probe, step = PROBE * self.patch_mm, 0.25 * self.patch_mm
        scene = self.engine.scene
        axes = scene.exit_grid.y_mm, scene.exit_grid.x_mm

        def middles(light: Field) -> Array:
            model = ForwardModel(self.engine, light, self.recorded, None, self.fill_factor)
            made = model.amplitudes(model.lit.astype(light.values.dtype))
            return np.array([_middle(one, axes) for one in made])

        # Planes are displaced from the exit grid as their shifts say; the model has that in it already.
        here = self.light_of(FieldStop(probe, (0.0, 0.0)))
        base = middles(here)
        moved = (middles(self.light_of(FieldStop(probe, (step, 0.0)))) - base) / step
        tilted = (middles(LightErrors((TILT_DEG, 0.0)).on(here)) - base) / TILT_DEG
        seen = np.array([_middle(plane.amplitude, axes, plane.known) for plane in self.recorded]) - base
        # The lens is round: y moves as x does.
        trust = TRUST_PIXELS * scene.exit_grid.pitch_mm
        matrix = np.vstack([np.column_stack([moved[:, 0], tilted[:, 0]]) / trust, [0.0, 1.0 / TRUST_DEG]])
        right = np.vstack([seen / trust, [0.0, 0.0]])
        x, y = np.linalg.lstsq(matrix, right, rcond=None)[0][0]
        return float(x), float(y)

    def misfit(self, stop: FieldStop, iterations: int) -> float:
        """What a short reconstruction behind a stop leaves."""
        if (stop, iterations) in self._tried:
            return self._tried[stop, iterations]
        self.progress(
            f"field stop: {1e3 * stop.width_mm:.3g} um at {1e3 * stop.at_mm[0]:.3g}, "
            f"{1e3 * stop.at_mm[1]:.3g} um"
        )
        found = reconstruct(
            self.engine,
            self.light_of(stop),
            self.recorded,
            kind=self.kind,
            tv_weight="auto",
            iterations=iterations,
            scale=self.scale,
            fill_factor=self.fill_factor,
            modes=self.modes,
            residuals=False,
        )
        self._tried[stop, iterations] = found.misfit[-1]
        return found.misfit[-1]

    def _within(self, values: Array) -> FieldStop:
        """A stop that the patch holds: smaller and nearer to the axis where it must be."""
        pitch = self.engine.scene.object_grid.pitch_mm
        width = float(np.clip(values[2], 4.0 * pitch, self.patch_mm))
        room = 0.5 * (self.patch_mm - width)
        x, y = (float(np.clip(v, -room, room)) for v in values[:2])
        return FieldStop(width, (x, y))

    def _pattern_search(
        self, start: FieldStop, iterations: int, first: float, free: NDArray[np.bool_]
    ) -> FieldStop:
        """Steps along x, y and the diameter, halved where none helps; between them, as a parabola says."""

        def value(stop: FieldStop) -> float:
            return self.misfit(stop, iterations)

        pitch = self.engine.scene.object_grid.pitch_mm
        best, step, begun = start, max(first * start.width_mm, 1.5 * LEAST_STEP * pitch), len(self._tried)
        while step >= LEAST_STEP * pitch and len(self._tried) - begun < MOST_TRIALS:
            before = best
            for direction in DIRECTIONS[~np.any(DIRECTIONS[:, ~free], axis=1)]:
                best = self._along(best, step * direction, value)
            if value(best) >= value(before):
                step *= 0.5
        return best

    def _along(self, best: FieldStop, step: Array, value: Callable[[FieldStop], float]) -> FieldStop:
        def at(length: float) -> FieldStop:
            return self._within(np.array([*best.at_mm, best.width_mm]) + length * step)

        low, here, high = value(at(-1.0)), value(best), value(at(1.0))
        bend = low - 2.0 * here + high
        tries = [best, at(-1.0), at(1.0)]
        if bend > 0.0 and min(low, high) >= here:
            length = 0.5 * (low - high) / bend
            if abs(length) > 0.1:
                tries.append(at(length))
        return min(tries, key=value)


class _End(NamedTuple):
    """Where a spectrum ends, in cycles per pixel, and its decades above what is beyond."""

    cycles: float
    height: float


def _spectrum_end(amplitude: Array, known: Any = None) -> _End | None:
    """Where the radial spectrum of a plane's intensity falls to that of its noise."""
    light = amplitude.astype(float) ** 2
    if known is not None:
        light = np.where(known, light, 0.0)
    light *= np.outer(*(np.hanning(count + 2)[1:-1] for count in light.shape))
    power = np.abs(scipy.fft.fft2(light)) ** 2
    cycles = np.hypot(*np.meshgrid(*(scipy.fft.fftfreq(count) for count in light.shape), indexing="ij"))
    place = (cycles * BINS).astype(int)
    count = np.maximum(np.bincount(place.ravel()), 1)
    profile = np.log10(np.bincount(place.ravel(), power.ravel()) / count + 1e-300)[: BINS // 2]
    floor = float(np.median(profile[-BINS // 20 :]))
    above = np.flatnonzero(profile > floor + ABOVE_FLOOR)
    if len(above) == 0 or above[-1] >= len(profile) - BINS // 20:
        return None
    last = int(above[-1])
    height, near = (float(profile[int(share * last)] - floor) for share in (0.5, 0.85))
    # Light that pixels alias falls off slowly towards their limit, and has no end there.
    return _End((last + 1.0) / BINS, height) if near > STEEP else None


def _middle(amplitude: Array, axes: tuple[Array, Array], known: Any = None) -> tuple[float, float]:
    """Middle (x, y) of the light on a plane, without what is faint."""
    light = amplitude.astype(float) ** 2
    if known is not None:
        light = np.where(known, light, 0.0)
    light = np.maximum(light - FAINT * float(light.max()), 0.0)
    total = float(light.sum())
    y, x = (float((light.sum(axis=1 - axis) * axes[axis]).sum()) / total for axis in (0, 1))
    return x, y
