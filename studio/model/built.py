"""What a lens will be as built: wavefronts and yield predicted under a grade or a study, and the cost."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.cost.pricing import cost_of
from tolerancing.cost.table import CostTable, load_costs
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.grades import GRADES, starting_study
from tolerancing.prediction.study_prediction import StudyPrediction, predict_study
from tolerancing.prediction.wavefront_prediction import drawn_batch
from tolerancing.study.files import check_against, load_study, study_from_tables
from tolerancing.study.study import Study

FEWER = 4
"""While a value moves: every so many of the draws, to first order."""


@dataclass(frozen=True, eq=False)
class ManufacturingQuality:
    """How a lens is made: the study that says what scatters, and what a good lens is.

    Attributes
    ----------
    name
        Of the grade, or of the study's file.
    study
        What scatters, and the limits.
    """

    name: str
    study: Study

    @cached_property
    def drawn(self) -> PerturbationBatch:
        """The drawn lenses of the prediction; the same for every lens."""
        return drawn_batch(self.study)

    @cached_property
    def fewer(self) -> PerturbationBatch:
        """Some of them, for a prediction while a value moves."""
        return drawn_batch(self.study, FEWER)


@dataclass(frozen=True, eq=False)
class AsBuiltFigures:
    """What is predicted.

    Attributes
    ----------
    name
        Of the workmanship.
    prediction
        The joint yield of all limits, its parts, wavefronts and rays.
    cost
        Of tolerances and elements, in the units of the table; None where it has no price.
    """

    name: str
    prediction: StudyPrediction
    cost: float | None


def workmanship(name: str, lens: Lens) -> ManufacturingQuality:
    """The study of a grade, as `tolerancing start` writes it for a lens, or that of a study file.

    Parameters
    ----------
    name
        A grade, or a file.
    lens
        The lens.

    Raises
    ------
    InputError
        If it is neither, or the lens does not have what scatters.
    """
    if name in GRADES:
        tables = tomllib.loads(starting_study(lens, "design.toml", name))
        return ManufacturingQuality(name, study_from_tables(tables, name))
    study = load_study(Path(name)).study
    check_against(study, lens, name)
    return ManufacturingQuality(Path(name).name, study)


def built(lens: Lens, made: ManufacturingQuality, *, settled: bool = True) -> AsBuiltFigures:
    """Predict a lens as built: as `tolerancing predict` does, or coarser, while a value moves.

    Raises
    ------
    InputError
        If rays do not pass.
    """
    check_against(made.study, lens, made.name)
    batch = made.drawn if settled else made.fewer
    prediction = predict_study(lens, made.study, batch, quick=not settled)
    try:
        cost = cost_of(made.study, lens, _costs()).total
    except InputError:
        cost = None
    return AsBuiltFigures(made.name, prediction, cost)


@lru_cache(maxsize=1)
def _costs() -> CostTable:
    return load_costs()
