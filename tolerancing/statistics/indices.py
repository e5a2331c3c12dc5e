"""Variance-based sensitivity indices of a study (Sobol).

The first-order index of perturbation i is the fraction of a merit's variance that would vanish if i were
fixed at its value, S_i = Var E[f | x_i] / Var f. The total index is the fraction that would remain if all
other perturbations were fixed, ST_i = 1 - Var E[f | x_~i] / Var f (Sobol, Math. Comput. Simul. 55, 271,
2001). The two differ by products of i with other perturbations, which a sensitivity of each perturbation
alone cannot show.

SALib draws the trials by Saltelli's scheme and estimates both indices, with intervals by resampling (Saltelli
et al., Comput. Phys. Commun. 181, 259, 2010).
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

SMALLEST_BASE, LARGEST_BASE = 16, 2**20


class IndicesError(TransferLensError):
    """Some trials could not be scored, so the indices cannot be computed."""


@dataclass(frozen=True, eq=False)
class VarianceIndices:
    """Indices of d perturbations for m merits, as arrays of shape (d, m).

    Attributes
    ----------
    study
        The study.
    first, first_half_width
        First-order indices, and half the width of their 95 % intervals.
    total, total_half_width
        Total indices, and half the width of their 95 % intervals.
    standard_deviation : ndarray, shape (m,)
        Standard deviation of each merit when all perturbations scatter.
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
        """Fraction of each merit's variance that comes from products of perturbations, shape (m,)."""
        return np.asarray(1.0 - self.first.sum(axis=0))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: each merit's perturbations by descending total index."""
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
    """Return the number of trials that the indices of a study need."""
    return base * (len(study.perturbations) + 2)


def variance_indices(
    loaded: LoadedStudy, base: int, *, progress: Callable[[int], None] | None = None
) -> VarianceIndices:
    """Compute variance-based indices of a study from trials of its lens.

    Parameters
    ----------
    loaded
        Study with its lens.
    base
        Power of two from 16 to 2**20. The number of trials is ``base * (perturbations + 2)``.
    progress
        Called as ``progress(count)`` with the number of trials scored since the last call.

    Returns
    -------
    VarianceIndices
        Indices with their intervals. Those of a merit that does not vary are NaN.

    Raises
    ------
    InputError
        If `base` is not allowed, there is only one perturbation, or perturbations are correlated or grouped.
        A fraction of the variance then belongs to no single perturbation.
    IndicesError
        If a trial cannot be scored.
    """
    study = loaded.study
    if not SMALLEST_BASE <= base <= LARGEST_BASE or base & (base - 1):
        raise InputError(f"base = {base}: must be a power of two from {SMALLEST_BASE} to {LARGEST_BASE}")
    if study.dependence.leaders or study.dependence.mixtures:
        raise InputError(
            "correlations and groups: perturbations that scatter together have no index of their own; "
            "remove their [[correlation]] tables and groups"
        )
    if len(study.perturbations) < 2:
        raise InputError(
            "the study has one perturbation, which has all of the variance; at least two are needed"
        )
    most = most_trials(study, base)
    columns = 3 * len(study.perturbations) + len(study.all_merits)  # Uniform draws (twice), values, scores.
    check_memory(8.0 * columns * most, f"base = {base}", "use a smaller base")
    from SALib.sample import sobol as sampling

    problem = _problem(study)
    drawn = sampling.sample(problem, base, calc_second_order=False, seed=study.seed)
    drawn = np.clip(drawn, SMALLEST, LARGEST)
    distributions = [p.distribution for p in study.perturbations]
    values = np.column_stack([one.quantile(drawn[:, k]) for k, one in enumerate(distributions)])
    scores = StudyScorer(context_of(loaded.lens, study), study, progress)(values)
    lost = int(np.count_nonzero(~np.all(np.isfinite(scores), axis=1)))
    if lost:
        raise IndicesError(
            f"{lost} of {len(scores)} trials could not be scored, and indices need all of them; reduce the "
            "tolerances"
        )
    return _analysed(study, problem, scores)


def _problem(study: Study) -> dict[str, Any]:
    names = [p.column for p in study.perturbations]
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


def _analysed(study: Study, problem: dict[str, Any], scores: Array) -> VarianceIndices:
    """Return SALib's estimates for each merit that varies."""
    from SALib.analyze import sobol as analysis

    shape = (len(study.perturbations), len(study.merits))
    found = {key: np.full(shape, np.nan) for key in ("S1", "S1_conf", "ST", "ST_conf")}
    deviation = scores.std(axis=0)
    for k in np.flatnonzero(deviation > 1e-12 * np.abs(scores).max(axis=0)).tolist():
        own = analysis.analyze(
            problem,
            scores[:, k],
            calc_second_order=False,
            num_resamples=200,
            conf_level=CONFIDENCE,
            seed=study.seed,
        )
        for key, table in found.items():
            table[:, k] = own[key]
    return VarianceIndices(
        study, found["S1"], found["S1_conf"], found["ST"], found["ST_conf"], deviation, len(scores)
    )
