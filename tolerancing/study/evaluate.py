"""Scores of trials and of steps: what a worker does; and the level of each merit, settled beforehand."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.memory import check_memory
from lensdesign.errors import InputError, TransferLensError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, all_passed
from tolerancing.merits.context import Context
from tolerancing.perturbations.batch import PerturbationBatch, batch_of
from tolerancing.perturbations.draws import probabilities
from tolerancing.study.results import HighFidelityResults, StepResults, TrialResults
from tolerancing.study.scoring import fault_text, score_batch
from tolerancing.study.series import LinePairSection
from tolerancing.study.study import Study

TRIAL_COPIES = 6
"""How many arrays of all trials exist at the same time while they are drawn."""

PROBED_TRIALS = 6
"""Trials that all levels of an ``auto`` merit score."""


def context_of(lens: Lens, study: Study) -> Context:
    """What the merits of a study share, all of them ready to score.

    Raises
    ------
    InputError
        If one is not; as of :meth:`Merit.get_ready`.
    """
    make_ready(study)
    return pupils_of(lens, study)


def make_ready(study: Study) -> None:
    """Make sure that all merits of a study can score.

    Raises
    ------
    InputError
        If one cannot; as of :meth:`Merit.get_ready`.
    """
    for merit in study.all_merits:
        merit.get_ready()


def pupils_of(lens: Lens, study: Study) -> Context:
    """As :func:`context_of`, for those who look at pupils and score by no merit."""
    points = compensated_points(study)
    return Context(lens, study.sampling, study.compensators, points, study.pivot_z_mm, study.seed)


def compensated_points(study: Study) -> tuple[tuple[tuple[float, float], float | None], ...]:
    """Field points and wavelengths whose pupils together tell compensators their values."""
    points = dict.fromkeys(
        (point, merit.wavelength_um) for merit in study.all_merits for point in merit.pupil_points
    )
    return tuple(points) or (((0.0, 0.0), None),)


def check_trial_memory(study: Study, trials: int) -> None:
    """Refuse a number of trials whose values and scores memory does not hold.

    Raises
    ------
    MemoryLimitError
        With the number and both sizes.
    """
    columns = len(study.perturbations) + len(study.all_merits)
    check_memory(TRIAL_COPIES * 8.0 * trials * columns, f"trials = {trials}", "take fewer trials")


def sample_perturbations(study: Study, trials: Sequence[int]) -> PerturbationBatch:
    """Draw the deltas of given trials.

    A trial's values depend on nothing but the study and its number: on the perturbations, their order, the
    seed, the way of drawing and, but for random draws, the number of trials that the study asks for.

    Parameters
    ----------
    study
        What scatters, and how.
    trials
        Numbers of the trials, from 0.

    Raises
    ------
    MemoryLimitError
        If memory does not hold the values.
    """
    perturbations = study.perturbations
    check_trial_memory(study, len(trials))
    drawn = probabilities(study.draws, study.seed, trials, len(perturbations), study.trials)
    dependent = study.dependence.apply(drawn)
    values = np.column_stack([p.distribution.quantile(dependent[:, k]) for k, p in enumerate(perturbations)])
    return batch_of(perturbations, values, study.pivot_z_mm, study.seed, trials)


def score_trials(context: Context, study: Study, trials: Sequence[int]) -> TrialResults:
    """Draw and score some trials of a study; one that fails says why and spoils no other."""
    start = time.perf_counter()
    batch = sample_perturbations(study, trials)
    scores, messages = score_batch(study.merits, context, batch)
    extras = np.column_stack(
        [_tolerant(merit.uncompensated, context, batch) for merit in study.compensated]
        + ([_compensator_values(context, batch)] if study.compensators else [])
        or [np.empty((len(batch), 0))]
    )
    passed = all_passed(study.merits, scores)
    seconds = np.full(len(batch), (time.perf_counter() - start) / len(batch))
    return TrialResults(tuple(trials), batch.values, scores, extras, messages, passed, seconds)


def score_high_fidelity(
    context: Context, study: Study, trials: Sequence[int], chosen: Sequence[str]
) -> HighFidelityResults:
    """Score some trials by the dear merits."""
    batch = sample_perturbations(study, trials)
    rows = []
    for one in batch.single_trials():
        start = time.perf_counter()
        scores, (message,) = score_batch(study.high_fidelity_merits, context, one)
        rows.append((scores[0], message, time.perf_counter() - start))
    return HighFidelityResults(
        trials=tuple(trials),
        chosen=tuple(chosen),
        scores=np.array([row[0] for row in rows]),
        messages=tuple(row[1] for row in rows),
        seconds=np.array([row[2] for row in rows]),
    )


def score_step(context: Context, study: Study, series: int, step: int) -> StepResults:
    """Score one step of one of a study's series; sweeps and grids may name dear merits too."""
    one = study.series[series]
    return one.score(context, study.all_merits if isinstance(one, LinePairSection) else study.merits, step)


