"""From frames without a lens to the field on z = 0: in-line holograms, lensless cameras, focus stacks.

The frames' amplitudes lie on samples as coarse as their bandwidth allows, with a margin around them. The
field takes accelerated steps of :class:`wavesim.forward.channel_model.ChannelModel` within its band.
From time to time, positions and gains of the planes take a Gauss-Newton step. The derivative of the amplitude
`|v|` on a plane with respect to its position or distance is `Re(conj(v) dv) / |v|`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError
from wavesim.engines.no_lens import FreeSpace
from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.field import Field, Grid
from wavesim.fields.files import write_arrays, write_field
from wavesim.forward.channel_model import ChannelModel
from wavesim.metrics.goodness_of_fit import MODEL_ERROR
from wavesim.plots.frames import save
from wavesim.plots.objects import object_figure
from wavesim.plots.pyramid import write_pyramid
from wavesim.runtime.result import WritableResult
from wavesim.runtime.result_files import write_csv, write_json
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frame_sets import PlaneFrames, planes_of_frames, recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Measurement
from wavesim.sensor.recording import Progress

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

ITERATIONS = 600
"""Default number of iterations.

Planes near each other determine coarse phases slowly. Predictions of a real series improve up to this
number.
"""

DEFAULT_FRAME_SETTINGS: dict[str, Any] = {
    "exposure": 1.0,
    "bits": 16,
    "offset_counts": 0.0,
    "gain_electrons_per_count": 1.0,
}
"""Assumed settings of frames that do not state their counts: counts are proportional to intensity."""

LARGEST_NOISE_RATIO = 1.5
"""Misfit over that of noise above which a warning says that frames are not explained."""

RINGS, SIGNAL_RATIO = 50, 2.0
"""Rings of a spectrum up to half a cycle per pixel, and power over that of noise above which a ring has
signal.
"""

SOON, OFTEN, SELDOM = 40, 5, 20
"""Number of first iterations, and intervals of the planes' steps during them and later."""

SCALES = (0.8, 1.25)
"""Range of the scale of distances."""

DETERMINATION_ITERATIONS = 60
"""Iterations of the least-squares problem that shows which part of the scale the frames determine."""

SCALE_ITERATIONS, SCALE_TOLERANCE = 60, 0.02
"""Iterations for each scale, and tolerance of the logarithm of the scale before a parabola refines it.

With half as many iterations the scale of a real series is wrong by 5 %.
"""


LARGEST_DEVIATION, FEWEST_PLANES = 0.005, 3
"""Largest standard deviation of the scale of distances with which it is searched, and fewest planes.

Stages state distances with about this error. Two planes measure as many numbers as the field has.
"""


class HeldDistancesWarning(UserWarning):
    """Distances of planes stay as stated: frames do not determine them, or the search has left its range."""


class NotExplainedWarning(UserWarning):
    """Frames differ from the modelled ones by more than their noise."""


