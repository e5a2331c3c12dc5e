"""Scores of a study's merits for any deltas, and how these scatter: what limits and budgets search with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from tolerancing.merits.context import Context
from tolerancing.perturbations.distributions.base import Distribution
from tolerancing.study.scoring import score_batch
from tolerancing.study.study import Study

Report = Callable[[int], None]

ROWS_AT_ONCE = 64
QUANTILES = 4096


@dataclass(frozen=True, eq=False)
class StudyScorer:
    """The study's merits as a function of deltas.

    Attributes
    ----------
    context, study
        What is scored.
    report
        Called with the number of rows after each of the parts in which they are scored.
    """

    context: Context
    study: Study
    report: Report | None = None

    def __call__(self, values: Array, trials: Sequence[int] | None = None) -> Array:
        """Scores, shape (n, merits), of deltas from nominal, shape (n, perturbations).

        Parameters
        ----------
        values
            The deltas.
        trials
            By whose numbers the shapes of irregularities, and noise, are drawn, one for each row; those of
            trial 0 for all rows where left out.
        """
        study, parts = self.study, []
        for start in range(0, len(values), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            rows = np.ascontiguousarray(values[part])
            numbers = None if trials is None else trials[part]
            batch = self.context.perturbed(study.perturbations, rows, numbers)
            parts.append(score_batch(study.merits, self.context, batch)[0])
            if self.report is not None:
                self.report(len(rows))
        return np.concatenate(parts) if parts else np.empty((0, len(study.merits)))

    def worst_of_shapes(self, values: Array, shapes: int) -> Array:
        """As a call, but where a row has an irregularity, the worst scores of so many shapes."""
        study = self.study
        columns = [k for k, p in enumerate(study.perturbations) if p.is_irregularity]
        rough = np.flatnonzero(np.any(values[:, columns] != 0.0, axis=1))
        smooth = np.setdiff1d(np.arange(len(values)), rough)
        scores = np.empty((len(values), len(study.merits)))
        scores[smooth] = self(values[smooth])
        if len(rough):
            drawn = self(np.repeat(values[rough], shapes, axis=0), list(range(shapes)) * len(rough))
            drawn = drawn.reshape(len(rough), shapes, -1)
            for k, merit in enumerate(study.merits):
                worst = np.argmin(np.nan_to_num(merit.margin(drawn[..., k]), nan=-np.inf), axis=1)
                scores[rough, k] = drawn[np.arange(len(rough)), worst, k]
        return scores


@dataclass(frozen=True, eq=False)
class Scatter:
    """How a study's perturbations scatter; arrays of shape (perturbations,).

    Attributes
    ----------
    tolerance
        Largest deviation that counts as the tolerance.
    mean, standard_deviation, kurtosis
        Of the distributions.
    """

    tolerance: Array
    mean: Array
    standard_deviation: Array
    kurtosis: Array


def scatter_of(study: Study) -> Scatter:
    """How a study's perturbations scatter."""
    shapes = [p.distribution for p in study.perturbations]
    return Scatter(
        tolerance=np.array([d.largest for d in shapes]),
        mean=np.array([d.centre for d in shapes]),
        standard_deviation=np.array([d.standard_deviation for d in shapes]),
        kurtosis=np.array([kurtosis(d) for d in shapes]),
    )


def validate_settings(study: Study, what: str) -> None:
    """Refuse an analysis that takes deviations for numbers between which there is always another.

    Parameters
    ----------
    study
        What is analysed.
    what
        What the analysis tells of a perturbation.

    Raises
    ------
    InputError
        If one of its perturbations is a setting of the reconstruction.
    """
    for perturbation in study.perturbations:
        if perturbation.is_setting:
            raise InputError(
                f"{perturbation.column}: a number of slices is no deviation from nominal, and nothing tells "
                f"{what}; leave the perturbation out, or take a [[sweep]] of it"
            )


def kurtosis(distribution: Distribution) -> float:
    """Fourth central moment over the squared variance, from the quantiles."""
    values = distribution.quantile((np.arange(QUANTILES) + 0.5) / QUANTILES)
    values = values - values.mean()
    return float(np.mean(values**4) / np.mean(values**2) ** 2)
