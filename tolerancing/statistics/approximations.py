"""Approximation of high-fidelity merits by the low-fidelity merits that they refine.

Sensitivities, budgets and models need scores of all trials, which only low-fidelity merits have. This module
names the merits that an analysis replaces in this way, and measures the difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.text import finite_or_none
from tolerancing.store.store import Store
from tolerancing.study.results import HighFidelityResults, TrialResults
from tolerancing.study.study import Study


@dataclass(frozen=True)
class Approximation:
    """A high-fidelity merit that an analysis replaces by its low-fidelity merit.

    Attributes
    ----------
    high_fidelity, low_fidelity : str
        Labels of the two merits.
    trials : int
        Number of trials that have both scores.
    root_mean_square, largest : float
        Root mean square and largest absolute difference of the two scores over these trials; NaN without any.
    """

    high_fidelity: str
    low_fidelity: str
    trials: int
    root_mean_square: float
    largest: float

    @property
    def sentence(self) -> str:
        """The approximation as a sentence."""
        head = f"{self.high_fidelity} is approximated by {self.low_fidelity}, which scores all trials"
        if not self.trials:
            return f"{head}; their difference has not been measured: no trial has both scores."
        return (
            f"{head}: in {self.trials} trials with both scores they differ by {self.root_mean_square:.3g} "
            f"root mean square, and by {self.largest:.3g} at most."
        )

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; a difference that is not known is None."""
        return {
            "high_fidelity": self.high_fidelity,
            "low_fidelity": self.low_fidelity,
            "trials": self.trials,
            "root_mean_square": finite_or_none(self.root_mean_square),
            "largest": finite_or_none(self.largest),
        }


def approximations(store: Store) -> tuple[Approximation, ...]:
    """Return the approximations of a stored study; an empty tuple without high-fidelity merits."""
    study = store.study
    if not study.high_fidelity_merits:
        return ()
    return approximations_of(study, store.trials(), store.high_fidelity())


def approximations_of(
    study: Study, trials: TrialResults, high_fidelity: HighFidelityResults | None
) -> tuple[Approximation, ...]:
    """Return the approximations of a study from its trials and its high-fidelity scores."""
    labels, numbers = [m.label for m in study.merits], np.asarray(trials.trials, np.int64)
    found = []
    for k, merit in enumerate(study.high_fidelity_merits):
        assert merit.predicted_by is not None
        column = trials.scores[:, labels.index(merit.predicted_by)]
        low = dict(zip(numbers.tolist(), column, strict=True))
        high = (
            []
            if high_fidelity is None
            else zip(high_fidelity.trials, high_fidelity.scores[:, k], strict=True)
        )
        both = np.array([score - low[trial] for trial, score in high if trial in low], float)
        both = np.abs(both[np.isfinite(both)])
        sizes = (float(np.sqrt(np.mean(both**2))), float(both.max())) if len(both) else (np.nan, np.nan)
        found.append(Approximation(merit.label, merit.predicted_by, len(both), *sizes))
    return tuple(found)
