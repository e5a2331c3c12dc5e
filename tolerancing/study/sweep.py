"""Sweeps of one parameter (paper, Figs. 7(b) and 7(c)), grids of two parameters, and sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from lensdesign.common.frozen_model import FiniteNumber
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import Name, Perturbation, PerturbedParameter
from tolerancing.study.results import StepResults
from tolerancing.study.series import Coordinates, LinePairSection, Series, score_perturbed, validate_unique

STEPS = (-1.0, -0.5, 0.5, 1.0)
"""Deviations at which each perturbation is scored alone, as fractions of its tolerance."""

SENSITIVITY = "sensitivity"
"""Label of the series of single perturbations."""


class Sweep(PerturbedParameter, LinePairSection, Series):
    """Series over values of one parameter; all other parameters are nominal.

    Attributes
    ----------
    values
        Deltas from nominal, in the parameter's unit.
    picture_values
        Values for which images of the line pairs are saved.
    """

    values: Annotated[tuple[FiniteNumber, ...], Field(min_length=1)]
    picture_values: tuple[FiniteNumber, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> Sweep:
        unknown = [v for v in self.picture_values if v not in self.values]
        if unknown:
            raise ValueError(f"picture_values = {unknown}: allowed: those of values, {list(self.values)}")
        if self.picture_values and not self.line_widths_um:
            raise ValueError("picture_values: pictures show line pairs; give line_widths_um")
        validate_unique(self, "values")
        self.check_setting(self.values)
        return self

    @property
    def label(self) -> str:
        return self.name or f"{self.target} {self.parameter}".replace(" ", "_")

    def __len__(self) -> int:
        return len(self.values)

    def check(self, lens: Lens) -> None:
        PerturbedParameter.check(self, lens)
        LinePairSection.check(self, lens)

    def coordinates(self, step: int) -> Coordinates:
        return {self.parameter: self.values[step]}

    def score(self, context: Context, merits: Sequence[Merit], step: int) -> StepResults:
        section = self if self.values[step] in self.picture_values else None
        return score_perturbed(context, self, step, self.scored(merits), self.batch(context, step), section)

    def batch(self, context: Context, step: int) -> PerturbationBatch:
        return context.perturbed((self,), np.array([[self.values[step]]]))


class GridAxis(PerturbedParameter):
    """A parameter of a grid, and its values."""

    values: Annotated[tuple[FiniteNumber, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check_values(self) -> GridAxis:
        validate_unique(self, "values")
        self.check_setting(self.values)
        return self


class ParameterGrid(LinePairSection, Series):
    """Series over all pairs of values of two parameters; all other parameters are nominal.

    Attributes
    ----------
    name
        Name of the grid.
    x, y
        The two parameters and their values.
    """

    name: Name
    x: GridAxis
    y: GridAxis

    @model_validator(mode="after")
    def _check_axes(self) -> ParameterGrid:
        if self.x.column == self.y.column:
            raise ValueError(f"x and y are both {self.x.column}; give two different parameters, or names")
        return self

    @property
    def label(self) -> str:
        return self.name

    def __len__(self) -> int:
        return len(self.x.values) * len(self.y.values)

    def check(self, lens: Lens) -> None:
        for axis in (self.x, self.y):
            axis.check(lens)
        super().check(lens)

    def coordinates(self, step: int) -> Coordinates:
        row, column = divmod(step, len(self.x.values))
        return {self.x.column: self.x.values[column], self.y.column: self.y.values[row]}

    def score(self, context: Context, merits: Sequence[Merit], step: int) -> StepResults:
        return score_perturbed(context, self, step, self.scored(merits), self.batch(context, step))

    def batch(self, context: Context, step: int) -> PerturbationBatch:
        values = np.array([list(self.coordinates(step).values())], float)
        return context.perturbed((self.x, self.y), values)


@dataclass(frozen=True)
class OneAtATime(Series):
    """Series of sensitivities: one perturbation deviates from nominal while all others are nominal.

    Attributes
    ----------
    perturbations
        Perturbations of the study; each is varied by `STEPS` times its largest deviation.
    """

    perturbations: tuple[Perturbation, ...]

    @property
    def label(self) -> str:
        return SENSITIVITY

    def __len__(self) -> int:
        return len(self.perturbations) * len(STEPS)

    def coordinates(self, step: int) -> Coordinates:
        perturbation, fraction = self._step(step)
        return {
            "perturbation": perturbation.column,
            "deviation": fraction * perturbation.distribution.largest,
        }

    def score(self, context: Context, merits: Sequence[Merit], step: int) -> StepResults:
        return score_perturbed(context, self, step, merits, self.batch(context, step))

    def batch(self, context: Context, step: int) -> PerturbationBatch:
        perturbation, fraction = self._step(step)
        values = np.array([[fraction * perturbation.distribution.largest]])
        return context.perturbed((perturbation,), values)

    def _step(self, step: int) -> tuple[Perturbation, float]:
        index, position = divmod(step, len(STEPS))
        return self.perturbations[index], STEPS[position]
