"""Reconstruction of an object of several layers from intensities behind the lens.

The unknowns are the transmissions t_k of the layers, whose fields follow from :mod:`wavesim.targets.layers`.
The solver minimizes the weighted misfit of amplitudes plus a total variation of each layer::

    1/2 mean over planes sum w (|A_n(u(t))| - a / scale)^2 + weight sum over k TV(t_k)

by a quasi-Newton method with bounds (L-BFGS-B). The forward model gives the gradient with respect to the
field u behind the layers, and the chain rule gives those of the layers. Curvature matters here: moving
coarse structure from one layer to another changes the light very little, and gradient steps would need
thousands of iterations to do so.

The weight of the total variation follows the misfit, as in :mod:`wavesim.reconstruction.object_solver`. It is
updated every few iterations. A search that starts from an even object then finds coarse structure first.

With more than two planes, the search begins with the nearest and the farthest one, which it fits in fewer
iterations than all of them, and continues with all planes from the layers that it has found.

The factors of single layers are not determined, only their product. Layers are normalized: the brightest
amplitude is 1, or the mean phase is 0.

References
----------
R. Byrd, P. Lu, J. Nocedal and C. Zhu, "A limited memory algorithm for bound constrained optimization", SIAM
J. Sci. Comput. 16, 1190 (1995).
A. M. Maiden, M. J. Humphry and J. M. Rodenburg, "Ptychographic transmission microscopy in three dimensions
using a multi-slice approach", J. Opt. Soc. Am. A 29, 1606 (2012).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from lensdesign.analysis.oversampling import ObjectKind
from lensdesign.common.memory import check_memory
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.step_noise import noise_of_step
from wavesim.reconstruction.object_solver import validate_measurements, validate_numbers
from wavesim.reconstruction.stop_rule import AT_NOISE, STOPPED, Stop
from wavesim.runtime.checkpoint import Checkpoint, CheckpointSeries
from wavesim.scene.engine import Engine
from wavesim.sensor.measurement import Measurement, amplitude_unit, in_unit, noise_misfit
from wavesim.targets.layers import LayerStack

RealArray = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

SHORT_ROUND, LONG_ROUND = 20, 60
"""Iterations between two updates of the weight of the total variation: while the misfit falls by more than
the fraction `FAST_FALL` in a round, and afterwards.
"""

FAST_FALL = 0.15

FIRST_FRACTION = 2.0 / 3.0
"""Largest fraction of the iterations for the nearest and the farthest plane alone, where there are more."""

TV_PER_NOISE = 0.15
"""Weight of the total variation over the standard deviation of the noise of a step.

