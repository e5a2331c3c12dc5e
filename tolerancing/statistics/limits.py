"""Inverse sensitivities: the largest deviation of each perturbation alone that keeps a merit's limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.given import FilePath, object_of
from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.statistics.response import Scorer
from tolerancing.statistics.scorer import Progress, StudyScorer, scatter_of, validate_settings
from tolerancing.statistics.sensitivities import checked_tolerance
from tolerancing.study.evaluate import context_of, decide_levels, nominal_scores
from tolerancing.study.files import LoadedStudy, load_study
from tolerancing.study.study import Study

_Excess = Callable[[NDArray[np.intp], Array], Array]

PRECISION = 1e-3
"""Relative precision of the magnitudes."""

SHAPES = 20
"""Number of random shapes of an irregularity at each size; all must keep the limit."""

SMALLEST_FACTOR = 0.5**6
"""Smallest magnitude that is tried when the tolerance itself is too large, in tolerances."""


@dataclass(frozen=True)
class InverseLimit:
    """Largest allowed deviations of one perturbation, as magnitudes in its unit.

    Attributes
    ----------
    below, above
        Largest magnitude of a negative, and of a positive, deviation; None if the merit keeps its limit over
        the whole range of the search.
    """

    below: float | None
    above: float | None

    @property
    def tightest(self) -> float | None:
        """The smaller of the two magnitudes; None if neither is limited."""
        return min((side for side in (self.below, self.above) if side is not None), default=None)


@dataclass(frozen=True, eq=False)
class StudyLimits:
    """Largest allowed deviation of each perturbation of a study, if all others are zero.

    Attributes
    ----------
    study
        The study; its merits have the levels that were used.
    limits : mapping of str to tuple of InverseLimit
        For the label of each merit, one limit for each perturbation, in its unit.

    Examples
    --------
    >>> from tolerancing import inverse, load_study
    >>> found = inverse(load_study("designs/as_built_tolerances.toml"), "wavefront")
    >>> round(found.as_dict()["wavefront"]["surface_2_radius_mm"]["above"], 2)  # in mm
    0.1
    """

    study: Study
    limits: Mapping[str, tuple[InverseLimit, ...]]

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Return plain values for JSON: for each merit the limits by the perturbations' columns."""
        columns = [p.column for p in self.study.perturbations]
        return {
            label: {column: vars(limit) for column, limit in zip(columns, own, strict=True)}
            for label, own in self.limits.items()
        }


