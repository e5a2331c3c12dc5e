"""The predicted yield of a study, as optimizer, commands, drawings, reports and workbench use it.

A lens is good if it meets every limit of its study. Limits on wavefronts and on rays are predicted for the
same drawn lenses, so that the joint yield includes their correlation. Merits of other kinds need trials. They
are listed, and the predicted yield covers the other limits only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.given import FilePath
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.prediction.ray_prediction import RayPrediction, is_predicted_ray_merit, predict_rays
from tolerancing.prediction.system import amounts_of
from tolerancing.prediction.wavefront_prediction import (
    WavefrontPrediction,
    drawn_batch,
    is_predicted_wavefront,
    predict,
)
from tolerancing.study.files import LoadedStudy, lens_and_study
from tolerancing.study.study import Study


@dataclass(frozen=True, eq=False)
class LimitPrediction:
    """Prediction for one limit of a study.

    Attributes
    ----------
    merit : Merit
        The merit with the limit.
    passed : ndarray of bool, shape (draws,)
        True for drawn lenses that meet the limit at all of its field points.
    """

    merit: Merit
    passed: NDArray[np.bool_]

    @property
    def yield_fraction(self) -> float:
        """Fraction of lenses that meet this limit."""
        return float(np.mean(self.passed))


@dataclass(frozen=True, eq=False)
class StudyPrediction:
    """Prediction of a study's lens as built.

    Attributes
    ----------
    limits : tuple of LimitPrediction
        The limits that are predicted, in the order of the study.
    not_predicted : tuple of str
        Labels of the merits that only trials can score. Their limits are not part of the yield.
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
    def passed(self) -> NDArray[np.bool_]:
        """True for drawn lenses that meet every predicted limit, shape (draws,)."""
        return np.all([limit.passed for limit in self.limits], axis=0)

    @property
    def yield_fraction(self) -> float:
        """Fraction of lenses that meet every predicted limit."""
        return float(np.mean(self.passed))

    @property
    def draws(self) -> int:
        """Number of drawn lenses."""
        return len(self.limits[0].passed)

    @property
    def is_trustworthy(self) -> bool:
        """True if the estimate of the neglected orders is small."""
        waves = self.wavefronts is None or self.wavefronts.second_order_suffices
        return waves and all(ray.first_order_suffices for ray in self.rays)


def is_predicted(merit: Merit) -> bool:
    """Return whether the limit of a merit is predicted without trials."""
    return is_predicted_wavefront(merit) or is_predicted_ray_merit(merit)


def predict_study(
    lens: Lens | FilePath,
    study: Study | LoadedStudy | FilePath,
    batch: PerturbationBatch | None = None,
    *,
    quick: bool = False,
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
        (:func:`tolerancing.prediction.wavefront_prediction.drawn_batch`).
    quick
        Whether to use the first order only, without traced draws as a check, in about a third of the time.

    Raises
    ------
    InputError
        If none of the study's merits can be predicted.
    DesignError
        If rays from a field point do not pass.
    """
    lens, study = lens_and_study(lens, study)
    batch = drawn_batch(study) if batch is None else batch
    waves = None
    # Tolerances that are too large give numbers that are not finite, which raise an error below.
    with np.errstate(all="ignore"):
        if any(is_predicted_wavefront(merit) for merit in study.merits):
            waves = predict(lens, study, amounts=amounts_of(batch), second=not quick)
        rays = predict_rays(lens, study, batch, checked=not quick)
    limits, not_predicted = list[LimitPrediction](), list[str]()
    points = iter(() if waves is None else waves.points)
    by_merit = {ray.merit.label: ray for ray in rays}
    for merit in study.merits:
        if is_predicted_wavefront(merit):
            own = [next(points).passed for _ in merit.points]
            limits.append(LimitPrediction(merit, np.all(own, axis=0)))
        elif merit.label in by_merit:
            limits.append(LimitPrediction(merit, by_merit[merit.label].passed))
        else:
            not_predicted.append(merit.label)
    if not limits:
        raise InputError(
            f"no merit of the study can be predicted without trials ({', '.join(not_predicted)}): add one of "
            "kind rms_waves, strehl, largest_spread_deg or footprint_radius_mm, or run the study"
        )
    _refuse_not_finite(waves, rays)
    return StudyPrediction(tuple(limits), tuple(not_predicted), waves, rays)


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
