"""Prediction of the wavefronts of lenses as built, from derivatives and without tracing trials.

The path difference of a trial is the sum of a first-order term for each perturbation and a second-order term
for each pair. Its mean square over the pupil, without shift and focus, is a polynomial of the drawn amounts,
whose evaluation takes microseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.given import FilePath
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.merits.pupil import PupilMerit, RmsWaves, Strehl
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.compensation import Compensation, less_model
from tolerancing.prediction.derivatives import FieldDifferentials, differentials
from tolerancing.prediction.system import Changes, amounts_of
from tolerancing.study.evaluate import compensated_points, pupil_context, sample_perturbations
from tolerancing.study.files import LoadedStudy, lens_and_study
from tolerancing.study.scoring import values_or_nan
from tolerancing.study.study import Study
from wavesim import rms_waves

TRACED_DRAWS = 16
"""Number of draws that are traced to measure the error of a prediction."""

Place = tuple[tuple[float, float], float | None]
"""An object point and a wavelength; None is the first wavelength of the lens."""

_At = tuple[Changes, tuple[FieldDifferentials, ...]]


RESOLVED_RMS_WAVES = 1e-6
"""Root mean square below which traced pupils do not resolve the effect of a tolerance."""


@dataclass(frozen=True)
class WavefrontLimit:
    """An object point and the limit of the root mean square wavefront error there.

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
    """Prediction at one object point.

    Attributes
    ----------
    judged : WavefrontLimit
    rms_waves : float
        Root of the mean square over pupil and lenses.
    first_order_rms_waves : float
        The same for path differences that are linear in the perturbations.
    shares : ndarray, shape (perturbations,)
        Fraction of the mean square of each perturbation alone, to first order.
    rms_of_draws : ndarray, shape (draws,)
        Root mean square over the pupil of each drawn lens, in waves.
    """

    judged: WavefrontLimit
    rms_waves: float
    first_order_rms_waves: float
    shares: Array
    rms_of_draws: Array

    @property
    def passed(self) -> NDArray[np.bool_]:
        """True for drawn lenses within the limit, shape (draws,)."""
        return np.asarray(self.rms_of_draws <= self.judged.limit_waves)

    @property
    def good(self) -> float:
        """Fraction of lenses within the limit."""
        return float(np.mean(self.passed))


@dataclass(frozen=True, eq=False)
class WavefrontPrediction:
    """Prediction of the wavefronts of a study.

    Attributes
    ----------
    points : tuple of PointPrediction
    draws : int
        Number of drawn lenses.
    perturbations : tuple of str
        Their columns.
    traced_rms_waves : ndarray, shape (traced draws, points)
        Root mean squares of the first draws, which are traced to measure the error; NaN for a lens without a
        pupil. No rows if none was traced.
    """

    points: tuple[PointPrediction, ...]
    draws: int
    perturbations: tuple[str, ...]
    traced_rms_waves: Array

    @property
    def relative_error(self) -> float:
        """Root mean square error of the predictions relative to traced draws, at the worst point.

        NaN if none was traced, and infinite if none of these has a pupil.
        """
        count = len(self.traced_rms_waves)
        if not count:
            return math.nan
        errors = []
        for point, true in zip(self.points, self.traced_rms_waves.T, strict=True):
            known = np.isfinite(true)
            if not np.any(known):
                return math.inf
            difference = float(np.linalg.norm(point.rms_of_draws[:count][known] - true[known]))
            smallest = RESOLVED_RMS_WAVES * math.sqrt(np.count_nonzero(known))
            errors.append(difference / max(float(np.linalg.norm(true[known])), smallest))
        return max(errors)

    @property
    def passed(self) -> NDArray[np.bool_]:
        """True for drawn lenses within the limit at every point."""
        return np.all([point.passed for point in self.points], axis=0)

    @property
    def good(self) -> float:
        """Fraction of lenses that are within the limit at every point."""
        return float(np.mean(self.passed))

    @property
    def second_order_suffices(self) -> bool:
        """True if the predictions are within 5 % of the traced draws; also if none was traced."""
        largest_error = 0.05
        return not self.relative_error > largest_error


