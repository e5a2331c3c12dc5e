"""What a run hands from its workers to its store."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array

OK = "ok"
FAILED = "failed"

WORST, RANDOM = "worst", "random"
"""Why a trial was chosen for the dear merits."""


@dataclass(frozen=True)
class TrialResults:
    """Trials, row by row.

    Attributes
    ----------
    trials : tuple of int, or ndarray of int
        Numbers of the trials, from 0.
    values : ndarray, shape (trials, perturbations)
        Realised deltas, in the units of the perturbations' columns.
    scores : ndarray, shape (trials, merits)
        NaN where a trial could not be scored.
    extras : ndarray, shape (trials, extra columns)
        By :attr:`tolerancing.study.study.Study.extra_columns`: scores without compensation, and what the
        compensators took. NaN where there is none.
    messages : tuple of str
        Why a trial could not be scored; empty where it could.
    passed : ndarray of bool, shape (trials,)
        Whether all limits are kept; a trial that could not be scored keeps none.
    seconds : ndarray, shape (trials,)
        Time that each took, with its share of what a chunk of trials does together.
    """

    trials: tuple[int, ...] | NDArray[np.int64]
    values: Array
    scores: Array
    extras: Array
    messages: tuple[str, ...]
    passed: NDArray[np.bool_]
    seconds: Array

    def __len__(self) -> int:
        return len(self.trials)

    @property
    def status(self) -> list[str]:
        """`OK` or `FAILED`, trial by trial."""
        return [FAILED if message else OK for message in self.messages]


@dataclass(frozen=True)
class HighFidelityResults:
    """Scores of the dear merits for trials that were chosen.

    Attributes
    ----------
    trials : tuple of int
        Their numbers.
    chosen : tuple of str
        Why each was chosen: `WORST` by the cheap merit, or by `RANDOM` draw.
    scores : ndarray, shape (trials, dear merits)
        NaN where a trial could not be scored.
    messages : tuple of str
        Why it could not.
    seconds : ndarray, shape (trials,)
        Time that each took.
    """

    trials: tuple[int, ...]
    chosen: tuple[str, ...]
    scores: Array
    messages: tuple[str, ...]
    seconds: Array

    def __len__(self) -> int:
        return len(self.trials)


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
    """One step of a series: a sweep, a grid, a comparison of slice counts, or the sensitivities.

    Attributes
    ----------
    series
        Label of the series.
    step
        Number of the step, from 0.
    coordinates : mapping of str to float or str
        What was varied, by name.
    scores : mapping of str to float
        By merit; NaN where there is none.
    message
        Why a score is missing.
    pictures : tuple of Picture
        Of line pairs, where they were asked for.
    seconds
        Time that it took.
    """

    series: str
    step: int
    coordinates: Mapping[str, float | str]
    scores: dict[str, float]
    message: str
    pictures: tuple[Picture, ...]
    seconds: float


Results = TrialResults | HighFidelityResults | StepResults
