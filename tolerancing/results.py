"""What a run hands from its workers to its store."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OK = "ok"
FAILED = "failed"


@dataclass(frozen=True)
class TrialResults:
    """Trials, row by row.

    Attributes
    ----------
    trials : tuple of int
        Numbers of the trials, from 0.
    values : ndarray, shape (trials, perturbations)
        Realised deltas, in the units of the perturbations' columns.
    scores : ndarray, shape (trials, merits)
        NaN where a trial could not be scored.
    messages : tuple of str
        Why a trial could not be scored; empty where it could.
    passed : ndarray of bool, shape (trials,)
        Whether all limits are kept; a trial that could not be scored keeps none.
    """

    trials: tuple[int, ...]
    values: Array
    scores: Array
    messages: tuple[str, ...]
    passed: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.trials)

    @property
    def status(self) -> list[str]:
        """`OK` or `FAILED`, trial by trial."""
        return [FAILED if message else OK for message in self.messages]


@dataclass(frozen=True, eq=False)
class Picture:
    """A reconstructed line pair target.

    Attributes
    ----------
    line_width_um
        Width of a bar and of a gap.
    orientation
        Axis along which the bars follow each other, x or y.
    refocused
        Whether the reconstruction was refocused.
    half_width_um
        Half the side of the square picture.
    intensity : ndarray of float32, shape (points, points)
        Row: y, column: x; 1 is that of a large bright area.
    """

    line_width_um: float
    orientation: str
    refocused: bool
    half_width_um: float
    intensity: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class StepResults:
    """One step of a sweep: scores by merit (NaN where there is none), and pictures."""

    sweep: str
    step: int
    value: float
    scores: dict[str, float]
    message: str
    pictures: tuple[Picture, ...]


Results = TrialResults | StepResults
