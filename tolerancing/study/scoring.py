"""Scores of perturbed lenses by merits, with failures as data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.text import visible
from lensdesign.errors import TransferLensError
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.perturbations.batch import PerturbationBatch


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
    why = [""] * len(scores)
    for trial in np.flatnonzero(np.any(np.isnan(scores), axis=1)):
        why[trial] = _missing(merits, scores[trial])
    return scores, tuple(why)


def _score_singly(
    merits: Sequence[Merit], context: Context, batch: PerturbationBatch
) -> tuple[Array, tuple[str, ...]]:
    """Score what can be scored of one trial, merit by merit."""
    scores, faults = np.full((1, len(merits)), np.nan), []
    for k, merit in enumerate(merits):
        try:
            scores[0, k] = merit.scores(context, batch)[0]
        except Exception as error:
            faults.append(f"{merit.label}: {fault_text(error)}")
    return scores, ("; ".join(dict.fromkeys(faults)) or _missing(merits, scores[0]),)


def fault_text(error: Exception) -> str:
    """What went wrong in a merit, in printable characters."""
    return visible(str(error) if isinstance(error, TransferLensError) else f"{type(error).__name__}: {error}")


def _missing(merits: Sequence[Merit], scores: Array) -> str:
    lost = [merit.label for merit, score in zip(merits, scores, strict=True) if np.isnan(score)]
    return f"{', '.join(lost)}: no ray arrives" if lost else ""
