"""Trials and predictions of finished lenses, which searches report at their end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.as_built import AsBuiltPrediction, MeritLoss, MeritYield, TrialsOf
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.draws import replicates
from tolerancing.prediction.reconstruction_loss import mean_loss
from tolerancing.prediction.study_prediction import predict_study
from tolerancing.prediction.wavefront_prediction import WavefrontLimit
from tolerancing.statistics.yields import yield_of
from tolerancing.study.evaluate import context_of, decide_levels, sample_perturbations
from tolerancing.study.scoring import score_batch, values_or_nan
from tolerancing.study.study import Study


def predicted_of(lens: Lens, study: Study) -> AsBuiltPrediction:
    """Predict the yields and wavefronts of a lens.

    Raises
    ------
    DesignError
        If rays from a field point do not pass.
    """
    found = predict_study(lens, study)
    points = () if found.wavefronts is None else found.wavefronts.points
    return AsBuiltPrediction(
        tuple(point.rms_waves for point in points),
        math.nan if found.yield_fraction is None else found.yield_fraction,
        {limit.merit.label: limit.yield_fraction for limit in found.limits},
        found.within_wavefronts_and_rays,
    )


def trials_of(
    name: str, lens: Lens, study: Study, judged: Sequence[WavefrontLimit], predicted: AsBuiltPrediction
) -> TrialsOf:
    """Score all trials of a study for a lens, as a run of the study does.

    Parameters
    ----------
    name
        Name of the lens.
    lens, study
        The lens and its study.
    judged
        Object points at which the root mean square of the wavefront is evaluated.
    predicted
        Prediction of the lens. It uses the draws of the study itself, also if the trials have another seed.

    Raises
    ------
    TransferLensError
        If the lens cannot be scored.
    """
    study = study.with_levels(decide_levels(lens, study))
    context = context_of(lens, study)
    size = min(merit.trials_per_chunk for merit in study.merits)
    scores, squares = [], []
    for start in range(0, study.trials, size):
        batch = sample_perturbations(study, range(start, min(start + size, study.trials)))
        found, messages = score_batch(study.merits, context, batch)
        scores.append(found)
        squares.append(_mean_squares(context, batch, judged))
        if start == 0 and all(messages):
            raise InputError(f"{name or 'the lens'}: no trial can be scored: {messages[0]}")
    scored = np.concatenate(scores)
    summary = _summary(name, study, scored, np.concatenate(squares), predicted)
    return replace(summary, losses=_losses(lens, study, scored))


def _losses(lens: Lens, study: Study, scores: Array) -> tuple[MeritLoss, ...]:
    """Return mean reconstruction losses; a trial without a score counts as a loss of 1."""
    found = []
    for k, merit in enumerate(study.merits):
        if isinstance(merit, ReconstructionLoss):
            own = np.where(np.isfinite(scores[:, k]), scores[:, k], 1.0)
            error = float(np.std(own) / np.sqrt(len(own)))
            words = ", ".join(merit.details)
            predicted = mean_loss(lens, study, merit)
            calibrated = bool(study.compensators)
            found.append(MeritLoss(merit.label, words, calibrated, float(np.mean(own)), error, predicted))
    return tuple(found)


def _summary(
    name: str, study: Study, scores: Array, squares: Array, predicted: AsBuiltPrediction
) -> TrialsOf:
    replicate = replicates(study.draws, range(study.trials))
    passed = [merit.passed(scores[:, k]) for k, merit in enumerate(study.merits)]
    good = yield_of(np.all(passed, axis=0), replicate)
    assert good is not None  # there are trials
    rows = tuple(
        _merit_yield(merit, passed[k], replicate, predicted.merits.get(merit.label))
        for k, merit in enumerate(study.merits)
    )
    scored = np.sum(np.isfinite(squares), axis=0)
    rms = np.sqrt(np.nanmean(squares, axis=0)) if len(squares.T) else np.zeros(0)
    errors = np.nanstd(squares, axis=0) / np.sqrt(scored) / (2.0 * rms) if len(squares.T) else rms
    return TrialsOf(
        name,
        study.trials,
        tuple(rms.tolist()),
        tuple(errors.tolist()),
        predicted.rms_waves,
        good.fraction,
        good.low,
        good.high,
        None if math.isnan(predicted.good) else predicted.good,
        rows,
    )


def _merit_yield(
    merit: Merit, passed: NDArray[np.bool_], replicate: NDArray[np.int64] | None, predicted: float | None
) -> MeritYield:
    found = yield_of(passed, replicate)
    assert found is not None  # there are trials
    return MeritYield(
        merit.label,
        merit.limit_text,
        ", ".join(merit.details),
        found.fraction,
        found.low,
        found.high,
        predicted,
    )


def _mean_squares(context: Context, batch: PerturbationBatch, judged: Sequence[WavefrontLimit]) -> Array:
    """Return mean squares of the refocused path difference, (trials, points); NaN for a missing pupil."""

    def squares(point: WavefrontLimit, batch: PerturbationBatch) -> Array:
        pupils = context.pupils(batch, point.field_mm, point.wavelength_um, True, True)
        return np.array([np.mean(pupil.opd_waves[pupil.valid] ** 2) for pupil in pupils])

    found = [values_or_nan(partial(squares, point), batch) for point in judged]
    return np.column_stack(found) if found else np.empty((len(batch), 0))
