"""Fast yields of a study with each tolerance multiplied by its own factor.

Derivatives are computed once, so each yield takes only milliseconds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from tolerancing.prediction.ray_prediction import BLOCK, FirstOrderRays, predicted_merits
from tolerancing.prediction.system import amounts_of
from tolerancing.prediction.wavefront_prediction import (
    drawn_batch,
    first_order,
    is_predicted_wavefront,
    judged_points,
    study_derivatives,
)
from tolerancing.study.study import Study


class FirstOrderYield:
    """Yield of a study by its wavefronts, to first order, with each tolerance multiplied.

    Parameters
    ----------
    lens, study
        Lens and study, as for :func:`tolerancing.prediction.wavefront_prediction.predict`.
    every
        Use every n-th draw of a prediction.

    Raises
    ------
    InputError
        If the study has no merit that judges the refocused wavefront.
    DesignError
        If rays from a field point do not pass.
    """

    def __init__(self, lens: Lens, study: Study, every: int = 1) -> None:
        judged = judged_points(study)
        self._known = study_derivatives(lens, study, judged, second=False)
        self._forms = [first_order(field) for field in self._known.fields]
        self._amounts = amounts_of(drawn_batch(study, every))
        self._limits = np.array([point.limit_waves**2 for point in judged])

    def at(self, factors: Array) -> float:
        """Return the yield with the tolerance of each perturbation multiplied by a factor; 0 removes it."""
        return float(np.mean(self.passed(factors)))

    def passed(self, factors: Array) -> NDArray[np.bool_]:
        """Return whether each drawn lens meets the limits with these factors, shape (draws,)."""
        changed = self._amounts.copy()
        for columns, factor in zip(self._known.changes.columns, factors, strict=True):
            changed[:, columns] *= factor
        together = np.concatenate([changed, self._known.compensation.values(changed)], axis=1)
        squares = np.stack([np.sum((together @ form) * together, axis=1) for form in self._forms], axis=1)
        return np.asarray(np.all(squares <= self._limits, axis=1))


class JointYield:
    """Joint yield of all predicted limits to first order, from a part of the draws of a prediction."""

    def __init__(self, lens: Lens, study: Study) -> None:
        waves = any(is_predicted_wavefront(merit) for merit in study.merits)
        # Joint yields use every nth draw of a prediction.
        joint_every = 16
        self._waves = FirstOrderYield(lens, study, joint_every) if waves else None
        self._merits = predicted_merits(study)
        self._rays = FirstOrderRays(lens, study)
        self._batch = drawn_batch(study, joint_every)

    def at(self, factors: Array) -> float:
        """Return the yield with the tolerance of each perturbation multiplied by a factor; 0 removes it."""
        good = np.ones(len(self._batch), bool)
        if self._waves is not None:
            good &= self._waves.passed(factors)
        changed = replace(self._batch, values=self._batch.values * factors)
        for start in range(0, len(good), BLOCK) if self._merits else ():
            part = slice(start, start + BLOCK)
            for merit in self._merits:
                good[part] &= merit.passed(merit.scores(self._rays, changed.subset(part)))
        return float(np.mean(good))
