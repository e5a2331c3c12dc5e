"""Light, lens, mounting and camera from the frames alone, together with the object.

A bench is judged by what a reconstruction from even light leaves after a few iterations, or by what a known
object leaves. Each step of the search takes its direction from the normal equations of object and bench about
that object, and its length from such reconstructions along it. Tiles are made where the search begins, and
turned from there; what parameters do to their rays hardly changes on the way and is told once. In the end the
object is reconstructed until its misfit is that of the noise, and the normal equations about it, with the
variance of the noise, give the estimates and their covariance. Parameters that the frames do not need
(:mod:`wavesim.calibration.joint.selection`) return to their nominal values. Light's
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
from wavesim.calibration.joint.pixels import Pixels, RaySlopes, plane_number
from wavesim.calibration.joint.selection import Selection, select_parameters
from wavesim.calibration.joint.step import GaussNewtonStep
from wavesim.calibration.parameters import SENSOR_TILTS, Parameter, Unknowns
from wavesim.metrics.goodness_of_fit import MODEL_ERROR
from wavesim.reconstruction.from_object import reconstruct
from wavesim.reconstruction.linear.linearised import Linearised, RealArray
from wavesim.scene.engine import Operator
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import DARK

ROUNDS = 3
"""Of conjugate gradients for a step's direction."""

BEHIND = 2
"""Rounds of the field behind the lens in an iteration: more of them take longer than the way through it."""

ADAPTED = 1
"""Iterations after which an object that was found through other tiles shows what a bench's own leave."""

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

SETTLED, ESTIMATED, FOLLOWS = 80, 30, 5
"""Iterations of the object at the end, rounds of conjugate gradients for the estimates, and rounds in which
the object follows for their covariance."""

REFINED = 2
"""Times that estimates are made, each about the object on the bench of the one before."""

OBJECT_FACTOR = 1.4
"""Standard deviations of estimates over those by the noise alone: objects are not quite at the minimum."""

COHERENT = 250
"""Independent parts of what engine and pixels err (`MODEL_ERROR` of the amplitude): unlike noise it is alike
in many pixels, and of parameters it takes away more. So many fit the pulls on benches that are as designed
(`benchmarks/calibration_pulls.py`)."""

WORSE = 1.02
"""Ratio of misfits up to which a bench with fewer parameters, or a refined one, explains frames as well."""

CLIPPED = 0.17
"""Square of the mean root of a dark pixel's noisy intensity, clipped at 0, over its standard deviation: noise
looks like so much light there, and passes for a background."""

RUNAWAY = 4.0
"""Stands for the misfit where the model fails."""

Progress = Callable[[int, Unknowns, float], None]


