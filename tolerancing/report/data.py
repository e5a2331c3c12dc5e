"""What the sections of a report are made from: a study's results, and what follows from several of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from tolerancing.statistics.approximations import Approximation, approximations_of
from tolerancing.statistics.correlation import RankCorrelation, rank_correlation
from tolerancing.statistics.quadratic_response import Sensitivity
from tolerancing.statistics.sensitivities import study_sensitivities
from tolerancing.statistics.summary import Summary
from tolerancing.study.results import HighFidelityResults, StepResults, TrialResults
from tolerancing.study.study import Study

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens
    from tolerancing.store.store import StudyRecord
    from tolerancing.study.files import LoadedStudy


MOST_POINTS, WORST_POINTS = 1500, 300
"""Trials drawn as points: all, the worst of them, and random ones for the rest."""


@dataclass(frozen=True, eq=False)
class ReportData:
    """Everything that a report says, before it is put into words.

    Attributes
    ----------
    loaded
        The study with its lens and files.
    record, nominal
        Of the store.
    results, dear, steps
        All that it holds; None where there are no dear merits.
    summary
        Of these.
    """

    loaded: LoadedStudy
    record: StudyRecord
    nominal: Mapping[str, float]
    results: TrialResults
    dear: HighFidelityResults | None
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
        """Numbers of the trials that there are."""
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
        """Places of the trials among the results, the worst first."""
        return np.argsort(self.badness, kind="stable")

    @cached_property
    def drawn(self) -> NDArray[np.intp]:
        """Places of the trials that are drawn as points, ascending."""
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
        """Which trials are drawn as points, where it is not all."""
        if len(self.drawn) == len(self.results):
            return ""
        return (
            f"Points: {len(self.drawn):,} of {len(self.results):,} trials, the worst {WORST_POINTS} and "
            "others at random."
        )

    @cached_property
    def sensitivity(self) -> Sensitivity | None:
        """What each perturbation does alone; None where a step or a nominal score is missing."""
        if any(self.nominal.get(m.label) is None for m in self.study.merits):
            return None
        try:
            return study_sensitivities(self.study, self.nominal, self.steps)
        except InputError:
            return None

    @cached_property
    def approximations(self) -> tuple[Approximation, ...]:
        """Dear merits for which sensitivities and models take the cheap ones."""
        return approximations_of(self.study, self.results, self.dear)

    @cached_property
    def variance_shares(self) -> Array | None:
        """Share of each merit's variance that a perturbation brings, shape (merits, perturbations).

        From the sensitivities; from squared rank correlations where there are none; None without either.
        """
        if self.sensitivity is not None:
            parts = np.nan_to_num(self.sensitivity.standard_deviation.T, posinf=0.0) ** 2
        elif len(self.results):
            parts = self.correlation.strength**2
        else:
            return None
        total = parts.sum(axis=1, keepdims=True)
        return np.divide(parts, total, out=np.zeros_like(parts), where=total > 0.0)

    def steps_of(self, label: str) -> list[StepResults]:
        """Steps of one series, in order."""
        return sorted((s for s in self.steps if s.series == label), key=lambda s: s.step)

    def trial_text(self, place: int) -> str:
        """One trial in a few words: its scores, and its largest deviations."""
        results, study = self.results, self.study
        scores = ", ".join(
            f"{m.label} {results.scores[place, k]:.4g} {m.unit}".strip() for k, m in enumerate(study.merits)
        )
        return f"trial {self.trial_numbers[place]}: {scores}; {self.causes(place)}"

    def causes(self, place: int) -> str:
        """The three largest deviations of one trial, in standard deviations."""
        found = []
        for p, value in zip(self.study.perturbations, self.results.values[place].tolist(), strict=True):
            spread = p.distribution.standard_deviation or 1.0
            found.append(((value - p.distribution.centre) / spread, p, value))
        found.sort(key=lambda item: -abs(item[0]))
        return ", ".join(
            f"{p.column} {value:.3g} ({sigmas:+.1f} σ)".replace("-", "−") for sigmas, p, value in found[:3]
        )
