"""Each perturbation by itself, at shares of its tolerance: what sensitivities are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tolerancing.analysis.sensitivity import STEPS
from tolerancing.perturbations.batch import batch_of
from tolerancing.study.series import Coordinates, Series, score_batch_step

if TYPE_CHECKING:
    from tolerancing.merits.context import Context
    from tolerancing.perturbations.parameters import Perturbation
    from tolerancing.study.results import StepResults
    from tolerancing.study.study import Study

LABEL = "sensitivity"


@dataclass(frozen=True)
class OneAtATime(Series):
    """The study's merits, with one perturbation away from nominal and all others nominal.

    Attributes
    ----------
    perturbations
        Of the study; each takes `STEPS` times its largest deviation.
    """

    perturbations: tuple[Perturbation, ...]

    @property
    def label(self) -> str:
        return LABEL

    def __len__(self) -> int:
        return len(self.perturbations) * len(STEPS)

    def coordinates(self, step: int) -> Coordinates:
        perturbation, fraction = self._step(step)
        return {
            "perturbation": perturbation.column,
            "deviation": fraction * perturbation.distribution.largest,
        }

    def score(self, context: Context, study: Study, step: int) -> StepResults:
        perturbation, fraction = self._step(step)
        values = np.array([[fraction * perturbation.distribution.largest]])
        batch = batch_of((perturbation,), values, study.pivot_z_mm, study.seed)
        return score_batch_step(context, self, step, study.merits, batch)

    def _step(self, step: int) -> tuple[Perturbation, float]:
        index, part = divmod(step, len(STEPS))
        return self.perturbations[index], STEPS[part]
