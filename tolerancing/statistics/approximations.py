"""Where an analysis takes a cheap merit for the dear one that refines it, and how far both differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tolerancing.store.store import Store
from tolerancing.study.results import HighFidelityResults, TrialResults
from tolerancing.study.study import Study


@dataclass(frozen=True)
class Approximation:
    """A dear merit that an analysis stands in for by its cheap merit.

    Attributes
    ----------
    dear, cheap : str
        Labels of both merits.
    trials : int
        Trials that both have scored.
    root_mean_square, largest : float
        Difference of their scores over those trials; NaN without any.
    """

    dear: str
    cheap: str
    trials: int
    root_mean_square: float
    largest: float

    @property
    def sentence(self) -> str:
        """For people."""
        head = f"{self.dear} is approximated by {self.cheap}, which scores all trials"
        if not self.trials:
            return f"{head}; how far both differ has not been measured: no trial has both scores."
        return (
            f"{head}: in {self.trials} trials with both scores they differ by {self.root_mean_square:.3g} "
            f"root mean square, and by {self.largest:.3g} at most."
        )


def approximations(store: Store) -> tuple[Approximation, ...]:
    """What sensitivities, budgets and models of a stored study approximate; nothing without dear merits."""
    study = store.study
    if not study.high_fidelity_merits:
        return ()
    return approximations_of(study, store.trials(), store.dear())


def approximations_of(
    study: Study, trials: TrialResults, dear: HighFidelityResults | None
) -> tuple[Approximation, ...]:
    """As :func:`approximations`, from the trials of a study and its dear scores."""
    labels, numbers = [m.label for m in study.merits], np.asarray(trials.trials, np.int64)
    found = []
    for k, merit in enumerate(study.high_fidelity_merits):
        assert merit.predicted_by is not None
        cheap = dict(zip(numbers.tolist(), trials.scores[:, labels.index(merit.predicted_by)], strict=True))
        own = [] if dear is None else zip(dear.trials, dear.scores[:, k], strict=True)
        both = np.array([score - cheap[trial] for trial, score in own if trial in cheap], float)
        both = np.abs(both[np.isfinite(both)])
        sizes = (float(np.sqrt(np.mean(both**2))), float(both.max())) if len(both) else (np.nan, np.nan)
        found.append(Approximation(merit.label, merit.predicted_by, len(both), *sizes))
    return tuple(found)
