"""Light, lens, mounting and camera from the frames alone, together with the object.

A bench is judged by what a reconstruction from even light leaves after a few iterations, or by what a known
object leaves. Each step of the search takes its direction from the normal equations of object and bench about
that object, and its length from such reconstructions along it. Tiles are made where the search begins, and
turned from there; what parameters do to their rays hardly changes on the way and is told once. Light's
unevenness comes last: until the rest is right, anything explains it; and so does the tilt of the sensor, of
which frames tell least and which makes every reconstruction half as long again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import TransferLensError
from wavesim.calibration.joint.line import Line
from wavesim.calibration.joint.pixels import Pixels, RaySlopes
from wavesim.calibration.joint.step import JointStep
from wavesim.calibration.parameters import SENSOR_TILTS, Parameter, Unknowns
from wavesim.reconstruction.from_object import reconstruct
from wavesim.reconstruction.linear.linearised import Linearised, RealArray
from wavesim.scene.engine import Operator
from wavesim.scene.settings import Kind

ROUNDS = 3
"""Of conjugate gradients for a step's direction."""

BEHIND = 2
"""Rounds of the field behind the lens in an iteration: more of them take longer than the way through it."""

ADAPTED = 1
"""Iterations after which an object that was found through other tiles shows what a bench's own leave."""

FOLLOWED = 1
"""Rounds in which the object follows a parameter where it is asked what the frames tell of that."""

LAST = "light_amplitude", "sensor_tilt"
"""Beginnings of the names of parameters that are sought when the rest is right."""

FIRST, MOST_STRETCH = (1.5, 1.75), 2.0
"""Multiples of a step, at first: of a stage's first one, and of any other at most."""

HARDLY_TOLD = 0.8
"""Standard deviation of what is expected of a sensor's tilt, from which on it is not sought."""

NOT_TOLD_GAIN = 0.02
"""Share of the squared misfit that tells nothing: the model's own errors leave as much. So much more of it is
a standard deviation of what is sought, and so much costs a parameter that is as far off as is expected."""

LEAST_GAINS = 0.05, 0.02
"""A stage ends when a step lowers the squared misfit by less than this share."""

NEAR = 1.5
"""Times what noise leaves, down to which the rest is right."""

ALIKE = 0.1
"""By a step that lowers the squared misfit by less than this share, what parameters do hardly changes."""

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
    stretch: float = FIRST[0]
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


class _Tried(NamedTuple):
    """A bench, with the object that a reconstruction finds on it, or the known one, and its misfits."""

    unknowns: Unknowns
    linear: Linearised
    transmission: NDArray[Any]
    curve: tuple[float, ...]

    @property
    def misfit(self) -> float:
        return self.linear.misfit

    @property
    def engine(self) -> Operator:
        return self.linear.model.engine


class _Near(NamedTuple):
    """Tiles of a bench that is not far, and what parameters do to their rays."""

    engine: Operator
    slopes: RaySlopes | None


