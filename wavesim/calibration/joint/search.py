"""Light, lens, mounting and camera from the frames alone, together with the object.

A bench is judged by what a reconstruction from even light leaves after a few iterations, or by what a known
object leaves. Each step of the search takes its direction from the normal equations of object and bench about
that object, and its length from such reconstructions along it. Light's unevenness comes last: until the rest
is right, anything explains it; and so does the tilt of the sensor, of which frames tell least and which makes
every reconstruction half as long again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import TransferLensError
from wavesim.calibration.joint.linearised import Linearised
from wavesim.calibration.joint.pixels import Pixels
from wavesim.calibration.joint.step import JointStep
from wavesim.calibration.parameters import Parameter, Unknowns
from wavesim.reconstruction.from_object import reconstruct
from wavesim.reconstruction.recording_model import RecordingModel
from wavesim.scene.engine import Operator
from wavesim.scene.settings import Kind

ROUNDS = 6
"""Of conjugate gradients for a step's direction."""

FOLLOWED = 2
"""Rounds in which the object follows a parameter where it is asked what the frames tell of that."""

LAST = "light_amplitude", "sensor_tilt"
"""Beginnings of the names of parameters that are sought when the rest is right."""

LONGEST, SHORTEST = 64.0, 0.05
"""Multiples of a step that are tried."""

NOT_TOLD_GAIN = 0.02
"""Share of the squared misfit that tells nothing: the model's own errors leave as much. So much more of it is
a standard deviation of what is sought, and so much costs a parameter that is as far off as is expected."""

LEAST_GAINS = 0.05, NOT_TOLD_GAIN
"""A stage ends when a step lowers the squared misfit by less than this share; then the last one."""

RUNAWAY = 4.0
"""Stands for the misfit where the model fails."""

Progress = Callable[[int, Unknowns, float], None]