@dataclass(frozen=True, eq=False)
class Stack:
    """Measured planes on the samples of the search, with the present estimates of positions and gains.

    Attributes
    ----------
    grid : Grid
        Grid of the field on z = 0: the frames' window and a margin.
    recorded : tuple of Measurement
        Amplitudes on that grid in units of their rms, at the estimated positions; unknown in the margin.
    gains : ndarray
        Factors that bring the measured amplitudes of all planes to the same light.
    window : (slice, slice)
        Window of the frames in the grid.
    binning : int
        Pixels along a side of a sample.
    band : ndarray of bool
        Frequencies, in FFT order, that the field may contain.
    aperture : float
        Numerical aperture of that band.
    noise : float
        Relative misfit that the frames' noise leaves.
    unit : float
        Measured amplitude that corresponds to 1.
    wavelength_um : float
        Wavelength of the light in um.
    """

    grid: Grid
    recorded: tuple[Measurement, ...]
    gains: Array
    window: tuple[slice, slice]
    binning: int
    band: NDArray[np.bool_]
    aperture: float
    noise: float
    unit: float
    wavelength_um: float

    @property
    def distances_mm(self) -> Array:
        """Distances of the planes from the object in mm."""
        return np.array([plane.distance_mm for plane in self.recorded])

    @property
    def shifts_mm(self) -> Array:
        """x and y of the sensor's centre on each plane in mm, shape (planes, 2)."""
        return np.array([plane.shift_mm for plane in self.recorded])

    def at(self, distances_mm: Array, shifts_mm: Array, gains: Array) -> Stack:
        """Return the stack with other positions and gains of its planes."""
        recorded = tuple(
            replace(plane, distance_mm=float(distance), shift_mm=(float(x), float(y)))
            for plane, distance, (x, y) in zip(self.recorded, distances_mm, shifts_mm, strict=True)
        )
        return replace(self, recorded=recorded, gains=gains)

    def scaled(self, factor: float) -> Stack:
        """Return the stack with all distances multiplied by a factor."""
        return self.at(factor * self.distances_mm, self.shifts_mm, self.gains)

    def forward_model(self) -> ChannelModel:
        """Return the forward model from the field on z = 0 to the amplitudes on the planes."""
        recorded = [
            replace(plane, amplitude=plane.amplitude * np.float32(gain))
            for plane, gain in zip(self.recorded, self.gains, strict=True)
        ]
        light = Field(self.grid, np.ones(self.grid.shape, np.complex64), self.wavelength_um)
        return ChannelModel.of_source(FreeSpace(self.grid), light, recorded, 1.0)

    def propagator_to(self, distance_mm: float, shift_mm: tuple[float, float]) -> TransferFunction:
        """Return the transfer function from z = 0 to a plane."""
        return TransferFunction(self.grid, self.wavelength_um, distance_mm, np.complex64, shift_mm)

    def propagate(
        self, samples: ComplexArray, distance_mm: float, shift_mm: tuple[float, float]
    ) -> ComplexArray:
        """Return the field on a plane from that on z = 0."""
        return self.propagator_to(distance_mm, shift_mm).forward(scipy.fft.fft2(samples, workers=-1))

    def limited(self, field: ComplexArray) -> ComplexArray:
        """Return a field within the band."""
        spectrum = scipy.fft.fft2(field, workers=-1)
        spectrum *= self.band
        return np.asarray(scipy.fft.ifft2(spectrum, workers=-1, overwrite_x=True))

    def on_pixels(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values of the grid on the frames' pixels."""
        return _upsampled(values[self.window], self.binning)


@dataclass(frozen=True, eq=False, repr=False)
class FreeSpaceField(WritableResult):
    """The field on z = 0 behind a stack of frames, and the bench with which it was found.

    Attributes
    ----------
    field : Field
        Field on the frames' pixels, in the unit of the measured amplitude: the object under its light.
    state : SystemState
        Increase of each plane's distance over the stated one, and position of the sensor on it.
    distance_scale : float
        True over stated distance, for all planes.
    drift : (x, y)
        Lateral drift of the sensor per unit of stated distance.
    gains : tuple of float
        Factors that bring the planes' amplitudes to the same light.
    planes : tuple of PlaneFrames
        Distance, exposures and saturation of each plane.
    correlations : tuple of float or None
        Correlation of modelled and measured amplitudes on each plane, without their means; None on a plane
        that is even.
    misfit : tuple of float
        Relative misfit before every iteration.
    stack : Stack
        Measured planes on the samples of the search, at the estimated positions.
    samples : ndarray
        Field on these samples.
    scale_deviation : float or None
        Standard deviation of the scale of distances that the frames determine; None without a calibration.
    seeks_distances : bool
        Whether distances were calibrated, too. Otherwise they are the stated ones.
    """

    heading, file = "Field behind frames in free space", "reconstruction.json"

    field: Field
    state: SystemState
    distance_scale: float
    drift: tuple[float, float]
    gains: tuple[float, ...]
    planes: tuple[PlaneFrames, ...]
    correlations: tuple[float | None, ...]
    misfit: tuple[float, ...]
    stack: Stack
    samples: ComplexArray
    scale_deviation: float | None = None
    seeks_distances: bool = False

    def amplitude(self, distance_mm: float) -> Array:
        """Return the amplitude on a plane at a distance in mm as the stage would state it.

        The plane need not be one of the measured planes.

        Raises
        ------
        InputError
            If the distance is not finite.
        """
        if not math.isfinite(distance_mm):
            raise InputError(f"distance_mm = {distance_mm!r}: must be finite")
        x, y = self.drift
        shift_mm = x * distance_mm, y * distance_mm
        propagated = self.stack.propagate(self.samples, self.distance_scale * distance_mm, shift_mm)
        return np.asarray(self.stack.unit * np.abs(self.stack.on_pixels(propagated)), np.float32)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "distance_scale": self.distance_scale,
            "distance_scale_deviation": finite_or_none(self.scale_deviation),
            "distances_calibrated": self.seeks_distances,
            "drift": list(self.drift),
            "numerical_aperture": self.stack.aperture,
            "wavelength_um": self.stack.wavelength_um,
            "pixel_pitch_um": 1e3 * self.field.grid.pitch_mm,
            "iterations": len(self.misfit),
            "misfit": finite_or_none(self.misfit[-1]),
            "misfit_of_noise": finite_or_none(self.stack.noise),
            "planes": [
                {
                    "plane_distance_mm": plane.distance_mm,
                    "found_distance_mm": plane.distance_mm + self.state.sensor_pose(n).distance_mm,
                    "shift_um": [1e3 * part for part in self.state.sensor_pose(n).shift_mm],
                    "gain": self.gains[n],
                    "correlation": self.correlations[n],
                }
                for n, plane in enumerate(self.planes)
            ],
        }

    def write(
        self, folder: str | Path, more: Mapping[str, Any] | None = None, predict_mm: Sequence[float] = ()
    ) -> dict[str, Any]:
        """Write the field, its pictures and the bench, with the amplitudes on planes at `predict_mm`."""
        return super().write(folder, dict(more or {}) | {"predicted_mm": list(predict_mm)})

    def _write_files(self, folder: Path, summary: Mapping[str, Any]) -> None:
        pitch_um = 1e3 * self.field.grid.pitch_mm
        write_field(self.field, folder / "reconstruction.npz", centre_x_mm=0.0, centre_y_mm=0.0)
        for name, quantity in (("amplitude", "amplitude"), ("phase", "phase_rad")):
            write_pyramid(self.field.values, folder / f"{name}.tif", pitch_um, (quantity,))
        everywhere = np.ones(self.field.grid.shape, bool)
        save(object_figure(self.field, everywhere, "free space, z = 0"), folder / "reconstruction.png")
        rows = [{"iteration": n, "misfit": value} for n, value in enumerate(self.misfit, 1)]
        write_csv(rows, folder / "convergence.csv")
        distances = summary["predicted_mm"]
        if distances:
            amplitudes = [self.amplitude(distance) for distance in distances]
            for distance, amplitude in zip(distances, amplitudes, strict=True):
                write_pyramid(amplitude, folder / f"predicted_{distance:g}_mm.tif", pitch_um, ("amplitude",))
            write_arrays(
                folder / "predicted.npz",
                amplitude=np.array(amplitudes),
                plane_distance_mm=distances,
                pitch_um=pitch_um,
                wavelength_um=self.field.wavelength_um,
            )
        write_json(summary, folder / "calibration.json")

    def _picture(self) -> NDArray[Any]:
        return self.field.values

    def table(self) -> list[tuple[str, str]]:
        rows, columns = self.field.grid.shape
        return [
            ("samples", f"{rows} x {columns} of {1e3 * self.field.grid.pitch_mm:.4g} µm"),
            ("planes", f"{len(self.planes)}, distances x {self.distance_scale:.4f}"),
            ("iterations", f"{len(self.misfit)}, misfit {self.misfit[-1]:.4f}"),
        ]


