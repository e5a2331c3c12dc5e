"""Field, drift, distances and exposures of a stack in free space, found together.

The field takes accelerated steps of :class:`wavesim.forward.forward_model.ForwardModel` within its
band. From time to time, the unknowns of the planes take a Gauss-Newton step. The derivative of the amplitude
|v| on a plane with respect to its position or distance is Re(conj(v) dv) / |v|.
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
from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.field import Field
from wavesim.forward.forward_model import ForwardModel

SOON, OFTEN, SELDOM = 40, 5, 20
"""Number of first iterations, and intervals of the planes' steps during them and later."""

SCALES = (0.8, 1.25)
"""Range of the scale of distances."""

SCALE_ITERATIONS, SCALE_TOLERANCE = 60, 0.02
"""Iterations for each scale, and tolerance of the logarithm of the scale before a parabola refines it.

With half as many iterations the scale of a real series is wrong by 5 %.
"""


@dataclass(frozen=True, eq=False)
class Planes:
    """Unknowns of the planes.

    Attributes
    ----------
    distances_mm : ndarray
        Distances from the object in mm.
    shifts_mm : ndarray, shape (planes, 2)
        x and y of the sensor's center in mm.
    gains : ndarray
        Factors that bring the measured amplitudes of all planes to the same light.
    """

    distances_mm: Array
    shifts_mm: Array
    gains: Array


Progress = Callable[[int, float], None]


def at_stated_planes(stack: Stack) -> Planes:
    """Return planes at their stated positions."""
    count = len(stack.recorded)
    return Planes(stack.distances_mm, np.zeros((count, 2)), np.ones(count))


def descend(
    stack: Stack, planes: Planes, iterations: int, *, calibrates: bool, progress: Progress | None = None
) -> tuple[ComplexArray, Planes, list[float]]:
    """Return the field on z = 0, the planes' unknowns, and the misfit before every iteration.

    Parameters
    ----------
    stack
        Measured planes.
    planes
        Initial unknowns of the planes.
    iterations
        Number of iterations.
    calibrates
        Whether the planes' unknowns are found; otherwise they stay fixed.
    progress
        Callback `progress(index, misfit)`, called after every iteration.
    """
    now: ComplexArray = np.ones(stack.grid.shape, np.complex64)
    ahead, momentum, misfits = now, 1.0, list[float]()
    model = forward_model(stack, planes)
    for iteration in range(1, iterations + 1):
        change, misfit = model.step(ahead)
        updated = stack.limited(ahead + change)
        next_momentum = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
        ahead = updated + np.float32((momentum - 1.0) / next_momentum) * (updated - now)
        now, momentum = updated, next_momentum
        misfits.append(misfit)
        if calibrates and iteration % (OFTEN if iteration <= SOON else SELDOM) == 0:
            planes = _refine_planes(stack, now, planes)
            model = forward_model(stack, planes)
        if progress is not None:
            progress(iteration - 1, misfit)
    return now, planes, misfits


def forward_model(stack: Stack, planes: Planes) -> ForwardModel:
    """Return the forward model from the field on z = 0 to the amplitudes on the planes."""
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
    """Return the factor of the stated distances for which short descents leave the smallest misfit.

    A Gauss-Newton step only sees the derivative at the scale for which the field was found, and the field
    has adapted to that scale. The scale is therefore searched with whole descents.
    """
    from scipy.optimize import minimize_scalar

    stated = at_stated_planes(stack)
    misfits_by_scale: dict[float, float] = {}

    def misfit(log: float) -> float:
        planes = replace(stated, distances_mm=math.exp(log) * stated.distances_mm)
        misfits_by_scale[log] = descend(stack, planes, SCALE_ITERATIONS, calibrates=True)[2][-1]
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


def _refine_planes(stack: Stack, field: ComplexArray, planes: Planes) -> Planes:
    """Do one Gauss-Newton step of each plane's position, distance and gain.

    A common shift of all positions or distances is equivalent to a shift of the object, and a common factor
    of all gains to one of its light. They stay fixed.
    """
    steps = np.array([_step_of_plane(stack, field, planes, n) for n in range(len(stack.recorded))])
    steps[:, :3] -= steps[:, :3].mean(axis=0)
    gains = planes.gains + steps[:, 3]
    return Planes(planes.distances_mm + steps[:, 2], planes.shifts_mm + steps[:, :2], gains / gains.mean())


def _step_of_plane(stack: Stack, field: ComplexArray, planes: Planes, index: int) -> NDArray[np.float64]:
    """Return the step of x, y and distance in mm, and of the gain."""
    grid, rows = stack.grid, stack.window
    x, y = planes.shifts_mm[index]
    propagator = TransferFunction(
        grid, stack.wavelength_um, float(planes.distances_mm[index]), np.complex64, (float(x), float(y))
    )
    spectrum = propagator.times(scipy.fft.fft2(field, workers=-1))
    down, across = (scipy.fft.fftfreq(n, grid.pitch_mm).astype(np.float32) for n in grid.shape)
    wavenumber = np.float32(1e3 / stack.wavelength_um)
    axial = np.sqrt(np.maximum(wavenumber**2 - down[:, None] ** 2 - across**2, 0.0)) - wavenumber
    field_on_plane = scipy.fft.ifft2(spectrum, workers=-1)[rows]
    amplitude = np.abs(field_on_plane)
    dark = 1e-6
    conjugate_phase = field_on_plane.conj() / np.maximum(amplitude, dark)
    measured = stack.recorded[index].amplitude[rows]
    derivatives = [
        (
            conjugate_phase * scipy.fft.ifft2(np.complex64(2j * np.pi) * slope * spectrum, workers=-1)[rows]
        ).real
        for slope in (across[None, :], down[:, None], axial)
    ]
    jacobian = np.array([derivative.ravel() for derivative in (*derivatives, -measured)], float)
    residual = (np.float32(planes.gains[index]) * measured - amplitude).ravel().astype(float)
    norms = np.linalg.norm(jacobian, axis=1)
    norms[norms == 0.0] = 1.0
    jacobian /= norms[:, None]
    return np.asarray(np.linalg.lstsq(jacobian @ jacobian.T, jacobian @ residual, rcond=1e-6)[0] / norms)
