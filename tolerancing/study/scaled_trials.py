"""Trials with all tolerances multiplied by a factor, which show how the yield follows the tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, model_validator

from lensdesign.common.frozen_model import FrozenModel, Positive
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.perturbations.batch import PerturbationBatch, batch_of
from tolerancing.perturbations.dependence import Dependence, sample_values
from tolerancing.perturbations.parameters import Perturbation
from tolerancing.study.results import StepResults
from tolerancing.study.series import Coordinates, Series, score_perturbed, validate_unique

SCALED_TRIALS = "scaled_trials"
"""Label of the series of trials with multiplied tolerances."""


class ScaledTrials(FrozenModel):
    """Trials with all tolerances multiplied; they have the random numbers of the study's first trials.

    Attributes
    ----------
    factors
        Common factors of all tolerances, other than 1.
    trials
        Number of trials for each factor.

    Examples
    --------
    >>> ScaledTrials(factors=(0.5, 2.0), trials=100).factors
    (0.5, 2.0)
    """

    factors: Annotated[tuple[Annotated[Positive, Field(le=100.0)], ...], Field(min_length=1)] = (0.5, 2.0)
    trials: Annotated[int, Field(ge=1, le=100_000)] = 100

    @model_validator(mode="after")
    def _consistent(self) -> ScaledTrials:
        if 1.0 in self.factors:
            raise ValueError("factors: 1 has no trials of its own; the trials of the study have this factor")
        validate_unique(self, "factors")
        return self


@dataclass(frozen=True)
class TrialsAtFactors(Series):
    """Series of the trials of :class:`ScaledTrials`, factor by factor.

    Attributes
    ----------
    settings
        Factors, and number of trials.
    perturbations, dependence
        Perturbations of the study, and their dependence.
    draws, seed, planned
        Sampling method, seed and number of trials of the study.
    pivot_z_mm
        Position on the axis about which the whole lens tilts.
    """

    settings: ScaledTrials
    perturbations: tuple[Perturbation, ...]
    dependence: Dependence
    draws: str
    seed: int
    planned: int
    pivot_z_mm: float

    @property
    def label(self) -> str:
        return SCALED_TRIALS

    def __len__(self) -> int:
        return len(self.settings.factors) * self.settings.trials

    def coordinates(self, step: int) -> Coordinates:
        factor, trial = self._step(step)
        return {"tolerance_factor": factor, "trial": float(trial)}

    def score(self, context: Context, merits: Sequence[Merit], step: int) -> StepResults:
        return score_perturbed(context, self, step, merits, self.batch(context, step))

    def batch(self, context: Context, step: int) -> PerturbationBatch:
        factor, trial = self._step(step)
        scaled = tuple(p.scaled(factor) for p in self.perturbations)
        values = sample_values(scaled, self.dependence, self.draws, self.seed, [trial], self.planned)
        return batch_of(scaled, values, self.pivot_z_mm, self.seed, [trial])

    def _step(self, step: int) -> tuple[float, int]:
        position, trial = divmod(step, self.settings.trials)
        return self.settings.factors[position], trial
