"""Object-domain retrieval on a meridional line.

The object t, lit by u, gives the fields A_n(u t) on the planes n. Each iteration replaces their amplitudes by
the recorded ones, carries the change back to the object and steps along it with momentum, as
:mod:`wavesim.reconstruction.from_object` does in the plane.
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

STEP, FRICTION = 1.3, 1.0
"""Length of a step, and how soon momentum grows, as in the plane."""

ROUNDS = 4
"""Steps of the field behind the lens for each step of the object."""

SETTLED, SETTLED_OVER = 0.02, 5
"""Iterations end where the misfit falls by less than this fraction over so many of them: what would follow
fits the errors of the model by changes of the object that the planes hardly tell."""


class LineOperator(Protocol):
    """Carries fields from the samples of a line in front of the lens to those of the first plane."""

    @property
    def scene(self) -> Grids: ...

    def forward(self, field: Field) -> Field: ...

    def adjoint(self, field: Field) -> Field: ...


@dataclass(frozen=True, eq=False)
class LineModel:
    """The reconstruction's model of how an object on a line makes the recorded amplitudes.

    Attributes
    ----------
    operator : LineOperator
        From the object plane to the first sensor plane, `SAMPLES_PER_PIXEL` samples a pixel. Its object grid
        holds that of the light in its middle.
    refocus : Passage or None
        From the plane in which the object is sought to the operator's object grid, if it is another plane.
    planes : tuple of Passage or None
        From the first plane to each plane; None for the first itself.
    light : Field
        On the object.
    """

    operator: LineOperator
    refocus: FreeSpacePropagator | None
    planes: tuple[FreeSpacePropagator | None, ...]
    light: Field

    def forward(self, transmission: Array) -> Any:
        """Values on the first plane."""
        values = self.light.values * transmission
        grid = self.operator.scene.object_grid
        if self.refocus is None:
            beside = (grid.size - len(values)) // 2
            values = np.pad(values, beside)
        else:
            values = self.refocus.forward(values)
        return self.operator.forward(Field(grid, values, self.light.wavelength_um)).values

    def adjoint(self, values: Any) -> Any:
        """Change of the transmission from a change of the field on the first plane."""
        field = Field(self.operator.scene.exit_grid, values, self.light.wavelength_um)
        back = self.operator.adjoint(field).values
        if self.refocus is None:
            beside = (len(back) - self.light.grid.size) // 2
            back = back[beside : beside + self.light.grid.size]
        else:
            back = self.refocus.adjoint(back)
        return self.light.values.conj() * back


def retrieve_on_line(
    model: LineModel, recorded: Sequence[Measurement], *, is_complex: bool, iterations: int
) -> tuple[NDArray[Any], tuple[float, ...]]:
    """Find the object on a line behind recorded amplitudes.

    Parameters
    ----------
    model
        The reconstruction's model.
    recorded
        Amplitudes of the pixels on each plane in units of the model's, which exposures tell, and their
        standard deviations where noise is known.
    is_complex
        Whether the object has a phase; without, it is real and between 0 and 1.
    iterations
        Largest number.

    Returns
    -------
    transmission : ndarray
        Complex, on the model's object grid.
    misfit : tuple of float
        Relative difference of modelled and recorded amplitudes, by iteration.
    """
    weights = weights_of(recorded)
    amplitudes = [np.asarray(plane.amplitude, float) for plane in recorded]
    size = np.sqrt(sum([_weighed(a, w) for a, w in zip(amplitudes, weights, strict=True)]))
    now = np.ones(model.light.grid.size, complex if is_complex else float)
    ahead, momentum = now, 0.0
    misfits: list[float] = []
    while len(misfits) < iterations and not _settled(misfits):
        first = model.forward(ahead)
        field = first
        for turn in range(ROUNDS):
            fields = [field if plane is None else plane.forward(field) for plane in model.planes]
            known = [pixel_amplitude(values) for values in fields]
            if turn == 0:
                parts = zip(amplitudes, known, weights, strict=True)
                missed = sum([_weighed(a - k, w) for a, k, w in parts])
                misfits.append(float(np.sqrt(missed) / size))
            change: Any = 0.0
            for plane, values, a, k, w in zip(model.planes, fields, amplitudes, known, weights, strict=True):
                ratio = a / np.maximum(k, np.finfo(float).tiny) - 1.0
                ratio = np.where(k > 0.0, ratio if w is None else w * ratio, 0.0)
                part = values * np.repeat(ratio, SAMPLES_PER_PIXEL)
                change = change + (part if plane is None else plane.adjoint(part))
            field = field + (STEP / len(recorded)) * change
        step = model.adjoint(field - first)
        after = ahead + step if is_complex else np.clip(ahead + step.real, 0.0, 1.0)
        after = _within_unit(after) if is_complex else after
        uphill = float(np.vdot(ahead - after, after - now).real) > 0.0
        momentum = 0.0 if uphill else momentum
        ahead = after + momentum / (momentum + FRICTION) * (after - now)
        now, momentum = after, momentum + 1.0
    return now.astype(complex), tuple(misfits)


def pixel_amplitude(values: Any) -> Array:
    """Root of the mean intensity on each pixel."""
    intensity = np.abs(values) ** 2
    return np.asarray(np.sqrt(intensity.reshape(-1, SAMPLES_PER_PIXEL).mean(axis=1)))


def _within_unit(values: NDArray[Any]) -> NDArray[Any]:
    return values / np.maximum(np.abs(values), 1.0)


def _weighed(values: Array, weights: Weights | None) -> float:
    return float(np.sum(values**2 if weights is None else weights * values**2))


def _settled(misfits: Sequence[float]) -> bool:
    if len(misfits) <= SETTLED_OVER:
        return False
    before, now = misfits[-1 - SETTLED_OVER], misfits[-1]
    return before - now < SETTLED * before