class _End(NamedTuple):
    """Where a stage ended, and what its parameters do there, or but for the last little step."""

    stand: Stand
    here: _Tried
    columns: RealArray
    reason: str


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

    def run(self, stand: Stand) -> Told:
        """Search, and see what the frames tell.

        Raises
        ------
        TransferLensError
            What the model raised at the start. Benches at which it raises later are avoided.
        """
        here = self._tried(stand.unknowns)
        stand = self._told(stand, here.unknowns, here.misfit)
        near = self._near(here)
        if stand.stage == 0:
            sure = tuple(p for p in self.parameters if not p.name.startswith(LAST))
            if not self._is_right(here):
                stand, here = self._descended(stand, here, near, sure or self.parameters)[:2]
            stand = replace(stand, stage=1, stretch=FIRST[1])
        end = self._descended(stand, here, near, self.parameters)
        checked = self._checked(end.here)
        if self._misled(end.here, checked) and len(end.stand.trail) < self.most_benches:
            here = self._tried(end.here.unknowns, checked.engine)
            stand = self._told(end.stand, here.unknowns, here.misfit)
            end = self._descended(stand, here, self._near(here), self.parameters)
            checked = self._checked(end.here)
        names, here, stand, reason = [p.name for p in self.parameters], end.here, end.stand, end.reason
        joint = self._joint(here, self.parameters, end.columns)
        del end  # of whose columns the step may have made its own
        left = joint.told_curvature(FOLLOWED if self.known is None else 0)
        return Told(
            stand.unknowns.changed(names, stand.unknowns.of(names).tolist()),
            np.asarray(np.linalg.inv(left) * _variance(here.misfit), float),
            checked.misfit,
            stand.trail,
            reason,
        )

    def _checked(self, here: _Tried) -> _Tried:
        """The bench by tiles of its own, and with as many iterations more."""
        return self._tried(here.unknowns, start=here.transmission)

    def _misled(self, here: _Tried, checked: _Tried) -> bool:
        """Whether tiles of a bench's own leave more than those that led to it, which know an older bench."""
        own = checked.curve[min(ADAPTED, len(checked.curve) - 1)]
        return own**2 > (1.0 + NOT_TOLD_GAIN) * here.misfit**2

    def _near(self, here: _Tried) -> _Near:
        return _Near(here.engine, self.pixels.ray_slopes(here.unknowns, here.engine, self.parameters))

    def _descended(self, stand: Stand, here: _Tried, near: _Near, parameters: tuple[Parameter, ...]) -> _End:
        sought, reason = parameters, "benches used up"
        columns = self.pixels.columns(here.unknowns, here.linear, parameters, near.slopes)
        if parameters == self.parameters:
            sought = self._worth_seeking(here, columns)
        while len(stand.trail) < self.most_benches:
            some = columns if sought == parameters else columns[[parameters.index(p) for p in sought]]
            joint = self._joint(here, sought, some)
            stand, best = self._farther(stand, here, near.engine, joint, sought)
            gain = 1.0 - self._price(best) / self._price(here)
            here, stand = best, replace(stand, unknowns=best.unknowns)
            if gain > 0.0 and self.keep is not None:
                self.keep(stand)
            if gain < LEAST_GAINS[stand.stage] or (stand.stage == 0 and self._is_right(here)):
                reason = "converged"
                break
            del joint, some
            if gain > ALIKE:
                del columns  # not those of two benches at one time
                columns = self.pixels.columns(here.unknowns, here.linear, parameters, near.slopes)
        return _End(stand, here, columns, reason)

    def _is_right(self, here: _Tried) -> bool:
        """Whether what is sought first is near enough to seek the rest."""
        return self.noise_misfit is not None and here.misfit < NEAR * self.noise_misfit

    def _farther(
        self,
        stand: Stand,
        here: _Tried,
        near: Operator,
        joint: JointStep,
        sought: Sequence[Parameter],
    ) -> tuple[Stand, _Tried]:
        """The best bench along a step; the one where it begins if none is better."""
        names, step, best = [p.name for p in sought], joint.solve(ROUNDS), here
        line = Line(self._price(here), -2.0 * float(joint.slope @ step), stand.stretch)
        while (length := line.next()) is not None and len(stand.trail) < self.most_benches:
            there = here.unknowns.changed(names, (here.unknowns.of(names) + length * step).tolist())
            try:
                tried = self._tried(there, near)
            except TransferLensError:
                line.add(length, RUNAWAY**2)
                stand = self._told(stand, there, RUNAWAY)
                continue
            line.add(length, self._price(tried))
            stand = self._told(stand, there, tried.misfit)
            best = tried if line.best == length else best
        return replace(stand, stretch=min(max(line.best, 1.0), MOST_STRETCH)), best

    def _worth_seeking(self, here: _Tried, columns: RealArray) -> tuple[Parameter, ...]:
        """All but tilts of the sensor of which frames would not even tell if the object were known."""
        flat = columns.reshape(len(columns), -1)
        typical = np.array([p.typical for p in self.parameters])
        told = np.asarray(flat @ flat.T, float) * np.outer(typical, typical) / _variance(here.misfit)
        deviations = np.sqrt(np.diag(np.linalg.inv(told + np.eye(len(typical)))))
        pairs = zip(self.parameters, deviations, strict=True)
        return tuple(p for p, share in pairs if p.name not in SENSOR_TILTS or share < HARDLY_TOLD)

    def _price(self, tried: _Tried) -> float:
        """The squared misfit, and more the farther values are from what is expected: sought at its least.

        With a variance of the residuals that is unknown but for the misfit, a probability's logarithm.
        """
        values = tried.unknowns.of([p.name for p in self.parameters])
        off = float(np.sum((values / [p.typical for p in self.parameters]) ** 2))
        return tried.misfit**2 * math.exp(NOT_TOLD_GAIN * off)

    def _told(self, stand: Stand, unknowns: Unknowns, misfit: float) -> Stand:
        stand = replace(stand, trail=(*stand.trail, (unknowns, misfit)))
        if self.progress is not None:
            self.progress(len(stand.trail), unknowns, misfit)
        return stand

    def _tried(
        self, unknowns: Unknowns, near: Operator | None = None, start: NDArray[Any] | None = None
    ) -> _Tried:
        """By tiles of its own, or by those of a bench that is not far; from even light, or an object."""
        model = self.pixels.model(unknowns, near)
        if self.known is not None:
            linear = Linearised(model, self.known, self.pixels.scale is None)
            model.scale = linear.scale
            return _Tried(unknowns, linear, self.known, (linear.misfit,))
        found = reconstruct(
            model.engine,
            model.illumination,
            model.recorded,
            kind=self.kind,
            tv_weight="auto" if self.noise_misfit is not None else 0.0,
            iterations=self.iterations,
            scale=self.pixels.scale,
            start=None if start is None else model.illumination.with_values(start),
            active_width=self.pixels.active_width,
            rows=self.pixels.rows,
            residuals=False,
            rounds=BEHIND,
        )
        model.scale = found.scale
        values = found.transmission.values
        transmission = values.real if self.kind == "amplitude" else values
        linear = Linearised(model, transmission, self.pixels.scale is None)
        return _Tried(unknowns, linear, transmission, found.misfit)

    def _joint(self, tried: _Tried, parameters: tuple[Parameter, ...], columns: RealArray) -> JointStep:
        values = tried.unknowns.of([p.name for p in parameters])
        typical = np.array([p.typical for p in parameters])
        variance, follows = _variance(tried.misfit), self.known is None
        undone = self._undone(tried, parameters) if follows else {}
        return JointStep(
            tried.linear, columns, values, typical, variance, tried.transmission, follows, undone
        )

    def _undone(self, tried: _Tried, parameters: Sequence[Parameter]) -> dict[int, NDArray[Any]]:
        """What of an amplitude object undoes a unit of the light's amplitude."""
        light = {n: p for n, p in enumerate(parameters) if p.name.startswith("light_amplitude")}
        if np.iscomplexobj(tried.transmission):
            return {}
        changes = {n: self.pixels.light_change(tried.unknowns, p).real for n, p in light.items()}
        return {n: -change.astype(np.float32) * tried.transmission for n, change in changes.items()}


def _variance(misfit: float) -> float:
    """Of the residuals' length along what a parameter does."""
    return NOT_TOLD_GAIN * misfit**2