def reconstruct_free_space(
    frames: Sequence[Frame],
    *,
    calibrates: bool = False,
    iterations: int = ITERATIONS,
    aperture: float | None = None,
    progress: Progress | None = None,
) -> FreeSpaceField:
    """Find the field on z = 0 behind frames in free space.

    The field outside the frames and the light are unknown. The field includes the light without an object. A
    common shift of all planes along z is equivalent to a shift of the object.

    Parameters
    ----------
    frames
        Frames of two or more planes with distances from the object plane, which may be 0 or negative.
    calibrates
        Whether the scale of distances, and each plane's distance, position and exposure are found, too.
    iterations
        Number of iterations.
    aperture
        Numerical aperture of the light; default: the largest at which the frames' spectra exceed the noise.
    progress
        Callback `progress(stage, completed, total)`; the total is 0 where it is unknown.

    Returns
    -------
    FreeSpaceField
        The field and the bench.

    Raises
    ------
    InputError
        If frames are of fewer than two planes, or a value is invalid.

    Warns
    -----
    HeldDistancesWarning
        If a calibration keeps the stated distances.
    NotExplainedWarning
        If the misfit stays above the frames' noise.
    """
    if iterations < 1:
        raise InputError(f"iterations = {iterations}: must be 1 or more")
    if aperture is not None and not 0.0 < aperture <= 1.0:
        raise InputError(f"numerical_aperture = {aperture!r}: must be above 0, and 1 at most")
    plane_frames = planes_of_frames(frames)
    if not plane_frames:
        raise InputError("frames: needs frames of at least two planes")
    progress = progress or (lambda what, done, count: None)
    frame_settings = frames[0].settings
    recorded = [
        replace(plane, distance_mm=frames_of_plane.distance_mm)
        for plane, frames_of_plane in zip(recorded_planes(frames), plane_frames, strict=True)
    ]
    pitch_mm = 1e-3 * frame_settings.pixel_pitch_um
    stack = stack_of(recorded, pitch_mm, frame_settings.wavelength_um, aperture)

    def found(start: Stack, seeks_distances: bool) -> FreeSpaceField:
        samples, end, misfit = descend(
            start,
            iterations,
            calibrates=calibrates,
            seeks_distances=seeks_distances,
            progress=lambda index, misfit_now: progress(
                f"free space: misfit {misfit_now:.5f}", index + 1, iterations
            ),
        )
        pixels = Grid(frames[0].counts.shape, pitch_mm, 0.0)
        result = _result(end, samples, plane_frames, misfit, pixels)
        return replace(result, scale_deviation=deviation, seeks_distances=seeks_distances)

    deviation, seeks_distances, start = None, False, stack
    if calibrates:
        progress("scale of distances", 0, 0)
        first, placed, _ = descend(stack, SCALE_ITERATIONS, calibrates=True, seeks_distances=False)
        deviation = scale_deviation(placed, first)
        seeks_distances = deviation <= LARGEST_DEVIATION and len(recorded) >= FEWEST_PLANES
        if seeks_distances:
            start = stack.scaled(best_scale(stack))
    result = found(start, seeks_distances)
    if seeks_distances and not SCALES[0] <= result.distance_scale <= SCALES[1]:
        result = found(stack, seeks_distances=False)
    if calibrates and not result.seeks_distances:
        assert deviation is not None
        reason = f"their scale has a standard deviation of {100.0 * deviation:.2g} %"
        if len(recorded) < FEWEST_PLANES:
            reason = f"{len(recorded)} planes measure as many numbers as the field has"
        cause = (
            f"the frames do not determine the distances of their planes ({reason}), as for weak phase "
            "objects, whose phase and defocus have the same effect"
        )
        advice = "record more planes, farther from the object"
        if seeks_distances:
            cause = "the scale of the distances has left its range, {:g} to {:g} times".format(*SCALES)
            advice = "check the stated distances, the pixel pitch and the wavelength"
        warnings.warn(
            f"{cause}: the distances stay as stated, and only positions across and exposures are calibrated; "
            f"{advice}",
            HeldDistancesWarning,
            stacklevel=2,
        )
    # Relative rounding of amplitudes in single precision, for frames without noise.
    noise = max(stack.noise, 1e-4)
    if result.misfit[-1] > LARGEST_NOISE_RATIO * noise:
        warnings.warn(
            f"the frames are not explained within their noise: the misfit is {result.misfit[-1]:.3g}, "
            f"{result.misfit[-1] / noise:.2g} times that of noise alone; to test the field, omit the frames "
            "of one plane and compare them with its prediction",
            NotExplainedWarning,
            stacklevel=2,
        )
    return result


