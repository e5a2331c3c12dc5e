"""Field, drift, distances and exposures of a stack in free space, found together.

Steps of :class:`wavesim.reconstruction.forward_model.ForwardModel`, accelerated, with the field held
within its band. Now and then the planes' unknowns take a Gauss-Newton step: of the amplitude |v| on a plane,
the derivatives by its place and distance are Re(conj(v) dv) / |v|.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.calibration.free_space.stack import Array, ComplexArray, Stack
from wavesim.engines.free_space import FreeSpace
from wavesim.fields.field import Field
from wavesim.fields.plane_waves import TransferFunction
from wavesim.reconstruction.forward_model import ForwardModel

SOON, OFTEN, SELDOM = 40, 5, 20
"""Iterations in which the planes' unknowns step every so many, and how often they do later."""

SCALES = (0.8, 1.25)
"""Range in which the scale of distances is sought."""

SCALE_ITERATIONS, SCALE_TOLERANCE = 60, 0.02
"""Of a trial of a scale, and how finely it is sought before a parabola ends it. Trials of half as many err by
5 % on a real series."""

DARK = 1e-6


@dataclass(frozen=True, eq=False)
class Planes:
    """What is not known of planes.

    Attributes
    ----------
    distances_mm : ndarray
        From the object.
    shifts_mm : ndarray, shape (planes, 2)
        x and y of the sensor's middle.
    gains : ndarray
        By which recorded amplitudes are multiplied, so that all planes are of one light.
    """

    distances_mm: Array
    shifts_mm: Array
    gains: Array


Tell = Callable[[int, float], None]


def at_stated_planes(stack: Stack) -> Planes:
    """Planes where the frames say that they are."""
    count = len(stack.recorded)
    return Planes(stack.distances_mm, np.zeros((count, 2)), np.ones(count))


def descend(
    stack: Stack, planes: Planes, iterations: int, *, calibrates: bool, tell: Tell | None = None
) -> tuple[ComplexArray, Planes, list[float]]:
    """The field on z = 0, the planes' unknowns, and the misfit before every iteration.

    Parameters
    ----------
    stack
        What was recorded.
    planes
        From what to start.
    iterations
        How many.
    calibrates
        Whether the planes' unknowns are found, or taken as they are.
    tell
        Told after every iteration with its number and misfit.
    """
    now: ComplexArray = np.ones(stack.grid.shape, np.complex64)
    ahead, momentum, misfits = now, 1.0, list[float]()
    model = forward_model(stack, planes)
    for number in range(1, iterations + 1):
        change, misfit = model.step(ahead)
        after = stack.limited(ahead + change)
        faster = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
        ahead = after + np.float32((momentum - 1.0) / faster) * (after - now)
        now, momentum = after, faster
        misfits.append(misfit)
        if calibrates and number % (OFTEN if number <= SOON else SELDOM) == 0:
            planes = _refined(stack, now, planes)
            model = forward_model(stack, planes)
        if tell is not None:
            tell(number - 1, misfit)
    return now, planes, misfits


def forward_model(stack: Stack, planes: Planes) -> ForwardModel:
    """From the field on z = 0 to the amplitudes on planes, as the planes are."""
    recorded = [
        replace(
            plane,
            amplitude=plane.amplitude * np.float32(gain),
            distance_mm=float(distance),
            shift_mm=(float(shift[0]), float(shift[1])),
        )
        for plane, distance, shift, gain in zip(
            stack.recorded, planes.distances_mm, planes.shifts_mm, planes.gains, strict=True
        )
    ]
    light = Field(stack.grid, np.ones(stack.grid.shape, np.complex64), stack.wavelength_um)
    return ForwardModel(FreeSpace(stack.grid), light, recorded, 1.0)


def best_scale(stack: Stack) -> float:
    """By which stated distances are multiplied, so that short descents leave least.

    A Gauss-Newton step sees only the slope about the scale with which the field was found, which has adapted
    to it: it is a search over whole descents that tells.
    """
    from scipy.optimize import minimize_scalar

    stated = at_stated_planes(stack)
    tried: dict[float, float] = {}

    def misfit(log: float) -> float:
        planes = replace(stated, distances_mm=math.exp(log) * stated.distances_mm)
        tried[log] = descend(stack, planes, SCALE_ITERATIONS, calibrates=True)[2][-1]
        return tried[log]

    minimize_scalar(
        misfit,
        bounds=(math.log(SCALES[0]), math.log(SCALES[1])),
        method="bounded",
        options={"xatol": SCALE_TOLERANCE},
    )
    logs = np.array(sorted(tried))
    best = int(np.argmin([tried[log] for log in logs]))
    if not 0 < best < len(logs) - 1:
        return math.exp(logs[best])
    near = logs[best - 1 : best + 2]
    curve = np.polyfit(near - near[1], [tried[log] for log in near], 2)
    vertex = near[1] - 0.5 * curve[1] / curve[0] if curve[0] > 0.0 else near[1]
    return math.exp(float(np.clip(vertex, near[0], near[2])))


def _refined(stack: Stack, field: ComplexArray, planes: Planes) -> Planes:
    """One Gauss-Newton step of each plane's place, distance and gain.

    A shift of all planes, or of all distances, is a shift of the object, and a factor of all gains one of
    its light: they stay.
    """
    steps = np.array([_step_of_plane(stack, field, planes, n) for n in range(len(stack.recorded))])
    steps[:, :3] -= steps[:, :3].mean(axis=0)
    gains = planes.gains + steps[:, 3]
    return Planes(planes.distances_mm + steps[:, 2], planes.shifts_mm + steps[:, :2], gains / gains.mean())


def _step_of_plane(stack: Stack, field: ComplexArray, planes: Planes, number: int) -> NDArray[np.float64]:
    """Of x, y, distance (mm) and gain."""
    grid, rows = stack.grid, stack.window
    x, y = planes.shifts_mm[number]
    way = TransferFunction(
        grid, stack.wavelength_um, float(planes.distances_mm[number]), np.complex64, (float(x), float(y))
    )
    spectrum = way.times(scipy.fft.fft2(field, workers=-1))
    down, across = (scipy.fft.fftfreq(n, grid.pitch_mm).astype(np.float32) for n in grid.shape)
    wave = np.float32(1e3 / stack.wavelength_um)
    along = np.sqrt(np.maximum(wave**2 - down[:, None] ** 2 - across**2, 0.0)) - wave
    seen = scipy.fft.ifft2(spectrum, workers=-1)[rows]
    amplitude = np.abs(seen)
    turned = seen.conj() / np.maximum(amplitude, DARK)
    told = stack.recorded[number].amplitude[rows]
    parts = [
        (turned * scipy.fft.ifft2(np.complex64(2j * np.pi) * slope * spectrum, workers=-1)[rows]).real
        for slope in (across[None, :], down[:, None], along)
    ]
    slopes = np.array([part.ravel() for part in (*parts, -told)], float)
    missed = (np.float32(planes.gains[number]) * told - amplitude).ravel().astype(float)
    sizes = np.linalg.norm(slopes, axis=1)
    sizes[sizes == 0.0] = 1.0
    slopes /= sizes[:, None]
    return np.asarray(np.linalg.lstsq(slopes @ slopes.T, slopes @ missed, rcond=1e-6)[0] / sizes)
