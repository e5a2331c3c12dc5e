"""What each tolerance alone does to the predicted yield."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from tolerancing.budgets.score_model import StudyScoreModel
from tolerancing.merits.base import all_passed
from tolerancing.prediction.study_prediction import is_predicted
from tolerancing.study.study import Study


@dataclass(frozen=True)
class LoosenedYield:
    """What one tolerance alone does to the predicted joint yield, all others as they are.

    Attributes
    ----------
    perturbation
        Its column.
    halved, doubled
        Fraction of good lenses with half of it, and with twice as much.
    """

    perturbation: str
    halved: float
    doubled: float


def loosen_each(lens: Lens, study: Study) -> tuple[LoosenedYield, ...]:
    """Predict the joint yield with each tolerance halved and doubled, to first order.

    The yield is that of the limits which :func:`tolerancing.prediction.predict_study` predicts.

    Raises
    ------
    InputError, DesignError
        As of :func:`tolerancing.prediction.predict_study`.
    """
    merits = tuple(merit for merit in study.merits if is_predicted(merit))
    model = StudyScoreModel(
        lens,
        study.model_copy(update={"all_merits": merits}),
        np.zeros((0, len(study.perturbations))),
        np.zeros((0, len(merits))),
    )

    def good(scales: Array) -> float:
        return float(np.mean(all_passed(merits, model.scores(scales))))

    ones = np.ones(len(study.perturbations))
    return tuple(
        LoosenedYield(
            p.column,
            *(good(np.where(np.arange(len(ones)) == k, factor, ones)) for factor in (0.5, 2.0)),
        )
        for k, p in enumerate(study.perturbations)
    )