def is_predicted_wavefront(merit: Merit) -> TypeGuard[RmsWaves | Strehl]:
    """Return whether a merit depends on the refocused wavefront, which is predicted without trials."""
    return isinstance(merit, RmsWaves | Strehl) and merit.refocus


def wavefront_points(study: Study) -> tuple[WavefrontLimit, ...]:
    """Return the object points at which a study limits the wavefront, with their limits.

    A limit on the Strehl ratio S is converted to a root mean square by S = exp(-(2 pi rms)^2).
    """
    return tuple(
        WavefrontLimit(point, merit.wavelength_um, _limit_waves(merit))
        for merit in study.merits
        if is_predicted_wavefront(merit)
        for point in merit.points
    )


def judged_points(study: Study) -> tuple[WavefrontLimit, ...]:
    """Return :func:`wavefront_points` of a study, which must have some.

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


def predict(
    lens: Lens | FilePath,
    study: Study | LoadedStudy | FilePath,
    points: Sequence[WavefrontLimit] | None = None,
    batch: PerturbationBatch | None = None,
    second: bool = True,
) -> WavefrontPrediction:
    """Predict wavefronts and yield of a study without trials.

    The third order, the changed vignetting of perturbed lenses, and merits that do not depend on wavefronts
    are neglected. The first draws are traced as well, which measures the error of this.

    Parameters
    ----------
    lens
        The study's lens, or the path of its design file.
    study
        The study with its perturbations, or the path of its file.
    points
        Object points with limits; default: those of the study's merits `rms_waves` and `strehl`.
    batch
        The drawn lenses, for callers that predict many lenses; default: those of :func:`drawn_batch`.
    second
        Whether to include the second order and traced draws; without them, the prediction takes a tenth of
        the time.

    Raises
    ------
    InputError
        If the study has no merit that can be predicted.
    DesignError
        If rays from an object point do not pass.
    """
    lens, study = lens_and_study(lens, study)
    judged = judged_points(study) if points is None else tuple(points)
    known = study_derivatives(lens, study, judged, second=second)
    batch = drawn_batch(study) if batch is None else batch
    amounts = amounts_of(batch)
    together = np.concatenate([amounts, known.compensation.values(amounts)], axis=1)
    squares = np.stack([mean_squares(field, together) for field in known.fields], axis=1)
    found = tuple(_point(known, k, amounts, together, squares[:, k]) for k in range(len(judged)))
    traced = _traced_rms(lens, study, judged, batch) if second else np.zeros((0, len(judged)))
    return WavefrontPrediction(found, len(amounts), tuple(p.column for p in study.perturbations), traced)


def _traced_rms(
    lens: Lens, study: Study, judged: Sequence[WavefrontLimit], batch: PerturbationBatch
) -> Array:
    """Return the root mean squares of the first draws from traced pupils, shape (traced draws, points)."""
    context, traced = traced_context(lens, study), batch.subset(slice(0, TRACED_DRAWS))

    def rms(own: PerturbationBatch) -> Array:
        places = ((point.field_mm, point.wavelength_um) for point in judged)
        pupils = [context.pupils(own, *place, True, True) for place in places]
        return np.array([[rms_waves(pupil) for pupil in of_draw] for of_draw in zip(*pupils, strict=True)])

    return values_or_nan(rms, traced, (len(judged),))


def traced_context(lens: Lens, study: Study) -> Context:
    """Return the context that traces draws to measure the error of a prediction."""
    # A root mean square over so many samples across the pupil is within 1 % of that of a fine grid.
    samples = min(study.sampling.pupil_samples, 64)
    sampling = study.sampling.model_copy(update={"pupil_samples": samples})
    return pupil_context(lens, study.model_copy(update={"sampling": sampling}))


def drawn_batch(study: Study, every: int = 1, draws: int = 8192) -> PerturbationBatch:
    """Return lenses of a study that a Sobol sequence draws, or every n-th of them."""
    by_sobol = study.model_copy(update={"draws": "sobol", "trials": draws})
    return sample_perturbations(by_sobol, range(0, draws, every))


def drawn_amounts(study: Study, draws: int = 8192) -> Array:
    """Return the amounts of the changes of the drawn lenses, shape (draws, d)."""
    return amounts_of(drawn_batch(study, draws=draws))


@dataclass(frozen=True, eq=False)
class StudyDerivatives:
    """Derivatives of a study's wavefronts by its changes and compensators, at the judged field points."""

    judged: tuple[WavefrontLimit, ...]
    changes: Changes
    compensation: Compensation
    fields: tuple[FieldDifferentials, ...]


