"""Position and diameter of the field stop, found from the frames of an unknown object.

The centroid of the light on a plane moves with the position of the lit object and with the direction of its
light. A small stop, shifted and tilted in the model, calibrates these movements. The measured centroids on
all planes then give a first position by least squares.

The Fourier transform of a plane's intensity is nearly the autocorrelation of the light on the object. The
width of this spectrum gives the diameter of the stop for any object.

A pattern search then reduces the misfit of short reconstructions over position and diameter. The first stage
uses the misfit of the object 1, which falls from far away. Later stages make some iterations, which
determine the rim to a fraction of a sample. A stop that is too small lacks light, and one that is too large
leaves too much freedom for so few iterations: the misfit increases in both cases.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.reconstruction.object_solver import reconstruct
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.scene.engine import Engine
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.settings import Kind
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement, noise_misfit

Array = NDArray[np.floating[Any]]

TILT_DEG, EXPECTED_TILT_DEG = 0.2, 0.5
"""Tilt for the calibration, and expected standard deviation of the direction of the light, in deg."""

PROBE_WIDTH, BINS, LEAST_DECADES = 0.3, 200, 0.3
"""Widths of spectra: diameter of the first probe over that of the patch, bins of the radial spectrum per
(cycle per pixel), and decades above the noise floor.
"""

SPECTRAL_ERROR, WIDTH_RATIOS = 0.2, (0.9, 1.0, 1.1)
"""Relative error of the diameter from spectra, and ratios to it that are tried."""

FIRST_STAGE, STAGES = (1, 0.25), ((6, 0.15), (6, 0.06), (15, 0.03))
"""Iterations of each stage, and its first step over the diameter."""


class FieldStop(NamedTuple):
    """A round field stop: diameter in mm, and center (x, y) relative to the axis in mm."""

    width_mm: float
    at_mm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class StopSearch:
    """Search for the field stop with which the frames were taken.

    Parameters
    ----------
    engine, recorded, kind, scale, fill_factor, modes
        See :func:`wavesim.reconstruct`.
    light_of
        Function that returns the light on the object for a field stop.
    patch_mm
        Side of the patch in mm, which contains the stop.
    progress
        Callback `progress(stage, completed, total)`, called for each stop that is tried.
    checkpoint
        File of the misfits that were found, from which an interrupted search continues.
    """

    engine: Engine
    recorded: Sequence[Measurement]
    light_of: Callable[[FieldStop], Field]
    patch_mm: float
    kind: Kind
    scale: float | None = None
    fill_factor: float = 0.0
    modes: Sequence[SourceMode] = ()
    progress: Callable[[str, int, int], None] = lambda stage, completed, total: None
    checkpoint: Checkpoint | None = None
    _misfits: dict[tuple[FieldStop, int], float] = field(default_factory=dict, init=False, repr=False)
    _requested: set[tuple[FieldStop, int]] = field(default_factory=set, init=False, repr=False)
    _stage: _Stage = field(default_factory=lambda: _Stage(), init=False, repr=False)

    def __post_init__(self) -> None:
        stored = None if self.checkpoint is None else self.checkpoint.load()
        for width_mm, x_mm, y_mm, iterations, misfit in () if stored is None else stored["trials"].tolist():
            self._misfits[FieldStop(width_mm, (x_mm, y_mm)), int(iterations)] = misfit

    def run(self, width_mm: float | None = None, at_mm: tuple[float, float] | None = None) -> FieldStop:
        """Return the stop that explains the frames best.

        Parameters
        ----------
        width_mm, at_mm
            Diameter or center in mm where one of them is known; it stays fixed. Default: both are found.
        """
        free = np.array((at_mm is None, at_mm is None, width_mm is None))
        stops = self._first_stops(width_mm, at_mm)
        estimated_width = self.estimated_width_mm if width_mm is None else width_mm
        iterations, step = FIRST_STAGE
        self._begin("first trials", 2 * len(stops) + 1)
        best = min(stops, key=lambda stop: self.misfit(stop, iterations))
        first = self._pattern_search(best, iterations, step, free)
        if estimated_width is None or abs(first.width_mm / estimated_width - 1.0) < SPECTRAL_ERROR:
            stops.append(first)
        # A dark or strongly diffracting object differs much from 1, which misleads the first stage.
        best = min(stops, key=lambda stop: self.misfit(stop, STAGES[0][0]))
        noise = noise_misfit(self.recorded) or 0.0
        # Misfit over that of noise above which the position is searched first.
        far_from_noise = 3.0
        if self.misfit(best, STAGES[0][0]) > far_from_noise * noise and at_mm is None:
            best = self._pattern_search(best, *STAGES[0], free & np.array((True, True, False)))
        for iterations, step in STAGES[1:]:
            best = self._pattern_search(best, iterations, step, free)
            if self.misfit(best, iterations) < far_from_noise * noise:
                break
        return best

    def _first_stops(
        self, width_mm: float | None = None, at_mm: tuple[float, float] | None = None
    ) -> list[FieldStop]:
        """Return the stops that are tried first: at the estimated centre, with several diameters."""
        centre = self.estimated_centre if at_mm is None else at_mm
        if width_mm is not None:
            widths = [width_mm]
        elif self.estimated_width_mm is not None:
            widths = [self.estimated_width_mm * ratio for ratio in WIDTH_RATIOS]
        else:
            # Diameters over that of the patch of the first stops that are tried.
            diameters = (0.12, 0.17, 0.24, 0.34, 0.48, 0.68, 1.0)
            widths = [self.patch_mm * fraction for fraction in diameters]
        return [self._within_patch(np.array([*centre, width])) for width in widths]

    @cached_property
    def estimated_width_mm(self) -> float | None:
        """Diameter from the spectra of the planes' intensities, or None where pixels do not resolve them.

        The Fourier transform of an intensity far behind the object is the autocorrelation of the light on
        the object, which ends at the diameter of the stop. A simulated stop of known diameter, with random
        phase grains and the same noise, calibrates where the spectrum ends.
        """
        random, probe_mm = np.random.default_rng(0), PROBE_WIDTH * self.patch_mm
        ends = [_spectrum_end(plane.amplitude, plane.known) for plane in self.recorded]
        measured = max((end for end in ends if end), key=lambda end: end.height, default=None)
        if measured is None:
            return None
        plane_index = ends.index(measured)
        for _ in range(2):
            light = self.light_of(self._within_patch(np.array([0.0, 0.0, probe_mm])))
            grains = np.exp(1j * gaussian_filter(random.standard_normal(light.grid.shape), 1.5) * 8.0)
            model = ChannelModel.of_source(self.engine, light, self.recorded, None, self.fill_factor)
            plane = self.recorded[plane_index]
            modelled = model.amplitudes(grains.astype(light.values.dtype))[plane_index].astype(float)
            modelled *= math.sqrt(float((plane.amplitude.astype(float) ** 2).sum() / (modelled**2).sum()))
            if plane.sigma is not None:
                noise = np.where(np.isfinite(plane.sigma), plane.sigma, 0.0)
                modelled += noise * random.standard_normal(modelled.shape)
            end = _spectrum_end(modelled, plane.known)
            if end is None:
                return None
            # The second pass uses a probe of the right size, because the mapping is not quite linear.
            probe_mm *= measured.cycles / end.cycles
        return probe_mm if probe_mm < self.patch_mm else None

    def find_better_stop(self, stop: FieldStop) -> FieldStop | None:
        """Return a stop that explains the frames better than the given one, or None.

        No search is made if the centroids and the spectra agree with the given stop, or if none of the first
        stops that a search would try explains the frames better. The light of a grey object may lie beside
        the centre of its stop.
        """
        width_mm = self.estimated_width_mm
        has_other_width = width_mm is not None and abs(width_mm / stop.width_mm - 1.0) > SPECTRAL_ERROR
        if not (has_other_width or self.is_displaced_from(stop)):
            return None
        iterations, first_stops = STAGES[0][0], self._first_stops()
        self._begin("comparison with the stated stop", 1 + len(first_stops))
        current = self.misfit(stop, iterations)
        if all(self.misfit(one, iterations) >= current for one in first_stops):
            return None
        better = self.run()
        # Ratio of misfits below which another stop explains the frames better.
        improving_ratio = 0.95
        return better if self.misfit(better, iterations) < improving_ratio * current else None

    def is_displaced_from(self, stop: FieldStop) -> bool:
        """Return whether the centroids of the light contradict the position of a stop."""
        # Offset of the light's centroid over the diameter above which another stop is searched.
        least_offset = 0.1
        return math.dist(self.estimated_centre, stop.at_mm) > least_offset * stop.width_mm

    def refined_width(self, stop: FieldStop) -> FieldStop:
        """Return the stop at the same position whose diameter explains the frames best."""
        return self._pattern_search(stop, *STAGES[-1], np.array((False, False, True)))

    @cached_property
    def estimated_centre(self) -> tuple[float, float]:
        """Center of the stop from the centroids of the light on all planes, in mm."""
        # Diameter over that of the patch of the stop that calibrates the movements of the light.
        probe_fraction = 0.12
        probe, step = probe_fraction * self.patch_mm, 0.25 * self.patch_mm
        scene = self.engine.scene
        axes = scene.exit_grid.y_mm, scene.exit_grid.x_mm

        def centroids(light: Field) -> Array:
            model = ChannelModel.of_source(self.engine, light, self.recorded, None, self.fill_factor)
            modelled = model.amplitudes(model.lit.astype(light.values.dtype))
            return np.array([_centroid(one, axes) for one in modelled])

        # The model already includes the shifts of the planes.
        current = self.light_of(FieldStop(probe, (0.0, 0.0)))
        base = centroids(current)
        moved = (centroids(self.light_of(FieldStop(probe, (step, 0.0)))) - base) / step
        tilted = (centroids(LightErrors((TILT_DEG, 0.0)).on(current)) - base) / TILT_DEG
        offsets = np.array([_centroid(plane.amplitude, axes, plane.known) for plane in self.recorded]) - base
        # Expected standard deviation of the centroid of the light on a plane, in pixels.
        expected_pixels = 1.0
        # The lens is round: y moves as x does.
        deviation = expected_pixels * scene.exit_grid.pitch_mm
        matrix = np.vstack(
            [np.column_stack([moved[:, 0], tilted[:, 0]]) / deviation, [0.0, 1.0 / EXPECTED_TILT_DEG]]
        )
        target = np.vstack([offsets / deviation, [0.0, 0.0]])
        x, y = np.linalg.lstsq(matrix, target, rcond=None)[0][0]
        return float(x), float(y)

    def misfit(self, stop: FieldStop, iterations: int) -> float:
        """Return the misfit of a short reconstruction with a stop."""
        self._requested.add((stop, iterations))
        if (stop, iterations) in self._misfits:
            return self._misfits[stop, iterations]
        stage, (x_mm, y_mm) = self._stage, stop.at_mm
        where = f"{1e3 * stop.width_mm:.3g} µm at {1e3 * x_mm:.3g}, {1e3 * y_mm:.3g} µm"
        total = stage.expected if stage.completed < stage.expected else 0
        self.progress(f"field stop, {stage.name}: {where}", stage.completed, total)
        stage.completed += 1
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
        self._misfits[stop, iterations] = found.misfit[-1]
        if self.checkpoint is not None:
            trials = [(s.width_mm, *s.at_mm, count, value) for (s, count), value in self._misfits.items()]
            self.checkpoint.keep(trials=np.array(trials))
        return found.misfit[-1]

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Add to an interrupt within the block whether the trials that were made are kept."""
        try:
            yield
        except KeyboardInterrupt:
            outcome = "nothing was written"
            if self.checkpoint is not None and self.checkpoint.kept:
                outcome = "run the same command again to continue"
            raise KeyboardInterrupt(f"interrupted in the search for the field stop; {outcome}") from None

    def _begin(self, name: str, expected: int) -> None:
        """Begin a stage of the search with an expected number of trials."""
        self._stage.name, self._stage.completed, self._stage.expected = name, 0, expected

    def _within_patch(self, values: Array) -> FieldStop:
        """Return a stop within the patch: smaller and nearer to the axis where necessary."""
        pitch = self.engine.scene.object_grid.pitch_mm
        width_mm = float(np.clip(values[2], 4.0 * pitch, self.patch_mm))
        largest_offset = 0.5 * (self.patch_mm - width_mm)
        x, y = (float(np.clip(v, -largest_offset, largest_offset)) for v in values[:2])
        return FieldStop(width_mm, (x, y))

    def _pattern_search(
        self, start: FieldStop, iterations: int, first: float, free: NDArray[np.bool_]
    ) -> FieldStop:
        """Search along x, y and the diameter with steps that are halved where none improves.

        A parabola through three misfits gives one more point of each step.
        """

        def value(stop: FieldStop) -> float:
            return self.misfit(stop, iterations)

        pitch = self.engine.scene.object_grid.pitch_mm
        # Smallest step, in samples.
        least_step = 0.3
        best, step = start, max(first * start.width_mm, 1.5 * least_step * pitch)
        trials_before = len(self._requested)
        # Directions of steps in x, y and diameter: the whole stop, its diameter, or one side of its rim.
        directions = np.array(
            [[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0, 1], [-0.5, 0, 1], [0, 0.5, 1], [0, -0.5, 1]]
        )
        # Largest number of trials in a stage.
        most_trials = 60
        halvings = 1 + max(int(math.log2(step / (least_step * pitch))), 0)
        count = int(np.sum(~np.any(directions[:, ~free], axis=1)))
        self._begin(f"search with {iterations} iterations", min(2 * count * halvings, most_trials))
        while step >= least_step * pitch and len(self._requested) - trials_before < most_trials:
            previous = best
            for direction in directions[~np.any(directions[:, ~free], axis=1)]:
                best = self._line_minimum(best, step * direction, value)
            if value(best) >= value(previous):
                step *= 0.5
        return best

    def _line_minimum(self, best: FieldStop, step: Array, value: Callable[[FieldStop], float]) -> FieldStop:
        def at(length: float) -> FieldStop:
            return self._within_patch(np.array([*best.at_mm, best.width_mm]) + length * step)

        low, current, high = value(at(-1.0)), value(best), value(at(1.0))
        curvature = low - 2.0 * current + high
        candidates = [best, at(-1.0), at(1.0)]
        if curvature > 0.0 and min(low, high) >= current:
            length = 0.5 * (low - high) / curvature
            if abs(length) > 0.1:
                candidates.append(at(length))
        return min(candidates, key=value)