def _result(
    stack: Stack,
    samples: ComplexArray,
    plane_frames: tuple[PlaneFrames, ...],
    misfit: list[float],
    pixels: Grid,
) -> FreeSpaceField:
    """Return the result, with origins defined by lines through distances and shifts of all planes."""
    amplitudes = stack.forward_model().amplitudes(samples)
    stated = np.array([plane.distance_mm for plane in plane_frames])
    scale, distance_offset = np.polyfit(stated, stack.distances_mm, 1)
    drift, shift_offset = np.polyfit(stated, stack.shifts_mm, 1)
    samples = stack.propagate(
        samples, float(distance_offset), (float(shift_offset[0]), float(shift_offset[1]))
    )
    shifts_um = 1e3 * (stack.shifts_mm - shift_offset)
    deltas = stack.distances_mm - distance_offset - stated
    state = SystemState(
        plane_distance_errors_mm=tuple(map(float, deltas)),
        plane_shifts_um=tuple((float(x), float(y)) for x, y in shifts_um),
    )
    values = np.asarray(stack.unit * stack.on_pixels(samples), np.complex64)
    return FreeSpaceField(
        Field(pixels, values, stack.wavelength_um),
        state,
        float(scale),
        (float(drift[0]), float(drift[1])),
        tuple(map(float, stack.gains)),
        plane_frames,
        tuple(
            _correlation(plane.amplitude[stack.window], amplitude[stack.window])
            for plane, amplitude in zip(stack.recorded, amplitudes, strict=True)
        ),
        tuple(misfit),
        stack,
        samples,
    )


