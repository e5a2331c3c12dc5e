"""End of a search: division of the time among starts, trials of lenses as built and the final check."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from lensdesign.common.deadlines import now
from lensdesign.optimization.as_built import AsBuiltReport
from lensdesign.optimization.specification.specification import Specification

CHECK_FRACTION, TRIALS_FRACTION = 0.05, 0.4
"""Fractions of a time limit that are reserved for the final check, and at most for trials."""


@dataclass
class Ending:
    """State of the end of a search.

    Attributes
    ----------
    began, end
        Start and end of the search on the clock of :func:`lensdesign.common.deadlines.now`; `end` is infinite
        without a time limit.
    interrupted
        Whether the user has stopped the search. The result is then only checked.
    seed, report
        Seed and progress callback of :func:`lensdesign.optimization.search.optimize`.
    trial_seconds
        Estimated time of the trials of lenses as built.
    built
        Completed trials; None if there are none.
    """

    began: float
    end: float = math.inf
    interrupted: bool = False
    seed: int = 0
    report: Callable[[str], None] | None = None
    trial_seconds: float = 0.0
    built: AsBuiltReport | None = None

    def plan_trials(self, specification: Specification) -> float:
        """Return the time at which starts must end, so that the check and, if possible, the trials fit in."""
        if self.end == math.inf:
            return math.inf
        seconds, study, tolerances = self.end - self.began, specification.as_built, specification.tolerances
        if study is not None and tolerances is not None:
            lenses = 2 + (specification.optimize.start == "design") + len(_temperatures(specification))
            study.trials([("", study.reference)], 1)  # compiles the kernels first
            before = now()
            # Number of trials by which the time of all trials is estimated.
            sampled_trials = 20
            study.trials([("", study.reference)], sampled_trials)
            self.trial_seconds = (now() - before) * tolerances.trials * lenses / sampled_trials
        kept = self.trial_seconds if self.trial_seconds <= TRIALS_FRACTION * seconds else 0.0
        return self.end - CHECK_FRACTION * seconds - kept

    @property
    def no_trials(self) -> bool:
        """True if no time is left for trials."""
        return self.interrupted or now() + self.trial_seconds > self.end

    @property
    def reason(self) -> str:
        """Reason why no time is left."""
        return "the interrupt" if self.interrupted else f"max_seconds = {self.end - self.began:g}"


def _temperatures(specification: Specification) -> tuple[float, ...]:
    return () if specification.environment is None else specification.environment.temperatures_c
