"""Tolerance budgets of studies: found on a score model, corrected and verified by trials of the lens."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.budgets.allocation import Budget, allocate_tolerances, check_required
from tolerancing.budgets.score_model import StudyScoreModel
from tolerancing.merits.base import all_passed
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import Perturbation
from tolerancing.statistics.scorer import ROWS_AT_ONCE
from tolerancing.statistics.yields import Yield, yield_of
from tolerancing.store.store import Store
from tolerancing.study.evaluate import check_trial_memory, context_of, sample_perturbations
from tolerancing.study.files import LoadedStudy, study_from_tables
from tolerancing.study.scoring import score_batch
from tolerancing.study.study import Study

SCALES = (0.1, 4.0)
"""Range in which the scales of tolerances are searched."""

MOST_ROUNDS, MODEL_ROUNDS = 8, 2
"""How often tolerances are tried at most; how many rounds believe a response surface, if there is one."""

PROBIT_SLOPE, LARGEST_STEP = 2.0, 0.5
"""First guess of -d probit(yield) / d log(common factor), and the largest step of the logarithm."""

CLOSE_ENOUGH = 0.002
"""Difference of the estimated yield from the requirement, up to which tolerances are not searched again."""

NO_COST = 1e-12
"""Weight of a fixed tolerance; a search asks for some."""

Report = Callable[[int, int], None]
"""Progress callback: `progress(completed, most)`, in trials of the lens."""


@dataclass(frozen=True, eq=False)
class StudyBudget:
    """A budget, and what trials of the lens itself find with it.

    Attributes
    ----------
    budget
        The scales, found on the score model and corrected by trials of the lens.
    cost, cost_before, uniform_cost
        Costs of the tolerances found, of the study's own, and of the best common scale (None where there is
        none): sum of weight / scale, and the cost of the parts without tolerances where it is given.
    verified
        Yield in random trials that the search did not know, with the tolerances rounded as the study states
        them; None if it was interrupted before one was scored.
    seed
        Seed of these trials. A run of the written study with this seed has the same trials.
    estimated_yield, estimated_yield_error
        The same yield and its standard error with the model's yield as a control variate, which is several
        times more precise; None where not all trials were scored.
    required
        The yield that was asked for.
    """

    budget: Budget
    cost: float
    cost_before: float
    uniform_cost: float | None
    verified: Yield | None
    seed: int
    estimated_yield: float | None
    estimated_yield_error: float | None
    required: float

    @property
    def agrees(self) -> bool:
        """Whether trials and requirement agree: the 95 % interval contains it, and the estimate is close.

        A yield above the requirement agrees if every tolerance is as loose as it is allowed to be.
        """
        if self.verified is None or self.estimated_yield is None or self.estimated_yield_error is None:
            return False
        excess = self.estimated_yield - self.required
        close = max(CLOSE_ENOUGH, self.estimated_yield_error)
        if self.at_widest:
            return excess >= -close
        return self.verified.low <= self.required <= self.verified.high and abs(excess) <= close

    @property
    def at_widest(self) -> bool:
        """Whether every tolerance is as loose as it is allowed to be."""
        return bool(np.all((self.budget.scales >= SCALES[1]) | (self.budget.scales == 1.0)))


class BudgetInterrupted(KeyboardInterrupt):
    """A budget was interrupted; `found` is the best so far, None before any was tried on the lens."""

    def __init__(self, found: StudyBudget | None) -> None:
        super().__init__("interrupted")
        self.found = found


def budget(
    store: Store,
    required: float,
    weights: Mapping[str, float] | None = None,
    *,
    fixed: Collection[str] = (),
    base_cost: float = 0.0,
    fresh: int = 500,
    report: Report | None = None,
) -> StudyBudget:
    """Find the loosest tolerances that keep a yield, from the trials of a store.

    :func:`scaled_study` gives the study that has them.

    Parameters
    ----------
    store
        An open store.
    required, weights, fixed, base_cost, fresh, report
        As of :func:`budget_of_study`.

    Raises
    ------
    InputError, BudgetInterrupted
        As of :func:`budget_of_study`.
    """
    loaded, trials = store.loaded, store.trials()
    return budget_of_study(
        loaded.lens,
        loaded.study,
        trials.values,
        trials.scores,
        required,
        weights,
        fixed=fixed,
        base_cost=base_cost,
        fresh=fresh,
        report=report,
    )


def budget_of_study(
    lens: Lens,
    study: Study,
    values: Array,
    scores: Array,
    required: float,
    weights: Mapping[str, float] | None = None,
    *,
    fixed: Collection[str] = (),
    base_cost: float = 0.0,
    fresh: int = 500,
    report: Report | None = None,
) -> StudyBudget:
    """Find the tolerances of least cost whose yield is what is required.

    1. A score model of all merits (:mod:`tolerancing.budgets.score_model`) is searched for the scales of
       least cost with which the required fraction of its lenses is good.
    2. Random trials of the lens itself, of a seed that is not the study's, verify the result.
    3. Where they disagree with the requirement, the difference between the yields of lens and model on the
       same trials corrects the aim, trials improve the response surfaces, and both steps are repeated with
       another seed. If a response surface still errs after two rounds, a common factor of the tolerances is
       sought by the yields of trials alone (regula falsi in probit(yield) over the factor's logarithm).

    Parameters
    ----------
    lens, study
        What was run.
    values, scores
        Trials of the study, shapes (n, perturbations) and (n, merits).
    required
        Yield, above 0 and below 1.
    weights
        Cost of each perturbation's tolerance at scale 1, by column; default: 1.
    fixed
        Columns whose tolerances stay as they are, at no cost.
    base_cost
        Cost of the parts without tolerances, which every cost of the result includes.
    fresh
        Number of trials of the lens in each round.
    report
        Called with the numbers of trials scored, and to score at most, before the first and after each part.

    Raises
    ------
    InputError
        If a weight names no perturbation, a distribution has no width to scale, the trials are too few for
        a response surface, or the yield is out of reach.
    BudgetInterrupted
        If it is interrupted.
    """
    columns = [p.column for p in study.perturbations]
    unknown = [name for name in (*(weights or {}), *fixed) if name not in columns]
    if unknown:
        raise InputError(
            f"weight of {unknown[0]!r}: there is no such perturbation; allowed: {', '.join(columns)}"
        )
    scaled_perturbations(study, np.ones(len(columns)))
    check_required(required)
    check_trial_memory(study, fresh)
    held = np.array([column in fixed for column in columns])
    costs = _Costs(
        np.where(held, NO_COST, [(weights or {}).get(column, 1.0) for column in columns]),
        np.where(held, 1.0, SCALES[0]),
        np.where(held, 1.0, SCALES[1]),
        base_cost,
    )
    return _Rounds(lens, study, required, costs, fresh, report).run(values, scores)


def most_trials(fresh: int) -> int:
    """How many trials of the lens a budget takes at most, with so many in each round."""
    return MOST_ROUNDS * fresh


def most_seconds(store: Store, fresh: int) -> float:
    """How long a budget takes at most, by the time that the trials of a store took."""
    return most_trials(fresh) * float(np.mean(store.trials().seconds))


class _Rounds:
    """The rounds of searching and trying, with the trials that are known so far."""

    def __init__(
        self, lens: Lens, study: Study, required: float, costs: _Costs, fresh: int, report: Report | None
    ) -> None:
        self.lens, self.study, self.required, self.costs, self.fresh = lens, study, required, costs, fresh
        self.report, self.scored = report, 0
        self.tries: list[_Try] = []

    def run(self, values: Array, scores: Array) -> StudyBudget:
        """Search and try until trials and requirement agree."""
        found: StudyBudget | None = None
        try:
            self.progress(0)
            model = StudyScoreModel(self.lens, self.study, values, scores)
            for number in range(MOST_ROUNDS):
                if found is not None and model.not_predicted and number >= MODEL_ROUNDS:
                    searched = self.along(model, found.budget)
                else:
                    searched = self.search(model)
                found = self.tried(model, searched, self.study.seed + 1 + number)
                if found.agrees:
                    break
                if model.not_predicted:
                    values = np.concatenate([values, self.tries[-1].batch.values])
                    scores = np.concatenate([scores, self.tries[-1].scores])
                    model.fit(values, scores)
        except _TrialsInterrupted as stop:
            raise BudgetInterrupted(stop.found) from None
        except KeyboardInterrupt:
            raise BudgetInterrupted(found) from None
        assert found is not None  # there is a round
        return found

    def correction(self, model: StudyScoreModel) -> float:
        """Yield of the lens less that of the model, on the same lenses, as far as they were tried.

        A response surface is better the nearer its tolerances are: of those only the last ones count.
        """
        tries = self.tries[-1:] if model.not_predicted else self.tries
        if not tries:
            return 0.0
        return float(np.mean([np.mean(one.passed) - np.mean(self.modelled(model, one)) for one in tries]))

    def modelled(self, model: StudyScoreModel, one: _Try) -> NDArray[np.bool_]:
        """Which tried lenses are good by the model."""
        return self.good(model.scores_of(one.batch))

    def along(self, model: StudyScoreModel, last: Budget) -> Budget:
        """The last tolerances times a common factor, by what trials say of such factors."""
        from scipy.special import ndtri

        direction = self.tries[MODEL_ROUNDS - 1].scales
        free = self.costs.low < self.costs.high
        known = [
            (float(np.mean(np.log(one.scales / direction)[free])), float(ndtri(one.yield_fraction)))
            for one in self.tries[MODEL_ROUNDS - 1 :]
        ]
        wanted = float(ndtri(self.required))
        above = max((k for k in known if k[1] >= wanted), default=None)
        below = min((k for k in known if k[1] < wanted), default=None)
        if above is not None and below is not None and above[0] < below[0]:
            share = (above[1] - wanted) / (above[1] - below[1])
            factor = above[0] + float(np.clip(share, 0.1, 0.9)) * (below[0] - above[0])
        else:
            logarithm, probit = known[-1]
            step = (probit - wanted) / PROBIT_SLOPE
            factor = logarithm + float(np.clip(step, -LARGEST_STEP, LARGEST_STEP))
        scales = np.clip(np.exp(factor) * direction, self.costs.low, self.costs.high)
        scales[~free] = 1.0
        cost = float(np.sum(self.costs.weights / scales))
        good = float(np.mean(self.good(model.scores(scales))))
        return replace(last, scales=scales, predicted_yield=good, cost=cost)

    def search(self, model: StudyScoreModel) -> Budget:
        """The loosest tolerances by the model, its yield corrected by what trials have shown so far.

        Raises
        ------
        InputError
            If the yield is out of reach of the smallest scales, by the model and by trials of the lens.
        """
        aim = float(np.clip(self.required - self.correction(model), 1e-3, 1.0 - 1e-3))
        low, high = self.costs.low, self.costs.high
        try:
            return allocate_tolerances(
                model,
                self.study.merits,
                aim,
                low=low,
                high=high,
                weights=self.costs.weights,
            )
        except InputError:
            smallest = self.smallest(model)
            own = self.tried(model, smallest, self.study.seed + 1).verified
            if own is not None and own.high >= self.required:
                return smallest
            raise InputError(
                f"required yield = {self.required:g}: out of reach; with the smallest scales, {SCALES[0]:g} "
                f"of the study's tolerances, {own.passed if own else 0} of {self.fresh} lenses are good"
            ) from None

    def smallest(self, model: StudyScoreModel) -> Budget:
        """The smallest scales, which the model takes for worse than they are."""
        low = self.costs.low

        def good(scales: Array) -> float:
            return float(np.mean(self.good(model.scores(scales))))

        ones = np.ones_like(low)
        weights = self.costs.weights
        return Budget(
            low, good(low), good(ones), float(np.sum(weights / low)), float(np.sum(weights)), None, None, 2
        )

    def tried(self, model: StudyScoreModel, budget: Budget, seed: int) -> StudyBudget:
        """What trials of the lens make of a budget."""
        perturbations = scaled_perturbations(self.study, budget.scales)
        scaled = self.study.model_copy(
            update={"perturbations": perturbations, "seed": seed, "draws": "random"}
        )
        context, scores = context_of(self.lens, scaled), list[Array]()
        batch = sample_perturbations(scaled, range(self.fresh))
        try:
            for start in range(0, self.fresh, ROWS_AT_ONCE):
                part = batch.part(slice(start, start + ROWS_AT_ONCE))
                scores.append(score_batch(self.study.merits, context, part)[0])
                self.progress(len(part))
        except KeyboardInterrupt:
            known = [self.good(own) for own in scores]
            verified = yield_of(np.concatenate([np.empty(0, bool), *known]))
            raise _TrialsInterrupted(self.made(budget, verified, seed, None)) from None
        one = _Try(budget.scales, batch, np.concatenate(scores), self.good(np.concatenate(scores)))
        self.tries.append(one)
        difference = one.passed.astype(float) - self.modelled(model, one)
        estimate = budget.predicted_yield + float(np.mean(difference))
        # Lens and model that agree in every trial may still differ in one of so many others.
        error = float(np.sqrt(np.var(difference) / self.fresh + 1.0 / self.fresh**2))
        return self.made(budget, yield_of(one.passed), seed, (estimate, error))

    def good(self, scores: Array) -> NDArray[np.bool_]:
        """Which lenses keep all limits, from their scores of shape (n, merits)."""
        return all_passed(self.study.merits, scores)

    def made(
        self, budget: Budget, verified: Yield | None, seed: int, estimate: tuple[float, float] | None
    ) -> StudyBudget:
        base, uniform = self.costs.base, budget.uniform_cost
        return StudyBudget(
            budget,
            base + budget.cost,
            base + budget.cost_before,
            None if uniform is None else base + uniform,
            verified,
            seed,
            None if estimate is None else estimate[0],
            None if estimate is None else estimate[1],
            self.required,
        )

    def progress(self, rows: int) -> None:
        self.scored += rows
        if self.report is not None:
            self.report(self.scored, most_trials(self.fresh))


@dataclass(frozen=True, eq=False)
class _Costs:
    """Costs at scale 1 and ranges of the scales, and the cost of the parts without tolerances."""

    weights: Array
    low: Array
    high: Array
    base: float


@dataclass(frozen=True, eq=False)
class _Try:
    """Scales that were tried, lenses with them, their scores, and which of them are good."""

    scales: Array
    batch: PerturbationBatch
    scores: Array
    passed: NDArray[np.bool_]

    @property
    def yield_fraction(self) -> float:
        """Fraction of good lenses, kept from 0 and 1 by half a lens."""
        return float(np.clip(np.mean(self.passed), 0.5 / len(self.passed), 1.0 - 0.5 / len(self.passed)))


class _TrialsInterrupted(KeyboardInterrupt):
    """Trials of a budget were interrupted; `found` has those that were scored."""

    def __init__(self, found: StudyBudget) -> None:
        super().__init__("interrupted")
        self.found = found


def scaled_perturbations(study: Study, scales: Array) -> tuple[Perturbation, ...]:
    """The perturbations of a study with their distributions scaled, to four digits.

    Raises
    ------
    InputError
        If a distribution has no width to scale.
    """
    perturbations = []
    for perturbation, scale in zip(study.perturbations, scales, strict=True):
        if not perturbation.distribution.widths:
            kind = "measured" if perturbation.file_name else perturbation.distribution.kind
            raise InputError(
                f"{perturbation.column}: a {kind} distribution has no width in the study file to scale; give "
                "it another distribution, or leave the perturbation out"
            )
        if scale != 1.0:
            shape = perturbation.scaled(float(scale)).distribution
            moved = ("mean",) if perturbation.is_irregularity and shape.centre else ()
            rounded = {name: float(f"{getattr(shape, name):.4g}") for name in (*shape.widths, *moved)}
            own = perturbation.distribution.model_copy(update=rounded)
            perturbation = perturbation.model_copy(update={"distribution": own})
        perturbations.append(perturbation)
    return tuple(perturbations)


def scaled_study(loaded: LoadedStudy, scales: Array) -> Study:
    """The study of a file with each perturbation's distribution scaled, to four digits.

    Parameters
    ----------
    loaded
        The study.
    scales : ndarray, shape (perturbations,)
        Of the widths of the distributions.

    Raises
    ------
    InputError
        If a distribution has no width to scale.
    """
    study = study_from_tables(tomllib.loads(loaded.study_text), loaded.name)
    return study.model_copy(update={"perturbations": scaled_perturbations(study, scales)})
