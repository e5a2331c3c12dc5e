"""Tolerance studies of the lens on the page: written, run, and their trials as they arrive."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lensdesign.errors import InputError
from lensdesign.files.design import save_design
from lensdesign.lens.lens import Lens
from studio.model.built import ManufacturingQuality
from studio.model.whatif import WhatIf
from tolerancing.study.files import load_study, save_study
from tolerancing.study.results import TrialResults


def write_study(lens: Lens, made: ManufacturingQuality, trials: int, folder: Path) -> Path:
    """Write a study and its design, with all merits by which the page predicts the yield.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    save_design(lens, folder / "design.toml")
    save_study(
        made.study.model_copy(update={"design": "design.toml", "trials": trials}), folder / "study.toml"
    )
    return folder / "study.toml"


def run_trials(
    lens: Lens, made: ManufacturingQuality, trials: int, folder: Path, report: Callable[[str], None]
) -> int:
    """Run a study into `folder`/study.db, in the process that calls; how many trials.

    Raises
    ------
    InputError
        If the study cannot be run.
    """
    from tolerancing.run.run import run_study

    report(f"{trials} trials")
    run_study(load_study(write_study(lens, made, trials, folder)), folder / "study.db", workers=1)
    return trials


def trials_so_far(folder: Path) -> TrialResults | None:
    """The trials that the store of a folder holds; None where there is no store yet."""
    from tolerancing.store.store import open_store

    try:
        with open_store(folder / "study.db") as store:
            return store.trials()
    except InputError:
        return None


def trial_what_if(folder: Path, number: int) -> WhatIf:
    """How far the lens of one trial is off; irregularities, which no slider has, are left out."""
    from tolerancing.study.evaluate import sample_perturbations

    study = load_study(folder / "study.toml").study
    batch = sample_perturbations(study, [number])
    values: dict[str, float] = {}
    for parameter, value in zip(batch.parameters, batch.values[0].tolist(), strict=True):
        if not parameter.is_irregularity:
            key = f"{parameter.target}.{parameter.parameter}"
            values[key] = values.get(key, 0.0) + value
    return WhatIf(values)
