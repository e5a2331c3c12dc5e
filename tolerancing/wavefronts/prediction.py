"""What a lens will be as built, from the derivatives of its wavefronts: no trial is traced.

The path difference of a trial is a first-order sum over its perturbations, and a second-order one over their
pairs. Its mean square over the pupil, shift and focus taken out, is then a polynomial of the drawn amounts,
which takes microseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.pupil import PupilMerit, RmsWaves, Strehl
from tolerancing.study.evaluate import realise
from tolerancing.study.study import Study
from tolerancing.wavefronts.derivatives import Differentials, differentials

DRAWS = 8192
"""Sobol draws of a study's perturbations."""

BLOCK = 512
"""Draws whose path differences are held at one time."""

SECOND_MATTERS = 0.003
"""Share of the root mean square that second order changes, above which predictions may be 5 % off.

The second order adds in squares, and what is left out is about the third order times the first: with the
tolerances of `designs/paper_tolerances.toml` made 5, 15 and 30 times as large, shares are 0.001, 0.008 and
0.03, and predictions 1, 8 and 16 % off.
"""


@dataclass(frozen=True)
class Judged:
    """An object point and how large a root mean square is good there.

    Attributes
    ----------
    field_mm : (x, y)
    wavelength_um : float or None
        None: the lens's first.
    limit_waves : float
    """

    field_mm: tuple[float, float]
    wavelength_um: float | None
    limit_waves: float


@dataclass(frozen=True, eq=False)
class PointPrediction:
    """What is predicted at one object point.

    Attributes
    ----------
    judged : Judged
    rms_waves : float
        Root of the mean square over pupil and lenses.
    first_order_rms_waves : float
        The same, were path differences linear in the perturbations.
    shares : ndarray, shape (perturbations,)
        Of the mean square that each perturbation brings by itself; to first order.
    good : float
        Share of lenses within the limit.
    """

    judged: Judged
    rms_waves: float
    first_order_rms_waves: float
    shares: Array
    good: float

    @property
    def second_order_share(self) -> float:
        """By how much of itself second order changes the root mean square."""
        return abs(self.rms_waves / self.first_order_rms_waves - 1.0) if self.first_order_rms_waves else 0.0


@dataclass(frozen=True, eq=False)
class WavefrontPrediction:
    """What is predicted of a study.

    Attributes
    ----------
    points : tuple of PointPrediction
    good : float
        Share of lenses that are within the limit at every point.
    draws : int
        By which it was found.
    perturbations : tuple of str
        Their columns.
    """

    points: tuple[PointPrediction, ...]
    good: float
    draws: int
    perturbations: tuple[str, ...]

    @property
    def second_order_suffices(self) -> bool:
        """Whether third order is small, as far as the second tells."""
        return all(point.second_order_share <= SECOND_MATTERS for point in self.points)


def wavefront_points(study: Study) -> tuple[Judged, ...]:
    """Object points that a study judges by the wavefront, with their limits.

    Strehl ratios count as the root mean square that they stand for: S = exp(-(2 pi rms)^2).
    """
    return tuple(
        Judged(point, merit.wavelength_um, _limit_waves(merit))
        for merit in study.merits
        if isinstance(merit, RmsWaves | Strehl) and merit.refocus
        for point in merit.points
    )


def judged_points(study: Study) -> tuple[Judged, ...]:
    """As :func:`wavefront_points`, of a study that has some.

    Raises
    ------
    InputError
        If the study has no merit of the kind.
    """
    found = wavefront_points(study)
    if not found:
        kinds = ", ".join(merit.label for merit in study.merits)
        raise InputError(
            f"no merit judges the refocused wavefront itself ({kinds}): add one of kind rms_waves, with "
            "field_points_mm and at_most, or strehl with at_least"
        )
    return found


def _limit_waves(merit: PupilMerit) -> float:
    if merit.at_most is not None:
        return float(merit.at_most)
    assert merit.at_least is not None  # every merit has one of both
    return math.sqrt(-math.log(min(max(merit.at_least, 1e-12), 1.0 - 1e-12))) / (2.0 * math.pi)


