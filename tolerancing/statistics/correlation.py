"""Rank correlations of merits with perturbations over the trials of a study (Spearman 1904)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from tolerancing.study.results import TrialResults
from tolerancing.study.study import Study

MOST_TRIALS = 50_000
"""Largest number of trials that are ranked; of more, evenly spaced ones, which give the same correlations."""


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's rank correlations of scores with deviations.

    Attributes
    ----------
    signed : ndarray, shape (merits, perturbations)
        Correlation with the deviation. It is large where one direction helps and the other harms.
    magnitude : ndarray, shape (merits, perturbations)
        Correlation with the magnitude of the deviation from its mean. It is large where both directions
        harm alike, as for a decenter of a centred lens.
    """

    signed: Array
    magnitude: Array

    @property
    def strength(self) -> Array:
        """The larger absolute value of the two correlations, shape (merits, perturbations)."""
        return np.maximum(np.abs(self.signed), np.abs(self.magnitude))


def rank_correlation(study: Study, results: TrialResults) -> RankCorrelation:
    """Return the rank correlations of all merits with all perturbations.

    A correlation is 0 where a merit has fewer than eight scores, or where all ranks are equal.
    """
    fewest_scores = 8
    step = max(1, -(-len(results) // MOST_TRIALS))
    means = np.array([p.distribution.mean for p in study.perturbations])
    deviations = results.values[::step] - means
    signed = np.zeros((results.scores.shape[1], deviations.shape[1]))
    magnitude = np.zeros_like(signed)
    for k, scores in enumerate(results.scores[::step].T):
        known = np.isfinite(scores)
        if np.count_nonzero(known) >= fewest_scores:
            signed[k] = _spearman(scores[known], deviations[known])
            magnitude[k] = _spearman(scores[known], np.abs(deviations[known]))
    return RankCorrelation(signed, magnitude)


def _spearman(scores: Array, columns: Array) -> Array:
    """Return Spearman's coefficient of scores with each column; 0 where all ranks are equal."""
    from scipy.stats import rankdata

    a, b = rankdata(scores), rankdata(columns, axis=0)
    a, b = a - a.mean(), b - b.mean(axis=0)
    norm = np.sqrt(np.sum(a * a) * np.sum(b * b, axis=0))
    return np.divide(a @ b, norm, out=np.zeros(columns.shape[1]), where=norm > 0.0)
