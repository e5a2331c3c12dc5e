"""What a lens will be as built: wavefronts and yield predicted under a grade or a study, and the cost."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.cost.pricing import cost_of
from tolerancing.cost.table import CostTable, load_costs
from tolerancing.merits.pupil import RmsWaves
from tolerancing.perturbations.grades import GRADES, starting_study
from tolerancing.study.files import check_against, load_study, study_from_tables
from tolerancing.study.study import Study
from tolerancing.wavefronts.prediction import (
    Judged,
    WavefrontPrediction,
    drawn_amounts,
    judged_points,
    predict,
)

FEWER = 4
"""While a value moves: every so many of the draws, to first order."""


@dataclass(frozen=True, eq=False)
class Workmanship:
    """How a lens is made: the study that says what scatters, and where wavefronts are judged.

    Attributes
    ----------
    name
        Of the grade, or of the study's file.
    study
        What scatters.
    judged
        Object points, with limits.
    """

    name: str
    study: Study
    judged: tuple[Judged, ...]

    @cached_property
    def amounts(self) -> Array:
        """Of what scatters, by draws; the same for every lens."""
        return drawn_amounts(self.study)


@dataclass(frozen=True, eq=False)
class Built:
    """What is predicted.

    Attributes
    ----------
    name
        Of the workmanship.
    prediction
        Wavefronts and yield.
    cost
        Of tolerances and elements, in the units of the table; None where it has no price.
    """

    name: str
    prediction: WavefrontPrediction
    cost: float | None


def workmanship(name: str, lens: Lens, heights_mm: tuple[float, ...]) -> Workmanship:
    """A grade's tolerances of a lens, or those of a study file, which names its own points.

    Parameters
    ----------
    name
        A grade, or a file.
    lens
        The lens.
    heights_mm
        Object points at which wavefronts are judged by a grade's limit.

    Raises
    ------
    InputError
        If it is neither, or the lens does not have what scatters.
    """
    if name not in GRADES:
        study = load_study(Path(name)).study
        check_against(study, lens, name)
        return Workmanship(Path(name).name, study, judged_points(study))
    study = study_from_tables(tomllib.loads(starting_study(lens, "design.toml", name)), name)
    limit = next(merit.at_most for merit in study.merits if isinstance(merit, RmsWaves))
    assert limit is not None  # as the grades have it
    return Workmanship(name, study, tuple(Judged((0.0, h), None, limit) for h in heights_mm))


def built(lens: Lens, made: Workmanship, *, settled: bool = True) -> Built:
    """Predict a lens as built: as `tolerancing predict` does, or coarser, while a value moves.

    Raises
    ------
    InputError
        If rays do not pass.
    """
    check_against(made.study, lens, made.name)
    amounts = made.amounts if settled else made.amounts[::FEWER]
    prediction = predict(lens, made.study, made.judged, amounts, second=settled)
    try:
        cost = cost_of(made.study, lens, _costs()).total
    except InputError:
        cost = None
    return Built(made.name, prediction, cost)


@lru_cache(maxsize=1)
def _costs() -> CostTable:
    return load_costs()
