"""Scores of perturbed lenses by merits; failures become messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence

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
    """Score a batch by all merits; the failure of one trial does not affect the others.

    Returns
    -------
    scores : ndarray, shape (trials, merits)
        Scores; NaN if missing.
    messages : tuple of str
        Reason for missing scores of each trial; empty if none is missing.
    """
    try:
        scores = np.column_stack([merit.scores(context, batch) for merit in merits])
    except Exception:
        if len(batch) == 1:
            return _score_singly(merits, context, batch)
        results = [score_batch(merits, context, single) for single in batch.single_trials()]
        return np.concatenate([own for own, _ in results]), tuple(messages[0] for _, messages in results)
    messages = [""] * len(scores)
    for trial in np.flatnonzero(np.any(np.isnan(scores), axis=1)):
        messages[trial] = _missing(merits, scores[trial])
    return scores, tuple(messages)


def _score_singly(
    merits: Sequence[Merit], context: Context, batch: PerturbationBatch
) -> tuple[Array, tuple[str, ...]]:
    """Score one trial merit by merit, so that a failing merit does not affect the others."""
    scores, faults = np.full((1, len(merits)), np.nan), []
    for k, merit in enumerate(merits):
        try:
            scores[0, k] = merit.scores(context, batch)[0]
        except Exception as error:
            faults.append(f"{merit.label}: {fault_text(error)}")
    return scores, ("; ".join(dict.fromkeys(faults)) or _missing(merits, scores[0]),)


def values_or_nan(
    compute: Callable[[PerturbationBatch], Array],
    batch: PerturbationBatch,
    shape: tuple[int, ...] = (),
    failure: type[Exception] = TransferLensError,
) -> Array:
    """Return values of shape `(trials, *shape)`, trial by trial if the batch fails; NaN for failed trials."""
    try:
        return np.asarray(compute(batch), float)
    except failure:
        if len(batch) == 1:
            return np.full((1, *shape), np.nan)
        singly = [values_or_nan(compute, one, shape, failure) for one in batch.single_trials()]
        return np.concatenate(singly)


def fault_text(error: Exception) -> str:
    """Return the message of an error in printable characters."""
    return visible(str(error) if isinstance(error, TransferLensError) else f"{type(error).__name__}: {error}")


def _missing(merits: Sequence[Merit], scores: Array) -> str:
    missing = [merit.label for merit, score in zip(merits, scores, strict=True) if np.isnan(score)]
    return f"{', '.join(missing)}: no ray arrives" if missing else ""
