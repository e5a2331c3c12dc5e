"""Which perturbation drives which merit: rank correlations over the trials of a study."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from tolerancing.study.results import TrialResults
from tolerancing.study.study import Study

FEWEST_TRIALS = 8
"""With fewer scores than this a correlation says nothing."""

MOST_TRIALS = 50_000
"""Ranks of more trials than this tell nothing more; evenly spaced ones are taken."""


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's rank correlations of scores with deviations.

    Attributes
    ----------
    signed : ndarray, shape (merits, perturbations)
        With the deviation: large where more one way helps and the other way harms.
    magnitude : ndarray, shape (merits, perturbations)
        With the deviation's magnitude about its mean: large where both ways harm alike, as a decenter
        of a centred lens does.
    """

    signed: Array
    magnitude: Array

    @property
    def strength(self) -> Array:
        """The larger magnitude of both, shape (merits, perturbations)."""
        return np.maximum(np.abs(self.signed), np.abs(self.magnitude))


def rank_correlation(study: Study, results: TrialResults) -> RankCorrelation:
    """Rank correlations of all merits with all perturbations; 0 where they cannot be told."""
    step = max(1, -(-len(results) // MOST_TRIALS))
    means = np.array([p.distribution.mean for p in study.perturbations])
    deviations = results.values[::step] - means
    signed = np.zeros((results.scores.shape[1], deviations.shape[1]))
    magnitude = np.zeros_like(signed)
    for k, scores in enumerate(results.scores[::step].T):
        known = np.isfinite(scores)
        if np.count_nonzero(known) >= FEWEST_TRIALS:
            signed[k] = _spearman(scores[known], deviations[known])
            magnitude[k] = _spearman(scores[known], np.abs(deviations[known]))
    return RankCorrelation(signed, magnitude)


def _spearman(scores: Array, columns: Array) -> Array:
    """Spearman's coefficient of scores with each column; 0 where all ranks tie."""
    from scipy.stats import rankdata

    a, b = rankdata(scores), rankdata(columns, axis=0)
    a, b = a - a.mean(), b - b.mean(axis=0)
    norm = np.sqrt(np.sum(a * a) * np.sum(b * b, axis=0))
    return np.divide(a @ b, norm, out=np.zeros(columns.shape[1]), where=norm > 0.0)