def _correlation(one: Array, other: Array) -> float | None:
    """Return the correlation of two amplitudes without their means; None if one of them is even."""
    differences = [values.astype(float).ravel() - float(values.mean()) for values in (one, other)]
    sizes = [float(np.linalg.norm(difference)) for difference in differences]
    # Relative variation below which an amplitude in single precision is even.
    even = 1e-6
    if any(
        size <= even * float(np.linalg.norm(values)) for size, values in zip(sizes, (one, other), strict=True)
    ):
        return None
    return float(differences[0] @ differences[1]) / (sizes[0] * sizes[1])


def stack_of(
    recorded: Sequence[Measurement],
    pitch_mm: float,
    wavelength_um: float,
    aperture: float | None = None,
) -> Stack:
    """Return the stack of measured amplitudes.

    Parameters
    ----------
    recorded
        Measured amplitudes of two or more planes, at distances from the object.
    pitch_mm, wavelength_um
        Pitch of the pixels in mm, and wavelength in um.
    aperture
        Numerical aperture of the light; default: the largest at which the planes' spectra exceed the noise.

    Raises
    ------
    InputError
        If there are fewer than two planes.
    """
    if len(recorded) < 2:
        raise InputError(
            "free space: must be frames of two planes or more; one plane does not determine the phase"
        )
    unit = math.sqrt(np.mean([np.mean(plane.amplitude.astype(float) ** 2) for plane in recorded]))
    spectra = [scipy.fft.dctn(plane.amplitude.astype(float) / unit, norm="ortho") for plane in recorded]
    cycles, variance = _band_and_noise(spectra)
    if aperture is not None:
        cycles = 1e3 * pitch_mm * aperture / wavelength_um
    cycles = min(cycles, 1e3 * pitch_mm / wavelength_um)
    binning = _coarsest(spectra[0].shape, cycles)
    shape = tuple(n // binning for n in spectra[0].shape)
    padded_shape, window = _padded(shape)
    grid = Grid(padded_shape, binning * pitch_mm, 0.0)
    across = [scipy.fft.fftfreq(n) for n in padded_shape]
    band = np.hypot(across[0][:, None], across[1]) <= binning * cycles
    planes = []
    for plane, spectrum in zip(recorded, spectra, strict=True):
        amplitude, sigma = np.ones(padded_shape, np.float32), np.full(padded_shape, np.inf, np.float32)
        rows, columns = (slice(0, n) for n in shape)
        amplitude[window] = np.maximum(scipy.fft.idctn(spectrum[rows, columns], norm="ortho") / binning, 0.0)
        sigma[window] = 1.0
        planes.append(replace(plane, amplitude=amplitude, sigma=sigma))
    return Stack(
        grid,
        tuple(planes),
        np.ones(len(planes)),
        window,
        binning,
        band,
        cycles * wavelength_um / (1e3 * pitch_mm),
        math.sqrt(variance) / binning,
        unit,
        wavelength_um,
    )


def _band_and_noise(spectra: Sequence[Array]) -> tuple[float, float]:
    """Return the band (cycles per pixel) in which signal exceeds noise, and the noise variance of a pixel."""
    down, across = (np.arange(n) / (2.0 * n) for n in spectra[0].shape)
    cycles = np.hypot(down[:, None], across)
    power = np.mean([spectrum**2 for spectrum in spectra], axis=0)
    # Cycles per pixel above which a spectrum contains only noise.
    noise_cycles = 0.4
    variance = float(np.mean(power[cycles > noise_cycles]))
    rings = (2.0 * RINGS * cycles).astype(int).ravel()
    ring_power = np.bincount(rings, power.ravel()) / np.maximum(np.bincount(rings), 1)
    signal = np.flatnonzero(ring_power[:RINGS] > SIGNAL_RATIO * variance)
    return 0.5 * (int(signal[-1]) + 1 if len(signal) else RINGS) / RINGS, variance


def _coarsest(shape: Sequence[int], cycles: float) -> int:
    """Return the largest binning that represents the band."""

    def is_sufficient(binning: int) -> bool:
        # Smallest number of samples along a side after binning.
        least_samples = 32
        divides = all(n % binning == 0 and n // binning >= least_samples for n in shape)
        # Samples of intensities for each cycle of the band.
        oversampling = 2.2
        return divides and oversampling * cycles * binning <= 1.0

    return next((binning for binning in (4, 3, 2) if is_sufficient(binning)), 1)


def _padded(shape: Sequence[int]) -> tuple[tuple[int, int], tuple[slice, slice]]:
    """Return the shape with a margin, and the window of the frames in it."""
    padded_shape, window = [], []
    # Margin on each side over the width of the frames, for light from outside.
    margin = 1.0 / 8.0
    for n in shape:
        least = math.ceil(n * (1.0 + 2.0 * margin))
        count = scipy.fft.next_fast_len(least)
        first = (count - n) // 2
        padded_shape.append(count)
        window.append(slice(first, first + n))
    return (padded_shape[0], padded_shape[1]), (window[0], window[1])


def _upsampled(values: NDArray[Any], binning: int) -> NDArray[Any]:
    """Return values on finer samples, from their cosine series."""
    if binning == 1:
        return values.copy()
    if np.iscomplexobj(values):
        return np.asarray(_upsampled(values.real, binning) + 1j * _upsampled(values.imag, binning))
    spectrum = np.zeros([binning * n for n in values.shape], values.dtype)
    spectrum[: values.shape[0], : values.shape[1]] = scipy.fft.dctn(values, norm="ortho") * binning
    return np.asarray(scipy.fft.idctn(spectrum, norm="ortho"))


def descend(
    stack: Stack,
    iterations: int,
    *,
    calibrates: bool,
    seeks_distances: bool = True,
    progress: Callable[[int, float], None] | None = None,
) -> tuple[ComplexArray, Stack, list[float]]:
    """Return the field on z = 0, the stack with its estimates, and the misfit before every iteration.

    Parameters
    ----------
    stack
        Measured planes, at their initial positions.
    iterations
        Number of iterations.
    calibrates
        Whether positions and gains of the planes are found; otherwise they stay fixed.
    seeks_distances
        Whether a calibration also finds the distances of the planes.
    progress
        Callback `progress(index, misfit)`, called after every iteration.
    """
    now: ComplexArray = np.ones(stack.grid.shape, np.complex64)
    ahead, momentum, misfits = now, 1.0, list[float]()
    model = stack.forward_model()
    for iteration in range(1, iterations + 1):
        change, misfit, _ = model.step(ahead)
        updated = stack.limited(ahead + change)
        next_momentum = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
        ahead = updated + np.float32((momentum - 1.0) / next_momentum) * (updated - now)
        now, momentum = updated, next_momentum
        misfits.append(misfit)
        if calibrates and iteration % (OFTEN if iteration <= SOON else SELDOM) == 0:
            stack = _refine_planes(stack, now, seeks_distances)
            model = stack.forward_model()
        if progress is not None:
            progress(iteration - 1, misfit)
    return now, stack, misfits


def best_scale(stack: Stack) -> float:
    """Return the factor of the stated distances for which short descents leave the smallest misfit.

    A Gauss-Newton step only sees the derivative at the scale for which the field was found, and the field
    has adapted to that scale. The scale is therefore searched with whole descents.
    """
    from scipy.optimize import minimize_scalar

    misfits_by_scale: dict[float, float] = {}

    def misfit(log: float) -> float:
        scaled = stack.scaled(math.exp(log))
        misfits_by_scale[log] = descend(scaled, SCALE_ITERATIONS, calibrates=True)[2][-1]
        return misfits_by_scale[log]

    minimize_scalar(
        misfit,
        bounds=(math.log(SCALES[0]), math.log(SCALES[1])),
        method="bounded",
        options={"xatol": SCALE_TOLERANCE},
    )
    logs = np.array(sorted(misfits_by_scale))
    best = int(np.argmin([misfits_by_scale[log] for log in logs]))
    if not 0 < best < len(logs) - 1:
        return math.exp(logs[best])
    near = logs[best - 1 : best + 2]
    curve = np.polyfit(near - near[1], [misfits_by_scale[log] for log in near], 2)
    vertex = near[1] - 0.5 * curve[1] / curve[0] if curve[0] > 0.0 else near[1]
    return math.exp(float(np.clip(vertex, near[0], near[2])))


def _refine_planes(stack: Stack, field: ComplexArray, seeks_distances: bool) -> Stack:
    """Do one Gauss-Newton step of each plane's position, distance and gain.

    A common shift of all positions or distances is equivalent to a shift of the object, and a common factor
    of all gains to one of its light. They stay fixed.
    """
    steps = np.array(
        [_step_of_plane(stack, field, index, seeks_distances) for index in range(len(stack.recorded))]
    )
    steps[:, :3] -= steps[:, :3].mean(axis=0)
    gains = stack.gains + steps[:, 3]
    return stack.at(stack.distances_mm + steps[:, 2], stack.shifts_mm + steps[:, :2], gains / gains.mean())


def _step_of_plane(
    stack: Stack, field: ComplexArray, index: int, seeks_distances: bool
) -> NDArray[np.float64]:
    """Return the step of x, y and distance in mm, and of the gain."""
    _, columns, residual = _linearised(stack, field, index)
    if not seeks_distances:
        columns[2] = 0.0
    norms = np.linalg.norm(columns, axis=1)
    norms[norms == 0.0] = 1.0
    columns /= norms[:, None]
    return np.asarray(np.linalg.lstsq(columns @ columns.T, columns @ residual, rcond=1e-6)[0] / norms)


def _linearised(
    stack: Stack, field: ComplexArray, index: int
) -> tuple[ComplexArray, NDArray[np.float64], NDArray[np.float64]]:
    """Return the conjugate phases of a plane's field, the derivatives of its amplitude, and the residual.

    The derivatives are those with respect to x, y and distance in mm, and to the gain.
    """
    grid, rows, plane = stack.grid, stack.window, stack.recorded[index]
    propagator = stack.propagator_to(plane.distance_mm, plane.shift_mm)
    spectrum = propagator.times(scipy.fft.fft2(field, workers=-1))
    down, across = (scipy.fft.fftfreq(n, grid.pitch_mm).astype(np.float32) for n in grid.shape)
    wavenumber = np.float32(1e3 / stack.wavelength_um)
    axial = np.sqrt(np.maximum(wavenumber**2 - down[:, None] ** 2 - across**2, 0.0)) - wavenumber
    field_on_plane = scipy.fft.ifft2(spectrum, workers=-1)[rows]
    amplitude = np.abs(field_on_plane)
    dark = 1e-6
    conjugate_phase = field_on_plane.conj() / np.maximum(amplitude, dark)
    measured = plane.amplitude[rows]
    derivatives = [
        (
            conjugate_phase * scipy.fft.ifft2(np.complex64(2j * np.pi) * slope * spectrum, workers=-1)[rows]
        ).real
        for slope in (across[None, :], down[:, None], axial)
    ]
    columns = np.array([derivative.ravel() for derivative in (*derivatives, -measured)], float)
    residual = (np.float32(stack.gains[index]) * measured - amplitude).ravel().astype(float)
    return conjugate_phase, columns, residual


def scale_deviation(stack: Stack, field: ComplexArray) -> float:
    """Return the standard deviation of the scale of distances that the frames determine.

    The field, the positions of the planes across z and their gains are determined by the same frames: the
    part of the scale's derivative that they can take up carries no information. For a weak phase object, this
    is nearly all, since phase and defocus have the same effect.

    Parameters
    ----------
    stack
        The planes at their present positions.
    field
        Field on z = 0 that the planes have given.
    """
    planes = [_linearised(stack, field, index)[:2] for index in range(len(stack.recorded))]
    propagators = [stack.propagator_to(plane.distance_mm, plane.shift_mm) for plane in stack.recorded]
    shape = planes[0][0].shape
    # x, y and gain of each plane, each column of length 1 on its plane.
    others = [columns[[0, 1, 3]] for _, columns in planes]
    others = [columns / np.maximum(np.linalg.norm(columns, axis=1), 1e-30)[:, None] for columns in others]

    def forward(change: ComplexArray, numbers: Array) -> Array:
        spectrum = scipy.fft.fft2(change, workers=-1)
        return np.array(
            [
                (phases * propagator.forward(spectrum)[stack.window]).real.ravel() + own @ columns
                for (phases, _), propagator, columns, own in zip(
                    planes, propagators, others, numbers, strict=True
                )
            ]
        )

    def adjoint(amplitudes: Array) -> tuple[ComplexArray, Array]:
        total = np.zeros(stack.grid.shape, np.complex128)
        for (phases, _), propagator, own in zip(planes, propagators, amplitudes, strict=True):
            on_plane = np.zeros(stack.grid.shape, np.complex64)
            on_plane[stack.window] = phases.conj() * own.reshape(shape)
            total += propagator.adjoint(on_plane)
        total *= stack.band
        change = scipy.fft.ifft2(total, workers=-1)
        return change, np.array([columns @ own for columns, own in zip(others, amplitudes, strict=True)])

    # Conjugate gradients for the least-squares problem, whose residual is what nothing else can take up.
    remaining = np.array(
        [distance * columns[2] for distance, (_, columns) in zip(stack.distances_mm, planes, strict=True)]
    )
    gradient = adjoint(remaining)
    direction, power = gradient, _power(gradient)
    for _ in range(DETERMINATION_ITERATIONS):
        if power == 0.0:
            break
        image = forward(*direction)
        length = power / float(np.vdot(image, image))
        remaining = remaining - length * image
        gradient = adjoint(remaining)
        previous, power = power, _power(gradient)
        ratio = power / previous
        direction = gradient[0] + ratio * direction[0], gradient[1] + ratio * direction[1]
    size = float(np.linalg.norm(remaining))
    return math.hypot(stack.noise, MODEL_ERROR) / size if size else math.inf


def _power(gradient: tuple[ComplexArray, Array]) -> float:
    return float(sum(np.vdot(part, part).real for part in gradient))
