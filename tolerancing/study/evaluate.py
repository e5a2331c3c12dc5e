"""Scoring of trials and steps in a worker process, and selection of the level of each merit."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np

from lensdesign.common.memory import check_memory
from lensdesign.errors import InputError, TransferLensError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, all_passed
from tolerancing.merits.context import Context
from tolerancing.perturbations.batch import PerturbationBatch, batch_of
from tolerancing.perturbations.dependence import sample_values
from tolerancing.study.results import HighFidelityResults, StepResults, TrialResults
from tolerancing.study.scoring import fault_text, score_batch, values_or_nan
from tolerancing.study.series import LinePairSection
from tolerancing.study.study import Study


def context_of(lens: Lens, study: Study) -> Context:
    """Check that all merits of a study can score, and return their shared context.

    Parameters
    ----------
    lens
        The nominal lens.
    study
        The study.

    Raises
    ------
    InputError
        If the user code of a merit cannot be run.
    """
    prepare_merits(study)
    return pupil_context(lens, study)


def prepare_merits(study: Study) -> None:
    """Check that all merits of a study can score.

    Raises
    ------
    InputError
        If the user code of a merit cannot be run.
    """
    for merit in study.all_merits:
        merit.prepare()


def pupil_context(lens: Lens, study: Study) -> Context:
    """Return the context of a study for callers that evaluate pupils but no merits."""
    points = compensated_points(study)
    return Context(lens, study.sampling, study.compensators, points, study.pivot_z_mm, study.seed)


def compensated_points(study: Study) -> tuple[tuple[tuple[float, float], float | None], ...]:
    """Return the field points and wavelengths whose pupils determine the values of compensators."""
    points = dict.fromkeys(
        (point, merit.wavelength_um) for merit in study.all_merits for point in merit.pupil_points
    )
    return tuple(points) or (((0.0, 0.0), None),)


def check_trial_memory(study: Study, trials: int) -> None:
    """Check that values and scores of the trials fit into memory.

    Raises
    ------
    MemoryLimitError
        If they do not fit. The message has the number of trials, the needed and the available memory.
    """
    columns = len(study.perturbations) + len(study.all_merits)
    arrays = 6  # arrays of all trials that exist at the same time while trials are drawn
    check_memory(arrays * 8.0 * trials * columns, f"trials = {trials}", "use fewer trials")


def sample_perturbations(study: Study, trials: Sequence[int]) -> PerturbationBatch:
    """Draw the deviations of the given trials from nominal.

    The values of a trial depend only on its number and on the study: the perturbations and their order, the
    seed, the sampling method and, except for random draws, the number of trials of the study.

    Parameters
    ----------
    study
        Study with its perturbations, their distributions and correlations.
    trials
        Numbers of the trials, from 0.

    Returns
    -------
    PerturbationBatch
        Deviations of the trials, one column for each perturbation.

    Raises
    ------
    MemoryLimitError
        If the values do not fit into memory.

    Examples
    --------
    >>> from tolerancing import load_study, sample_perturbations
    >>> study = load_study("designs/as_built_tolerances.toml").study
    >>> sample_perturbations(study, range(100)).values.shape
    (100, 12)
    """
    perturbations = study.perturbations
    check_trial_memory(study, len(trials))
    values = sample_values(perturbations, study.dependence, study.draws, study.seed, trials, study.trials)
    return batch_of(perturbations, values, study.pivot_z_mm, study.seed, trials)


def score_trials(context: Context, study: Study, trials: Sequence[int]) -> TrialResults:
    """Draw and score some trials of a study; a trial that fails has a message and does not affect others."""
    start = time.perf_counter()
    batch = sample_perturbations(study, trials)
    scores, messages = score_batch(study.merits, context, batch)
    extras = [np.empty((len(batch), 0))]
    extras += [
        values_or_nan(partial(merit.uncompensated, context), batch, failure=Exception)
        for merit in study.compensated
    ]
    if study.compensators:
        extras.append(values_or_nan(context.compensator_values, batch, (len(study.compensators),)))
    passed = all_passed(study.merits, scores)
    seconds = np.full(len(batch), (time.perf_counter() - start) / len(batch))
    return TrialResults(
        tuple(trials), batch.values, scores, np.column_stack(extras), messages, passed, seconds
    )


def score_high_fidelity(
    context: Context, study: Study, trials: Sequence[int], chosen: Sequence[str]
) -> HighFidelityResults:
    """Score some trials by the high-fidelity merits."""
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
    """Score one step of one of a study's series; sweeps and grids may also name high-fidelity merits."""
    one = study.series[series]
    return one.score(context, study.all_merits if isinstance(one, LinePairSection) else study.merits, step)


def levels_and_nominal_scores(lens: Lens, study: Study) -> tuple[dict[str, str], dict[str, float]]:
    """Return the selected level of each merit and its score of the nominal lens, by label.

    Raises
    ------
    InputError
        If a merit cannot score the nominal lens.
    """
    levels = decide_levels(lens, study)
    with_levels = study.with_levels(levels)
    return levels, nominal_scores(context_of(lens, with_levels), with_levels)


def nominal_scores(context: Context, study: Study) -> dict[str, float]:
    """Return the scores of the nominal lens, by label of the merit.

    Raises
    ------
    InputError
        If a merit cannot score the nominal lens.
    """
    batch = context.perturbed(study.perturbations, np.zeros((1, len(study.perturbations))))
    # Line pairs of sweeps and grids may share a label with a merit: they are scored only to find errors.
    for pairs in dict.fromkeys(
        pairs for series in (*study.sweeps, *study.grids) for pairs in series.line_pairs()
    ):
        _nominal_score(pairs, context, batch)
    return {merit.label: _nominal_score(merit, context, batch) for merit in study.all_merits}


def _nominal_score(merit: Merit, context: Context, batch: PerturbationBatch) -> float:
    try:
        return float(merit.scores(context, batch)[0])
    except Exception as error:
        raise InputError(
            f"merit {merit.label!r} cannot score the nominal lens: {fault_text(error)}; no trial was run: "
            "correct the merit or the design"
        ) from error


def decide_levels(lens: Lens, study: Study) -> dict[str, str]:
    """Select the level of each merit, by label.

    For ``auto``, the fastest level is selected that agrees with the most accurate level in trials 0 to 5. If
    a level cannot score one of these trials, the most accurate level is selected.

    Parameters
    ----------
    lens
        The nominal lens.
    study
        The study.

    Returns
    -------
    dict of str to str
        Level by label of the merit.
    """
    context = context_of(lens, study)
    return {merit.label: _level(merit, context, study) for merit in study.all_merits}


def with_decided_levels(lens: Lens, study: Study) -> Study:
    """Return the study with the level of each merit, selected with trials only where several can score it."""
    several = [m for m in study.all_merits if m.level == "auto" and len(m.able_levels()) > 1]
    if not several:
        return study
    context = pupil_context(lens, study)
    return study.with_levels({merit.label: _level(merit, context, study) for merit in several})


def _level(merit: Merit, context: Context, study: Study) -> str:
    able = merit.able_levels()
    if merit.level != "auto" or len(able) == 1:
        return merit.used_level if merit.level != "auto" else able[0]
    batch = sample_perturbations(study, range(min(6, study.trials)))
    try:
        scores = {level: merit.model_copy(update={"level": level}).scores(context, batch) for level in able}
    except TransferLensError:
        return able[-1]
    for level in able[:-1]:
        if np.all(np.abs(scores[level] - scores[able[-1]]) <= study.fidelity.largest_difference):
            return level
    return able[-1]