@dataclass(frozen=True, eq=False)
class Stand:
    """Where a search stands: all that it needs to go on.

    Attributes
    ----------
    unknowns : Unknowns
    stage : int
        Of the parameters that are sought one after the other.
    stretch : float
        Multiple of the last step that was best.
    trail : tuple of (Unknowns, float)
        Benches tried, and their misfits.
    """

    unknowns: Unknowns
    stage: int = 0
    stretch: float = 3.0
    trail: tuple[tuple[Unknowns, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Told:
    """What frames tell of a bench.

    Attributes
    ----------
    unknowns : Unknowns
    covariance : ndarray, shape (parameters, parameters)
        Of what was found, with what was expected before.
    misfit : float
    trail : tuple of (Unknowns, float)
    stopped_because : str
    """

    unknowns: Unknowns
    covariance: Array
    misfit: float
    trail: tuple[tuple[Unknowns, float], ...]
    stopped_because: str

    @property
    def deviations(self) -> Array:
        """Standard deviation of each parameter."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class JointSearch:
    """The frames, and what is known of how they came about.

    Attributes
    ----------
    pixels : Pixels
        What is seen of the frames, and by which engines.
    kind : {"amplitude", "complex"}
        Of the object.
    parameters : tuple of Parameter
        What is sought.
    iterations : int
        Of each reconstruction.
    most_benches : int
        That are tried.
    noise_misfit : float or None
        What the stated noise alone would leave.
    known : ndarray or None
        Transmission of the object where it is known, real where it is an amplitude.
    progress
        Told of each bench tried: its number, itself, and its misfit.
    keep
        Given where the search stands after each step.
    """

    pixels: Pixels
    kind: Kind
    parameters: tuple[Parameter, ...]
    iterations: int
    most_benches: int
    noise_misfit: float | None
    known: NDArray[Any] | None = None
    progress: Progress | None = None
    keep: Callable[[Stand], None] | None = None
    _last: list[tuple[Unknowns, RecordingModel, NDArray[Any]]] = field(default_factory=list, init=False)

    def run(self, stand: Stand) -> Told:
        """Search, and see what the frames tell.

        Raises
        ------
        TransferLensError
            What the model raised at the start. Benches at which it raises later are avoided.
        """
        reason = "converged"
        for stage, parameters in enumerate(self._stages()):
            if stage < stand.stage:
                continue
            if stage > stand.stage:
                stand = replace(stand, stage=stage)
            stand, reason = self._descended(stand, parameters)
        names = [p.name for p in self.parameters]
        model, transmission = self._at(stand.unknowns)
        joint = self._joint(stand.unknowns, model, transmission, self.parameters)
        left = joint.told_curvature(FOLLOWED if self.known is None else 0)
        values = stand.unknowns.of(names)
        return Told(
            stand.unknowns.changed(names, values.tolist()),
            np.asarray(np.linalg.inv(left) * _variance(joint.linear.misfit), float),
            joint.linear.misfit,
            stand.trail,
            reason,
        )

    def _stages(self) -> list[tuple[Parameter, ...]]:
        sure = tuple(p for p in self.parameters if not p.name.startswith(LAST))
        stages = [sure, self.parameters] if len(sure) < len(self.parameters) else [self.parameters]
        return [stage for stage in stages if stage]

    def _descended(self, stand: Stand, parameters: tuple[Parameter, ...]) -> tuple[Stand, str]:
        names = [p.name for p in parameters]
        before: tuple[Unknowns, float] | None = None
        while len(stand.trail) < self.most_benches:
            model, transmission = self._at(stand.unknowns)
            joint = self._joint(stand.unknowns, model, transmission, parameters)
            misfit = joint.linear.misfit
            stand = self._told(stand, stand.unknowns, misfit)
            price = self._price(stand.unknowns, misfit)
            if before is not None and price > before[1]:
                return replace(stand, unknowns=before[0]), "converged"
            if before is not None and 1.0 - price / before[1] < LEAST_GAINS[parameters == self.parameters]:
                return stand, "converged"
            before = stand.unknowns, price
            step = joint.solve(ROUNDS)
            line = _Line(price)
            while (length := line.next(stand.stretch)) is not None and len(stand.trail) < self.most_benches:
                there = stand.unknowns.changed(names, (stand.unknowns.of(names) + length * step).tolist())
                found = self._misfit(there, model.engine)
                stand = self._told(stand, there, found)
                line.add(length, self._price(there, found))
            best, _ = line.best
            if best == 0.0:
                return stand, "converged"
            here = stand.unknowns.of(names) + best * step
            stand = replace(
                stand,
                unknowns=stand.unknowns.changed(names, here.tolist()),
                stretch=float(np.clip(best, 1.0, 16.0)),
            )
            if self.keep is not None:
                self.keep(stand)
        return stand, "benches used up"

    def _price(self, unknowns: Unknowns, misfit: float) -> float:
        """The squared misfit, and more the farther values are from what is expected: sought at its least.

        With a variance of the residuals that is unknown but for the misfit, a probability's logarithm.
        """
        values = unknowns.of([p.name for p in self.parameters])
        off = float(np.sum((values / [p.typical for p in self.parameters]) ** 2))
        return misfit**2 * math.exp(NOT_TOLD_GAIN * off)

    def _told(self, stand: Stand, unknowns: Unknowns, misfit: float) -> Stand:
        stand = replace(stand, trail=(*stand.trail, (unknowns, misfit)))
        if self.progress is not None:
            self.progress(len(stand.trail), unknowns, misfit)
        return stand

    def _misfit(self, unknowns: Unknowns, near: Operator) -> float:
        """Of a bench not far from an engine's."""
        try:
            model, transmission = self._reconstructed(unknowns, near)
            return Linearised(model, transmission, self.pixels.scale is None).misfit
        except TransferLensError:
            return RUNAWAY

    def _at(self, unknowns: Unknowns) -> tuple[RecordingModel, NDArray[Any]]:
        """With an engine of its own; a stage begins, and the search ends, where the last one was made."""
        if not self._last or self._last[0][0] is not unknowns:
            self._last[:] = [(unknowns, *self._reconstructed(unknowns))]
        _, model, transmission = self._last[0]
        return model, transmission

    def _reconstructed(
        self, unknowns: Unknowns, near: Operator | None = None
    ) -> tuple[RecordingModel, NDArray[Any]]:
        model = self.pixels.model(unknowns, near)
        if self.known is not None:
            model.scale = Linearised(model, self.known, self.pixels.scale is None).scale
            return model, self.known
        found = reconstruct(
            model.engine,
            model.illumination,
            model.recorded,
            kind=self.kind,
            tv_weight="auto" if self.noise_misfit is not None else 0.0,
            iterations=self.iterations,
            scale=self.pixels.scale,
            active_width=self.pixels.active_width,
            rows=self.pixels.rows,
        )
        values = found.transmission.values
        model.scale = found.scale
        return model, values.real if self.kind == "amplitude" else values

    def _joint(
        self,
        unknowns: Unknowns,
        model: RecordingModel,
        transmission: NDArray[Any],
        parameters: tuple[Parameter, ...],
    ) -> JointStep:
        linear = Linearised(model, transmission, self.pixels.scale is None)
        columns = self.pixels.columns(unknowns, linear, parameters)
        values = unknowns.of([p.name for p in parameters])
        typical = np.array([p.typical for p in parameters])
        variance, follows = _variance(linear.misfit), self.known is None
        return JointStep(linear, columns, values, typical, variance, transmission, follows)


def _variance(misfit: float) -> float:
    """Of the residuals' length along what a parameter does."""
    return NOT_TOLD_GAIN * misfit**2


class _Line:
    """Lengths of a step that are tried: doubled while that helps, else cut down until it does."""

    def __init__(self, price: float) -> None:
        self._tried: dict[float, float] = {0.0: price}

    @property
    def best(self) -> tuple[float, float]:
        """Length and price."""
        return min(self._tried.items(), key=lambda one: one[1])

    def add(self, length: float, price: float) -> None:
        """What was found at a length."""
        self._tried[length] = price

    def next(self, stretch: float) -> float | None:
        """The length to be tried; None where the best is between others."""
        tried = sorted(self._tried)
        if len(tried) == 1:
            return stretch
        best, _ = self.best
        if best == 0.0:
            return tried[1] / 3.0 if tried[1] > 3.0 * SHORTEST else None
        return 2.0 * best if best == tried[-1] and best < LONGEST else None