It is smaller than that of a single layer. Among layers that explain the frames equally well, a larger weight
prefers those whose contrast has moved to one of them.
"""

HISTORY = 15
"""Number of corrections that the quasi-Newton method keeps."""

ROUNDED_STEP = 0.02
"""Difference of neighbouring samples below which the total variation is rounded, so that it is smooth."""

TOLERANCE = 1e-3
"""Relative change of the misfit over a round at which iterations end."""


@dataclass(frozen=True, eq=False)
class Layers:
    """Reconstructed layers of an object.

    Attributes
    ----------
    transmissions : tuple of Field
        Transmission of each layer, in the order in which light passes them; 0 outside the field stop.
    misfit : tuple of float
        Relative L2 difference between modelled and measured amplitudes after each iteration, on the planes
        that the iteration used.
    residual_maps : tuple of ndarray
        For each plane, modelled less measured amplitude, in the unit of the measured amplitude.
    scale : float
        Measured amplitude per unit of the modelled amplitude.
    stopped_because : {"noise", "converged", "iterations"}
        Reason for the end of the iterations: :class:`wavesim.reconstruction.Reconstructed`.
    """

    transmissions: tuple[Field, ...]
    misfit: tuple[float, ...]
    residual_maps: tuple[RealArray, ...]
    scale: float
    stopped_because: Stop


def find_layers(
    engine: Engine,
    stack: LayerStack,
    recorded: Sequence[Measurement],
    *,
    kind: ObjectKind = "amplitude",
    tv_weight: float | str = "auto",
    iterations: int = 300,
    fill_factor: float = 0.0,
    scale: float | None = None,
    progress: Callable[[int, float], None] | None = None,
    checkpoints: CheckpointSeries | None = None,
) -> Layers:
    """Find the transmissions of the layers of an object behind measured amplitudes.

    Parameters
    ----------
    engine
        Engine from the object plane to a plane behind the lens.
    stack
        Positions of the layers, and the light on the first one.
    recorded
        Measured amplitudes of one or more planes, with standard deviations; see :func:`wavesim.reconstruct`.
    kind
        "amplitude" for real transmissions that are not negative, "phase" for transmissions of modulus 1, or
        "complex".
    tv_weight
        Weight of the total variation of each layer; "auto": `TV_PER_NOISE` times the noise of a step, times
        the ratio of the misfit to that of noise alone.
    iterations
        Largest number of iterations, with those on two of more than two planes.
    fill_factor
        Linear fill factor of a pixel.
    scale
        Measured amplitude per unit of the modelled amplitude, which determines the product of the layers;
        their brightest parts are then equal. Default: fitted to an even object, and the brightest part of
        each layer is 1.
    progress
        Callback `progress(index, misfit)`, called after every iteration.
    checkpoints
        Where states are saved, after each round of iterations; the same call continues an interrupted search,
        and finds the same layers. Default: nowhere.

    Returns
    -------
    Layers
        Transmissions of the layers.

    Raises
    ------
    InputError
        If a value or a shape is invalid.
    MemoryLimitError
        If the arrays of the search do not fit in memory.

    Examples
    --------
    Two layers, 20 µm apart, from amplitudes on two planes without noise:

    >>> import numpy as np
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import Field, Measurement, engine_for, patch_scene
    >>> from wavesim.reconstruction.layered import find_layers
    >>> from wavesim.targets.layers import LayerStack
    >>> scene = patch_scene(scaled(load_design("designs/paper_singlet.toml"), 1 / 64), 0.02)
    >>> engine, grid = engine_for(scene, "eikonal", error=0.1), scene.object_grid
    >>> x, y = grid.x_mm, grid.y_mm[:, None]
    >>> stop = np.where(np.hypot(x, y) < 0.008, 1.0, 0.0)
    >>> light = Field(grid, stop + 0j, scene.wavelength_um)
    >>> discs = [1.0 - 0.8 * (np.hypot(x - at, y) < 0.002) for at in (0.003, -0.003)]
    >>> stack = LayerStack(grid, light, (-20.0, 0.0), stop)
    >>> amplitude = np.abs(engine.forward(light.with_values(stack.forward(discs).behind)).values)
    >>> recorded = [Measurement(0.0, amplitude, np.full(amplitude.shape, 1e-3 * amplitude.max()))]
    >>> found = find_layers(engine, stack, recorded, iterations=40)
    >>> [round(float(np.corrcoef(one.values.real[stack.lit], disc[stack.lit])[0, 1]), 1)
    ...  for one, disc in zip(found.transmissions, discs)]
    [1.0, 1.0]
    """
    validate_numbers("complex", tv_weight, iterations, scale, fill_factor)
    even = Field(stack.grid, np.ones(stack.grid.shape, complex), stack.light.wavelength_um)
    validate_measurements(engine.scene, even.with_values(stack.light.values), recorded, None, ())
    parameters = _PARAMETERS[kind]
    unknowns = parameters.numbers * len(stack.distances_um) * int(np.count_nonzero(stack.lit))
    arrays = 2 * HISTORY + 10
    check_memory(
        8 * arrays * unknowns,
        f"layers of {unknowns:.3g} unknowns",
        "use a smaller patch_mm or fewer layers",
    )
    unit = amplitude_unit(recorded)
    recorded = in_unit(recorded, unit)
    near, far = (select(recorded, key=lambda plane: plane.distance_mm) for select in (min, max))
    first = [([near, far], int(FIRST_FRACTION * iterations))] if len(recorded) > 2 else []
    values, misfits = None, list[float]()
    for planes, last in (*first, (recorded, iterations)):
        model = ChannelModel.of_source(engine, even, planes, scale and scale / unit, fill_factor)
        objective = LayersObjective(model, stack, kind)
        values = objective.start() if values is None else values
        if scale is None:
            objective.fit_scale(values)
        # Layers of modulus 1 cannot take up an error of the scale, which the even object leaves.
        fits_scale = scale is None and kind == "phase"
        checkpoint = None if checkpoints is None else checkpoints.next()
        search = _Search(objective, tv_weight, noise_misfit(planes), last, fits_scale, progress, checkpoint)
        values, reason = search.run(values, misfits)
    assert values is not None
    transmissions, factor = parameters.normalized(objective.transmissions(values), stack.lit)
    model = objective.model
    if scale is None:
        model = model.with_scale(factor * model.scale)
    else:  # The light on the planes determines the product of all layers.
        transmissions = [factor ** (1.0 / len(transmissions)) * one for one in transmissions]
    maps = tuple(model.amplitudes(stack.forward(transmissions).behind))
    for modelled, plane in zip(maps, recorded, strict=True):
        modelled -= plane.amplitude
        modelled *= unit
    fields = tuple(
        Field(
            stack.grid.at(stack.grid.z_mm + 1e-3 * distance),
            one.astype(np.complex64),
            stack.light.wavelength_um,
        )
        for distance, one in zip(stack.distances_um, transmissions, strict=True)
    )
    return Layers(fields, tuple(misfits), maps, model.scale * unit, reason)


class LayersObjective:
    """Misfit and total variation of layers, as a function of real unknowns.

    Parameters
    ----------
    model
        Forward model from the object plane, with an illumination of 1 everywhere in double precision.
    stack
        Positions of the layers, and the light on the first one.
    kind
        Kind of the layers.
    """

    def __init__(self, model: ChannelModel, stack: LayerStack, kind: ObjectKind) -> None:
        self.model, self.stack = model, stack
        self.parameters = _PARAMETERS[kind]
        self.inside = stack.lit
        # Differences between neighbours count where both samples are within the field stop.
        self._along_x = self.inside[:, 1:] & self.inside[:, :-1]
        self._along_y = self.inside[1:] & self.inside[:-1]
        scene = model.engine.scene
        self._cells = scene.exit_grid.cell / scene.object_grid.cell
        self.tv_weight = 0.0
        self.misfit = np.inf

    def start(self) -> RealArray:
        """Return the unknowns of layers that transmit all light."""
        samples = int(np.count_nonzero(self.inside))
        one_layer = self.parameters.from_transmission(np.ones(samples))
        return np.tile(one_layer, len(self.stack.distances_um))

    def transmissions(self, unknowns: RealArray) -> list[ComplexArray]:
        """Return the transmissions of the layers on all samples; 0 outside the field stop."""
        layers = []
        for part in np.split(unknowns, len(self.stack.distances_um)):
            values = np.zeros(self.inside.shape, complex)
            values[self.inside] = self.parameters.to_transmission(part)
            layers.append(values)
        return layers

    def fit_scale(self, unknowns: RealArray) -> None:
        """Set the scale with which the light of given layers has the energy of the measured light.

        A least-squares fit of amplitudes would give a smaller scale, as long as the layers are wrong.
        """
        model = self.model
        step = model.step(self.stack.forward(self.transmissions(unknowns)).behind, fits_scale=True)
        # The least-squares scale explains the fraction 1 - misfit^2 of the energy.
        self.model = model.with_scale(step.scale / math.sqrt(max(1.0 - step.misfit**2, 1e-6)))

    def __call__(self, unknowns: RealArray) -> tuple[float, RealArray]:
        """Return the objective and its gradient. The misfit is stored in `misfit`."""
        model, layers = self.model, self.transmissions(unknowns)
        fields = self.stack.forward(layers)
        change, self.misfit, _ = model.step(fields.behind)
        value = 0.5 * (self.misfit * model.size / model.scale) ** 2 * self._cells / len(model.recorded)
        gradients = self.stack.adjoint(change, layers, fields)
        parts = []
        for layer, gradient in zip(layers, gradients, strict=True):
            total = np.asarray(-gradient, complex)
            if self.tv_weight > 0.0:
                variation, slope = self._total_variation(layer)
                value += self.tv_weight * variation
                total += self.tv_weight * slope
            parts.append(self.parameters.gradient(total[self.inside], layer[self.inside]))
        return value, np.concatenate(parts)

    def _total_variation(self, layer: ComplexArray) -> tuple[float, ComplexArray]:
        """Return the rounded total variation of a layer within the field stop, and its gradient."""
        along_x, along_y = np.zeros_like(layer), np.zeros_like(layer)
        along_x[:, :-1] = np.diff(layer, axis=1) * self._along_x
        along_y[:-1] = np.diff(layer, axis=0) * self._along_y
        size = np.sqrt(np.abs(along_x) ** 2 + np.abs(along_y) ** 2 + ROUNDED_STEP**2)
        along_x /= size
        along_y /= size
        slope = -along_x - along_y
        slope[:, 1:] += along_x[:, :-1]
        slope[1:] += along_y[:-1]
        return float(np.sum(size - ROUNDED_STEP)), slope


@dataclass(frozen=True)
class _Parameters:
    """Real unknowns of the transmission of one layer.

    Attributes
    ----------
    numbers : int
        Unknowns of a sample.
    lowest : float or None
        Lower bound of an unknown.
    to_transmission, from_transmission : callable
        Conversions between unknowns and transmissions, shape (samples,).
    gradient : callable
        Returns the derivative with respect to the unknowns, from that with respect to the transmission and
        the transmission itself.
    normalized : callable
        Returns layers with normalized factors, and the factor of the light that this removes.
    """

    numbers: int
    lowest: float | None
    to_transmission: Callable[[RealArray], Any]
    from_transmission: Callable[[Any], RealArray]
    gradient: Callable[[ComplexArray, ComplexArray], RealArray]
    normalized: Callable[[list[ComplexArray], NDArray[np.bool_]], tuple[list[ComplexArray], float]]


def _brightest_is_1(
    layers: list[ComplexArray], inside: NDArray[np.bool_]
) -> tuple[list[ComplexArray], float]:
    """Return layers whose brightest amplitude is 1, with a mean phase of 0."""
    factor, scaled = 1.0, []
    for layer in layers:
        amplitudes = np.sort(np.abs(layer[inside]))
        energy = np.cumsum(amplitudes**2)
        if energy[-1] > 0.0:
            # A few samples at edges may exceed the brightest parts. They are limited by their energy, because
            # the bright part itself may cover a small area, as a pinhole does.
            brightest = float(amplitudes[np.searchsorted(energy, 0.99 * energy[-1])])
            factor, layer = factor * brightest, layer / brightest
        scaled.append(layer)
    return _without_mean_phase(scaled, inside)[0], factor


def _without_mean_phase(
    layers: list[ComplexArray], inside: NDArray[np.bool_]
) -> tuple[list[ComplexArray], float]:
    """Return layers with a mean phase of 0."""
    return [layer * np.exp(-1j * np.angle(np.sum(layer[inside]))) for layer in layers], 1.0


def _halves(values: RealArray) -> ComplexArray:
    real, imaginary = np.split(values, 2)
    return np.asarray(real + 1j * imaginary)


_PARAMETERS: dict[ObjectKind, _Parameters] = {
    "amplitude": _Parameters(
        1,
        0.0,
        lambda unknowns: unknowns,
        lambda transmission: np.abs(transmission),
        lambda gradient, transmission: gradient.real,
        _brightest_is_1,
    ),
    "phase": _Parameters(
        1,
        None,
        lambda unknowns: np.exp(1j * unknowns),
        lambda transmission: np.angle(transmission),
        lambda gradient, transmission: (np.conj(1j * transmission) * gradient).real,
        _without_mean_phase,
    ),
    "complex": _Parameters(
        2,
        None,
        _halves,
        lambda transmission: np.concatenate([transmission.real, transmission.imag]),
        lambda gradient, transmission: np.concatenate([gradient.real, gradient.imag]),
        _brightest_is_1,
    ),
}
"""Unknowns of each kind of layer."""


@dataclass(frozen=True, eq=False)
class _Search:
    """Rounds of quasi-Newton iterations, each with its weight of the total variation."""

    objective: LayersObjective
    tv_weight: float | str
    misfit_of_noise: float | None
    iterations: int
    fits_scale: bool
    progress: Callable[[int, float], None] | None
    checkpoint: Checkpoint | None = None

    def run(self, unknowns: RealArray, misfits: list[float]) -> tuple[RealArray, Stop]:
        """Return the unknowns and the reason to stop, and append the misfit of every iteration."""
        objective, begun = self.objective, len(misfits)
        noise = noise_of_step(objective.model) if self.tv_weight == "auto" else 0.0
        lowest = -np.inf if objective.parameters.lowest is None else objective.parameters.lowest
        length, reason = SHORT_ROUND, None
        saved = None if self.checkpoint is None else self.checkpoint.load()
        if saved is not None:
            unknowns, length, misfits[:] = saved["unknowns"], int(saved["length"]), saved["misfits"].tolist()
            objective.model = objective.model.with_scale(float(saved["scale"]))
            reason = next((one for one in STOPPED if one == str(saved["reason"])), None)
        objective(unknowns)

        def after_iteration(_: RealArray) -> None:
            misfits.append(objective.misfit)
            if self.progress is not None:
                self.progress(len(misfits) - 1, objective.misfit)

        while reason is None and len(misfits) < self.iterations:
            before, done = objective.misfit, len(misfits)
            if done > begun and self.fits_scale:
                objective.fit_scale(unknowns)
            objective.tv_weight = self._weight(noise)
            unknowns = scipy.optimize.minimize(  # type: ignore[call-overload]
                objective,
                unknowns,
                jac=True,
                method="L-BFGS-B",
                bounds=scipy.optimize.Bounds(lowest, np.inf),
                callback=after_iteration,
                options={
                    "maxiter": min(length, self.iterations - done),
                    "maxcor": HISTORY,
                    "ftol": 0.0,
                    "gtol": 0.0,
                },
            ).x
            objective(unknowns)
            fall = 1.0 - objective.misfit / before
            if len(misfits) == done or (length == LONG_ROUND and abs(fall) < TOLERANCE):
                at_noise = objective.misfit <= AT_NOISE * (self.misfit_of_noise or 0.0)
                if not misfits:
                    misfits.append(before)
                reason = "noise" if at_noise else "converged"
            if fall < FAST_FALL:
                length = LONG_ROUND
            if self.checkpoint is not None:
                self.checkpoint.keep(
                    unknowns=unknowns,
                    length=length,
                    misfits=misfits,
                    scale=objective.model.scale,
                    reason=reason or "",
                )
        return unknowns, reason or "iterations"

    def _weight(self, noise: float) -> float:
        """Return the weight of the total variation at the present misfit."""
        if self.tv_weight != "auto" or self.misfit_of_noise is None:
            return 0.0 if isinstance(self.tv_weight, str) else self.tv_weight
        over = max(self.objective.misfit / self.misfit_of_noise, 1.0)
        return TV_PER_NOISE * noise / self.objective.model.scale * over
