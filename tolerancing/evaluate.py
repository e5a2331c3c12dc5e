"""Scores of trials and of sweep steps: what a worker does, with failures as data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import TransferLensError
from tolerancing.context import Context
from tolerancing.merit import Merit
from tolerancing.perturbations import PerturbationBatch, realise
from tolerancing.pupil_merits import Axis
from tolerancing.results import Picture, StepResults, TrialResults
from tolerancing.study import Study
from tolerancing.sweep import Sweep

Array = NDArray[np.float64]

PICTURE_POINTS = 121


def score_trials(context: Context, study: Study, trials: Sequence[int]) -> TrialResults:
    """Draw and score some trials of a study; one that fails says why and spoils no other."""
    batch = realise(study.perturbations, study.seed, trials, study.pivot_z_mm)
    scores, messages = score_batch(study.merits, context, batch)
    kept = [merit.passed(scores[:, k]) for k, merit in enumerate(study.merits)]
    return TrialResults(tuple(trials), batch.values, scores, messages, np.all(kept, axis=0))


def score_step(context: Context, study: Study, sweep: Sweep, step: int) -> StepResults:
    """Score one value of a sweep, and draw its pictures if it asks for them."""
    value = sweep.values[step]
    batch = PerturbationBatch((sweep,), np.array([[value]]), study.pivot_z_mm)
    merits = study.sweep_merits(sweep)
    scores, (message,) = score_batch(merits, context, batch)
    pictures: tuple[Picture, ...] = ()
    if value in sweep.picture_values and not message:
        pictures = _pictures(context, sweep, batch)
    by_label = {merit.label: float(score) for merit, score in zip(merits, scores[0], strict=True)}
    return StepResults(sweep.label, step, value, by_label, message, pictures)


def nominal_scores(context: Context, study: Study) -> dict[str, float]:
    """Scores of the nominal lens, by merit.

    Raises
    ------
    TransferLensError
        If the nominal lens itself cannot be scored.
    """
    batch = PerturbationBatch(study.perturbations, np.zeros((1, len(study.perturbations))), study.pivot_z_mm)
    merits = {m.label: m for m in study.merits}
    merits |= {m.label: m for sweep in study.sweeps for m in sweep.line_pairs()}
    scores = {label: float(merit.scores(context, batch)[0]) for label, merit in merits.items()}
    return {merit.label: scores[merit.label] for merit in study.merits}


def score_batch(
    merits: Sequence[Merit], context: Context, batch: PerturbationBatch
) -> tuple[Array, tuple[str, ...]]:
    """Scores, shape (trials, merits), and for each trial why a score is missing.

    Whatever goes wrong with one trial of the batch, the others are scored.
    """
    try:
        scores = np.column_stack([merit.scores(context, batch) for merit in merits])
    except Exception:
        if len(batch) == 1:
            return _score_singly(merits, context, batch)
        parts = [score_batch(merits, context, single) for single in batch.single_trials()]
        return np.concatenate([part[0] for part in parts]), tuple(part[1][0] for part in parts)
    return scores, tuple(_missing(merits, row) for row in scores)


def _score_singly(
    merits: Sequence[Merit], context: Context, batch: PerturbationBatch
) -> tuple[Array, tuple[str, ...]]:
    """Score what can be scored of one trial, merit by merit."""
    scores, faults = np.full((1, len(merits)), np.nan), []
    for k, merit in enumerate(merits):
        try:
            scores[0, k] = merit.scores(context, batch)[0]
        except TransferLensError as error:
            faults.append(f"{merit.label}: {error}")
        except Exception as error:
            faults.append(f"{merit.label}: {type(error).__name__}: {error}")
    return scores, ("; ".join(dict.fromkeys(faults)) or _missing(merits, scores[0]),)


def _missing(merits: Sequence[Merit], scores: Array) -> str:
    lost = [merit.label for merit, score in zip(merits, scores, strict=True) if not np.isfinite(score)]
    return f"{', '.join(lost)}: no ray arrives" if lost else ""


def _pictures(context: Context, sweep: Sweep, batch: PerturbationBatch) -> tuple[Picture, ...]:
    from wavesim import line_pair_contrast, line_pair_image

    axes: tuple[Axis, ...] = ("x", "y") if sweep.orientation == "worse" else (sweep.orientation,)
    pictures = []
    for merit in sweep.line_pairs():
        (pupil,) = context.pupils(batch, sweep.field_mm, merit.wavelength_um, merit.refocus)
        contrast = {axis: line_pair_contrast(pupil, merit.line_width_um, axis) for axis in axes}
        axis = min(axes, key=contrast.__getitem__)
        coordinates, intensity = line_pair_image(pupil, merit.line_width_um, axis, points=PICTURE_POINTS)
        pictures.append(
            Picture(
                line_width_um=merit.line_width_um,
                orientation=axis,
                refocused=merit.refocus,
                half_width_um=float(coordinates[-1]),
                intensity=intensity.astype(np.float32),
            )
        )
    return tuple(pictures)
