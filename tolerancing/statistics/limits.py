"""Inverse sensitivities: how far each perturbation may go, by itself, before a merit reaches its limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.statistics.quadratic_response import checked_tolerance
from tolerancing.statistics.response import Scorer
from tolerancing.statistics.scorer import Report, StudyScorer, scatter_of, validate_settings
from tolerancing.study.evaluate import context_of, decide_levels, nominal_scores
from tolerancing.study.files import LoadedStudy
from tolerancing.study.study import Study

_Excess = Callable[[NDArray[np.intp], Array], Array]

PRECISION = 1e-3
"""Relative precision of the magnitudes."""

LARGEST = 64.0
"""How far a search goes, in tolerances."""

SHAPES = 20
"""Shapes of an irregularity that are tried at each size; all must keep the limit."""

HALVINGS = 6
"""How often a tolerance that is too large already is halved in search of one that is not."""


@dataclass(frozen=True)
class InverseLimit:
    """How far one perturbation may go; magnitudes in its unit, None where the search found no end.

    Attributes
    ----------
    below, above
        Largest magnitude of a negative, and of a positive, deviation.
    """

    below: float | None
    above: float | None

    @property
    def tightest(self) -> float | None:
        """The smaller of both."""
        return min((side for side in (self.below, self.above) if side is not None), default=None)


@dataclass(frozen=True, eq=False)
class StudyLimits:
    """How far each perturbation of a study may go by itself.

    Attributes
    ----------
    study
        The study, the levels of its merits settled.
    limits : mapping of str to tuple of InverseLimit
        By merit; one for each perturbation.
    """

    study: Study
    limits: Mapping[str, tuple[InverseLimit, ...]]

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """For JSON: for each merit the limits by the perturbations' columns."""
        columns = [p.column for p in self.study.perturbations]
        return {
            label: {column: vars(limit) for column, limit in zip(columns, own, strict=True)}
            for label, own in self.limits.items()
        }


def inverse(
    loaded: LoadedStudy,
    merit: str | None = None,
    *,
    change: float | None = None,
    report: Report | None = None,
) -> StudyLimits:
    """How far each perturbation of a study may go by itself before a merit misses its limit.

    An irregularity may go as far as none of `SHAPES` shapes of that size misses the limit.

    Parameters
    ----------
    loaded
        The study, with its lens.
    merit
        Name of the merit, dear ones included; all that score every trial where left out.
    change
        Amount, above 0 and in the merit's unit, by which it may become worse; left out: up to its limit.
    report
        Called with the number of lenses scored after each part of them.

    Raises
    ------
    InputError
        If there is no such merit, or as of :func:`inverse_limits`.
    """
    study = loaded.study.with_levels(decide_levels(loaded.lens, loaded.study))
    validate_settings(study, "how far it may go")
    dear = [m for m in study.high_fidelity_merits if m.label == merit]
    if dear:  # scored by itself, not by the cheap merit that chooses its trials
        own = dear[0].model_copy(update={"predicted_by": None})
        study = study.model_copy(update={"all_merits": (own,)})
    labels = [m.label for m in study.merits]
    if merit is not None and merit not in labels:
        allowed = ", ".join(m.label for m in loaded.study.all_merits)
        raise InputError(f"merit = {merit!r}: there is no such merit; allowed: {allowed}")
    if change is not None and merit is None and len(labels) > 1:
        raise InputError(f"change = {change:g}: is in one merit's unit; name the merit: {', '.join(labels)}")
    context = context_of(loaded.lens, study)
    scorer, nominal = StudyScorer(context, study, report), nominal_scores(context, study)
    scores, tolerance = [nominal[label] for label in labels], scatter_of(study).tolerance

    def worst(values: Array) -> Array:
        return scorer.worst_of_shapes(values, SHAPES)

    limits = {
        one.label: inverse_limits(worst, scores, tolerance, one, k, change)
        for k, one in enumerate(study.merits)
        if merit in (None, one.label)
    }
    return StudyLimits(study, limits)


