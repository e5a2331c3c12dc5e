"""Compensators: what the reconstruction's model adapts to the lens as it is.

A compensator is a parameter of the model that light is carried back through. With the model's path taken
from that of the perturbed lens, what is left of the reconstruction pupils of all field points is made as
small as it gets, in the least squares sense, within the compensators' bounds; shift and focus of each field
point are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from pydantic import model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.section import Positive
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import IRREGULARITIES, PerturbedParameter
from wavesim.scene.placement import Placement

if TYPE_CHECKING:
    from wavesim import PatchChain, PupilSampler, ReconstructionPupil
    from wavesim.pupil.patch_return import PerturbedPatch


ROUNDS = 2
"""Gauss-Newton steps; paths bend little over what a mount allows."""

LEAST_EFFECT_WAVES = 1e-3
"""Root mean square below which a compensator at its limit does nothing that refocusing would not."""

STEP_SHARE = 1e-2
"""Of the limit, for the derivatives of the model's path."""


class Compensator(PerturbedParameter):
    """A parameter of the reconstruction's model that adapts to each lens.

    Attributes
    ----------
    limit
        Largest value of either sign that it may take, in the parameter's unit.
    """

    limit: Positive

    @model_validator(mode="after")
    def _adaptable(self) -> Compensator:
        if self.parameter in IRREGULARITIES or self.target in ("light", "reconstruction"):
            raise ValueError(f"parameter = {self.parameter!r}: the reconstruction's model cannot adapt it")
        return self


@dataclass(frozen=True, eq=False)
class ModelPupils:
    """Pupils of the reconstruction's model at one field point, and how its path follows the compensators.

    Attributes
    ----------
    sampler
        Of the field point.
    compensators
        What adapts.
    pivot_z_mm
        Where on the axis the model's lens turns.
    slopes : ndarray, shape (compensators, n)
        Change of path in mm for each compensator's limit, less what shift and refocus take.
    """

    sampler: PupilSampler
    compensators: tuple[Compensator, ...]
    pivot_z_mm: float
    slopes: Array

    def pupil(self, values: Array) -> ReconstructionPupil:
        """Of the model, with compensators at these values."""
        return model_pupil(self.sampler, self.compensators, values, self.pivot_z_mm)


def model_pupil(
    sampler: PupilSampler, compensators: tuple[Compensator, ...], values: Array, pivot_z_mm: float
) -> ReconstructionPupil:
    """Reconstruction pupil between a model with compensators at some values and the nominal lens."""
    wavelength = sampler.grid.wavelength_um
    return sampler.pupil(_model(sampler.lens, compensators, values, pivot_z_mm, wavelength))


def _model(
    lens: Lens, compensators: tuple[Compensator, ...], values: Array, pivot_z_mm: float, wavelength_um: float
) -> Placement:
    batch = PerturbationBatch(compensators, np.asarray(values, float)[None], pivot_z_mm)
    (model,) = batch.placements(lens, wavelength_um)
    return model


def less_model_patch(
    patch: PerturbedPatch,
    chain: PatchChain,
    compensators: tuple[Compensator, ...],
    values: Array,
    pivot_z_mm: float,
) -> PerturbedPatch:
    """A patch that is carried back through the model with compensators at some values.

    The model's path takes the place of the nominal lens's; its directions are taken as the nominal ones.
    """
    if not np.any(values):
        return patch
    wavelength = patch.patch.wavelength_um
    system = _model(chain.lens, compensators, values, pivot_z_mm, wavelength)
    pupil, model = patch.pupil, chain.perturbed(system).pupil
    left = replace(pupil, opd_mm=pupil.opd_mm - model.opd_mm, valid=pupil.valid & model.valid)
    return replace(patch, pupil=left)


def model_pupils(
    sampler: PupilSampler, compensators: tuple[Compensator, ...], pivot_z_mm: float
) -> ModelPupils:
    """Trace what the compensators do at one field point.

    Raises
    ------
    InputError
        If one does nothing beside what shift and refocus do.
    """
    slopes = []
    for k, compensator in enumerate(compensators):
        step = np.zeros(len(compensators))
        step[k] = STEP_SHARE * compensator.limit
        ends = [
            registered(model_pupil(sampler, compensators, sign * step, pivot_z_mm)) for sign in (1.0, -1.0)
        ]
        slopes.append((ends[0] - ends[1]) / (2.0 * STEP_SHARE))
        effect = float(np.sqrt(np.mean(slopes[-1] ** 2))) * 1e3 / sampler.grid.wavelength_um
        if effect < LEAST_EFFECT_WAVES:
            raise InputError(
                f"compensator {compensator.column}: at its limit of {compensator.limit:g} {compensator.unit} "
                f"it changes the pupil by {effect:.2g} waves rms beside shift and refocus, at least "
                f"{LEAST_EFFECT_WAVES:g} is needed: leave it out, or give it a larger limit"
            )
    return ModelPupils(sampler, compensators, pivot_z_mm, np.array(slopes))


def registered(pupil: ReconstructionPupil) -> Array:
    """Path in mm at the samples once shift and focus are taken out; 0 where not valid."""
    from wavesim import refocus

    return refocus(pupil).pupil.opd_mm


def compensate(pupils: Sequence[ReconstructionPupil], models: Sequence[ModelPupils]) -> Array:
    """Values of the compensators that leave the least of one perturbed lens's pupils.

    Parameters
    ----------
    pupils, models
        One for each field point.

    Returns
    -------
    ndarray, shape (compensators,)
        In the compensators' units, within their limits.
    """
    limits = np.array([c.limit for c in models[0].compensators])
    shares = np.zeros(len(limits))
    for _ in range(ROUNDS):
        matrix, wanted = np.zeros((len(limits), len(limits))), np.zeros(len(limits))
        for pupil, model in zip(pupils, models, strict=True):
            rest = less_model(pupil, model, shares * limits)
            # Samples that do not arrive say nothing, nor may their slopes.
            slopes = np.where(rest.valid, model.slopes, 0.0) / len(rest.valid)
            matrix += slopes @ model.slopes.T
            wanted += slopes @ registered(rest)
        shares = np.clip(shares + bounded_change(matrix, wanted, shares), -1.0, 1.0)
    return np.asarray(shares * limits)


def bounded_change(matrix: Array, wanted: Array, shares: Array) -> Array:
    """Change of shares that solves normal equations in the least squares sense, shares staying within +-1.

    Parameters
    ----------
    matrix : ndarray, shape (k, k)
    wanted, shares : ndarray, shape (k,)
    """
    from scipy.optimize import lsq_linear

    triangle = np.linalg.cholesky(steadied(matrix))
    bounds = (-1.0 - shares, 1.0 - shares)
    return np.asarray(
        lsq_linear(triangle.T, np.linalg.solve(triangle, wanted), bounds=bounds, method="bvls").x
    )


def steadied(matrix: Array) -> Array:
    """Normal equations whose directions that do next to nothing are held where they are."""
    floor = 1e-9 * np.trace(matrix) / len(matrix) + np.finfo(float).tiny
    return np.asarray(matrix + floor * np.eye(len(matrix)))


def less_model(pupil: ReconstructionPupil, model: ModelPupils, values: Array) -> ReconstructionPupil:
    """The pupil between a perturbed lens and the model with compensators at some values."""
    if not np.any(values):
        return pupil
    own = model.pupil(values)
    return replace(pupil, opd_mm=pupil.opd_mm - own.opd_mm, valid=pupil.valid & own.valid)
