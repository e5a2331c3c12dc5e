"""Results of trials and steps, which workers return and a store saves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array

OK = "ok"
FAILED = "failed"

WORST, RANDOM = "worst", "random"
"""Reasons why a trial was selected for the high-fidelity merits."""


@dataclass(frozen=True)
class TrialResults:
    """Values and scores of trials, one row for each trial.

    Attributes
    ----------
    trials : tuple of int, or ndarray of int
        Numbers of the trials, from 0.
    values : ndarray, shape (trials, perturbations)
        Sampled deltas, in the units of the perturbations' columns.
    scores : ndarray, shape (trials, merits)
        Scores; NaN if a trial could not be scored.
    extras : ndarray, shape (trials, extra columns)
        Values of :attr:`tolerancing.study.study.Study.extra_columns`: scores without compensation, and values
        of the compensators; NaN if missing.
    messages : tuple of str
        Reasons why trials could not be scored; empty for scored trials.
    passed : ndarray of bool, shape (trials,)
        True if all limits are met; False for trials that could not be scored.
    seconds : ndarray, shape (trials,)
        Computing time of each trial, including its fraction of common work.
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
        """`OK` or `FAILED` for each trial."""
        return [FAILED if message else OK for message in self.messages]


@dataclass(frozen=True)
class HighFidelityResults:
    """Scores of the high-fidelity merits for selected trials.

    Attributes
    ----------
    trials : tuple of int
        Numbers of the trials.
    chosen : tuple of str
        Reason for the selection of each trial: `WORST` by the low-fidelity merit, or a `RANDOM` draw.
    scores : ndarray, shape (trials, high-fidelity merits)
        Scores; NaN if a trial could not be scored.
    messages : tuple of str
        Reasons why trials could not be scored; empty for scored trials.
    seconds : ndarray, shape (trials,)
        Computing time of each trial.
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
    """Image of a reconstructed line pair target.

    Attributes
    ----------
    line_width_um
        Width of a bar and of a gap.
    orientation
        Axis along which the bars repeat, x or y.
    refocused
        Whether the reconstruction was refocused.
    half_width_um
        Half the side of the square image.
    intensity : ndarray of float32, shape (points, points)
        Intensity relative to a large bright area; rows along y, columns along x.
    """

    line_width_um: float
    orientation: str
    refocused: bool
    half_width_um: float
    intensity: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class StepResults:
    """Scores of one step of a series: a sweep, a grid, a comparison of slice counts, or the sensitivities.

    Attributes
    ----------
    series
        Label of the series.
    step
        Number of the step, from 0.
    coordinates : mapping of str to float or str
        Values of the varied parameters, by name.
    scores : mapping of str to float
        Scores by label of the merit; NaN if missing.
    message
        Reason why a score is missing; empty if none is.
    pictures : tuple of Picture
        Images of line pairs, if the study requests them.
    seconds
        Computing time.
    """

    series: str
    step: int
    coordinates: Mapping[str, float | str]
    scores: dict[str, float]
    message: str
    pictures: tuple[Picture, ...]
    seconds: float


Results = TrialResults | HighFidelityResults | StepResults
