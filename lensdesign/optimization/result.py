"""Result of an optimization, its reliability, and unfinished steps."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lensdesign.analysis.double_reflections import ghost_paths
from lensdesign.analysis.report import CheckReport, WavelengthCheck
from lensdesign.analysis.space_bandwidth import sensor_spread_sine
from lensdesign.common.deadlines import deadline, now
from lensdesign.common.notebook import html_table
from lensdesign.common.text import finite_or_none, number_with_unit
from lensdesign.errors import DesignError, TransferLensError
from lensdesign.lens.lens import Lens
from lensdesign.lens.temperature import named_at
from lensdesign.optimization.as_built import AsBuilt, AsBuiltReport, TrialsOf
from lensdesign.optimization.limits.feasible_limits import (
    FeasibilityLimit,
    feasibility_limit,
    feasibility_limit_of,
)
from lensdesign.optimization.limits.search import LimitsInterrupted, binding
from lensdesign.optimization.local_search import SearchResult
from lensdesign.optimization.operands.operand import Operand
from lensdesign.optimization.problem import finished_lens
from lensdesign.optimization.specification.sections import (
    AS_BUILT_GOALS,
    GHOST_GOAL,
    LARGEST,
    LOSS_GOAL,
)
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification.stop_rules import Ending
from lensdesign.optimization.specification_check import at_temperatures, check_against

INTERRUPT = "interrupt"
"""Limit of a search that the user has stopped."""


@dataclass(frozen=True)
class WavelengthSpread:
    """Spread of the lens at one wavelength.

    Attributes
    ----------
    wavelength_um
        Vacuum wavelength.
    spread_deg, limit_deg
        Largest spread angle, and the limit of the sensor, in the medium in front of the sensor.
    share
        Sine of the spread divided by the sine of the limit.
    """

    wavelength_um: float
    spread_deg: float
    limit_deg: float
    share: float


@dataclass(frozen=True)
class GlassChoiceResult:
    """Result of one choice of glasses.

    Attributes
    ----------
    glasses
        Names of the glasses, front to back.
    found
        Results of its starts.
    limit
        Limit that ended the starts before they agreed; empty if there was none.
    dropped
        Reason of each start that could not be evaluated.
    """

    glasses: str
    found: tuple[SearchResult, ...]
    limit: str
    dropped: tuple[str, ...] = ()

    @property
    def best(self) -> SearchResult:
        """Result of the best start; of equally good ones, one that has converged."""
        first = min(self.found, key=lambda f: f.rank)
        alike = [f for f in self.found if f.converged and agree(f, first, 1e-6)]
        return min(alike, key=lambda f: f.rank, default=first)

    @property
    def at_best(self) -> int:
        """Number of starts that led to the best result."""
        return sum(agree(f, self.best) for f in self.found)


def agree(one: SearchResult, other: SearchResult, tolerance: float = 1e-3) -> bool:
    """Return whether two starts agree: in their goals or, without a feasible lens, in largest violations."""
    (violation, goal), (other_violation, other_goal) = one.rank, other.rank
    if violation or other_violation:
        close = abs(violation - other_violation) <= tolerance * (1.0 + other_violation)
        return close and bool(violation and other_violation)
    return abs(goal - other_goal) <= tolerance * abs(other_goal)


@dataclass(frozen=True, repr=False)
class OptimizationResult:
    """Result of an optimization.

    Attributes
    ----------
    lens
        The best lens: feasible if `feasible` is true, else the one with the smallest violation.
    variables
        Value of each variable by name, in the unit of its name.
    goal, goal_value, goal_unit
        Name, value and unit of the optimized quantity. The unit is ``deg``, ``mm``, ``waves`` or ``%``. With
        several wavelengths, the smallest spread is given in % of the limit of each.
    spreads
        Spread at each wavelength.
    feasible, violations
        Whether `lens` meets all constraints, and a sentence for each violation. A constraint that could not
        be checked, for lack of time or after an interrupt, counts as violated.
    check
        Check of the lens against the specification by :func:`lensdesign.optimization.check_against`.
    binding
        Active constraints and bounds, which prevent a better lens. Violated constraints are not among them.
    unfinished
        A sentence for each step that a limit of time or evaluations has shortened; empty if there is none.
    not_tried
        Choices of glasses that no start has tried.
    as_built
        Independent Monte Carlo trials of the start, of the tolerance study's lens and of the result. None if
        neither goal nor constraints concern lenses as built.
    reach
        Largest feasible field and aperture, if the specification could not be met; else None.
    evaluations, seconds
        Number of evaluated lenses, and wall-clock time (s).
    algorithm, stopped_because
        Algorithm of the starts, and the reason why they ended: ``agreement``, or a limit.
    glasses, starts, starts_at_best
        Best choice of glasses, number of its starts, and number of these starts whose goal is within 0.1 % of
        the best.

    Examples
    --------
    >>> from lensdesign import load_specification, optimize
    >>> result = optimize(load_specification("designs/feasible_singlet_spec.toml"))
    >>> result.goal, round(result.goal_value, 2), result.goal_unit
    ('smallest spread', 4.64, 'deg')
    >>> result.feasible, result.stopped_because
    (True, 'agreement')
    """

    lens: Lens
    variables: dict[str, float | str | None]
    goal: str
    goal_value: float
    goal_unit: str
    spreads: tuple[WavelengthSpread, ...]
    feasible: bool
    violations: tuple[str, ...]
    check: CheckReport
    binding: list[str]
    unfinished: list[str]
    not_tried: list[str]
    as_built: AsBuiltReport | None
    reach: FeasibilityLimit | None
    evaluations: int
    seconds: float
    algorithm: str
    stopped_because: str
    glasses: str
    starts: int
    starts_at_best: int

    @property
    def agreed(self) -> bool:
        """True if more than one start led to this lens."""
        return self.starts_at_best > 1

    def __repr__(self) -> str:
        met = "feasible" if self.feasible else f"not met: {len(self.violations)}"
        met += ", unfinished" if self.unfinished else ""
        return f"<OptimizationResult {self.goal} = {self.goal_value:.6g}, {met}, {self.lens!r}>"

    def _repr_html_(self) -> str:
        rows = [
            (name, "plane" if v is None else f"{v:.8g}" if isinstance(v, float) else v)
            for name, v in self.variables.items()
        ]
        rows = [
            *(("not finished", sentence) for sentence in self.unfinished),
            *rows,
            (self.goal, number_with_unit(f"{self.goal_value:.6g}", self.goal_unit)),
            ("binding", ", ".join(self.binding)),
            *(("not met", sentence) for sentence in self.violations),
            ("search", f"{self.algorithm}: {self.evaluations} evaluations in {self.seconds:.2f} s"),
            ("starts", f"{self.starts_at_best} of {self.starts} reached this lens"),
        ]
        return html_table("Optimization", rows) + self.lens._repr_html_()

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, without the lens."""
        plain = {
            k: v for k, v in vars(self).items() if k not in ("lens", "check", "spreads", "reach", "as_built")
        }
        return plain | {
            "title": self.lens.title,
            "spreads": [asdict(s) for s in self.spreads],
            "as_built": None if self.as_built is None else asdict(self.as_built),
            "reach": None if self.reach is None else self.reach.as_dict(),
            "constraints": [
                {k: finite_or_none(v) for k, v in asdict(c).items()} for c in self.check.constraints
            ],
        }