def study_derivatives(
    lens: Lens, study: Study, judged: Sequence[WavefrontLimit], second: bool
) -> StudyDerivatives:
    """Differentiate the wavefronts of a lens by all perturbations and compensators of a study."""

    def at(points: Sequence[Place], perturbed: Sequence[PerturbedParameter], sizes: list[float]) -> _At:
        # Points with the same wavelength are traced together.
        found: dict[Place, FieldDifferentials] = {}
        for wavelength in dict.fromkeys(w for _, w in points):
            same = [place for place in points if place[1] == wavelength]
            part = differentials(
                lens,
                perturbed,
                np.array(sizes),
                [point for point, _ in same],
                wavelength_um=wavelength,
                plane_distance_mm=study.sampling.plane_distance_mm,
                pivot_z_mm=study.pivot_z_mm,
                second=second,
            )
            found |= zip(same, part.fields, strict=True)
        return part.changes, tuple(found[place] for place in points)

    own = [(point.field_mm, point.wavelength_um) for point in judged]
    scatter = study.perturbations, [p.tolerance for p in study.perturbations]
    changes, fields = at(own, *scatter)
    limits = [c.limit for c in study.compensators]
    if not limits:
        return StudyDerivatives(tuple(judged), changes, Compensation(np.zeros(0), (), ()), fields)
    adapted = study.compensators, limits
    fitted = compensated_points(study)
    compensation = Compensation(np.array(limits), at(fitted, *scatter)[1], at(fitted, *adapted)[1])
    models = at(own, *adapted)[1]
    left = tuple(less_model(field, model) for field, model in zip(fields, models, strict=True))
    return StudyDerivatives(tuple(judged), changes, compensation, left)


def mean_squares(field: FieldDifferentials, amounts: Array) -> Array:
    """Return the mean square of the refocused path difference in waves of each trial, shape (trials,)."""
    return np.asarray(field.waves(amounts) ** 2 @ field.weights)


def first_order(field: FieldDifferentials) -> Array:
    """Return the quadratic form of the amounts for the mean square path difference, shape (d, d)."""
    return np.asarray((field.registered.T * field.weights) @ field.registered)


def _point(
    known: StudyDerivatives, k: int, amounts: Array, together: Array, squares: Array
) -> PointPrediction:
    judged, form = known.judged[k], first_order(known.fields[k])
    linear = float(np.mean(np.sum((together @ form) * together, axis=1)))
    # The effect of a perturbation alone is what remains of it after compensation.
    follow = known.compensation.following(known.changes.count)
    alone = (follow.T @ form @ follow) * (amounts.T @ amounts / len(amounts))
    shares = [float(np.sum(alone[own, own])) for own in known.changes.columns]
    return PointPrediction(
        judged,
        math.sqrt(float(np.mean(squares))),
        math.sqrt(max(linear, 0.0)),
        np.array(shares) / max(float(np.sum(alone)), np.finfo(float).tiny),
        np.sqrt(squares),
    )
