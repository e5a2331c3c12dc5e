"""Effect of each single tolerance on the predicted yield."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from tolerancing.budgets.score_model import StudyScoreModel
from tolerancing.merits.base import all_passed
from tolerancing.prediction.study_prediction import is_scored_at_once
from tolerancing.study.study import Study


@dataclass(frozen=True)
class LoosenedYield:
    """Predicted joint yield with one tolerance halved or doubled and all others unchanged.

    Attributes
    ----------
    perturbation
        Column of the perturbation.
    halved, doubled
        Fraction of good lenses with half the tolerance, and with twice the tolerance.
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
        If the study cannot be predicted; see :func:`tolerancing.prediction.predict_study`.
    """
    merits = tuple(merit for merit in study.merits if is_scored_at_once(merit))
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