def result_of(
    specification: Specification, tried: list[GlassChoiceResult], ending: Ending
) -> OptimizationResult:
    """Return the best of all choices of glasses, checked against its specification.

    Parameters
    ----------
    specification
        Specification of the search.
    tried
        All choices of glasses, at least one of them with a completed start.
    ending
        End of the search. An interrupt from here on also shortens the remaining steps.

    Raises
    ------
    DesignError
        If the best point is not a valid lens.
    """
    try:
        return _result(specification, tried, ending)
    except KeyboardInterrupt as stop:
        if ending.interrupted:
            raise
        ending.interrupted = True
        found = feasibility_limit_of(stop.limits) if isinstance(stop, LimitsInterrupted) else None
        return _result(specification, tried, ending, found)


def _result(
    specification: Specification,
    tried: list[GlassChoiceResult],
    ending: Ending,
    reach: FeasibilityLimit | None = None,
) -> OptimizationResult:
    chosen = min((t for t in tried if t.found), key=lambda t: t.best.rank)
    best = chosen.best
    problem, point = best.problem, best.outcome.point
    goals, _ = problem.rows(point, best.rays, final=True, derivatives=False)
    unfinished = _unfinished(specification, tried, chosen)
    searched = not unfinished and not ending.interrupted

    def can() -> FeasibilityLimit:
        with deadline(ending.end):
            report = ending.report or (lambda _: None)
            return feasibility_limit(specification, problem.base, chosen.glasses, point, ending.seed, report)

    try:
        lens = finished_lens(problem, point, best.rays)
    except DesignError as error:
        others = [replace(t, found=tuple(one for one in t.found if one is not best)) for t in tried]
        if any(t.found for t in others):
            return _result(specification, others, ending, reach)
        if ending.interrupted:
            raise KeyboardInterrupt(f"interrupted; nothing was written: {error}") from None
        sentences = [*unfinished, str(error)]
        if not (specification.asks_losses or specification.asks_ghosts):
            sentences.append(can().in_words(specification.required_object))
        raise DesignError("; ".join(sentences)) from None
    unchecked: list[str] = []
    if ending.built is None and specification.as_built is not None:
        if ending.no_trials:
            sentence = f"{ending.reason} ended the search before the trials of lenses as built"
            unfinished.append(sentence)
            unchecked = _unchecked(specification, sentence)
        else:
            ending.built = _as_built(specification, lens)
    built = ending.built
    check = check_against(lens, specification.without_as_built() if unchecked else specification, built)
    # A search for the feasibility limit takes too long if each lens needs reconstructions or ghosts.
    takes_too_long = specification.asks_losses or specification.asks_ghosts
    if not check.feasible and reach is None and not takes_too_long:
        if searched and now() < ending.end:
            reach = can()
        elif searched:
            unfinished.append(f"{ending.reason} ended the search before the feasibility limit was found")
    value, unit = _shown_goal(specification, lens, goals, built)
    starts = len(chosen.found)
    # A constraint is active if the absolute value of its scaled value is smaller than this.
    tolerance = 1e-4
    return OptimizationResult(
        lens=lens,
        variables=_variables(specification, lens),
        goal=specification.optimize.goal,
        goal_value=value,
        goal_unit=unit,
        spreads=tuple(_spread(row) for row in check.wavelengths),
        feasible=check.feasible and not unchecked,
        violations=(*check.violations, *unchecked),
        check=check,
        binding=list(binding(problem, point, best.rays, tolerance)),
        unfinished=unfinished,
        as_built=built,
        not_tried=[t.glasses for t in tried if not t.found and t.limit],
        reach=reach,
        evaluations=sum(f.outcome.evaluations for t in tried for f in t.found),
        seconds=now() - ending.began,
        algorithm=specification.optimize.algorithm,
        stopped_because=_end(specification, chosen),
        glasses=chosen.glasses,
        starts=starts,
        starts_at_best=chosen.at_best,
    )


