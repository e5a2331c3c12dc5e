"""Tolerance studies of the lens on the page: writing, running, and reading of trials during the run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lensdesign.errors import InputError
from lensdesign.files.design import save_design
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SurfacePerturbation
from studio.model.built import ManufacturingQuality
from studio.model.whatif import WhatIf
from tolerancing.statistics.summary import Summary
from tolerancing.statistics.yields import Yield, yield_of
from tolerancing.study.files import load_study, save_study
from tolerancing.study.results import TrialResults
from wavesim.scene.system_state import SystemState


def write_study(lens: Lens, quality: ManufacturingQuality, trials: int, folder: Path) -> Path:
    """Write a study and its design, with all merits of the page's yield prediction.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    save_design(lens, folder / "design.toml")
    save_study(
        quality.study.model_copy(update={"design": "design.toml", "trials": trials}), folder / "study.toml"
    )
    return folder / "study.toml"


def run_trials(
    lens: Lens, quality: ManufacturingQuality, trials: int, folder: Path, report: Callable[[str], None]
) -> int:
    """Run a study in the calling process, store it in `folder`/study.db, and return the number of trials.

    Raises
    ------
    InputError
        If the study cannot be run.
    """
    from tolerancing.run.run import run_study

    report(f"{trials} trials")
    run_study(load_study(write_study(lens, quality, trials, folder)), folder / "study.db", workers=1)
    return trials


@dataclass(frozen=True, eq=False)
class StudyProgress:
    """Trials of a study that has run so far.

    Attributes
    ----------
    summary
        Yields and statistics, as `tolerancing show` prints them.
    trials
        The trials.
    counts
        Numbers of first trials for which `yields` are given.
    yields
        Yield of the first trials with its confidence interval.
    """

    summary: Summary
    trials: TrialResults
    counts: tuple[int, ...]
    yields: tuple[Yield, ...]


def study_progress(folder: Path) -> StudyProgress | None:
    """Return the trials in the store of a folder; None if there are none yet."""
    from tolerancing.perturbations.draws import replicates
    from tolerancing.statistics.summary import summary_of
    from tolerancing.store.store import open_store

    try:
        with open_store(folder / "study.db") as store:
            record, study, nominal, found = store.record(), store.study, store.nominal(), store.trials()
    except InputError:
        return None
    if not len(found):
        return None
    passed, numbers = np.asarray(found.passed, bool), np.asarray(found.trials)
    # Enough points for a curve, however many trials there are.
    points = 60
    counts = np.unique(np.linspace(min(10, len(found)), len(found), points).astype(int))
    yields = [yield_of(passed[:n], replicates(study.draws, numbers[:n].tolist())) for n in counts]
    return StudyProgress(
        summary_of(record, study, nominal, found, 0),
        found,
        tuple(counts.tolist()),
        tuple(one for one in yields if one is not None),
    )


def trial_what_if(folder: Path, number: int) -> WhatIf:
    """Return the deviations of one trial's lens, as mounted: values of compensators do not move it.

    Irregularities have no slider, but act as well.
    """
    from tolerancing.study.evaluate import sample_perturbations

    loaded = load_study(folder / "study.toml")
    batch = sample_perturbations(loaded.study, [number])
    values: dict[str, float] = {}
    for parameter, value in zip(batch.parameters, batch.values[0].tolist(), strict=True):
        if not parameter.is_irregularity:
            key = f"{parameter.target}.{parameter.parameter}"
            values[key] = values.get(key, 0.0) + value
    state = batch.states(loaded.lens, loaded.lens.wavelengths_um[0])[0]
    figures = {
        index: SurfacePerturbation(figure=own.figure)
        for index, own in state.surface_perturbations.items()
        if own.figure is not None
    }
    without = ", without compensators" if loaded.study.compensators else ""
    words = f"irregularities of trial {number}{without}"
    return WhatIf(values, SystemState(surface_perturbations=figures), words)
