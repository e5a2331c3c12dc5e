"""The predicted yield of a study, as optimizer, commands, drawings, reports and workbench use it.

A lens is good if it meets every limit of its study. All limits are predicted for the same drawn lenses, so
that the joint yield includes their correlation. Some draws are traced, which measures the error of each
prediction. There is no yield if the study has a limit that cannot be predicted, or if this error is large:
a yield that leaves a limit out is not a yield of the study.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.given import FilePath
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit
from tolerancing.merits.pupil import RmsWaves
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.prediction.drawn_scores import is_scored_by_draw, measured_error, scores_by_draw
from tolerancing.prediction.ray_prediction import RayPrediction, is_predicted_ray_merit, predict_rays
from tolerancing.prediction.wavefront_prediction import (
    TRACED_DRAWS,
    WavefrontPrediction,
    drawn_batch,
    is_predicted_wavefront,
    predict,
    traced_context,
)
from tolerancing.statistics.yields import wilson
from tolerancing.study.evaluate import with_decided_levels
from tolerancing.study.files import LoadedStudy, lens_and_study
from tolerancing.study.scoring import score_batch
from tolerancing.study.study import Study

SCORED_DRAWS = 256
"""Number of drawn lenses for merits that are scored draw by draw, which takes some milliseconds each."""

LARGEST_MODEL_ERROR = 0.05
"""Largest change of the yield by the errors of the predicted scores for which a yield is given."""


@dataclass(frozen=True, eq=False)
class LimitPrediction:
    """Prediction for one limit of a study.

    Attributes
    ----------
    merit : Merit
        The merit with the limit.
    scores : ndarray, shape (draws,)
        Predicted scores of the drawn lenses, at the worst field point; NaN for a lens without a score.
    error : float
        Error of these scores, as measured with traced draws; 0 if none was traced.
    """

    merit: Merit
    scores: Array
    error: float

    @property
    def passed(self) -> NDArray[np.bool_]:
        """True for drawn lenses that meet the limit at all of its field points, shape (draws,)."""
        return self.merit.passed(self.scores)

    @property
    def yield_fraction(self) -> float:
        """Fraction of lenses that meet this limit."""
        return float(np.mean(self.passed))


@dataclass(frozen=True)
class PredictedYield:
    """Predicted fraction of lenses that keep every limit of a study.

    Attributes
    ----------
    fraction
        The yield, 0 to 1.
    low, high
        Ends of its interval, from the number of draws (95 %) and the measured errors of the scores.
    draws
        Number of drawn lenses.
    model_error
        Largest change of the yield by the errors of the scores alone.
    """

    fraction: float
    low: float
    high: float
    draws: int
    model_error: float


@dataclass(frozen=True, eq=False)
class StudyPrediction:
    """Prediction of a study's lens as built.

    Attributes
    ----------
    limits : tuple of LimitPrediction
        The limits that are predicted, in the order of the study.
    not_predicted : tuple of str
        Labels of the merits that only trials can score.
    wavefronts : WavefrontPrediction or None
        Wavefronts at each field point; None if the study judges none.
    rays : tuple of RayPrediction
        Spreads and footprints.
    """

    limits: tuple[LimitPrediction, ...]
    not_predicted: tuple[str, ...]
    wavefronts: WavefrontPrediction | None
    rays: tuple[RayPrediction, ...]

    @property
    def draws(self) -> int:
        """Number of drawn lenses that all predicted merits score."""
        return min(len(limit.scores) for limit in self.limits)

    @property
    def passed(self) -> NDArray[np.bool_]:
        """True for drawn lenses that meet every *predicted* limit, shape (draws,)."""
        return np.all([limit.passed[: self.draws] for limit in self.limits], axis=0)

    @cached_property
    def joint(self) -> PredictedYield | None:
        """The yield over all limits of the study; None if it is not predicted (`reason`)."""
        found = None if self.not_predicted else self._within_limits
        return None if found is None or found.model_error > LARGEST_MODEL_ERROR else found

    @property
    def yield_fraction(self) -> float | None:
        """Fraction of lenses that meet every limit of the study; None if it is not predicted."""
        return None if self.joint is None else self.joint.fraction

    @property
    def reason(self) -> str:
        """Why the yield is not predicted; empty if it is."""
        if self.not_predicted:
            verb = "has" if len(self.not_predicted) == 1 else "have"
            return f"{', '.join(self.not_predicted)} {verb} no prediction"
        if self.joint is not None:
            return ""
        change = self._within_limits.model_error
        return (
            f"traced draws differ from the predicted scores so much that the yield may change by "
            f"{100.0 * change:.0f} percentage points"
        )

    @property
    def is_trustworthy(self) -> bool:
        """True if the yield is predicted, and the measured errors of wavefronts and rays are small."""
        waves = self.wavefronts is None or self.wavefronts.second_order_suffices
        return self.joint is not None and waves and all(ray.first_order_suffices for ray in self.rays)

    @property
    def within_wavefronts_and_rays(self) -> float:
        """Fraction of lenses that meet the limits on wavefronts and rays; NaN if there are none.

        It is no yield if the study has other limits.
        """
        own = [limit.passed for limit in self.limits if is_scored_at_once(limit.merit)]
        return float(np.mean(np.all(own, axis=0))) if own else math.nan

    @cached_property
    def _within_limits(self) -> PredictedYield:
        """Fraction of lenses that meet every predicted limit."""
        margins = np.stack([limit.merit.margin(limit.scores[: self.draws]) for limit in self.limits], axis=1)
        errors = np.array([limit.error for limit in self.limits])
        fraction, fewer, more = (
            float(np.mean(np.all(margins >= least, axis=1)))
            for least in (np.zeros_like(errors), errors, -errors)
        )
        low, high = wilson(fraction, self.draws)
        return PredictedYield(
            fraction,
            max(fraction - math.hypot(fraction - low, fraction - fewer), 0.0),
            min(fraction + math.hypot(high - fraction, more - fraction), 1.0),
            self.draws,
            max(fraction - fewer, more - fraction),
        )


def is_scored_at_once(merit: Merit) -> bool:
    """Return whether all drawn lenses are scored at once, from derivatives of wavefronts or rays."""
    return is_predicted_wavefront(merit) or is_predicted_ray_merit(merit)


def is_predicted(merit: Merit) -> bool:
    """Return whether drawn lenses are scored without trials, at once or draw by draw."""
    return is_scored_at_once(merit) or is_scored_by_draw(merit)


def predict_study(
    lens: Lens | FilePath,
    study: Study | LoadedStudy | FilePath,
    batch: PerturbationBatch | None = None,
    *,
    quick: bool = False,
    proceed: Callable[[], None] = lambda: None,
) -> StudyPrediction:
    """Predict the yield of a study, jointly over all limits and limit by limit, without trials.

    Parameters
    ----------
    lens
        The study's lens, or the path of its design file.
    study
        The study with perturbations and limits, or the path of its file.
    batch
        The drawn lenses, for callers that predict many lenses; default: 8192 Sobol draws of the study
        (:func:`tolerancing.prediction.wavefront_prediction.drawn_batch`). Merits of pupils and losses of
        reconstructions use the first 256 of them.
    quick
        Whether to use the first order only, without traced draws as a check, in about a third of the time.
        Merits that are scored draw by draw are then not predicted.
    proceed
        Function that is called between blocks of draws; it may raise an exception to end the prediction.

    Raises
    ------
    InputError
        If none of the study's merits can be predicted.
    DesignError
        If rays from a field point do not pass.
    """
    lens, study = lens_and_study(lens, study)
    batch = drawn_batch(study) if batch is None else batch
    by_draw: list[Merit] = []
    if not quick:
        study = with_decided_levels(lens, study)
        by_draw = [m for m in study.merits if is_scored_by_draw(m) and not is_scored_at_once(m)]
    waves, found = None, dict[str, LimitPrediction]()
    # Tolerances that are too large give numbers that are not finite, which raise an error below.
    with np.errstate(all="ignore"):
        if any(is_predicted_wavefront(merit) for merit in study.merits):
            waves = predict(lens, study, batch=batch, second=not quick)
        rays = predict_rays(lens, study, batch, checked=not quick)
        if by_draw:
            drawn = scores_by_draw(lens, study, by_draw, batch.subset(slice(0, SCORED_DRAWS)), proceed)
            for k, merit in enumerate(by_draw):
                found[merit.label] = LimitPrediction(merit, drawn.scores[:, k], float(drawn.errors[k]))
    _refuse_not_finite(waves, rays)
    if waves is not None:
        found |= _wavefront_limits(lens, study, waves, batch, checked=not quick)
    found |= {ray.merit.label: LimitPrediction(ray.merit, ray.scores, ray.error) for ray in rays}
    labels = [merit.label for merit in study.merits]
    missing = tuple(label for label in labels if label not in found)
    if not found:
        raise InputError(
            f"no merit of the study can be predicted without trials ({', '.join(missing)}): add one of kind "
            "rms_waves, strehl, line_pair_contrast, reconstruction_loss, largest_spread_deg or "
            "footprint_radius_mm, or run the study"
        )
    return StudyPrediction(tuple(found[label] for label in labels if label in found), missing, waves, rays)


def _wavefront_limits(
    lens: Lens, study: Study, waves: WavefrontPrediction, batch: PerturbationBatch, checked: bool
) -> dict[str, LimitPrediction]:
    """Return the limits on wavefronts by label; Strehl ratios are exp(-(2 pi rms)^2), as Maréchal has it."""
    columns, found = iter(range(len(waves.points))), dict[str, LimitPrediction]()
    for merit in study.merits:
        if not is_predicted_wavefront(merit):
            continue
        own = [next(columns) for _ in merit.points]
        scores = np.max([waves.points[k].rms_of_draws for k in own], axis=0)
        traced = np.max(waves.traced_rms_waves[:, own], axis=1)
        if not isinstance(merit, RmsWaves):
            scores = np.exp(-((2.0 * np.pi * scores) ** 2))
            if checked:
                part = batch.subset(slice(0, TRACED_DRAWS))
                traced = score_batch([merit], traced_context(lens, study), part)[0][:, 0]
        error = measured_error(scores[: len(traced)], traced) if checked else 0.0
        found[merit.label] = LimitPrediction(merit, scores, error)
    return found


def _refuse_not_finite(waves: WavefrontPrediction | None, rays: tuple[RayPrediction, ...]) -> None:
    """Raise an error for a prediction that is not a number, which would give a wrong yield."""
    points = () if waves is None else waves.points
    wrong = [f"the wavefront at {p.judged.field_mm} mm" for p in points if not math.isfinite(p.rms_waves)]
    wrong += [r.merit.label for r in rays if not math.isfinite(r.mean + r.deviation)]
    if wrong:
        raise InputError(
            f"no finite prediction for {', '.join(wrong)}: a tolerance of the study is too large or too "
            "small to compute with"
        )