def _unchecked(specification: Specification, why: str) -> list[str]:
    """Return a sentence for each constraint on lenses as built, which needs trials."""
    limits = specification.constraints
    required = {
        "yield": limits.min_yield,
        "as-built rms": limits.max_as_built_rms_waves,
        LOSS_GOAL: limits.max_as_built_reconstruction_loss,
    }
    return [f"{name}: not checked, because {why}" for name, limit in required.items() if limit is not None]


def _as_built(specification: Specification, lens: Lens) -> AsBuiltReport | None:
    """Return trials of the start (if it is a design), of the lens of the study, and of the result."""
    tolerances, study = specification.tolerances, specification.as_built
    if tolerances is None or study is None:
        return None
    lenses = []
    if specification.optimize.start == "design":
        lenses.append(("start", specification.lens))
    lenses.append(("lens of the study", study.reference))
    others = [row for own in lenses for row in _rows_if_possible(study, own, tolerances.trials)]
    hot = [(named_at("result", t), one) for t, one in at_temperatures(lens, specification)]
    found = study.trials([("result", lens), *hot], tolerances.trials)
    return replace(found, rows=(*others, *found.rows))


def _rows_if_possible(study: AsBuilt, named: tuple[str, Lens], trials: int) -> tuple[TrialsOf, ...]:
    """Return trials of a lens for comparison; none if they are not possible."""
    try:
        return study.trials([named], trials).rows
    except TransferLensError:
        return ()