def first_scores(lens: Lens, study: Study) -> tuple[dict[str, str], dict[str, float]]:
    """The level of each merit, and its score of the nominal lens, by its label.

    Raises
    ------
    InputError
        As of :func:`nominal_scores`.
    """
    levels = decide_levels(lens, study)
    settled = study.with_levels(levels)
    return levels, nominal_scores(context_of(lens, settled), settled)


def nominal_scores(context: Context, study: Study) -> dict[str, float]:
    """Scores of the nominal lens, by merit.

    Raises
    ------
    InputError
        If the nominal lens itself cannot be scored, whatever a merit raises.
    """
    batch = context.perturbed(study.perturbations, np.zeros((1, len(study.perturbations))))
    # Line pairs of sweeps and grids are scored for their errors alone: they may share a label with a merit.
    for pairs in dict.fromkeys(
        pairs for part in (*study.sweeps, *study.grids) for pairs in part.line_pairs()
    ):
        _nominal_score(pairs, context, batch)
    return {merit.label: _nominal_score(merit, context, batch) for merit in study.all_merits}


def _nominal_score(merit: Merit, context: Context, batch: PerturbationBatch) -> float:
    try:
        return float(merit.scores(context, batch)[0])
    except Exception as error:
        raise InputError(
            f"merit {merit.label!r} cannot score the nominal lens: {fault_text(error)}; nothing was "
            "run: mend the merit or the design"
        ) from error


def decide_levels(lens: Lens, study: Study) -> dict[str, str]:
    """The level of each merit, by its label; ``auto`` takes the cheapest that agrees with the dearest.

    Trials 0 to 5 tell. Where a level cannot score one of them, the dearest is taken.

    Parameters
    ----------
    lens, study
        What is to be run.
    """
    context = context_of(lens, study)
    return {merit.label: _level(merit, context, study) for merit in study.all_merits}


def _tolerant(score: object, context: Context, batch: PerturbationBatch) -> Array:
    """Scores trial by trial where a batch fails; NaN where a trial does."""
    assert callable(score)
    try:
        return np.asarray(score(context, batch), float)
    except Exception:
        if len(batch) == 1:
            return np.array([np.nan])
        return np.concatenate([_tolerant(score, context, one) for one in batch.single_trials()])


def _compensator_values(context: Context, batch: PerturbationBatch) -> Array:
    try:
        return context.compensator_values(batch)
    except TransferLensError:
        if len(batch) == 1:
            return np.full((1, len(context.compensators)), np.nan)
        return np.concatenate([_compensator_values(context, one) for one in batch.single_trials()])


def _level(merit: Merit, context: Context, study: Study) -> str:
    able = merit.able_levels()
    if merit.level != "auto" or len(able) == 1:
        return merit.used_level if merit.level != "auto" else able[0]
    batch = sample_perturbations(study, range(min(PROBED_TRIALS, study.trials)))
    try:
        scores = {level: merit.model_copy(update={"level": level}).scores(context, batch) for level in able}
    except TransferLensError:
        return able[-1]
    for level in able[:-1]:
        if np.all(np.abs(scores[level] - scores[able[-1]]) <= study.fidelity.largest_difference):
            return level
    return able[-1]
