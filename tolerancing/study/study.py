"""A tolerance study: which lens, what scatters, what is judged, what is swept."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Literal

from pydantic import Field, SerializeAsAny, model_validator

from lensdesign.common.section import Bounded, Section
from tolerancing.merits.base import Merit
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Sampling
from tolerancing.perturbations.dependence import Correlation, Dependence, study_dependence
from tolerancing.perturbations.draws import DRAWS
from tolerancing.perturbations.parameters import Perturbation, PerturbedParameter
from tolerancing.study.series import Series
from tolerancing.study.slice_counts import SliceCounts
from tolerancing.study.sweep import OneAtATime, ParameterGrid, Sweep

MOST_TRIALS = 10_000_000

RESERVED_COLUMNS = ("trial", "status", "message", "passed", "seconds", "finished")

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Fidelity(Section):
    """How cheap a level may be, and which trials the dear merits score.

    Dear merits are those that name in `predicted_by` the cheap merit that they refine.

    Attributes
    ----------
    largest_difference
        Between the scores of the levels of an ``auto`` merit, in any of the trials that probe it, for the
        cheaper level to do.
    worst_share
        Share of all trials, the worst by the cheap merit.
    random_share
        Share of all trials, drawn at random from the others.
    """

    largest_difference: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.03
    worst_share: Share = 0.02
    random_share: Share = 0.05


class Study(Section):
    """A tolerance study; the study file, in memory.

    Attributes
    ----------
    title
        What to call it.
    design
        Design file of the lens, relative to the study file.
    trials
        Number of Monte Carlo trials.
    seed
        Seed of all randomness.
    pivot_z_mm
        Where on the axis the whole lens turns, from its front vertex.
    sampling
        How finely merits are sampled.
    draws
        How trials are drawn: ``random``, ``latin_hypercube`` or ``sobol``.
    sensitivity
        Whether each perturbation is also taken by itself to shares of its tolerance.
    fidelity
        Which trials the dear merits score.
    perturbations
        What scatters; the ``[[perturbation]]`` tables.
    correlations
        Which perturbations scatter together; the ``[[correlation]]`` tables.
    compensators
        What the reconstruction's model adapts; the ``[[compensator]]`` tables.
    all_merits
        What is judged; the ``[[merit]]`` tables.
    sweeps, grids, slice_counts
        What is varied by itself; the ``[[sweep]]``, ``[[grid]]`` and ``[[slice_count]]`` tables.
    """

    title: str = ""
    design: str
    trials: Annotated[int, Field(ge=1, le=MOST_TRIALS)]
    seed: Annotated[int, Field(ge=0)]
    pivot_z_mm: Bounded = 0.0
    draws: Literal[DRAWS] = "random"  # type: ignore[valid-type]
    sensitivity: bool = True
    sampling: Sampling = Sampling()
    fidelity: Fidelity = Fidelity()
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
        """The merits that all trials are scored by."""
        return tuple(m for m in self.all_merits if m.predicted_by is None)

    @property
    def high_fidelity_merits(self) -> tuple[Merit, ...]:
        """The merits that chosen trials are scored by."""
        return tuple(m for m in self.all_merits if m.predicted_by is not None)

    @cached_property
    def series(self) -> tuple[Series, ...]:
        """All that is varied step by step."""
        alone = (OneAtATime(self.perturbations),) if self.sensitivity else ()
        return (*self.sweeps, *self.grids, *self.slice_counts, *alone)

    @cached_property
    def dependence(self) -> Dependence:
        """Which perturbations scatter together."""
        groups: dict[str, list[str]] = {}
        for p in self.perturbations:
            if p.group is not None:
                groups.setdefault(p.group, []).append(p.column)
        return study_dependence([p.column for p in self.perturbations], self.correlations, groups)

    @property
    def compensated(self) -> tuple[Merit, ...]:
        """The merits that the reconstruction's refocusing or compensators help."""
        return tuple(m for m in self.merits if m.is_compensated(bool(self.compensators)))

    @property
    def extra_columns(self) -> tuple[str, ...]:
        """Columns beside scores: scores without compensation, and what the compensators took."""
        return (
            *(f"{m.column}_uncompensated" for m in self.compensated),
            *(f"compensator_{c.column}" for c in self.compensators),
        )

    @property
    def levels(self) -> dict[str, str]:
        """The merits' levels, by their labels; where they are open, the cheapest."""
        return {merit.label: merit.used_level for merit in self.all_merits}

    def with_levels(self, levels: Mapping[str, str]) -> Study:
        """The study with its merits' levels, by their labels, settled."""
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
            *RESERVED_COLUMNS,
            *(p.column for p in self.perturbations),
            *(m.column for m in self.all_merits),
            *self.extra_columns,
        ]
        validate_not_repeated(columns, "a perturbation or merit and another column")
        self._check_names()
        self._check_settings()
        self.dependence  # noqa: B018  refuses what does not go together
        return self

    def _check_names(self) -> None:
        """Refuse merits named by others that are not there, with a ValueError."""
        labels = [m.label for m in self.merits]
        if not labels:
            raise ValueError("merit: all are predicted_by another; at least one must score all trials")
        for merit in self.high_fidelity_merits:
            validate_merit_name(f"merit {merit.label!r}: predicted_by", merit.predicted_by, labels)
        every = [m.label for m in self.all_merits]
        for kind, parts in (("sweep", self.sweeps), ("grid", self.grids)):
            for part in parts:
                for label in part.merits:
                    validate_merit_name(f"{kind} {part.label!r}: merits", label, every)

    def _check_settings(self) -> None:
        """Refuse settings of the reconstruction that no merit follows, or that have no derivative."""
        varied = [p for p in self.varied_parameters if p.is_setting]
        for parameter in varied:
            if not any(merit.varies_slices for merit in self.all_merits):
                raise ValueError(
                    f"{parameter.column}: no merit of the study follows the number of slices; give one of "
                    "kind 'reconstruction' with reconstruction_engine = 'slices'"
                )
        named = [p.column for p in self.perturbations if p.is_setting]
        if named and self.sensitivity:
            raise ValueError(
                f"{named[0]}: a number of slices has no fractions of a tolerance; give sensitivity = false, "
                "and a [[sweep]] of it to see what it does alone"
            )

    @property
    def varied_parameters(self) -> tuple[PerturbedParameter, ...]:
        """All that trials, sweeps and grids vary."""
        axes = (axis for grid in self.grids for axis in (grid.x, grid.y))
        return (*self.perturbations, *self.sweeps, *axes)


def validate_merit_name(what: str, label: str | None, allowed: Sequence[str]) -> None:
    """Refuse the name of a merit that is not there, with a ValueError."""
    if label not in allowed:
        raise ValueError(f"{what}: there is no merit {label!r}; allowed: {', '.join(allowed)}")


def validate_not_repeated(names: Iterable[str], what: str) -> None:
    """Refuse a name that stands twice, with a ValueError."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f"{what} are both called {name!r}; give one of them another name")
        seen.add(name)
