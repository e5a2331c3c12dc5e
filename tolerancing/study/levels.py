"""Levels of ``auto`` merits: the cheapest that a few trials show to agree with the dearest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.study.evaluate import context_of, realise
from tolerancing.study.study import Study

PROBED_TRIALS = 6
"""Trials that all levels score."""


def decide_levels(lens: Lens, study: Study) -> dict[str, str]:
    """The level of each merit, by its label; ``auto`` where there is a choice is settled by trials 0 to 5.

    Where a level cannot score one of those trials, the dearest is taken.

    Parameters
    ----------
    lens, study
        What is to be run.
    """
    context = context_of(lens, study)
    return {merit.label: _level(merit, context, study) for merit in study.all_merits}


def with_levels(study: Study, levels: Mapping[str, str]) -> Study:
    """The study with its merits' levels settled."""
    merits = tuple(
        merit.model_copy(update={"level": levels.get(merit.label, merit.used_level)})
        for merit in study.all_merits
    )
    return study.model_copy(update={"all_merits": merits})


def _level(merit: Merit, context: Context, study: Study) -> str:
    able = merit.able_levels()
    if merit.level != "auto" or len(able) == 1:
        return merit.used_level if merit.level != "auto" else able[0]
    batch = realise(study, range(min(PROBED_TRIALS, study.trials)))
    try:
        scores = {level: merit.model_copy(update={"level": level}).scores(context, batch) for level in able}
    except TransferLensError:
        return able[-1]
    for level in able[:-1]:
        if np.all(np.abs(scores[level] - scores[able[-1]]) <= study.fidelity.largest_difference):
            return level
    return able[-1]
