"""When a search must end, and what still fits in: trials of lenses as built, and the check of the result."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from lensdesign.common.deadlines import now
from lensdesign.optimization.as_built import AsBuiltReport
from lensdesign.optimization.specification.specification import Specification

CHECK_SHARE, TRIALS_SHARE = 0.05, 0.4
"""Fractions of a time limit: kept for the check of the result; most that is kept for trials."""

SAMPLED_TRIALS = 20
"""Trials by which the time of all trials is estimated."""


@dataclass
class Ending:
    """When a search must end, and what remains possible then.

    Attributes
    ----------
    began, end
        By :func:`lensdesign.common.deadlines.now`; `end` is infinite without a time limit.
    interrupted
        Whether the user stopped the search: the result is then checked, and nothing else.
    seed, report
        As :func:`lensdesign.optimization.search.optimize` has them.
    trial_seconds
        Estimated time of the trials of lenses as built.
    built
        Trials that were made.
    """

    began: float
    end: float = math.inf
    interrupted: bool = False
    seed: int = 0
    report: Callable[[str], None] | None = None
    trial_seconds: float = 0.0
    built: AsBuiltReport | None = None

    def plan_trials(self, specification: Specification) -> float:
        """Return when starts must end, so that trials, where there is room for them, and the check fit in."""
        if self.end == math.inf:
            return math.inf
        seconds, study, tolerances = self.end - self.began, specification.as_built, specification.tolerances
        if study is not None and tolerances is not None:
            lenses = 2 + (specification.optimize.start == "design") + len(_temperatures(specification))
            study.trials([("", study.reference)], 1)  # compiles what there is to compile
            before = now()
            study.trials([("", study.reference)], SAMPLED_TRIALS)
            self.trial_seconds = (now() - before) * tolerances.trials * lenses / SAMPLED_TRIALS
        kept = self.trial_seconds if self.trial_seconds <= TRIALS_SHARE * seconds else 0.0
        return self.end - CHECK_SHARE * seconds - kept

    @property
    def no_trials(self) -> bool:
        """Whether no time is left for trials."""
        return self.interrupted or now() + self.trial_seconds > self.end

    @property
    def reason(self) -> str:
        """What leaves no time."""
        return "the interrupt" if self.interrupted else f"max_seconds = {self.end - self.began:g}"


def _temperatures(specification: Specification) -> tuple[float, ...]:
    return () if specification.environment is None else specification.environment.temperatures_c