def _unfinished(
    specification: Specification, tried: list[GlassChoiceResult], chosen: GlassChoiceResult
) -> list[str]:
    """Return a sentence for each step that a limit has shortened."""
    settings, best = specification.optimize, chosen.best
    sentences = []
    for limit in ("max_evaluations", "max_seconds"):
        value = getattr(settings, limit)
        cut = [t for t in tried if t.limit == limit and t.found]
        if cut:
            names = "; ".join(f"{t.glasses} (start {len(t.found)} of at most {settings.starts})" for t in cut)
            sentences.append(f"{limit} = {value:g} ended the search of {names}")
        none = [t.glasses for t in tried if t.limit == limit and not t.found]
        if none:
            sentences.append(f"{limit} = {value:g} ended the search before {'; '.join(none)} could be tried")
    cut = [t for t in tried if t.limit == INTERRUPT]
    if cut:
        names = "; ".join(f"{t.glasses} (start {len(t.found)} of at most {settings.starts})" for t in cut)
        sentences.append(f"an interrupt ended the search of {names}")
    if not sentences and not best.converged and chosen.at_best < settings.agreeing:
        sentences.append(
            f"the best start did not converge ({best.outcome.stopped_because}); try another algorithm or "
            "narrower bounds"
        )
    return sentences


def _end(specification: Specification, chosen: GlassChoiceResult) -> str:
    """Return the reason why the starts ended."""
    if chosen.limit:
        return chosen.limit
    settings = specification.optimize
    if chosen.at_best < settings.agreeing:
        return f"starts = {settings.starts}"
    return "agreement" if chosen.at_best > 1 else f"agreeing = {settings.agreeing}"


def _variables(specification: Specification, lens: Lens) -> dict[str, float | str | None]:
    values: dict[str, float | str | None] = {}
    for v in specification.variables:
        surface = lens.surfaces[(v.surface or 1) - 1]
        if v.parameter == "stop":
            values["stop on surface"] = str(lens.stop_index + 1)
        elif v.surface is None:
            values[v.name] = getattr(lens.object, v.parameter)
        elif hasattr(surface, v.parameter):
            values[v.name] = getattr(surface, v.parameter)
        else:
            values[v.name] = surface.shape.term(v.parameter)
    return values


def _goal(specification: Specification, lens: Lens, goals: list[Operand]) -> tuple[float, str]:
    """Return the goal of a lens in its usual unit."""
    largest = max(float(np.max(row.values)) for row in goals)
    goal, waves = specification.optimize.goal, specification.wavelengths_um
    if goal == "smallest spread" and len(waves) > 1:
        return 100.0 * math.sqrt(largest), "%"
    if goal.startswith("smallest spread"):
        # The references of `goal_operands`.
        reference = lens if goal == "smallest spread" else specification
        sine = math.sqrt(largest) * sensor_spread_sine(reference, max(waves))
        return math.degrees(math.asin(min(1.0, sine))), "deg"
    if goal == "smallest aperture":
        return math.sqrt(largest) * specification.stop_semi_diameter_mm, "mm"
    if goal in LARGEST:
        return getattr(specification.object, LARGEST[goal]) / largest, "mm"
    return largest * specification.exit_vertex_z_mm, "mm"


def _shown_goal(
    specification: Specification, lens: Lens, goals: list[Operand], built: AsBuiltReport | None
) -> tuple[float, str]:
    """Return the goal of the finished lens; without trials, goals of lenses as built are predicted."""
    goal, study = specification.optimize.goal, specification.as_built
    if goal == GHOST_GOAL:
        return ghost_paths(lens).total(), ""
    if built is not None:
        return _built_goal(specification, lens, goals, built)
    if goal not in AS_BUILT_GOALS or study is None:
        return _goal(specification, lens, goals)
    if goal == LOSS_GOAL:
        return max(float(np.max(row.values)) for row in goals), ""
    predicted = study.predict(lens)
    return (max(predicted.rms_waves), "waves") if goal == "as-built rms" else (100.0 * predicted.good, "%")


def _built_goal(
    specification: Specification, lens: Lens, goals: list[Operand], built: AsBuiltReport
) -> tuple[float, str]:
    """Return the goal of lenses as built at all temperatures, predicted or, for some yields, by trials."""
    environment = specification.environment
    own = built.rows[-1 - (0 if environment is None else len(environment.temperatures_c)) :]
    if specification.optimize.goal == "as-built rms":
        return max(max(row.predicted_rms_waves) for row in own), "waves"
    if specification.optimize.goal == "yield":
        return 100.0 * min(row.good if row.predicted_good is None else row.predicted_good for row in own), "%"
    if specification.optimize.goal == LOSS_GOAL:
        return max(loss.predicted for row in own for loss in row.losses), ""
    return _goal(specification, lens, goals)


def _spread(row: WavelengthCheck) -> WavelengthSpread:
    spread, limit = row.max_spread_deg, row.spread_limit_deg
    share = math.sin(math.radians(min(spread, 90.0))) / math.sin(math.radians(limit))
    return WavelengthSpread(row.wavelength_um, spread, limit, share)
