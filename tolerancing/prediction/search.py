"""A tolerance study in a search for lenses: predictions with exact derivatives, and independent trials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError, TransferLensError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.as_built import (
    AsBuiltPrediction,
    AsBuiltReport,
    AsBuiltValues,
    LossValues,
    untraceable,
    without_losses,
)
from lensdesign.optimization.problem import DesignProblem
from lensdesign.raytrace.gradients import Variable
from tolerancing.cost.pricing import cost_of
from tolerancing.cost.table import CostTable, load_costs
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.prediction.drawing_yield import DrawingYieldPredictor
from tolerancing.prediction.goals.compensated import CompensatedWaves, WavefrontLoads
from tolerancing.prediction.goals.design import DesignPoint, Scatter, bent, sized
from tolerancing.prediction.goals.joint_yield import DrawnLoads, failing_fraction
from tolerancing.prediction.goals.quadratic_forms import wavefront_forms
from tolerancing.prediction.goals.ray_loads import FollowedRays, RayLoads, judged_rays
from tolerancing.prediction.goals.reconstruction_loss import SearchedLosses
from tolerancing.prediction.goals.trials import predicted_of, trials_of
from tolerancing.prediction.ray_prediction import predicted_merits
from tolerancing.prediction.study_prediction import is_predicted, is_scored_at_once
from tolerancing.prediction.wavefront_prediction import WavefrontLimit, wavefront_points
from tolerancing.study.evaluate import compensated_points, prepare_merits
from tolerancing.study.files import check_against, load_study, study_by_name
from tolerancing.study.scaling import write_scaled_study
from tolerancing.study.study import Study


@dataclass(frozen=True, eq=False)
class StudyAsBuilt:
    """A study that scores the lenses of a search as built.

    Attributes
    ----------
    study : Study
    reference : Lens
        The lens of the study file.
    source : str
        Name of the study file.
    costs : Path or None
        Table of costs; None is the table of the toolkit.
    amount : float or None
        Cost to which the tolerances of each lens are scaled by one factor; None keeps the tolerances.
    """

    study: Study
    reference: Lens
    source: str
    costs: Path | None = None
    amount: float | None = None

    def yield_predictor(self) -> DrawingYieldPredictor:
        """Return an object that derives tolerances of drawings and predicts their yields by the study."""
        return DrawingYieldPredictor(self.study, self.source)

    def write_scaled(self, factor: float, twin: Lens, design: Path) -> Path:
        """Write the study of the scaled lens beside its design file, and return its path."""
        return write_scaled_study(self.study, Path(self.source).parent, factor, twin, design)

    def priced(self, costs: Path | None, cost: float | None) -> StudyAsBuilt:
        """Return the study with a table of costs and, if given, a cost to which tolerances are scaled."""
        return replace(self, costs=costs, amount=cost)

    @cached_property
    def _table(self) -> CostTable:
        return load_costs(self.costs)

    def cost(self, lens: Lens) -> float:
        """Return the cost of the tolerances of a lens, its elements included.

        Raises
        ------
        InputError
            If the table has no price for one of them.
        """
        return self.amount or cost_of(self.study, bent(lens), self._table).total

    def factor(self, lens: Lens) -> float:
        """Return the factor of the tolerances of a lens that gives the requested cost.

        Costs of tolerances are their reciprocals.
        """
        if self.amount is None:
            return 1.0
        elements = len(lens.glass_fronts)
        return (cost_of(self.study, lens, self._table).total - elements) / (self.amount - elements)

    def scaled(self, factor: float) -> StudyAsBuilt:
        """Return the study with all tolerances multiplied."""
        if factor == 1.0:
            return self
        return replace(self, study=_multiplied(self.study, factor))

    @cached_property
    def judged(self) -> tuple[WavefrontLimit, ...]:
        """Object points at which wavefronts are limited, and their limits."""
        return wavefront_points(self.study)

    @property
    def points_mm(self) -> tuple[tuple[float, float], ...]:
        """Object points at which wavefronts are limited."""
        return tuple(point.field_mm for point in self.judged)

    @cached_property
    def trials_only(self) -> tuple[str, ...]:
        """Names of the merits that a search does not know."""
        return tuple(m.label for m in self.study.merits if not is_scored_at_once(m))

    @property
    def loss_merits(self) -> tuple[str, ...]:
        """Names of the study's merits `reconstruction_loss`."""
        return tuple(merit.label for merit in self.study.merits if isinstance(merit, ReconstructionLoss))

    @cached_property
    def _losses(self) -> SearchedLosses:
        return SearchedLosses(self.study, self.reference, self.factor, self.source)

    @cached_property
    def _scatter(self) -> Scatter:
        self.check_trials()  # a search ends with trials
        return Scatter(self.study, self.factor)

    @cached_property
    def _places(self) -> tuple[tuple[tuple[float, float], float | None], ...]:
        """Object points whose wavefronts are predicted: points with limits, then others for compensators."""
        judged = [(p.field_mm, p.wavelength_um) for p in self.judged]
        own = compensated_points(self.study) if self.study.compensators else ()
        return (*judged, *(place for place in own if place not in judged))

    def check(self, lens: Lens) -> None:
        """Check that a lens has all perturbed parameters.

        Raises
        ------
        DesignError
        """
        check_against(self.study, bent(lens), self.source)
        if self.amount is not None:
            if self.amount <= (elements := len(lens.glass_fronts)):
                raise DesignError(
                    f"tolerances: cost = {self.amount:g}: must be above {elements}, the cost of the "
                    "elements without tolerances"
                )
            self.factor(sized(lens, np.ones(len(lens.surfaces))))
        used = {wavelength for _, wavelength in self._places}
        used |= {merit.wavelength_um for merit in predicted_merits(self.study)}
        own = used - {None, *lens.wavelengths_um}
        if own:
            known = ", ".join(f"{w:g}" for w in lens.wavelengths_um)
            raise DesignError(
                f"{self.source}: merits at {', '.join(f'{w:g}' for w in own if w is not None)} µm: allowed "
                f"in a search: the wavelengths of its specification, {known} µm"
            )

    def evaluate(self, problem: DesignProblem, point: Array, derivatives: bool) -> AsBuiltValues:
        """Predict the lens at a point of the unit box, to first order in the perturbations.

        Derivatives are by the variables in their own units.

        Raises
        ------
        InputError
            If a merit that only trials score is faulty, such as user code that cannot be loaded.
        """
        variables, scatter = problem.variables if derivatives else (), self._scatter
        try:
            with np.errstate(all="ignore"):
                found = self._values(scatter, problem, point, variables)
        except (TransferLensError, np.linalg.LinAlgError):
            return untraceable(len(self.judged), len(variables))
        numbers = (found.rms_waves, found.rms_by, found.failing, found.failing_by)
        if not all(np.all(np.isfinite(own)) for own in numbers) or np.any(found.rms_waves <= 0.0):
            return untraceable(len(self.judged), len(variables))
        return found

    def check_trials(self) -> None:
        """Check that all merits can be scored.

        Raises
        ------
        InputError
            If the Python code of a merit is not trusted, or fails.
        """
        prepare_merits(self.study)

    def check_yields(self) -> None:
        """Check that the yield of the study can be predicted.

        Raises
        ------
        DesignError
        """
        if not self.judged and not predicted_merits(self.study):
            raise DesignError(
                f"{self.source}: a search knows none of the merits ({', '.join(self.trials_only)}), "
                "so it cannot use the study: add one of kind rms_waves, strehl, largest_spread_deg or "
                "footprint_radius_mm"
            )

    def check_whole_yields(self) -> None:
        """Check that all limits of the study are predicted, so that their yield is that of the study.

        Raises
        ------
        DesignError
        """
        missing = [m.label for m in self.study.merits if not is_predicted(m)]
        if missing:
            raise DesignError(
                f"{self.source}: its yield cannot be explored, since {', '.join(missing)} can be scored by "
                "trials only: explore as_built_rms, or remove these merits from the study"
            )

    def check_losses(self, lens: Lens) -> None:
        """Check that a search can predict the losses of such a lens.

        Raises
        ------
        DesignError
            If the study's own lens cannot represent the lenses of the search.
        """
        self._losses.check(lens)

    def losses(self, problem: DesignProblem, point: Array, derivatives: bool) -> LossValues:
        """Predict mean reconstruction losses of the lens at a point of the unit box.

        Derivatives are by the variables in their own units.
        """
        count = len(problem.variables) if derivatives else 0
        try:
            with np.errstate(all="ignore"):
                found = self._losses.values(problem, point, derivatives)
        except (TransferLensError, np.linalg.LinAlgError):
            return without_losses(len(self.loss_merits), count)
        if not (np.all(np.isfinite(found.losses)) and np.all(np.isfinite(found.losses_by))):
            return without_losses(len(self.loss_merits), count)
        return found

    def _values(
        self, scatter: Scatter, problem: DesignProblem, point: Array, variables: tuple[Variable, ...]
    ) -> AsBuiltValues:
        wavelengths = problem.base.wavelengths_um
        designs: dict[int, DesignPoint] = {}

        def design_at(wavelength_um: float | None) -> DesignPoint:
            index = wavelengths.index(wavelength_um or wavelengths[0])
            if index not in designs:
                designs[index] = DesignPoint(scatter, problem, point, variables, index)
            return designs[index]

        limits: list[DrawnLoads] = []
        rms, rms_by = np.zeros(0), np.zeros((0, len(variables)))
        if self.judged:
            waves = self._waves([design_at(w) for _, w in self._places])
            count = len(scatter.amounts)
            squares = [waves.squares(k) for k in range(len(self.judged))]
            rms = np.sqrt([np.mean(own) for own in squares])
            equal = np.full(count, 1.0 / count)
            if variables:
                rms_by = np.stack([waves.weighted(k, equal) / (2.0 * rms[k]) for k in range(len(rms))])
            else:
                rms_by = np.zeros((len(rms), 0))
            limits += [WavefrontLoads(waves, k, own.limit_waves) for k, own in enumerate(self.judged)]
        for merit in predicted_merits(self.study):
            design = design_at(merit.wavelength_um)
            rays = judged_rays(merit, design.lens, self.study.sampling)
            limits.append(RayLoads(merit, FollowedRays(design, rays), scatter.amounts))
        return AsBuiltValues(rms, rms_by, *failing_fraction(limits, len(variables)))

    def _waves(self, designs: Sequence[DesignPoint]) -> CompensatedWaves:
        """Return wavefronts at all object points, each for the design at its wavelength."""
        size, variables = designs[0].changes.count, len(designs[0].variables)
        values = np.empty((len(designs), size, size))
        by = np.empty((variables, *values.shape))
        for design in dict.fromkeys(designs):
            own = [k for k, other in enumerate(designs) if other is design]
            values[own], by[:, own] = wavefront_forms(design, [self._places[k][0] for k in own])
        scatter, total, total_by = self._scatter, np.zeros((size, size)), np.zeros((variables, size, size))
        if len(scatter.limits):
            own = [self._places.index(place) for place in compensated_points(self.study)]
            total, total_by = np.sum(values[own], axis=0), np.sum(by[:, own], axis=1)
        return CompensatedWaves(values, by, total, total_by, scatter.amounts, scatter.limits)

    def predict(self, lens: Lens) -> AsBuiltPrediction:
        """Predict a finished lens as the command `tolerancing predict` does."""
        if not any(is_predicted(merit) for merit in self.study.merits):
            return AsBuiltPrediction((), math.nan, {}, math.nan)
        lens = self._fitting(lens)
        return predicted_of(lens, self._toleranced(self.study, lens))

    def trials(self, lenses: Sequence[tuple[str, Lens]], count: int, seed: int = 0) -> AsBuiltReport:
        """Score lenses by `count` independent trials each, with a seed that differs from the study's.

        A run of the study with this seed and number of trials scores the same trials.

        Raises
        ------
        TransferLensError
            If a lens cannot be scored.
        """
        fresh = self.study.model_copy(update={"seed": self.study.seed + 1 + seed, "trials": count})
        rows = []
        for name, given in lenses:
            lens = self._fitting(given)
            rows.append(
                trials_of(name, lens, self._toleranced(fresh, lens), self.judged, self.predict(given))
            )
        return AsBuiltReport(
            self.points_mm,
            tuple(p.wavelength_um for p in self.judged),
            tuple(p.limit_waves for p in self.judged),
            fresh.seed,
            self.trials_only,
            tuple(rows),
        )

    def _fitting(self, lens: Lens) -> Lens:
        """Return the lens; planes are slightly curved if the study perturbs the radius of one."""
        try:
            check_against(self.study, lens, self.source)
        except DesignError:
            return bent(lens)
        return lens

    def _toleranced(self, study: Study, lens: Lens) -> Study:
        """Return the study with the tolerances of a lens."""
        return _multiplied(study, self.factor(bent(lens)))


def read_study(path: Path, lens: Lens | None = None) -> StudyAsBuilt:
    """Read a study for a search; with a lens, the study or the grade of this name for that lens."""
    if lens is not None:
        return StudyAsBuilt(study_by_name(str(path), lens), lens, str(path))
    loaded = load_study(path)
    return StudyAsBuilt(loaded.study, loaded.lens, str(path))


def _multiplied(study: Study, factor: float) -> Study:
    """Return the study with all tolerances multiplied."""
    if factor == 1.0:
        return study
    return study.model_copy(update={"perturbations": tuple(p.scaled(factor) for p in study.perturbations)})
