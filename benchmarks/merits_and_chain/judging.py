"""What merits say of the same perturbed lenses, and how well it agrees with the chain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import spearmanr

from tolerancing.merits.base import Merit
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Context
from tolerancing.merits.registry import merit_from_table
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.study.scoring import score_batch

Array = np.ndarray[Any, Any]

GOOD = 0.95
"""Correlation of found and true object from which a reconstruction counts as good."""

HALVES, SPLIT_SEED = 200, 5
"""Random halves of the trials: on one a merit's limit is chosen, on the other it is judged."""

FINE_UM, FREQUENCY = 0.8, 600.0

MERITS: dict[str, dict[str, Any]] = {
    "reconstruction_loss": {"at_most": 0.05},
    "rms_waves": {"at_most": 0.1},
    "rms_waves, not refocused": {"kind": "rms_waves", "at_most": 0.1, "refocus": False},
    "strehl": {"at_least": 0.5},
    "line_pair_contrast": {"at_least": 0.5, "line_width_um": FINE_UM, "level": "pupil"},
    "line_pair_contrast, wave": {
        "kind": "line_pair_contrast",
        "at_least": 0.5,
        "line_width_um": FINE_UM,
        "level": "wave",
        "patch_um": 30.0,
    },
    "mtf": {"at_least": 0.5, "frequency_lp_per_mm": FREQUENCY},
    "smallest_resolved_line_um": {"at_most": 1.0},
    "image_shift_um": {"at_most": 1.0},
    "largest_spread_deg": {"at_most": 4.9},
    "footprint_radius_mm": {"at_most": 1.0},
    "throughput": {"at_least": 0.9},
}
"""Every kind of merit but the chain itself; limits do not matter here."""

COMPENSATORS = tuple(
    Compensator(target=target, parameter=parameter, limit=limit)
    for target, parameter, limit in (
        ("lens", "decenter_x_mm", 0.02),
        ("lens", "decenter_y_mm", 0.02),
        ("lens", "tilt_x_deg", 5.0),
        ("lens", "tilt_y_deg", 5.0),
        ("object", "working_distance_mm", 0.02),
    )
)
"""What a calibration of the mounting finds."""


class Agreement(NamedTuple):
    """Of a merit with the chain: Spearman's rank correlation, shares of right verdicts, trials."""

    rank: float
    good: float
    trials: int


def merit_of(name: str, place: Any, kind: str, planes_mm: Sequence[float]) -> Merit:
    """A merit at the middle of a part of the object."""
    table = {"kind": name, "name": "merit"} | MERITS[name]
    if table["kind"] in ("largest_spread_deg", "footprint_radius_mm", "throughput"):
        table["field_points_mm"] = [list(place.middle_mm)]
    else:
        table["field_mm"] = list(place.middle_mm)
    if name == "reconstruction_loss":
        table |= {"patch_mm": place.stop_mm, "object": kind, "planes_mm": list(planes_mm)}
    return merit_from_table(table, "benchmark")


def scores_of(merit: Merit, context: Context, batch: PerturbationBatch) -> Array:
    """Scores of which larger ones are better; without one, a trial is worse than all others."""
    scores = score_batch([merit], context, batch)[0][:, 0]
    sign = 1.0 if merit.at_least is not None else -1.0
    return np.where(np.isfinite(scores), sign * scores, -math.inf)


def with_compensators(context: Context, place: Any) -> Context:
    """The same lens, whose mounting the reconstruction knows."""
    return Context(context.lens, context.sampling, COMPENSATORS, ((place.middle_mm, None),), 0.0, 0)


def agreement(scores: Array, truth: Array) -> Agreement:
    """How a merit's scores, larger ones better, agree with correlations of the chain.

    Parameters
    ----------
    scores, truth
        Of the same trials.
    """
    order = np.argsort(np.argsort(scores)) if np.any(np.isinf(scores)) else scores
    rank = float(spearmanr(order, truth).statistic) if np.ptp(order) > 0.0 else 0.0
    random, count = np.random.default_rng(SPLIT_SEED), len(truth)
    right = []
    for _ in range(HALVES):
        chosen = np.zeros(count, bool)
        chosen[random.permutation(count)[: count // 2]] = True
        limit = _limit(scores[chosen], truth[chosen] >= GOOD)
        right.append(np.mean((scores[~chosen] >= limit) == (truth[~chosen] >= GOOD)))
    return Agreement(rank, float(np.mean(right)), count)


def _limit(scores: Array, good: Array) -> float:
    """The limit with most right verdicts, in the middle between two scores."""
    finite = np.unique(scores[np.isfinite(scores)])
    limits = np.concatenate([[-math.inf], 0.5 * (finite[1:] + finite[:-1]), [math.inf]])
    right = np.mean((scores >= limits[:, None]) == good, axis=1)
    best = np.flatnonzero(right == right.max())
    return float(limits[best[len(best) // 2]])
