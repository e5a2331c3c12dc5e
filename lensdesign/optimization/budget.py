"""What a search may cost: evaluations, which do not depend on the machine, and time where it is asked for."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass


@dataclass
class Budget:
    """What is left for one choice of glasses; it shrinks as the search spends it.

    Attributes
    ----------
    evaluations
        Evaluations of a lens that are left.
    deadline
        Of :func:`time.monotonic`.
    spent
        Evaluations that were made.
    """

    evaluations: int
    deadline: float = math.inf
    spent: int = 0

    def spend(self, evaluations: int) -> None:
        """Take some off."""
        self.evaluations -= evaluations
        self.spent += evaluations

    @property
    def seconds(self) -> float:
        """Time that is left."""
        return self.deadline - time.monotonic()

    @property
    def used_up(self) -> str:
        """The limit that has been reached, by its name in a specification; empty where none has."""
        if self.evaluations <= 0:
            return "max_evaluations"
        return "max_seconds" if self.seconds <= 0.0 else ""
