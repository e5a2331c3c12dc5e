"""Which trials the dear merits score: the worst by a cheap merit, and some drawn from the others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from tolerancing.analysis.control_variates import Chosen
    from tolerancing.merits.base import Merit
    from tolerancing.study.study import Study


def predictor(study: Study) -> Merit:
    """The cheap merit that trials are chosen by: that of the study's first dear merit."""
    label = study.dear_merits[0].predicted_by
    return next(merit for merit in study.merits if merit.label == label)


def dear_counts(study: Study, trials: int) -> tuple[int, int]:
    """How many of the worst and of the other trials the study's `fidelity` chooses.

    A share above 0 is at least one trial, as long as there are trials.
    """
    if not study.dear_merits:
        return 0, 0
    shares = study.fidelity.worst_share, study.fidelity.random_share
    worst, random = (max(round(share * trials), 1) if share > 0.0 else 0 for share in shares)
    worst = min(worst, trials)
    return worst, min(random, trials - worst)


def chosen_trials(study: Study, cheap_scores: ArrayLike) -> Chosen:
    """The trials to choose, which follow from the study and the scores alone.

    Parameters
    ----------
    study
        With at least one dear merit.
    cheap_scores : array_like, shape (trials,)
        Of all trials, by :func:`predictor`; NaN where there is none.
    """
    from tolerancing.analysis.control_variates import choose_trials

    margin = predictor(study).margin(cheap_scores)
    return choose_trials(margin, study.seed, *dear_counts(study, len(margin)))