def inverse(
    loaded: LoadedStudy | FilePath,
    merit: str | None = None,
    *,
    change: float | None = None,
    progress: Progress | None = None,
) -> StudyLimits:
    """Find the largest deviation of each perturbation for which a merit still meets its limit.

    The perturbations are varied one at a time, in both directions, to a relative precision of 0.1 %.

    For an irregularity, each of 20 random shapes of the same size must meet the limit.

    Parameters
    ----------
    loaded
        Study with its lens, or the path of a study file.
    merit
        Label of the merit, which may be a high-fidelity merit. Default: all merits that score every trial.
    change
        Amount above 0, in the unit of the merit, by which the merit may become worse than nominal. Default:
        it may become worse up to its limit.
    progress
        Called as ``progress(count)`` with the number of lenses scored since the last call.

    Returns
    -------
    StudyLimits
        Limits of all perturbations for each merit.

    Raises
    ------
    InputError
        If there is no such merit, a perturbation is a setting of the reconstruction, `change` is given for
        several merits, or the nominal lens misses a limit.

    Examples
    --------
    >>> from tolerancing import inverse, load_study
    >>> found = inverse(load_study("designs/as_built_tolerances.toml"), "wavefront")
    >>> round(found.limits["wavefront"][0].tightest, 4)  # decenter along x in mm
    0.0196
    """
    loaded = object_of(loaded, LoadedStudy, load_study, "loaded")
    study = loaded.study.with_levels(decide_levels(loaded.lens, loaded.study))
    validate_settings(study, "its largest deviation")
    high_fidelity = [m for m in study.high_fidelity_merits if m.label == merit]
    if high_fidelity:  # It is scored itself, not the low-fidelity merit that selects its trials.
        own = high_fidelity[0].model_copy(update={"predicted_by": None})
        study = study.model_copy(update={"all_merits": (own,)})
    labels = [m.label for m in study.merits]
    if merit is not None and merit not in labels:
        allowed = ", ".join(m.label for m in loaded.study.all_merits)
        raise InputError(f"merit = {merit!r}: there is no such merit; allowed: {allowed}")
    if change is not None and merit is None and len(labels) > 1:
        raise InputError(f"change = {change:g}: is in one merit's unit; name the merit: {', '.join(labels)}")
    context = context_of(loaded.lens, study)
    scorer, nominal = StudyScorer(context, study, progress), nominal_scores(context, study)
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
    largest: float = 64.0,
) -> tuple[InverseLimit, ...]:
    """Find the magnitudes at which a merit reaches its limit, or has become worse by a given change.

    All perturbations and both signs are searched together. The tolerance is doubled until the merit misses
    the limit, or halved if it misses the limit already. Then the ITP method (Oliveira and Takahashi 2020)
    searches between the last two magnitudes; it needs at most one step more than bisection. With the defaults
    the scorer is called at most 18 times. A merit that misses the limit and meets it again between two
    doublings is not noticed. Deviations without a score count as beyond the limit.

    Parameters
    ----------
    scorer
        Function from deviations, shape (n, d), to scores, shape (n, m).
    nominal : array_like, shape (m,)
        Scores of the nominal lens.
    tolerance : array_like, shape (d,)
        Magnitudes at which the search starts.
    merit, index
        The merit, and its column among the scores.
    change
        Amount above 0 by which the merit may become worse than nominal. Default: up to its limit.
    largest
        Largest magnitude of the search, in tolerances; at least 1.

    Returns
    -------
    tuple of InverseLimit
        One for each perturbation. At these magnitudes the merit keeps its limit. It misses the limit within
        `PRECISION` of them, relative to the magnitude or to the smallest magnitude of the search.

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
    perturbation, sign = np.tile(np.arange(d), 2), np.repeat([-1.0, 1.0], d)

    def excess(rows: NDArray[np.intp], magnitude: Array) -> Array:
        deltas = np.zeros((len(rows), d))
        deltas[np.arange(len(rows)), perturbation[rows]] = sign[rows] * magnitude
        margin = merit.margin(np.asarray(scorer(deltas))[:, index])
        return np.where(np.isfinite(margin), margin - floor, -np.inf)

    start = float(merit.margin(np.atleast_1d(nominal)[index])) - floor
    search = _Search(excess, np.tile(sizes, 2), start)
    search.bracket(largest)
    search.narrow()
    ends = [float(end) if found else None for end, found in zip(search.low, search.found, strict=True)]
    return tuple(InverseLimit(below, above) for below, above in zip(ends[:d], ends[d:], strict=True))


def _floor(merit: Merit, nominal: float, change: float | None) -> float:
    """Return the smallest margin that is allowed."""
    if change is not None:
        if not (np.isfinite(change) and change > 0.0):
            raise InputError(f"change = {change:g}: must be above 0 and finite")
        if not np.isfinite(nominal):
            raise InputError(f"{merit.label}: the nominal lens has no score to change from")
        return float(merit.margin(nominal)) - change
    if not merit.passed(nominal):
        raise InputError(
            f"{merit.label}: the nominal lens scores {nominal:g} and misses its limit, {merit.limit_text}; "
            "no tolerance can keep it. Improve the lens or change the limit"
        )
    return 0.0


class _Search:
    """Brackets of several roots, narrowed together. The excess is negative at `high`, and not at `low`."""

    def __init__(self, excess: _Excess, size: Array, start: float) -> None:
        self.excess, self.size = excess, size
        self.low, self.high = np.zeros_like(size), np.full_like(size, np.inf)
        self.at_low, self.at_high = np.full_like(size, start), np.full_like(size, -np.inf)

    @property
    def found(self) -> NDArray[np.bool_]:
        """True if each root is bracketed."""
        return np.isfinite(self.high)

    def bracket(self, largest: float) -> None:
        """Double or halve the magnitudes until the ends of each bracket are a factor of two apart."""
        farthest, nearest = self.size * largest, self.size * SMALLEST_FACTOR
        self.evaluate(np.arange(len(self.size)), self.size)
        outward = ~self.found
        while True:
            unfinished = np.where(
                outward, ~self.found & (self.low < farthest), (self.low == 0.0) & (self.high > nearest)
            )
            active = np.flatnonzero(unfinished)
            if not active.size:
                return
            doubled = np.minimum(2.0 * self.low, farthest)
            self.evaluate(active, np.where(outward, doubled, 0.5 * self.high)[active])

    def narrow(self) -> None:
        """Narrow every bracket to the precision by the ITP method."""
        precision = 0.5 * PRECISION * np.maximum(self.low, self.size * SMALLEST_FACTOR)
        width = np.where(self.found, self.high - self.low, 0.0)
        steps = np.ceil(np.log2(np.maximum(width / (2.0 * precision), 1.0))) + 1.0
        done = 0
        while True:
            active = np.flatnonzero(self.found & (self.high - self.low > 2.0 * precision))
            if not active.size:
                return
            reach = precision[active] * 2.0 ** (steps[active] - done)
            self.evaluate(active, self._next_magnitudes(active, reach, 0.2 / width[active]))
            done += 1

    def _next_magnitudes(self, rows: NDArray[np.intp], reach: Array, truncation: Array) -> Array:
        """Interpolate, truncate toward the middle, and project to bisection's reach of the middle (ITP)."""
        low, high, at_low, at_high = (v[rows] for v in (self.low, self.high, self.at_low, self.at_high))
        middle, width = 0.5 * (low + high), high - low
        with np.errstate(invalid="ignore"):
            falsi = (at_low * high - at_high * low) / (at_low - at_high)
        falsi = np.where(np.isfinite(at_high) & np.isfinite(falsi), falsi, middle)
        offset, shift = middle - falsi, truncation * width**2
        moved = np.where(shift <= np.abs(offset), falsi + np.sign(offset) * shift, middle)
        radius = np.maximum(reach - 0.5 * width, 0.0)
        return np.clip(moved, middle - radius, middle + radius)

    def evaluate(self, rows: NDArray[np.intp], magnitude: Array) -> None:
        """Score new magnitudes and move the ends of the brackets to them."""
        value = self.excess(rows, magnitude)
        good = value >= 0.0
        self.low[rows[good]], self.at_low[rows[good]] = magnitude[good], value[good]
        self.high[rows[~good]], self.at_high[rows[~good]] = magnitude[~good], value[~good]