def predict(lens: Lens, study: Study, points: Sequence[Judged] | None = None) -> WavefrontPrediction:
    """Predict wavefronts and yield of a study without trials.

    What it neglects: third order, compensators other than shift and focus, merits other than the wavefront's,
    and rays that a perturbed stop lets through or not.

    Parameters
    ----------
    lens
        The study's lens.
    study
        What scatters.
    points
        What is judged; by default what the study's merits `rms_waves` and `strehl` judge.

    Raises
    ------
    InputError
        If the study has compensators, or no merit that can be predicted.
    DesignError
        If rays from an object point do not pass.
    """
    _refuse_compensators(study)
    judged = judged_points(study) if points is None else tuple(points)
    batch = realise(replace_draws(study, DRAWS), range(DRAWS))
    squares, found = np.empty((DRAWS, len(judged))), []
    for k, point in enumerate(judged):
        known = _known(lens, study, point, second=True)
        amounts = known.changes.amounts(batch)
        squares[:, k] = mean_squares(known, amounts)
        found.append(_point(known, amounts, point, squares[:, k]))
    limits = np.array([point.limit_waves for point in judged])
    good = np.all(squares <= limits**2, axis=1)
    columns = tuple(p.column for p in study.perturbations)
    return WavefrontPrediction(tuple(found), float(np.mean(good)), DRAWS, columns)


@dataclass(frozen=True)
class Loosened:
    """What one tolerance alone does to the yield, all others as they are.

    Attributes
    ----------
    perturbation
        Its column.
    halved, doubled
        Share of good lenses with half of it, and with twice as much.
    """

    perturbation: str
    halved: float
    doubled: float


def loosen_each(lens: Lens, study: Study) -> tuple[Loosened, ...]:
    """Yields with each tolerance halved and doubled, to first order; perturbation by perturbation.

    Raises
    ------
    InputError, DesignError
        As of :func:`predict`.
    """
    _refuse_compensators(study)
    judged = judged_points(study)
    batch = realise(replace_draws(study, DRAWS), range(DRAWS))
    forms, limits = [], np.array([point.limit_waves**2 for point in judged])
    for point in judged:
        known = _known(lens, study, point, second=False)
        forms.append(first_order(known))
    amounts = known.changes.amounts(batch)

    def good(columns: slice, factor: float) -> float:
        changed = amounts.copy()
        changed[:, columns] *= factor
        squares = np.stack([np.sum((changed @ form) * changed, axis=1) for form in forms], axis=1)
        return float(np.mean(np.all(squares <= limits, axis=1)))

    return tuple(
        Loosened(p.column, good(columns, 0.5), good(columns, 2.0))
        for p, columns in zip(study.perturbations, known.changes.columns, strict=True)
    )


def _known(lens: Lens, study: Study, point: Judged, second: bool) -> Differentials:
    """Derivatives at one object point by all that a study perturbs."""
    return differentials(
        lens,
        study.perturbations,
        np.array([p.tolerance for p in study.perturbations]),
        [point.field_mm],
        wavelength_um=point.wavelength_um,
        plane_distance_mm=study.sampling.plane_distance_mm,
        pivot_z_mm=study.pivot_z_mm,
        second=second,
    )


def _refuse_compensators(study: Study) -> None:
    if study.compensators:
        names = ", ".join(c.column for c in study.compensators)
        raise InputError(f"compensators ({names}): predictions know shift and focus alone; run the study")


def replace_draws(study: Study, count: int) -> Study:
    """The study, drawn by so many points of a Sobol sequence."""
    return study.model_copy(update={"draws": "sobol", "trials": count})


def mean_squares(known: Differentials, amounts: Array) -> Array:
    """Mean square of the refocused path difference, in waves, of each trial; shape (trials,)."""
    (field,) = known.fields
    parts = [amounts[start : start + BLOCK] for start in range(0, len(amounts), BLOCK)]
    return np.concatenate([field.waves(part) ** 2 @ field.weights for part in parts])


def first_order(known: Differentials) -> Array:
    """Mean square of the refocused path difference as a quadratic form of the amounts, shape (d, d)."""
    (field,) = known.fields
    return np.asarray((field.registered.T * field.weights) @ field.registered)


def _point(known: Differentials, amounts: Array, judged: Judged, squares: Array) -> PointPrediction:
    form = first_order(known)
    moments = amounts.T @ amounts / len(amounts)
    alone = [float(np.sum(form[own, own] * moments[own, own])) for own in known.changes.columns]
    linear = float(np.sum(form * moments))
    return PointPrediction(
        judged,
        math.sqrt(float(np.mean(squares))),
        math.sqrt(max(linear, 0.0)),
        np.array(alone) / max(linear, np.finfo(float).tiny),
        float(np.mean(squares <= judged.limit_waves**2)),
    )
