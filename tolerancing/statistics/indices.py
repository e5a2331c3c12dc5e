"""Variance-based indices: which share of a merit's variance is a perturbation's own, and which it has part
in.

The first-order index of perturbation i is the share of the variance that would go if i were held at its
value, S_i = Var E[f | x_i] / Var f; the total index the share that would stay if all but i were, ST_i = 1 -
Var E[f | x_~i] / Var f (Sobol, Math. Comput. Simul. 55, 271, 2001). What lies between them are products of i
with others, which a sensitivity of each by itself does not see. SALib draws the trials (Saltelli's scheme)
and estimates both, with intervals by resampling (Saltelli et al., Comput. Phys. Commun. 181, 259, 2010).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.memory import check_memory
from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError, TransferLensError
from tolerancing.perturbations.draws import LARGEST, SMALLEST
from tolerancing.statistics.scorer import StudyScorer
from tolerancing.statistics.yields import CONFIDENCE
from tolerancing.study.evaluate import context_of
from tolerancing.study.files import LoadedStudy
from tolerancing.study.study import Study

RESAMPLES = 200
SMALLEST_BASE, LARGEST_BASE = 16, 2**20


class IndicesError(TransferLensError):
    """Trials could not be scored, so that there are no indices."""


@dataclass(frozen=True, eq=False)
class VarianceIndices:
    """Indices of d perturbations for m merits, each with half the width of its 95 % interval, shape (d, m).

    Attributes
    ----------
    study
        Whose they are.
    first, first_half_width
        Of first order.
    total, total_half_width
        Total.
    standard_deviation : ndarray, shape (m,)
        Of the merits, with all that scatters.
    trials
        Number of trials that were scored.
    """

    study: Study
    first: Array
    first_half_width: Array
    total: Array
    total_half_width: Array
    standard_deviation: Array
    trials: int

    @property
    def products(self) -> Array:
        """Share of each merit's variance that no perturbation has by itself, shape (m,)."""
        return np.asarray(1.0 - self.first.sum(axis=0))

    def as_dict(self) -> dict[str, Any]:
        """For JSON: for each merit's column the perturbations, the largest total index first."""
        return {
            merit.column: {
                "standard_deviation": finite_or_none(float(self.standard_deviation[k])),
                "share_of_products": finite_or_none(float(self.products[k])),
                "indices": [self._row(i, k) for i in np.argsort(-self.total[:, k], kind="stable").tolist()],
            }
            for k, merit in enumerate(self.study.merits)
        }

    def _row(self, i: int, k: int) -> dict[str, Any]:
        names = ("first", "first_half_width", "total", "total_half_width")
        numbers = {name: finite_or_none(float(getattr(self, name)[i, k])) for name in names}
        return {"perturbation": self.study.perturbations[i].column, **numbers}


def most_trials(study: Study, base: int) -> int:
    """Number of trials that indices take."""
    return base * (len(study.perturbations) + 2)


def variance_indices(
    loaded: LoadedStudy, base: int, *, report: Callable[[int], None] | None = None
) -> VarianceIndices:
    """Variance-based indices of a study, from trials of its lens.

    Parameters
    ----------
    loaded
        The study, with its lens.
    base
        Trials are this number, a power of two, times the number of perturbations and two.
    report
        Called with the number of trials scored after each part.

    Raises
    ------
    InputError
        If the number is no power of two within its limits, or perturbations scatter together: a share of the
        variance is then no perturbation's own.
    IndicesError
        If a trial cannot be scored.
    """
    study = loaded.study
    if not SMALLEST_BASE <= base <= LARGEST_BASE or base & (base - 1):
        raise InputError(f"base = {base}: must be a power of two from {SMALLEST_BASE} to {LARGEST_BASE}")
    if study.dependence.leaders or study.dependence.mixtures:
        raise InputError("correlations and groups: perturbations that scatter together have no index each")
    if len(study.perturbations) < 2:
        raise InputError("one perturbation: it has all of the variance; indices need at least two")
    most = most_trials(study, base)
    columns = 3 * len(study.perturbations) + len(study.all_merits)  # shares twice, then values and scores
    check_memory(8.0 * columns * most, f"base = {base}", "take a smaller base")
    from SALib.sample import sobol as sampling

    problem = _problem(study)
    drawn = sampling.sample(problem, base, calc_second_order=False, seed=study.seed)
    drawn = np.clip(drawn, SMALLEST, LARGEST)
    shapes = [p.distribution for p in study.perturbations]
    values = np.column_stack([shape.quantile(drawn[:, k]) for k, shape in enumerate(shapes)])
    scores = StudyScorer(context_of(loaded.lens, study), study, report)(values)
    lost = int(np.count_nonzero(~np.all(np.isfinite(scores), axis=1)))
    if lost:
        raise IndicesError(f"{lost} of {len(scores)} trials could not be scored: no indices without them")
    return _analysed(study, problem, scores)


def _problem(study: Study) -> dict[str, Any]:
    names = [p.column for p in study.perturbations]
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


def _analysed(study: Study, problem: dict[str, Any], scores: Array) -> VarianceIndices:
    """SALib's estimates, merit by merit; none of a merit that does not vary."""
    from SALib.analyze import sobol as analysis

    shape = (len(study.perturbations), len(study.merits))
    found = {key: np.full(shape, np.nan) for key in ("S1", "S1_conf", "ST", "ST_conf")}
    deviation = scores.std(axis=0)
    for k in np.flatnonzero(deviation > 1e-12 * np.abs(scores).max(axis=0)).tolist():
        own = analysis.analyze(
            problem,
            scores[:, k],
            calc_second_order=False,
            num_resamples=RESAMPLES,
            conf_level=CONFIDENCE,
            seed=study.seed,
        )
        for key, table in found.items():
            table[:, k] = own[key]
    return VarianceIndices(
        study, found["S1"], found["S1_conf"], found["ST"], found["ST_conf"], deviation, len(scores)
    )
