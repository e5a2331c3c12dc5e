"""Scores of a study's merits for given deviations from nominal, and the spread of these deviations.

Inverse limits, variance-based indices, importance sampling and budgets score lenses of their own choice. They
share the class :class:`StudyScorer` of this module.
"""

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

Progress = Callable[[int], None]

ROWS_AT_ONCE = 64
"""Number of lenses that are scored together."""


@dataclass(frozen=True, eq=False)
class StudyScorer:
    """The study's merits as a function of deviations from nominal.

    Attributes
    ----------
    context, study
        Nominal lens with its cached analyses, and the study that names perturbations and merits.
    progress
        Called as ``progress(count)`` with the number of lenses scored since the last call.
    """

    context: Context
    study: Study
    progress: Progress | None = None

    def __call__(self, values: Array, trials: Sequence[int] | None = None) -> Array:
        """Return the scores of perturbed lenses.

        Parameters
        ----------
        values : ndarray, shape (n, perturbations)
            Deviations from nominal, in the units of the perturbations.
        trials
            Trial number of each row. The shapes of irregularities, and noise, are drawn by these numbers.
            Default: trial 0 for all rows.

        Returns
        -------
        ndarray, shape (n, merits)
            Scores; NaN where a lens cannot be scored.
        """
        study, blocks = self.study, []
        for start in range(0, len(values), ROWS_AT_ONCE):
            block = slice(start, start + ROWS_AT_ONCE)
            rows = np.ascontiguousarray(values[block])
            numbers = None if trials is None else trials[block]
            batch = self.context.perturbed(study.perturbations, rows, numbers)
            blocks.append(score_batch(study.merits, self.context, batch)[0])
            if self.progress is not None:
                self.progress(len(rows))
        return np.concatenate(blocks) if blocks else np.empty((0, len(study.merits)))

    def worst_of_shapes(self, values: Array, shapes: int) -> Array:
        """Return the scores of a call, or the worst scores of several random shapes for irregular surfaces.

        Parameters
        ----------
        values : ndarray, shape (n, perturbations)
            Deviations from nominal.
        shapes
            Number of random shapes for each row that has an irregularity.

        Returns
        -------
        ndarray, shape (n, merits)
            Scores; NaN where a lens cannot be scored.
        """
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
    """Moments of a study's perturbations, as arrays of shape (perturbations,).

    Attributes
    ----------
    tolerance
        Largest deviation that counts as within the tolerance.
    mean, standard_deviation
        Mean and standard deviation of each distribution.
    kurtosis
        Fourth central moment over the squared variance; 3 for a normal distribution.
    """

    tolerance: Array
    mean: Array
    standard_deviation: Array
    kurtosis: Array


def scatter_of(study: Study) -> Scatter:
    """Return the moments of a study's perturbations."""
    distributions = [p.distribution for p in study.perturbations]
    return Scatter(
        tolerance=np.array([d.largest for d in distributions]),
        mean=np.array([d.centre for d in distributions]),
        standard_deviation=np.array([d.standard_deviation for d in distributions]),
        kurtosis=np.array([kurtosis(d) for d in distributions]),
    )


def validate_settings(study: Study, what: str) -> None:
    """Check that all perturbations of a study vary continuously, as an analysis of deviations requires.

    Parameters
    ----------
    study
        Study to be analysed.
    what
        What the analysis finds for a perturbation, for the message.

    Raises
    ------
    InputError
        If a perturbation is a setting of the reconstruction, such as a number of slices.
    """
    for perturbation in study.perturbations:
        if perturbation.is_setting:
            raise InputError(
                f"{perturbation.column}: a number of slices is no deviation from nominal, so no value exists "
                f"for {what}; remove the perturbation, or vary it in a [[sweep]]"
            )


def kurtosis(distribution: Distribution) -> float:
    """Return the fourth central moment over the squared variance, computed from evenly spaced quantiles."""
    count = 4096
    values = distribution.quantile((np.arange(count) + 0.5) / count)
    values = values - values.mean()
    return float(np.mean(values**4) / np.mean(values**2) ** 2)
