"""A tolerance study: lens, perturbations, merits and series; the contents of a study file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Literal

from pydantic import Field, SerializeAsAny, model_validator

from lensdesign.common.frozen_model import FiniteNumber, FrozenModel
from tolerancing.merits.base import Merit
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Sampling
from tolerancing.perturbations.dependence import Correlation, Dependence, study_dependence
from tolerancing.perturbations.draws import DRAWS
from tolerancing.perturbations.parameters import Perturbation, PerturbedParameter
from tolerancing.study.scaled_trials import ScaledTrials, TrialsAtFactors
from tolerancing.study.series import Series
from tolerancing.study.slice_counts import SliceCounts
from tolerancing.study.sweep import OneAtATime, ParameterGrid, Sweep

MOST_TRIALS = 10_000_000

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class Fidelity(FrozenModel):
    """Criteria for the levels of merits, and for the trials that high-fidelity merits score.

    A high-fidelity merit names in `predicted_by` the low-fidelity merit that it refines.

    Attributes
    ----------
    largest_difference
        Largest difference between the scores of two levels of an ``auto`` merit, in any of the first six
        trials, for which the faster level is selected.
    worst_share
        Fraction of all trials that are selected because they are the worst by the low-fidelity merit.
    random_share
        Fraction of all trials that are selected at random from the others.

    Examples
    --------
    >>> Fidelity(random_share=0.1).worst_share
    0.02
    """

    largest_difference: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.03
    worst_share: Fraction = 0.02
    random_share: Fraction = 0.05


class Study(FrozenModel):
    """A tolerance study: the contents of a study file.

    The names in brackets below are the tables of the file. :meth:`replaced` returns a changed study.

    Attributes
    ----------
    title
        Title of the study.
    design
        Design file of the lens, relative to the study file.
    trials
        Number of Monte Carlo trials.
    seed
        Seed of all random numbers.
    pivot_z_mm
        Position on the axis about which the whole lens tilts, in mm from its front vertex.
    sampling
        Sampling of rays and pupils.
    draws
        Sampling method of the trials: ``random``, ``latin_hypercube`` or ``sobol``.
    sensitivity
        Whether each perturbation is also varied alone, to fractions of its tolerance.
    fidelity
        Rules that select the levels of merits, and the trials that high-fidelity merits score.
    perturbations
        Perturbed parameters with their distributions (``[[perturbation]]``).
    correlations
        Correlations of perturbations (``[[correlation]]``).
    compensators
        Parameters that the model of the reconstruction adapts to each lens (``[[compensator]]``).
    all_merits
        Merits with their limits (``[[merit]]``).
    scaled_trials
        Trials with all tolerances multiplied, for the yield against the tolerances (``[scaled_trials]``).
    sweeps, grids, slice_counts
        Series of steps that vary one parameter, two parameters, or the number of slices (``[[sweep]]``,
        ``[[grid]]``, ``[[slice_count]]``).

    Examples
    --------
    >>> from tolerancing import load_study
    >>> study = load_study("designs/as_built_tolerances.toml").study
    >>> study.trials, len(study.perturbations), [merit.label for merit in study.merits]
    (1000, 12, ['wavefront'])
    >>> study.replaced(draws="sobol").draws
    'sobol'
    """

    title: str = ""
    design: str
    trials: Annotated[int, Field(ge=1, le=MOST_TRIALS)]
    seed: Annotated[int, Field(ge=0)]
    pivot_z_mm: FiniteNumber = 0.0
    draws: Literal[DRAWS] = "random"  # type: ignore[valid-type]
    sensitivity: bool = True
    sampling: Sampling = Sampling()
    fidelity: Fidelity = Fidelity()
    scaled_trials: ScaledTrials | None = None
    perturbations: Annotated[
        tuple[SerializeAsAny[Perturbation], ...], Field(alias="perturbation", min_length=1)
    ]
    correlations: tuple[Correlation, ...] = Field(default=(), alias="correlation")
    compensators: tuple[Compensator, ...] = Field(default=(), alias="compensator")
    all_merits: Annotated[tuple[SerializeAsAny[Merit], ...], Field(alias="merit", min_length=1)]
    sweeps: tuple[Sweep, ...] = Field(default=(), alias="sweep")
    grids: tuple[ParameterGrid, ...] = Field(default=(), alias="grid")
    slice_counts: tuple[SliceCounts, ...] = Field(default=(), alias="slice_count")

    @property
    def merits(self) -> tuple[Merit, ...]:
        """Merits that score all trials."""
        return tuple(m for m in self.all_merits if m.predicted_by is None)

    @property
    def high_fidelity_merits(self) -> tuple[Merit, ...]:
        """High-fidelity merits, which score selected trials."""
        return tuple(m for m in self.all_merits if m.predicted_by is not None)

    @cached_property
    def series(self) -> tuple[Series, ...]:
        """Series: sweeps, grids, slice counts, sensitivities, and trials with multiplied tolerances."""
        alone = (OneAtATime(self.perturbations),) if self.sensitivity else ()
        return (*self.sweeps, *self.grids, *self.slice_counts, *alone, *self._trials_at_factors)

    @property
    def _trials_at_factors(self) -> tuple[TrialsAtFactors, ...]:
        if self.scaled_trials is None:
            return ()
        how = self.draws, self.seed, self.trials, self.pivot_z_mm
        return (TrialsAtFactors(self.scaled_trials, self.perturbations, self.dependence, *how),)

    @cached_property
    def dependence(self) -> Dependence:
        """Dependences between perturbations: groups and correlations."""
        groups: dict[str, list[str]] = {}
        for p in self.perturbations:
            if p.group is not None:
                groups.setdefault(p.group, []).append(p.column)
        return study_dependence([p.column for p in self.perturbations], self.correlations, groups)

    @property
    def compensated(self) -> tuple[Merit, ...]:
        """Merits that depend on refocusing or compensators."""
        return tuple(m for m in self.merits if m.is_compensated(bool(self.compensators)))

    @property
    def extra_columns(self) -> tuple[str, ...]:
        """Columns in addition to scores: scores without compensation, and values of the compensators."""
        return (
            *(f"{m.column}_uncompensated" for m in self.compensated),
            *(f"compensator_{c.column}" for c in self.compensators),
        )

    @property
    def levels(self) -> dict[str, str]:
        """Levels of the merits, by label; for an undecided level, the fastest."""
        return {merit.label: merit.used_level for merit in self.all_merits}

    def with_levels(self, levels: Mapping[str, str]) -> Study:
        """Return the study with the given levels of its merits, by label."""
        merits = tuple(
            merit.model_copy(update={"level": levels.get(merit.label, merit.used_level)})
            for merit in self.all_merits
        )
        return self.model_copy(update={"all_merits": merits})

    @model_validator(mode="after")
    def _consistent(self) -> Study:
        validate_not_repeated([p.column for p in self.perturbations], "two perturbations")
        validate_not_repeated([m.label for m in self.all_merits], "two merits")
        validate_not_repeated([c.column for c in self.compensators], "two compensators")
        validate_not_repeated([s.label for s in self.series], "two sweeps, grids or slice counts")
        columns = [
            "trial",
            "status",
            "message",
            "passed",
            "seconds",
            "finished",
            *(p.column for p in self.perturbations),
            *(m.column for m in self.all_merits),
            *self.extra_columns,
        ]
        validate_not_repeated(columns, "a perturbation or merit and another column")
        self._check_names()
        self._check_settings()
        self.dependence  # noqa: B018  raises if groups and correlations contradict each other
        return self

    def _check_names(self) -> None:
        """Raise a ValueError for names of merits that do not exist."""
        labels = [m.label for m in self.merits]
        if not labels:
            raise ValueError("merit: all have predicted_by; at least one merit must score all trials")
        for merit in self.high_fidelity_merits:
            validate_merit_name(f"merit {merit.label!r}: predicted_by", merit.predicted_by, labels)
        every = [m.label for m in self.all_merits]
        for kind, tables in (("sweep", self.sweeps), ("grid", self.grids)):
            for table in tables:
                for label in table.merits:
                    validate_merit_name(f"{kind} {table.label!r}: merits", label, every)

    def _check_settings(self) -> None:
        """Raise a ValueError for settings of the reconstruction without effect or without derivative."""
        varied = [p for p in self.varied_parameters if p.is_setting]
        for parameter in varied:
            if not any(merit.varies_slices for merit in self.all_merits):
                raise ValueError(
                    f"{parameter.column}: no merit of the study depends on the number of slices; add a merit "
                    "of kind 'reconstruction' with reconstruction_engine = 'slices'"
                )
        named = [p.column for p in self.perturbations if p.is_setting]
        if named and self.sensitivity:
            raise ValueError(
                f"{named[0]}: a number of slices has no fractions of a tolerance; give sensitivity = false, "
                "and add a [[sweep]] of it to see its effect"
            )

        if named and self.scaled_trials is not None:
            raise ValueError(f"scaled_trials: {named[0]} has no tolerance that can be multiplied")

    @property
    def varied_parameters(self) -> tuple[PerturbedParameter, ...]:
        """Parameters that trials, sweeps and grids vary."""
        axes = (axis for grid in self.grids for axis in (grid.x, grid.y))
        return (*self.perturbations, *self.sweeps, *axes)


def validate_merit_name(key: str, label: str | None, allowed: Sequence[str]) -> None:
    """Raise a ValueError for the name of a merit that does not exist."""
    if label not in allowed:
        raise ValueError(f"{key}: there is no merit {label!r}; allowed: {', '.join(allowed)}")


def validate_not_repeated(names: Iterable[str], items: str) -> None:
    """Raise a ValueError for a repeated name; `items` names the two items in the message."""
    known: set[str] = set()
    for name in names:
        if name in known:
            raise ValueError(f"{items} are both called {name!r}; give one of them another name")
        known.add(name)
