"""Prediction of a lens as built: wavefronts, yield and cost for a grade or a tolerance study."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.cost.pricing import cost_of
from tolerancing.cost.table import CostTable, load_costs
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.prediction.study_prediction import StudyPrediction, predict_study
from tolerancing.prediction.wavefront_prediction import drawn_batch
from tolerancing.study.files import check_against, study_by_name
from tolerancing.study.study import Study


@dataclass(frozen=True, eq=False)
class ManufacturingQuality:
    """Manufacturing tolerances of a lens, and the limits of a good lens.

    Attributes
    ----------
    name
        Name of the grade or of the study's file.
    study
        Perturbations and limits.
    """

    name: str
    study: Study

    @cached_property
    def drawn(self) -> PerturbationBatch:
        """Drawn perturbations of the prediction; the same for every lens."""
        return drawn_batch(self.study)

    @cached_property
    def coarse_batch(self) -> PerturbationBatch:
        """Subset of the drawn perturbations, for a prediction while a value changes."""
        # While a value changes, the prediction uses every n-th draw, to first order.
        coarse_stride = 4
        return drawn_batch(self.study, coarse_stride)


@dataclass(frozen=True, eq=False)
class AsBuiltPrediction:
    """Predicted yield and cost of a lens as built.

    Attributes
    ----------
    name
        Name of the grade or study.
    prediction
        Joint yield of all limits, yields of single limits, wavefronts and rays.
    cost
        Cost of tolerances and elements, in the units of the cost table; None if it lacks a price.
    """

    name: str
    prediction: StudyPrediction
    cost: float | None


def manufacturing_quality(name: str, lens: Lens) -> ManufacturingQuality:
    """Return the study of a grade, as `tolerancing start` writes it for a lens, or that of a study file.

    Parameters
    ----------
    name
        A grade, or the path of a study.
    lens
        The lens.

    Raises
    ------
    InputError
        If it is neither, or the lens lacks surfaces or elements that the study perturbs.
    """
    return ManufacturingQuality(Path(name).name, study_by_name(name, lens))


def built(
    lens: Lens,
    quality: ManufacturingQuality,
    *,
    settled: bool = True,
    proceed: Callable[[], None] = lambda: None,
) -> AsBuiltPrediction:
    """Predict a lens as built, like `tolerancing predict`, or coarsely if not `settled`.

    `proceed` is called from time to time, and may raise an exception to end the prediction.

    Raises
    ------
    InputError
        If rays do not pass.
    """
    check_against(quality.study, lens, quality.name)
    batch = quality.drawn if settled else quality.coarse_batch
    prediction = predict_study(lens, quality.study, batch, quick=not settled, proceed=proceed)
    try:
        cost = cost_of(quality.study, lens, _costs()).total
    except InputError:
        cost = None
    return AsBuiltPrediction(quality.name, prediction, cost)


@lru_cache(maxsize=1)
def _costs() -> CostTable:
    return load_costs()
