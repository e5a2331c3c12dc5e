"""Compensators: parameters of the reconstruction's model that adapt to the lens as built.

A compensator is a parameter of the model through which light propagates back to the object. Bounded least
squares over the compensators minimise the difference between the optical paths of the perturbed lens and of
the model in the reconstruction pupils of all field points. Shift and focus of each field point are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from pydantic import model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import Positive
from lensdesign.common.text import number_with_unit
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import (
    COATING_THICKNESS,
    IRREGULARITIES,
    ROUGHNESS,
    PerturbedParameter,
)
from wavesim.scene.system_state import SystemState

if TYPE_CHECKING:
    from wavesim import PatchReconstructor, PupilSampler, ReconstructionPupil
    from wavesim.pupil.patch_reconstruction import PerturbedPatch


GAUSS_NEWTON_STEPS = 2
"""Two steps converge, because paths are nearly linear over mounting tolerances."""

STEP_FRACTION = 1e-2
"""Step of the finite differences of the model's path, as a fraction of the compensator's limit."""


class Compensator(PerturbedParameter):
    """A parameter of the reconstruction's model that adapts to each lens.

    Attributes
    ----------
    limit
        Largest value of either sign, in the parameter's unit.

    Examples
    --------
    >>> Compensator(target="lens", parameter="decenter_x_mm", limit=0.2).column
    'lens_decenter_x_mm'
    """

    limit: Positive

    @model_validator(mode="after")
    def _adaptable(self) -> Compensator:
        fixed = (*IRREGULARITIES, ROUGHNESS, COATING_THICKNESS)
        if self.parameter in fixed or self.target in ("light", "reconstruction"):
            raise ValueError(f"parameter = {self.parameter!r}: the reconstruction's model cannot adapt it")
        return self


@dataclass(frozen=True, eq=False)
class ModelPupils:
    """The reconstruction's model at one field point, with derivatives of its path by the compensators.

    Attributes
    ----------
    sampler
        Sampler of pupils at the field point.
    compensators
        Adaptable parameters of the model.
    pivot_z_mm
        Position on the axis about which the model's lens tilts, from its front vertex.
    slopes : ndarray, shape (compensators, n)
        Change of path in mm for each compensator's limit, without lateral shift and focus.
    """

    sampler: PupilSampler
    compensators: tuple[Compensator, ...]
    pivot_z_mm: float
    slopes: Array

    def pupil(self, values: Array) -> ReconstructionPupil:
        """Return the pupil of the model with compensators at these values."""
        return model_pupil(self.sampler, self.compensators, values, self.pivot_z_mm)


def model_pupil(
    sampler: PupilSampler, compensators: tuple[Compensator, ...], values: Array, pivot_z_mm: float
) -> ReconstructionPupil:
    """Return the pupil of a model with compensators at some values, relative to the nominal lens."""
    wavelength = sampler.grid.wavelength_um
    return sampler.pupil(_model(sampler.lens, compensators, values, pivot_z_mm, wavelength))


def _model(
    lens: Lens, compensators: tuple[Compensator, ...], values: Array, pivot_z_mm: float, wavelength_um: float
) -> SystemState:
    batch = PerturbationBatch(compensators, np.asarray(values, float)[None], pivot_z_mm)
    (model,) = batch.states(lens, wavelength_um)
    return model


def less_model_patch(
    patch: PerturbedPatch,
    reconstructor: PatchReconstructor,
    compensators: tuple[Compensator, ...],
    values: Array,
    pivot_z_mm: float,
) -> PerturbedPatch:
    """Return a patch that propagates back through the model with compensators at some values.

    The path of the model replaces that of the nominal lens. Ray directions remain those of the nominal lens.
    """
    if not np.any(values):
        return patch
    wavelength = patch.patch.wavelength_um
    system = _model(reconstructor.lens, compensators, values, pivot_z_mm, wavelength)
    pupil, model = patch.pupil, reconstructor.perturbed(system).pupil
    residual = replace(pupil, opd_mm=pupil.opd_mm - model.opd_mm, valid=pupil.valid & model.valid)
    return replace(patch, pupil=residual)


def model_pupils(
    sampler: PupilSampler, compensators: tuple[Compensator, ...], pivot_z_mm: float
) -> ModelPupils:
    """Trace the effect of the compensators at one field point.

    Raises
    ------
    InputError
        If a compensator has no effect other than shift and focus.
    """
    # Root mean square below which a compensator at its limit has no effect beyond shift and focus.
    least_effect_waves = 1e-3
    slopes = []
    for k, compensator in enumerate(compensators):
        step = np.zeros(len(compensators))
        step[k] = STEP_FRACTION * compensator.limit
        ends = [
            registered(model_pupil(sampler, compensators, sign * step, pivot_z_mm)) for sign in (1.0, -1.0)
        ]
        slopes.append((ends[0] - ends[1]) / (2.0 * STEP_FRACTION))
        effect = float(np.sqrt(np.mean(slopes[-1] ** 2))) * 1e3 / sampler.grid.wavelength_um
        if effect < least_effect_waves:
            limit = number_with_unit(f"{compensator.limit:g}", compensator.unit)
            raise InputError(
                f"compensator {compensator.column}: at its limit of {limit} it changes "
                f"the pupil by only {effect:.2g} waves rms beyond shift and focus, at least "
                f"{least_effect_waves:g} is needed: remove it, or give it a larger limit"
            )
    return ModelPupils(sampler, compensators, pivot_z_mm, np.array(slopes))


def registered(pupil: ReconstructionPupil) -> Array:
    """Return the path in mm at the samples without lateral shift and focus; 0 at invalid samples."""
    from wavesim import refocus

    return refocus(pupil).pupil.opd_mm


def compensate(pupils: Sequence[ReconstructionPupil], models: Sequence[ModelPupils]) -> Array:
    """Fit the compensators to the pupils of one perturbed lens.

    Parameters
    ----------
    pupils, models
        Pupil of the perturbed lens and model, one for each field point.

    Returns
    -------
    ndarray, shape (compensators,)
        Values in the compensators' units, within their limits.
    """
    limits = np.array([c.limit for c in models[0].compensators])
    fractions = np.zeros(len(limits))
    for _ in range(GAUSS_NEWTON_STEPS):
        hessian, gradient = np.zeros((len(limits), len(limits))), np.zeros(len(limits))
        for pupil, model in zip(pupils, models, strict=True):
            residual = less_model(pupil, model, fractions * limits)
            # Samples that do not arrive must not contribute slopes either.
            slopes = np.where(residual.valid, model.slopes, 0.0) / len(residual.valid)
            hessian += slopes @ model.slopes.T
            gradient += slopes @ registered(residual)
        fractions = np.clip(fractions + bounded_step(hessian, gradient, fractions), -1.0, 1.0)
    return np.asarray(fractions * limits)


def bounded_step(hessian: Array, gradient: Array, fractions: Array) -> Array:
    """Return the step that solves normal equations while `fractions` stay within -1 and 1.

    Parameters
    ----------
    hessian : ndarray, shape (k, k)
        Matrix of the normal equations.
    gradient : ndarray, shape (k,)
        Right-hand side of the normal equations.
    fractions : ndarray, shape (k,)
        Current values as fractions of the limits.
    """
    from scipy.optimize import lsq_linear

    triangle = np.linalg.cholesky(regularised(hessian))
    bounds = (-1.0 - fractions, 1.0 - fractions)
    return np.asarray(
        lsq_linear(triangle.T, np.linalg.solve(triangle, gradient), bounds=bounds, method="bvls").x
    )


def regularised(hessian: Array) -> Array:
    """Return normal equations in which directions with almost no effect stay at their values."""
    floor = 1e-9 * np.trace(hessian) / len(hessian) + np.finfo(float).tiny
    return np.asarray(hessian + floor * np.eye(len(hessian)))


def less_model(pupil: ReconstructionPupil, model: ModelPupils, values: Array) -> ReconstructionPupil:
    """Return the pupil of a perturbed lens minus that of the model with compensators at some values."""
    if not np.any(values):
        return pupil
    own = model.pupil(values)
    return replace(pupil, opd_mm=pupil.opd_mm - own.opd_mm, valid=pupil.valid & own.valid)
