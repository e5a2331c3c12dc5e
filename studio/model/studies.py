"""Tolerance studies of the lens on the page: writing, running, and reading of trials during the run."""

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


def trials_so_far(folder: Path) -> TrialResults | None:
    """Return the trials in the store of a folder; None if there is no store yet."""
    from tolerancing.store.store import open_store

    try:
        with open_store(folder / "study.db") as store:
            return store.trials()
    except InputError:
        return None


def trial_what_if(folder: Path, number: int) -> WhatIf:
    """Return the deviations of one trial's lens, without irregularities, for which there are no sliders."""
    from tolerancing.study.evaluate import sample_perturbations

    study = load_study(folder / "study.toml").study
    batch = sample_perturbations(study, [number])
    values: dict[str, float] = {}
    for parameter, value in zip(batch.parameters, batch.values[0].tolist(), strict=True):
        if not parameter.is_irregularity:
            key = f"{parameter.target}.{parameter.parameter}"
            values[key] = values.get(key, 0.0) + value
    return WhatIf(values)
