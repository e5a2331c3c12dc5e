"""Object-domain retrieval on a meridional line.

An object of transmission t under the illumination u gives the fields A_n(u t) on the planes n. Each iteration
replaces their amplitudes by the recorded ones, applies the adjoint to the change, and takes a step with
momentum, as :mod:`wavesim.reconstruction.object_solver` does for two dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.fields.field import Field
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.scene.engine import Grids
from wavesim.sensor.measurement import Measurement, weights_of

Weights = NDArray[np.inexact[Any]]

SAMPLES_PER_PIXEL = 2


class LineOperator(Protocol):
    """Linear operator from the samples of a line in the object plane to those of the first sensor plane."""

    @property
    def scene(self) -> Grids: ...

    def forward(self, field: Field) -> Field: ...

    def adjoint(self, field: Field) -> Field: ...


@dataclass(frozen=True, eq=False)
class LineModel:
    """Forward model of the reconstruction, from the transmission on a line to fields on the sensor planes.

    Attributes
    ----------
    operator : LineOperator
        Operator from the object plane to the first sensor plane, with `SAMPLES_PER_PIXEL` samples per pixel.
        Its object grid contains the grid of the light, with equal margins.
    refocus : FreeSpacePropagator or None
        Propagator from a shifted object plane to the operator's object grid; None: no shift.
    planes : tuple of FreeSpacePropagator or None
        Propagators from the first plane to each plane; None: the first plane itself.
    light : Field
        Illumination of the object.
    """

    operator: LineOperator
    refocus: FreeSpacePropagator | None
    planes: tuple[FreeSpacePropagator | None, ...]
    light: Field

    def forward(self, transmission: Array) -> Any:
        """Return the field values on the first plane."""
        values = self.light.values * transmission
        grid = self.operator.scene.object_grid
        if self.refocus is None:
            values = np.pad(values, (grid.size - len(values)) // 2)
        else:
            values = self.refocus.forward(values)
        return self.operator.forward(Field(grid, values, self.light.wavelength_um)).values

    def adjoint(self, values: Any) -> Any:
        """Apply the adjoint of :meth:`forward` to field values on the first plane."""
        field = Field(self.operator.scene.exit_grid, values, self.light.wavelength_um)
        adjoint = self.operator.adjoint(field).values
        if self.refocus is None:
            margin = (len(adjoint) - self.light.grid.size) // 2
            adjoint = adjoint[margin : margin + self.light.grid.size]
        else:
            adjoint = self.refocus.adjoint(adjoint)
        return self.light.values.conj() * adjoint


def retrieve_on_line(
    model: LineModel, recorded: Sequence[Measurement], *, is_complex: bool, iterations: int
) -> tuple[NDArray[Any], tuple[float, ...]]:
    """Reconstruct the object on a line from recorded amplitudes.

    Iterations end early if the misfit falls by less than 2 % over five iterations. Further iterations would
    fit errors of the model by changes of the object that hardly affect the planes.

    Parameters
    ----------
    model
        Forward model of the reconstruction.
    recorded
        Amplitudes of the pixels on each plane in the units of the model, and their standard deviations if
        noise is known.
    is_complex
        Whether the object has a phase. Otherwise its transmission is real and between 0 and 1.
    iterations
        Largest number of iterations.

    Returns
    -------
    transmission : ndarray
        Complex transmission on the grid of the model's light.
    misfit : tuple of float
        Relative difference of modelled and recorded amplitudes, for each iteration.
    """
    step_length, friction = 1.3, 1.0  # as in two dimensions
    weights = weights_of(recorded)
    amplitudes = [np.asarray(plane.amplitude, float) for plane in recorded]
    norm = np.sqrt(sum([_weighted_square(a, w) for a, w in zip(amplitudes, weights, strict=True)]))
    current = np.ones(model.light.grid.size, complex if is_complex else float)
    extrapolated, momentum = current, 0.0
    misfits: list[float] = []
    # Steps of the field on the first plane for each step of the object.
    inner_iterations = 4
    while len(misfits) < iterations and not _has_converged(misfits):
        first = model.forward(extrapolated)
        field = first
        for inner in range(inner_iterations):
            fields = [field if plane is None else plane.forward(field) for plane in model.planes]
            modelled = [pixel_amplitude(values) for values in fields]
            if inner == 0:
                planes = zip(amplitudes, modelled, weights, strict=True)
                squares = sum([_weighted_square(a - m, w) for a, m, w in planes])
                misfits.append(float(np.sqrt(squares) / norm))
            change: Any = 0.0
            for plane, values, a, m, w in zip(
                model.planes, fields, amplitudes, modelled, weights, strict=True
            ):
                ratio = a / np.maximum(m, np.finfo(float).tiny) - 1.0
                ratio = np.where(m > 0.0, ratio if w is None else w * ratio, 0.0)
                correction = values * np.repeat(ratio, SAMPLES_PER_PIXEL)
                change = change + (correction if plane is None else plane.adjoint(correction))
            field = field + (step_length / len(recorded)) * change
        step = model.adjoint(field - first)
        updated = extrapolated + step if is_complex else np.clip(extrapolated + step.real, 0.0, 1.0)
        updated = _within_unit(updated) if is_complex else updated
        # Momentum restarts if the step turns against the last change.
        is_uphill = float(np.vdot(extrapolated - updated, updated - current).real) > 0.0
        momentum = 0.0 if is_uphill else momentum
        extrapolated = updated + momentum / (momentum + friction) * (updated - current)
        current, momentum = updated, momentum + 1.0
    return current.astype(complex), tuple(misfits)


def pixel_amplitude(values: Any) -> Array:
    """Return the square root of the mean intensity on each pixel."""
    intensity = np.abs(values) ** 2
    return np.asarray(np.sqrt(intensity.reshape(-1, SAMPLES_PER_PIXEL).mean(axis=1)))


def _within_unit(values: NDArray[Any]) -> NDArray[Any]:
    return values / np.maximum(np.abs(values), 1.0)


def _weighted_square(values: Array, weights: Weights | None) -> float:
    return float(np.sum(values**2 if weights is None else weights * values**2))


def _has_converged(misfits: Sequence[float]) -> bool:
    iterations, smallest_decrease = 5, 0.02
    if len(misfits) <= iterations:
        return False
    earlier, latest = misfits[-1 - iterations], misfits[-1]
    return earlier - latest < smallest_decrease * earlier
