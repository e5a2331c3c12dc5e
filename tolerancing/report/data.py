"""Data of a report: the results of a study, and quantities that several sections derive from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.text import number_with_unit
from lensdesign.errors import InputError
from tolerancing.statistics.approximations import Approximation, approximations_of
from tolerancing.statistics.correlation import RankCorrelation, rank_correlation
from tolerancing.statistics.sensitivities import Sensitivity, study_sensitivities
from tolerancing.statistics.summary import Summary
from tolerancing.study.results import HighFidelityResults, StepResults, TrialResults
from tolerancing.study.study import Study

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens
    from tolerancing.store.store import StudyRecord
    from tolerancing.study.files import LoadedStudy


MOST_POINTS, WORST_POINTS = 1500, 300
"""Most trials drawn as points in a figure. The worst ones are among them; the others are random."""


@dataclass(frozen=True, eq=False)
class ReportData:
    """Data of a report.

    Attributes
    ----------
    loaded
        Study with its lens and files.
    record, nominal
        Record of the run, and scores of the nominal lens by the merit's label.
    results, high_fidelity, steps
        Trials, high-fidelity scores and steps in the store; None without high-fidelity merits.
    summary
        Summary of the trials.
    """

    loaded: LoadedStudy
    record: StudyRecord
    nominal: Mapping[str, float]
    results: TrialResults
    high_fidelity: HighFidelityResults | None
    steps: Sequence[StepResults]
    summary: Summary

    @property
    def study(self) -> Study:
        """The study."""
        return self.summary.study

    @property
    def lens(self) -> Lens:
        """The nominal lens."""
        return self.loaded.lens

    @cached_property
    def trial_numbers(self) -> NDArray[np.int64]:
        """Numbers of the stored trials."""
        return np.asarray(self.results.trials, dtype=np.int64)

    @cached_property
    def correlation(self) -> RankCorrelation:
        """Rank correlations of merits with perturbations."""
        return rank_correlation(self.study, self.results)

    @cached_property
    def badness(self) -> Array:
        """The smallest margin of each trial, in standard deviations of its merit; -inf if unscored."""
        worst = np.full(len(self.results), np.inf)
        for merit, scores in zip(self.study.merits, self.results.scores.T, strict=True):
            finite = scores[np.isfinite(scores)]
            spread = (float(finite.std()) if len(finite) else 0.0) or 1.0
            margin = merit.margin(scores) / spread
            worst = np.minimum(worst, np.where(np.isnan(margin), -np.inf, margin))
        return worst

    @cached_property
    def by_badness(self) -> NDArray[np.intp]:
        """Row indices of the trials, the worst first."""
        return np.argsort(self.badness, kind="stable")

    @cached_property
    def drawn(self) -> NDArray[np.intp]:
        """Row indices of the trials that are drawn as points, ascending."""
        count = len(self.results)
        if count <= MOST_POINTS:
            return np.arange(count)
        others = self.by_badness[WORST_POINTS:]
        chosen = np.random.default_rng(self.study.seed).choice(
            others, MOST_POINTS - WORST_POINTS, replace=False
        )
        return np.sort(np.concatenate([self.by_badness[:WORST_POINTS], chosen]))

    @cached_property
    def drawn_text(self) -> str:
        """Sentence about the trials that are drawn as points; empty if all are drawn."""
        if len(self.drawn) == len(self.results):
            return ""
        return (
            f"Points: {len(self.drawn):,} of {len(self.results):,} trials, the worst {WORST_POINTS} and a "
            "random sample of the others."
        )

    @cached_property
    def sensitivity(self) -> Sensitivity | None:
        """Effect of each perturbation alone; None if a step or a nominal score is missing."""
        if any(self.nominal.get(m.label) is None for m in self.study.merits):
            return None
        try:
            return study_sensitivities(self.study, self.nominal, self.steps)
        except InputError:
            return None

    @cached_property
    def approximations(self) -> tuple[Approximation, ...]:
        """High-fidelity merits that sensitivities and models approximate by low-fidelity ones."""
        return approximations_of(self.study, self.results, self.high_fidelity)

    @cached_property
    def variance_fractions(self) -> Array | None:
        """Fraction of each merit's variance that a perturbation causes, shape (merits, perturbations).

        It is computed from the sensitivities, or else from squared rank correlations; None without either.
        """
        if self.sensitivity is not None:
            variances = np.nan_to_num(self.sensitivity.standard_deviation.T, posinf=0.0) ** 2
        elif len(self.results):
            variances = self.correlation.strength**2
        else:
            return None
        total = variances.sum(axis=1, keepdims=True)
        return np.divide(variances, total, out=np.zeros_like(variances), where=total > 0.0)

    def steps_of(self, label: str) -> list[StepResults]:
        """Return the steps of one series in order."""
        return sorted((s for s in self.steps if s.series == label), key=lambda s: s.step)

    def trial_text(self, row: int) -> str:
        """Describe one trial, by its row index, with its scores and its largest deviations."""
        results, study = self.results, self.study
        scores = ", ".join(
            number_with_unit(f"{m.label} {results.scores[row, k]:.4g}", m.unit)
            for k, m in enumerate(study.merits)
        )
        return f"trial {self.trial_numbers[row]}: {scores}; {self.causes(row)}"

    def causes(self, row: int) -> str:
        """Describe the three largest deviations of one trial, in standard deviations."""
        found = []
        for p, value in zip(self.study.perturbations, self.results.values[row].tolist(), strict=True):
            spread = p.distribution.standard_deviation or 1.0
            found.append(((value - p.distribution.centre) / spread, p, value))
        found.sort(key=lambda item: -abs(item[0]))
        return ", ".join(
            f"{p.column} {value:.3g} ({sigmas:+.1f} σ)".replace("-", "−") for sigmas, p, value in found[:3]
        )