def inverse_limits(
    scorer: Scorer,
    nominal: ArrayLike,
    tolerance: ArrayLike,
    merit: Merit,
    index: int,
    change: float | None = None,
    largest: float = LARGEST,
) -> tuple[InverseLimit, ...]:
    """Magnitudes at which a merit reaches its limit, or has become worse by a given change.

    All perturbations and both sides are searched together: by doubling the tolerance until the merit is
    beyond the limit (by halving, where it is already), then between the last two magnitudes by the ITP
    method (Oliveira and Takahashi 2020), which takes no more steps than one above bisection's. With the
    defaults the scorer is called 18 times at most. A merit that leaves the limit and returns between two
    doublings is not noticed. Deltas without a score lie beyond the limit.

    Parameters
    ----------
    scorer
        Scores of deltas from nominal.
    nominal : array_like, shape (m,)
        Scores of the nominal lens.
    tolerance : array_like, shape (d,)
        Where the search starts.
    merit, index
        The merit, and its column among the scores.
    change
        Amount, above 0, by which the merit may become worse than nominal; left out: up to its limit.
    largest
        How far to search, in tolerances; at least 1.

    Returns
    -------
    tuple of InverseLimit
        One for each perturbation. At the magnitudes given the merit still keeps its limit; it fails within
        `PRECISION` of them, relative to them or to the smallest magnitude that the halving reaches.

    Raises
    ------
    InputError
        If the nominal lens misses the limit, or a tolerance, `change` or `largest` is out of range.
    """
    sizes = checked_tolerance(tolerance)
    floor = _floor(merit, float(np.atleast_1d(nominal)[index]), change)
    if not (np.isfinite(largest) and largest >= 1.0):
        raise InputError(f"largest = {largest:g}: must be finite and at least 1, in tolerances")
    d = len(sizes)
    which, side = np.tile(np.arange(d), 2), np.repeat([-1.0, 1.0], d)

    def excess(rows: NDArray[np.intp], magnitude: Array) -> Array:
        deltas = np.zeros((len(rows), d))
        deltas[np.arange(len(rows)), which[rows]] = side[rows] * magnitude
        margin = merit.margin(np.asarray(scorer(deltas))[:, index])
        return np.where(np.isfinite(margin), margin - floor, -np.inf)

    start = float(merit.margin(np.atleast_1d(nominal)[index])) - floor
    search = _Search(excess, np.tile(sizes, 2), start)
    search.bracket(largest)
    search.narrow()
    ends = [float(end) if found else None for end, found in zip(search.low, search.found, strict=True)]
    return tuple(InverseLimit(below, above) for below, above in zip(ends[:d], ends[d:], strict=True))


def _floor(merit: Merit, nominal: float, change: float | None) -> float:
    """Smallest margin that is allowed."""
    if change is not None:
        if not (np.isfinite(change) and change > 0.0):
            raise InputError(f"change = {change:g}: must be above 0 and finite")
        if not np.isfinite(nominal):
            raise InputError(f"{merit.label}: the nominal lens has no score to change from")
        return float(merit.margin(nominal)) - change
    if not merit.passed(nominal):
        raise InputError(
            f"{merit.label}: the nominal lens scores {nominal:g} and misses its limit, {merit.limit_text}; "
            "no tolerance can keep it"
        )
    return 0.0


class _Search:
    """Brackets of several roots, narrowed together: excess negative at `high`, and not at `low`."""

    def __init__(self, excess: _Excess, size: Array, start: float) -> None:
        self.excess, self.size = excess, size
        self.low, self.high = np.zeros_like(size), np.full_like(size, np.inf)
        self.at_low, self.at_high = np.full_like(size, start), np.full_like(size, -np.inf)

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which roots are bracketed."""
        return np.isfinite(self.high)

    def bracket(self, largest: float) -> None:
        """Double, or halve, until the ends of each bracket are a factor of two apart."""
        farthest, nearest = self.size * largest, self.size * 0.5**HALVINGS
        self.try_at(np.arange(len(self.size)), self.size)
        outward = ~self.found
        while True:
            goes_on = np.where(
                outward, ~self.found & (self.low < farthest), (self.low == 0.0) & (self.high > nearest)
            )
            active = np.flatnonzero(goes_on)
            if not active.size:
                return
            doubled = np.minimum(2.0 * self.low, farthest)
            self.try_at(active, np.where(outward, doubled, 0.5 * self.high)[active])

    def narrow(self) -> None:
        """Narrow every bracket to the precision by the ITP method."""
        precision = 0.5 * PRECISION * np.maximum(self.low, self.size * 0.5**HALVINGS)
        width = np.where(self.found, self.high - self.low, 0.0)
        steps = np.ceil(np.log2(np.maximum(width / (2.0 * precision), 1.0))) + 1.0
        taken = 0
        while True:
            active = np.flatnonzero(self.found & (self.high - self.low > 2.0 * precision))
            if not active.size:
                return
            reach = precision[active] * 2.0 ** (steps[active] - taken)
            self.try_at(active, self._between(active, reach, 0.2 / width[active]))
            taken += 1

    def _between(self, rows: NDArray[np.intp], reach: Array, pull: Array) -> Array:
        """Next magnitudes: interpolated, pulled to the middle, and kept within bisection's reach of it."""
        low, high, at_low, at_high = (v[rows] for v in (self.low, self.high, self.at_low, self.at_high))
        middle, width = 0.5 * (low + high), high - low
        with np.errstate(invalid="ignore"):
            falsi = (at_low * high - at_high * low) / (at_low - at_high)
        falsi = np.where(np.isfinite(at_high) & np.isfinite(falsi), falsi, middle)
        away = middle - falsi
        moved = np.where(pull * width**2 <= np.abs(away), falsi + np.sign(away) * pull * width**2, middle)
        radius = np.maximum(reach - 0.5 * width, 0.0)
        return np.clip(moved, middle - radius, middle + radius)

    def try_at(self, rows: NDArray[np.intp], magnitude: Array) -> None:
        """Score new magnitudes and move the ends of the brackets to them."""
        value = self.excess(rows, magnitude)
        good = value >= 0.0
        self.low[rows[good]], self.at_low[rows[good]] = magnitude[good], value[good]
        self.high[rows[~good]], self.at_high[rows[~good]] = magnitude[~good], value[~good]
