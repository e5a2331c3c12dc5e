"""Object-domain reconstruction: the object itself from intensities behind the lens.

The object t (its complex transmission) under a known illumination u gives the fields A_n(u t) on the planes
n. Steps

    t <- prox( t + mean over n of conj(u) A_n*( P_n(A_n(u t)) - A_n(u t) ) / max |u|^2 ),

with P_n the replacement of the amplitude by the recorded one, go down the misfit of amplitudes; because the
engine and free space are nearly unitary, the unit step is safe. The proximal map of the total variation keeps
edges and takes noise out; steps are accelerated (FISTA). Where the illumination is dark, so is the object:
a field stop is a support.

Sources: A. Beck and M. Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse
problems", SIAM J. Imaging Sci. 2, 183 (2009); A. Chambolle, "An algorithm for total variation minimization
and applications", J. Math. Imaging Vis. 20, 89 (2004).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.engine import Engine
from wavesim.fields import Field
from wavesim.free_space import transfer_function
from wavesim.retrieval import Recorded, refuse_planes, replace_amplitude

ComplexArray = NDArray[np.complexfloating[Any, Any]]
Kind = Literal["complex", "amplitude"]

PROX_ITERATIONS = 12
PROX_STEP = 0.248

SCALE_ITERATIONS = 4
"""In which an unknown scale is fitted; longer, it and the transmission would drift against each other."""

EARLY, EARLY_GAIN = 5, 1e-3
"""Early stop: over so many iterations the misfit falls by less than this share."""


@dataclass(frozen=True, eq=False)
class Reconstructed:
    """A reconstructed object.

    Attributes
    ----------
    transmission : Field
        On the engine's object grid; 0 where there is no light.
    misfit : tuple of float
        For every iteration, the relative L2 difference of all planes' amplitudes and the recorded ones.
    residual_maps : tuple of ndarray
        For each plane, amplitude of the result less the recorded one, in units of the recorded one.
    scale : float
        Recorded amplitude for a unit of the model's.
    stopped_early : bool
        Whether the misfit fell no more before the iterations were used up.
    """

    transmission: Field
    misfit: tuple[float, ...]
    residual_maps: tuple[NDArray[np.floating[Any]], ...]
    scale: float
    stopped_early: bool


def reconstruct(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Recorded],
    *,
    kind: Kind = "complex",
    tv_weight: float = 0.0,
    iterations: int = 30,
    scale: float | None = None,
    start: Field | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Reconstructed:
    """Find the object behind recorded amplitudes.

    Parameters
    ----------
    engine
        From the object grid to a plane behind the lens.
    illumination
        On the engine's object grid, field stop included; in complex64 all is computed so.
    recorded
        One plane or more, with distances from the engine's exit grid.
    kind
        "complex", or "amplitude" for a transmission that is real and between 0 and 1.
    tv_weight
        Of the total variation, for transmissions of order 1; 0 leaves it out.
    iterations
        At most.
    scale
        Recorded amplitude for a unit of the model's, where a picture without object has told it. Left out,
        it is fitted in the first iterations: then the transmission is known but for a factor.
    start
        Transmission to start from; 1 if left out.
    progress
        Called after every iteration with its number and misfit.

    Raises
    ------
    InputError
        If a value or a shape is not usable.
    """
    _refuse(engine, illumination, recorded, kind, tv_weight, iterations, scale)
    model = _Model(engine, illumination, recorded, scale)
    now = model.lit.astype(illumination.values.dtype) if start is None else start.values * model.lit
    ahead, momentum = now, 1.0
    misfits: list[float] = []
    stopped = False
    for k in range(iterations):
        model.fits_scale = scale is None and k < SCALE_ITERATIONS
        change, misfit = model.step(ahead)
        after = prox_tv(ahead + change, tv_weight)
        if kind == "amplitude":
            after = np.clip(after.real, 0.0, 1.0).astype(after.dtype)
        after *= model.lit
        next_momentum = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum**2))
        ahead = after + ((momentum - 1.0) / next_momentum) * (after - now)
        now, momentum = after, next_momentum
        misfits.append(misfit)
        if progress is not None:
            progress(k, misfit)
        if (
            k >= EARLY
            and misfits[-1 - EARLY] - misfit < EARLY_GAIN * misfit
            and misfits[-1 - EARLY] >= misfit
        ):
            stopped = True
            break
    maps = model.residual_maps(now)
    found = Field(engine.scene.object_grid, now, illumination.wavelength_um)
    return Reconstructed(found, tuple(misfits), maps, model.scale, stopped)


class _Model:
    """The engine, the way to each plane, and what was recorded there."""

    def __init__(
        self, engine: Engine, illumination: Field, recorded: Sequence[Recorded], scale: float | None
    ) -> None:
        self.engine, self.illumination, self.recorded = engine, illumination, recorded
        power = np.abs(illumination.values) ** 2
        self.brightest = float(power.max())
        self.lit = (power > 1e-6 * self.brightest).astype(power.dtype)
        grid, dtype = engine.scene.exit_grid, illumination.values.dtype
        self.ways = [
            np.asarray(
                transfer_function(
                    grid.shape,
                    grid.pitch_mm,
                    illumination.wavelength_um,
                    1.0,
                    p.distance_mm,
                    band_limit=False,
                )
            ).astype(dtype)
            for p in recorded
        ]
        self.size = math.sqrt(sum(float(np.sum(p.amplitude**2, dtype=float)) for p in recorded))
        self.scale, self.fits_scale = scale or 1.0, False

    def _fields(self, transmission: ComplexArray) -> list[ComplexArray]:
        lit = self.illumination.with_values(transmission * self.illumination.values)
        spectrum = scipy.fft.fftn(self.engine.forward(lit).values, workers=-1)
        fields = [scipy.fft.ifftn(spectrum * way, workers=-1, overwrite_x=True) for way in self.ways]
        if not self.fits_scale:
            return fields
        moduli = [np.abs(field) for field in fields]
        met = sum(float(np.vdot(m, p.amplitude)) for m, p in zip(moduli, self.recorded, strict=True))
        own = sum(float(np.vdot(m, m)) for m in moduli)
        self.scale = met / own if met > 0.0 < own else 1.0
        return fields

    def step(self, transmission: ComplexArray) -> tuple[ComplexArray, float]:
        """The change of the transmission, and the misfit before it."""
        spectrum: ComplexArray | None = None
        missed = 0.0
        for field, way, plane in zip(self._fields(transmission), self.ways, self.recorded, strict=True):
            wanted = field.copy()
            replace_amplitude(wanted, (plane.amplitude / self.scale).astype(wanted.real.dtype))
            wanted -= field
            missed += self.scale**2 * float(np.sum(np.abs(wanted) ** 2, dtype=float))
            part = scipy.fft.fftn(wanted, workers=-1, overwrite_x=True)
            part *= way.conj()
            spectrum = part if spectrum is None else spectrum + part
        assert spectrum is not None
        back = scipy.fft.ifftn(spectrum, workers=-1, overwrite_x=True) / len(self.ways)
        exit_field = Field(self.engine.scene.exit_grid, back, self.illumination.wavelength_um)
        change = self.engine.adjoint(exit_field).values * self.illumination.values.conj() / self.brightest
        return change, math.sqrt(missed) / self.size

    def residual_maps(self, transmission: ComplexArray) -> tuple[NDArray[np.floating[Any]], ...]:
        """Amplitudes of the model less the recorded ones."""
        fields = self._fields(transmission)
        return tuple(self.scale * np.abs(f) - p.amplitude for f, p in zip(fields, self.recorded, strict=True))


def prox_tv(values: ComplexArray, weight: float, iterations: int = PROX_ITERATIONS) -> ComplexArray:
    """Minimize half the squared distance to values, plus a weight times the isotropic total variation.

    Parameters
    ----------
    values
        Complex, on a line or a plane; real and imaginary part are taken together.
    weight
        0 leaves the values as they are.
    iterations
        Of Chambolle's dual projection.
    """
    if weight == 0.0:
        return values
    flow = np.zeros((values.ndim, *values.shape), values.dtype)
    step = PROX_STEP * (2.0 / values.ndim) / 2.0
    for _ in range(iterations):
        slope = _gradient(_divergence(flow) - values / weight)
        modulus = np.sqrt(np.sum(np.abs(slope) ** 2, axis=0))
        flow = (flow + step * slope) / (1.0 + step * modulus)
    return np.asarray(values - weight * _divergence(flow))


def _gradient(values: ComplexArray) -> ComplexArray:
    result = np.zeros((values.ndim, *values.shape), values.dtype)
    for axis in range(values.ndim):
        result[axis][_part(values.ndim, axis, slice(0, -1))] = np.diff(values, axis=axis)
    return result


def _divergence(flow: ComplexArray) -> ComplexArray:
    """Negative adjoint of the gradient."""
    dimensions = len(flow)
    result = np.zeros(flow.shape[1:], flow.dtype)
    for axis in range(dimensions):
        inner = flow[axis][_part(dimensions, axis, slice(0, -1))]
        result[_part(dimensions, axis, slice(0, -1))] += inner
        result[_part(dimensions, axis, slice(1, None))] -= inner
    return result


def _part(dimensions: int, axis: int, part: slice) -> tuple[slice, ...]:
    return tuple(part if i == axis else slice(None) for i in range(dimensions))


def _refuse(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Recorded],
    kind: str,
    tv_weight: float,
    iterations: int,
    scale: float | None,
) -> None:
    if illumination.grid != engine.scene.object_grid:
        raise InputError(f"illumination: its grid {illumination.grid} is not the engine's object grid")
    if not np.any(np.abs(illumination.values) > 0.0):
        raise InputError("illumination: is all dark")
    if not recorded:
        raise InputError("recorded: must be one plane at least")
    refuse_planes(recorded, engine.scene.exit_grid.shape, "the exit grid's")
    if kind not in ("complex", "amplitude"):
        raise InputError(f"kind = {kind!r}: allowed: complex, amplitude")
    if not (math.isfinite(tv_weight) and tv_weight >= 0.0):
        raise InputError(f"tv_weight = {tv_weight!r}: must be finite and not negative")
    if iterations < 1:
        raise InputError(f"iterations = {iterations}: must be at least 1")
    if scale is not None and not (math.isfinite(scale) and scale > 0.0):
        raise InputError(f"scale = {scale!r}: must be finite and above 0")
