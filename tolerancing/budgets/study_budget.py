"""Tolerance budgets of studies, found on a score model and verified by trials of the lens."""

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
"""Range of the scales of tolerances."""

MOST_ROUNDS, MODEL_ROUNDS = 8, 2
"""Largest number of rounds, and number of first rounds that rely even on an inaccurate response surface."""

COARSE_DRAWS = 2048
"""Number of drawn lenses with which a search begins."""

Progress = Callable[[int, int], None]
"""Progress callback: `progress(completed, most)`, in trials of the lens."""


@dataclass(frozen=True, eq=False)
class StudyBudget:
    """A tolerance budget, and its yield in trials of the lens itself.

    Attributes
    ----------
    budget
        Scales of the tolerances, found on a model of the scores and corrected by trials of the lens.
    cost, cost_before, uniform_cost
        Costs of the new tolerances, of the study's tolerances, and of the largest common scale that meets the
        yield (None if there is none). A cost is the sum of weight / scale, plus the cost of the parts without
        tolerances.
    verified
        Yield in new random trials with the tolerances rounded as in :func:`scaled_study`; None if the search
        was interrupted before a trial was scored.
    seed
        Seed of these trials. A run of the scaled study with this seed has the same trials.
    estimated_yield, estimated_yield_error
        More precise estimate of the same yield, with the model's yield as a control variate, and its standard
        error; None if not all trials were scored.
    required
        The required yield.
    yield_before
        Yield of the trials from which the search started, with the tolerances of the study; None without any.

    Examples
    --------
    >>> from tolerancing import budget, load_study, open_store, run_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     found = budget(store, required=0.9, fresh=100)
    >>> round(found.cost), round(found.uniform_cost), found.agrees
    (13, 20, True)
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
    yield_before: Yield | None

    @property
    def agrees(self) -> bool:
        """True if the 95 % interval contains the required yield and the estimated yield is close to it.

        A yield above the requirement agrees if every tolerance has its largest allowed value.
        """
        if self.verified is None or self.estimated_yield is None or self.estimated_yield_error is None:
            return False
        excess = self.estimated_yield - self.required
        # Accepted difference between the estimated and the required yield.
        close_enough = 0.002
        close = max(close_enough, self.estimated_yield_error)
        if self.at_widest:
            return excess >= -close
        return self.verified.low <= self.required <= self.verified.high and abs(excess) <= close

    @property
    def is_precise(self) -> bool:
        """True if the standard error of the estimated yield is at most half a percentage point."""
        return self.estimated_yield_error is not None and self.estimated_yield_error <= 0.005

    @property
    def at_widest(self) -> bool:
        """True if every tolerance has its largest allowed value."""
        return bool(np.all((self.budget.scales >= SCALES[1]) | (self.budget.scales == 1.0)))


class BudgetInterrupted(KeyboardInterrupt):
    """Raised on interruption of a budget; `found` is the best budget so far, or None."""

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
    progress: Progress | None = None,
) -> StudyBudget:
    """Find the tolerances of least cost that meet a yield, starting from the trials of a store.

    A search on a model of the scores finds the scales of the tolerances. New trials of the lens verify and
    correct them; :func:`tolerancing.budgets.budget_of_study` explains the steps.

    :func:`scaled_study` returns the study with these tolerances.

    Parameters
    ----------
    store
        Open store with enough trials for the model; the error message names the number.
    required
        Required yield, above 0 and below 1.
    weights
        Cost of each tolerance at scale 1, by the column of its perturbation; default: 1.
    fixed
        Columns of the perturbations whose tolerances stay unchanged, at no cost.
    base_cost
        Cost of the parts without tolerances; every cost of the result includes it.
    fresh
        Number of new trials of the lens in each round.
    progress
        Progress callback: `progress(completed, most)`, in trials of the lens.

    Returns
    -------
    StudyBudget
        Scales of the tolerances, their cost, and their verified yield.

    Raises
    ------
    InputError
        If a weight names no perturbation, a distribution has no width to scale, there are too few trials, or
        the yield cannot be met.
    BudgetInterrupted
        If the search is interrupted; its `found` is the best budget so far.

    Examples
    --------
    >>> from tolerancing import budget, load_study, open_store, run_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     found = budget(store, required=0.9, weights={"lens_tilt_x_deg": 2.0}, fresh=100)
    >>> len(found.budget.scales), found.verified.low < 0.9 < found.verified.high
    (12, True)
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
        progress=progress,
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
    progress: Progress | None = None,
) -> StudyBudget:
    """Find the tolerances of least cost that meet a required yield.

    1. A search on a score model of all merits (:mod:`tolerancing.budgets.score_model`) finds the scales of
       least cost for which the required fraction of its lenses is good. Losses of reconstructions are then
       fitted again near these scales, and the search is repeated. A merit whose response surface is poor is
       omitted until there are trials near the scales found.
    2. Random trials of the lens itself, with a seed other than the study's, verify the result.
    3. If they disagree with the requirement, or leave the yield uncertain by a standard error of more than
       half a percentage point, the difference between the yields of lens and model on the same trials
       corrects the target, and the trials improve the response surfaces. Both steps are repeated with
       another seed. If a response surface is still inaccurate after two rounds, a common factor of the
       tolerances is found from the yields of trials alone (regula falsi in probit(yield) over the logarithm
       of the factor).

    Parameters
    ----------
    lens
        The nominal lens.
    study
        The study.
    values, scores
        Trials of the study, shapes (n, perturbations) and (n, merits).
    required
        Required yield, above 0 and below 1.
    weights
        Cost of each perturbation's tolerance at scale 1, by column; default: 1.
    fixed
        Columns whose tolerances stay unchanged, at no cost.
    base_cost
        Cost of the parts without tolerances, which every cost of the result includes.
    fresh
        Number of new trials of the lens in each round.
    progress
        Progress callback: `progress(completed, most)`, in trials of the lens.

    Raises
    ------
    InputError
        If a weight names no perturbation, a distribution has no width to scale, there are too few trials for
        a response surface, or the yield cannot be met.
    BudgetInterrupted
        If the search is interrupted.
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
    is_fixed = np.array([column in fixed for column in columns])
    # The search needs a positive weight for fixed tolerances as well.
    costs = _Costs(
        np.where(is_fixed, 1e-12, [(weights or {}).get(column, 1.0) for column in columns]),
        np.where(is_fixed, 1.0, SCALES[0]),
        np.where(is_fixed, 1.0, SCALES[1]),
        base_cost,
    )
    return _Rounds(lens, study, required, costs, fresh, progress).run(values, scores)


def most_trials(fresh: int) -> int:
    """Return the largest number of trials of a budget with this number of trials in each round."""
    return MOST_ROUNDS * fresh


def most_seconds(store: Store, fresh: int) -> float:
    """Return the longest computing time of a budget, estimated from the trials of a store."""
    return most_trials(fresh) * float(np.mean(store.trials().seconds))


class _Rounds:
    """Rounds of search and verification, with all verification trials so far."""

    def __init__(
        self, lens: Lens, study: Study, required: float, costs: _Costs, fresh: int, progress: Progress | None
    ) -> None:
        self.lens, self.study, self.required, self.costs, self.fresh = lens, study, required, costs, fresh
        self.progress, self.scored = progress, 0
        self.verifications: list[_Verification] = []
        self.before: Yield | None = None

    def run(self, values: Array, scores: Array) -> StudyBudget:
        """Search and verify until trials and requirement agree."""
        found: StudyBudget | None = None
        self.before = yield_of(self.good(scores))
        try:
            self.report_progress(0)
            model = StudyScoreModel(self.lens, self.study, values, scores)
            first = self.search(model)
            if model.refine(first.scales):
                first = self.search(model, first.scales)
            for index in range(MOST_ROUNDS):
                if found is not None and index >= MODEL_ROUNDS and self.is_inaccurate(model):
                    candidate = self.scale_by_trials(model, found.budget)
                else:
                    candidate = self.search(model, found.budget.scales) if found is not None else first
                found = self.verify(model, candidate, self.study.seed + 1 + index)
                if found.agrees and found.is_precise:
                    break
                if model.not_predicted:
                    values = np.concatenate([values, self.verifications[-1].batch.values])
                    scores = np.concatenate([scores, self.verifications[-1].scores])
                    model.fit(values, scores)
                    model.check_fit(self.verifications[-1].scores)
        except _TrialsInterrupted as stop:
            raise BudgetInterrupted(stop.found) from None
        except KeyboardInterrupt:
            raise BudgetInterrupted(found) from None
        assert found is not None  # there is a round
        return found

    def correction(self, model: StudyScoreModel) -> float:
        """Return the yield of the lens minus that of the model on the verification trials.

        The difference changes with the tolerances: rounds with tolerances like those of the last one count.
        """
        return float(np.mean(self.differences(model))) if self.verifications else 0.0

    def differences(self, model: StudyScoreModel) -> Array:
        """Return 1 for trials that only the lens passes, -1 for those that only the model passes, else 0.

        The trials are those of the rounds whose tolerances are like those of the last one.
        """
        last, alike = self.verifications[-1], 1.25
        rounds = [
            one
            for one in self.verifications
            if np.all(np.abs(np.log(one.scales / last.scales)) < np.log(alike))
        ]
        return np.concatenate([one.passed.astype(float) - self.modelled(model, one) for one in rounds])

    def is_inaccurate(self, model: StudyScoreModel) -> bool:
        """Return whether the model has a response surface and is wrong for too many of the last trials."""
        most_errors = 0.1
        return bool(model.not_predicted) and float(np.mean(np.abs(self.differences(model)))) > most_errors

    def modelled(self, model: StudyScoreModel, one: _Verification) -> NDArray[np.bool_]:
        """Return whether each verification lens is good by the model."""
        return self.good(model.scores_of(one.batch))

    def scale_by_trials(self, model: StudyScoreModel, last: Budget) -> Budget:
        """Return the last tolerances times a common factor that is found from the yields of trials."""
        from scipy.special import ndtri

        direction = self.verifications[MODEL_ROUNDS - 1].scales
        free = self.costs.low < self.costs.high
        known = [
            (float(np.mean(np.log(one.scales / direction)[free])), float(ndtri(one.yield_fraction)))
            for one in self.verifications[MODEL_ROUNDS - 1 :]
        ]
        target = float(ndtri(self.required))
        above = max((k for k in known if k[1] >= target), default=None)
        below = min((k for k in known if k[1] < target), default=None)
        if above is not None and below is not None and above[0] < below[0]:
            fraction = (above[1] - target) / (above[1] - below[1])
            factor = above[0] + float(np.clip(fraction, 0.1, 0.9)) * (below[0] - above[0])
        else:
            # First guess of -d probit(yield) / d log(common factor), and largest step of the logarithm.
            probit_slope, largest_step = 2.0, 0.5
            logarithm, probit = known[-1]
            step = (probit - target) / probit_slope
            factor = logarithm + float(np.clip(step, -largest_step, largest_step))
        scales = np.clip(np.exp(factor) * direction, self.costs.low, self.costs.high)
        scales[~free] = 1.0
        cost = float(np.sum(self.costs.weights / scales))
        good = float(np.mean(self.good(model.scores(scales))))
        return replace(last, scales=scales, predicted_yield=good, cost=cost)

    def search(self, model: StudyScoreModel, start: Array | None = None) -> Budget:
        """Return the tolerances of least cost by the model, whose yield is corrected by the trials so far.

        The scales of an earlier search are a good start.

        Raises
        ------
        InputError
            If the smallest scales do not meet the yield, by the model and by trials of the lens.
        """
        target = float(np.clip(self.required - self.correction(model), 1e-3, 1.0 - 1e-3))
        low, high = self.costs.low, self.costs.high
        try:
            return allocate_tolerances(
                model,
                self.study.merits,
                target,
                low=low,
                high=high,
                weights=self.costs.weights,
                coarse=model.with_draws(COARSE_DRAWS),
                start=start,
            )
        except InputError:
            smallest = self.smallest(model)
            own = self.verify(model, smallest, self.study.seed + 1).verified
            if own is not None and own.high >= self.required:
                return smallest
            raise InputError(
                f"required yield = {self.required:g}: out of reach; with the smallest scales, {SCALES[0]:g} "
                f"of the study's tolerances, {own.passed if own else 0} of {self.fresh} lenses are good"
            ) from None

    def smallest(self, model: StudyScoreModel) -> Budget:
        """Return the budget of the smallest scales, whose yield the model underestimates."""
        low = self.costs.low

        def good(scales: Array) -> float:
            return float(np.mean(self.good(model.scores(scales))))

        ones = np.ones_like(low)
        weights = self.costs.weights
        return Budget(
            low, good(low), good(ones), float(np.sum(weights / low)), float(np.sum(weights)), None, None, 2
        )

    def verify(self, model: StudyScoreModel, budget: Budget, seed: int) -> StudyBudget:
        """Verify a budget by random trials of the lens."""
        perturbations = scaled_perturbations(self.study, budget.scales)
        scaled = self.study.model_copy(
            update={"perturbations": perturbations, "seed": seed, "draws": "random"}
        )
        context, scores = context_of(self.lens, scaled), list[Array]()
        batch = sample_perturbations(scaled, range(self.fresh))
        try:
            for start in range(0, self.fresh, ROWS_AT_ONCE):
                block = batch.subset(slice(start, start + ROWS_AT_ONCE))
                scores.append(score_batch(self.study.merits, context, block)[0])
                self.report_progress(len(block))
        except KeyboardInterrupt:
            known = [self.good(own) for own in scores]
            verified = yield_of(np.concatenate([np.empty(0, bool), *known]))
            raise _TrialsInterrupted(self.result(budget, verified, seed, None)) from None
        one = _Verification(budget.scales, batch, np.concatenate(scores), self.good(np.concatenate(scores)))
        self.verifications.append(one)
        difference = self.differences(model)
        count = len(difference)
        estimate = budget.predicted_yield + float(np.mean(difference))
        # Lens and model that agree in every trial may still differ in other trials.
        error = float(np.sqrt(np.var(difference) / count + 1.0 / count**2))
        return self.result(budget, yield_of(one.passed), seed, (estimate, error))

    def good(self, scores: Array) -> NDArray[np.bool_]:
        """Return whether each lens meets all limits, from scores of shape (n, merits)."""
        return all_passed(self.study.merits, scores)

    def result(
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
            self.before,
        )

    def report_progress(self, rows: int) -> None:
        self.scored += rows
        if self.progress is not None:
            self.progress(self.scored, most_trials(self.fresh))


@dataclass(frozen=True, eq=False)
class _Costs:
    """Costs at scale 1 and ranges of the scales, and the cost of the parts without tolerances."""

    weights: Array
    low: Array
    high: Array
    base: float


@dataclass(frozen=True, eq=False)
class _Verification:
    """Verification trials of some scales: the lenses, their scores, and whether they are good."""

    scales: Array
    batch: PerturbationBatch
    scores: Array
    passed: NDArray[np.bool_]

    @property
    def yield_fraction(self) -> float:
        """Fraction of good lenses, at least half a lens from 0 and from 1."""
        return float(np.clip(np.mean(self.passed), 0.5 / len(self.passed), 1.0 - 0.5 / len(self.passed)))


class _TrialsInterrupted(KeyboardInterrupt):
    """Raised on interruption of verification trials; `found` includes the trials that were scored."""

    def __init__(self, found: StudyBudget) -> None:
        super().__init__("interrupted")
        self.found = found


def scaled_perturbations(study: Study, scales: Array) -> tuple[Perturbation, ...]:
    """Return the perturbations of a study with scaled distributions, rounded to four digits.

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
                "it another distribution, or remove the perturbation"
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
    """Return a study with scaled tolerances.

    The widths of the distributions are multiplied by the scales and rounded to four digits.

    Parameters
    ----------
    loaded
        Study with its lens.
    scales : ndarray, shape (perturbations,)
        Factors of the widths of the distributions, such as those of a :class:`StudyBudget`.

    Returns
    -------
    Study
        The scaled study; :func:`tolerancing.study.files.save_study` writes it to a file.

    Raises
    ------
    InputError
        If a distribution has no width to scale.

    Examples
    --------
    >>> import numpy as np
    >>> from tolerancing import load_study, scaled_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> tighter = scaled_study(loaded, np.full(len(loaded.study.perturbations), 0.5))
    >>> loaded.study.perturbations[0].tolerance, tighter.perturbations[0].tolerance
    (0.016, 0.008)
    """
    study = study_from_tables(tomllib.loads(loaded.study_text), loaded.name)
    return study.model_copy(update={"perturbations": scaled_perturbations(study, scales)})