@dataclass
class _Stage:
    """Name of the current stage of a search, and its completed and expected trials."""

    name: str = "trials"
    completed: int = 0
    expected: int = 0


class _SpectrumEnd(NamedTuple):
    """The end of a spectrum in cycles per pixel, and its height above the noise floor in decades."""

    cycles: float
    height: float


def _spectrum_end(amplitude: Array, known: Any = None) -> _SpectrumEnd | None:
    """Return where the radial spectrum of a plane's intensity falls to its noise."""
    light = amplitude.astype(float) ** 2
    if known is not None:
        light = np.where(known, light, 0.0)
    light *= np.outer(*(np.hanning(count + 2)[1:-1] for count in light.shape))
    power = np.abs(scipy.fft.fft2(light)) ** 2
    cycles = np.hypot(*np.meshgrid(*(scipy.fft.fftfreq(count) for count in light.shape), indexing="ij"))
    bin_index = (cycles * BINS).astype(int)
    count = np.maximum(np.bincount(bin_index.ravel()), 1)
    profile = np.log10(np.bincount(bin_index.ravel(), power.ravel()) / count + 1e-300)[: BINS // 2]
    floor = float(np.median(profile[-BINS // 20 :]))
    above = np.flatnonzero(profile > floor + LEAST_DECADES)
    if len(above) == 0 or above[-1] >= len(profile) - BINS // 20:
        return None
    last = int(above[-1])
    height, slope = (float(profile[int(fraction * last)] - floor) for fraction in (0.5, 0.85))
    # Decades by which a spectrum falls over the last 15 % before its end.
    least_slope = 0.8
    # A spectrum that pixels alias falls slowly towards the Nyquist limit and has no end there.
    return _SpectrumEnd((last + 1.0) / BINS, height) if slope > least_slope else None


def _centroid(amplitude: Array, axes: tuple[Array, Array], known: Any = None) -> tuple[float, float]:
    """Return the centroid (x, y) of the light on a plane, without faint light."""
    light = amplitude.astype(float) ** 2
    if known is not None:
        light = np.where(known, light, 0.0)
    # Light below this fraction of the peak intensity (background and noise) is ignored.
    faint_fraction = 0.02
    light = np.maximum(light - faint_fraction * float(light.max()), 0.0)
    total = float(light.sum())
    y, x = (float((light.sum(axis=1 - axis) * axes[axis]).sum()) / total for axis in (0, 1))
    return x, y