@dataclass(frozen=True, eq=False)
class SearchState:
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
        The bench: parameters that are not needed have their nominal values.
    estimates : ndarray, shape (parameters,)
        What the frames say of each parameter, needed or not.
    needed : ndarray of bool, shape (parameters,)
        Whether the frames need the parameter.
    covariance : ndarray, shape (parameters, parameters)
        Of the estimates, with what was expected before.
    misfit : float
    trail : tuple of (Unknowns, float)
    stopped_because : str
    """

    unknowns: Unknowns
    estimates: Array
    needed: NDArray[np.bool_]
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

    stand: SearchState
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
    keep: Callable[[SearchState], None] | None = None

    def run(self, stand: SearchState) -> Told:
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
            near = self._near(here)
            end = self._descended(stand, here, near, self.parameters)
            checked = self._checked(end.here)
        here, stand, reason = end.here, end.stand, end.reason
        del end  # of whose columns the step may have made its own
        return self._estimated(stand, here, checked, near.slopes, reason)

    def _estimated(
        self, stand: SearchState, here: _Tried, checked: _Tried, slopes: RaySlopes | None, reason: str
    ) -> Told:
        """Estimates about the object in the end, and the bench with the parameters that are needed."""
        names = [p.name for p in self.parameters]
        best = self._settled(here.unknowns, checked.transmission)
        for count in range(REFINED):
            estimates, covariance = self._estimate(best, slopes)
            if count == REFINED - 1:
                break
            refined = self._or_none(best.unknowns.changed(names, estimates.tolist()), best.transmission)
            if refined is None or refined.misfit > WORSE * best.misfit:
                break
            best = refined
        # First the bench as designed: where a stiff direction is a little off, a linear model asks for more.
        selected = select_parameters(estimates, covariance, self._pixels)
        none = Selection(np.zeros(len(names), bool), np.zeros(len(names)))
        needed = np.ones(len(names), bool)
        for one in (none, selected):
            fewer = self._or_none(best.unknowns.changed(names, one.values.tolist()), best.transmission)
            if fewer is not None and fewer.misfit <= WORSE * max(best.misfit, self.noise_misfit or 0.0):
                best, needed = fewer, one.needed
                break
        return Told(best.unknowns, estimates, needed, covariance, best.misfit, stand.trail, reason)

    @property
    def _pixels(self) -> int:
        """Pixels of which something is known."""
        planes = self.pixels.recorded
        return sum(p.amplitude.size if p.known is None else int(p.known.sum()) for p in planes)

    def _or_none(self, unknowns: Unknowns, start: NDArray[Any]) -> _Tried | None:
        try:
            return self._settled(unknowns, start)
        except TransferLensError:
            return None

    def _settled(self, unknowns: Unknowns, start: NDArray[Any]) -> _Tried:
        """The bench with the object whose misfit is that of the noise, or falls no more."""
        return self._tried(unknowns, start=start, iterations=SETTLED)

    def _estimate(self, tried: _Tried, slopes: RaySlopes | None) -> tuple[Array, Array]:
        """Estimates of all parameters, and their covariance."""
        names, linear = [p.name for p in self.parameters], tried.linear
        columns = self.pixels.columns(tried.unknowns, linear, self.parameters, slopes)
        # A misfit beyond the noise is an error of the model, of which frames tell as little as of noise.
        misfit = max(linear.misfit, self.noise_misfit or 0.0)
        variance = (OBJECT_FACTOR * misfit) ** 2 / self._pixels + MODEL_ERROR**2 / COHERENT
        typical, values = np.array([p.typical for p in self.parameters]), tried.unknowns.of(names)
        follows = self.known is None
        joint = GaussNewtonStep(
            linear,
            columns,
            values,
            typical,
            variance,
            tried.transmission,
            follows,
            self._undone(tried, self.parameters) if follows else {},
        )
        joint.damping = np.zeros_like(joint.damping)
        estimates = values + joint.solve(ESTIMATED)
        covariance = np.linalg.inv(joint.reduced_curvature(FOLLOWS if follows else 0)) * variance
        return estimates, np.asarray(covariance + np.diag(self._clipped() ** 2), float)

    def _clipped(self) -> Array:
        """How large a background, by the parameter's place, clipped noise of dark pixels may pass for."""
        planes, found = self.pixels.recorded, np.zeros(len(self.parameters))
        for place, parameter in enumerate(self.parameters):
            if not parameter.name.endswith("_background"):
                continue
            plane = planes[plane_number(parameter)]
            if plane.sigma is not None:
                dark = np.min(plane.sigma[plane.amplitude == plane.amplitude.min()])
                mean = float(np.mean(plane.amplitude.astype(float) ** 2))
                found[place] = CLIPPED * 4.0 * DARK * float(dark) ** 2 / mean
        return found

    def _checked(self, here: _Tried) -> _Tried:
        """The bench by tiles of its own, and with as many iterations more."""
        return self._tried(here.unknowns, start=here.transmission)

    def _misled(self, here: _Tried, checked: _Tried) -> bool:
        """Whether tiles of a bench's own leave more than those that led to it, which know an older bench."""
        own = checked.curve[min(ADAPTED, len(checked.curve) - 1)]
        return own**2 > (1.0 + NOT_TOLD_GAIN) * here.misfit**2

    def _near(self, here: _Tried) -> _Near:
        return _Near(here.engine, self.pixels.ray_slopes(here.unknowns, here.engine, self.parameters))

    def _descended(
        self, stand: SearchState, here: _Tried, near: _Near, parameters: tuple[Parameter, ...]
    ) -> _End:
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
        stand: SearchState,
        here: _Tried,
        near: Operator,
        joint: GaussNewtonStep,
        sought: Sequence[Parameter],
    ) -> tuple[SearchState, _Tried]:
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

    def _told(self, stand: SearchState, unknowns: Unknowns, misfit: float) -> SearchState:
        stand = replace(stand, trail=(*stand.trail, (unknowns, misfit)))
        if self.progress is not None:
            self.progress(len(stand.trail), unknowns, misfit)
        return stand

    def _tried(
        self,
        unknowns: Unknowns,
        near: Operator | None = None,
        start: NDArray[Any] | None = None,
        iterations: int | None = None,
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
            iterations=iterations or self.iterations,
            until_noise=iterations is not None,
            scale=self.pixels.scale,
            start=None if start is None else model.illumination.with_values(start),
            fill_factor=self.pixels.fill_factor,
            rows=self.pixels.rows,
            residuals=False,
            rounds=BEHIND,
        )
        model.scale = found.scale
        values = found.transmission.values
        transmission = values.real if self.kind == "amplitude" else values
        linear = Linearised(model, transmission, self.pixels.scale is None)
        return _Tried(unknowns, linear, transmission, found.misfit)

    def _joint(self, tried: _Tried, parameters: tuple[Parameter, ...], columns: RealArray) -> GaussNewtonStep:
        values = tried.unknowns.of([p.name for p in parameters])
        typical = np.array([p.typical for p in parameters])
        variance, follows = _variance(tried.misfit), self.known is None
        undone = self._undone(tried, parameters) if follows else {}
        return GaussNewtonStep(
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
