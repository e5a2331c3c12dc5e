"""What every merit has: a score for each trial, and the limit that a good part keeps."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.section import Bounded, Positive, Section
from lensdesign.lens.lens import Lens
from tolerancing.merits.context import Context, Points
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import Name, PerturbedParameter, with_unit

Level = Literal["auto", "ray", "pupil", "wave"]

LARGEST_SCORE = 1e100
"""Scores beyond it, either way, are none: sums and squares of them would not be finite."""


class Merit(Section):
    """One figure of merit and its limit.

    Attributes
    ----------
    kind
        Name in the registry of merits.
    name
        Lower-case letters, digits and underscores; the kind where left out.
    at_least, at_most
        The limit of a good part; one of the two.
    wavelength_um
        The lens's first wavelength where left out.
    level
        What it is made of: rays, the reconstruction pupil, or waves carried through the perturbed lens and
        back through the nominal one; ``auto`` is the cheapest that a few trials show to agree with the
        dearest.
    predicted_by
        Name of a cheaper merit that all trials are scored by; this one then scores those that the study's
        `fidelity` chooses.
    """

    kind: str
    name: Name = ""
    at_least: Bounded | None = None
    at_most: Bounded | None = None
    wavelength_um: Positive | None = None
    level: Level = "auto"
    predicted_by: Name | None = None

    kind_unit: ClassVar[str] = ""
    adds_in_squares: ClassVar[bool] = False
    levels: ClassVar[tuple[str, ...]] = ("pupil",)
    trials_per_chunk: ClassVar[int] = 16

    @model_validator(mode="after")
    def _one_limit(self) -> Merit:
        if (self.at_least is None) == (self.at_most is None):
            given = "both are given" if self.at_least is not None else "the limit is missing"
            raise ValueError(f"give one limit, at_least or at_most; {given}")
        return self

    @model_validator(mode="after")
    def _known_level(self) -> Merit:
        if self.level not in ("auto", *self.levels):
            raise ValueError(f"level = {self.level!r}: allowed: {', '.join(('auto', *self.levels))}")
        return self

    @property
    def used_level(self) -> str:
        """The level, where ``auto`` leaves no choice or has been decided."""
        return self.able_levels()[0] if self.level == "auto" else self.level

    def able_levels(self) -> tuple[str, ...]:
        """The levels that can score what is asked for, the cheapest first."""
        return self.levels

    @property
    def file_name(self) -> str | None:
        """A file beside the study that the merit needs."""
        return None

    def loaded(self, folder: Path) -> Self:
        """The merit with what its file holds; relative to the study's folder. Nothing of it is run."""
        return self

    def refused(self, why: str) -> Self:
        """The merit without leave to run a user's code; where it would, that is an InputError: `why`."""
        return self

    def get_ready(self) -> None:
        """Make sure, before the first trial, that it can score.

        Raises
        ------
        InputError
            If the code of a user that it needs cannot be run, or is not to be.
        """

    def is_compensated(self, compensators: bool) -> bool:
        """Whether refocusing, or the study's compensators if it has any, change the scores."""
        return False

    @property
    def unit(self) -> str:
        """Unit of the scores."""
        return self.kind_unit

    @property
    def label(self) -> str:
        """What to call the merit."""
        return self.name or self.kind

    @property
    def column(self) -> str:
        """Name of the scores in tables, with the unit."""
        return with_unit(self.label, self.unit)

    @property
    def limit(self) -> float:
        """The limit, whichever way it works."""
        value = self.at_least if self.at_least is not None else self.at_most
        assert value is not None  # the validator saw to it
        return value

    @property
    def limit_text(self) -> str:
        """The limit in words."""
        return f"{'at least' if self.at_least is not None else 'at most'} {self.limit:g} {self.unit}".strip()

    @property
    def location(self) -> str:
        """The field points at which it judges, in words; empty if it has none."""
        return ""

    @property
    def details(self) -> tuple[str, ...]:
        """What it was asked for beside its limit, in words."""
        return () if self.wavelength_um is None else (f"light of {self.wavelength_um:g} um",)

    @property
    def meaning(self) -> str:
        """What the merit is, in one sentence, and what it was asked for."""
        sentence, asked = (type(self).__doc__ or "").splitlines()[0], ", ".join(self.details)
        return f"{sentence} {asked[:1].upper()}{asked[1:]}." if asked else sentence

    def margin(self, scores: Any) -> Array:
        """How far scores lie on the good side of the limit; NaN where there is no score."""
        distance = np.asarray(scores, float) - self.limit
        return distance if self.at_least is not None else -distance

    def passed(self, scores: Any) -> NDArray[np.bool_]:
        """Which scores keep the limit; one that is missing does not."""
        return self.margin(scores) >= 0.0

    def check(self, lens: Lens) -> None:
        """Refuse what does not fit this lens.

        Raises
        ------
        ValueError
            For a field point outside the lens's field of view.
        """

    def check_perturbation(self, parameter: PerturbedParameter) -> None:
        """Refuse a parameter whose deviations the merit cannot score.

        Raises
        ------
        ValueError
            Naming the parameter.
        """

    @property
    def pupil_points(self) -> Points:
        """Object points whose pupils tell compensators their values; none of merits without such points."""
        return ()

    @property
    def varies_slices(self) -> bool:
        """Whether the score depends on the reconstruction's number of slices."""
        return False

    def setups(self, context: Context, batch: PerturbationBatch) -> Mapping[Hashable, float]:
        """What is set up once in a process before a batch is scored, and the seconds that each part takes.

        Parts that are there already are left out.
        """
        return {}

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        """Score each trial of a batch.

        Parameters
        ----------
        context
            The nominal lens and what merits share.
        batch
            The trials' perturbations.

        Returns
        -------
        ndarray, shape (trials,)
            NaN for a trial that cannot be scored.

        Raises
        ------
        TransferLensError
            If a trial cannot be evaluated at all; whoever runs the batch then scores trials singly.
        """
        raise NotImplementedError

    def uncompensated(self, context: Context, batch: PerturbationBatch) -> Array:
        """As :meth:`scores`, without refocusing and compensators."""
        return self.scores(context, batch)


def all_passed(merits: Sequence[Merit], scores: Array) -> NDArray[np.bool_]:
    """Which lenses keep the limits of all merits, from their scores of shape (n, merits)."""
    return np.all([merit.passed(scores[:, k]) for k, merit in enumerate(merits)], axis=0)


def points_text(points: Sequence[tuple[float, float]]) -> str:
    """Object points in words; the worst of several counts."""
    text = ", ".join(f"({x:g}, {y:g})" for x, y in points)
    return f"at {text} mm in the object" + (", the worst counting" if len(points) > 1 else "")


def orientation_text(orientation: str) -> str:
    """The axis along which bars follow each other, in words."""
    return f"along {'the worse axis' if orientation == 'worse' else orientation}"


def refocus_text(refocus: bool) -> str:
    """Whether a reconstruction is refocused, in words."""
    return "refocused" if refocus else "not refocused"


def check_field_point(lens: Lens, point: tuple[float, float], key: str) -> None:
    """Refuse an object point outside the field of view, with a ValueError."""
    height = float(np.hypot(*point))
    if height > lens.half_field_mm * (1.0 + 1e-9):
        raise ValueError(
            f"{key} = {list(point)}: lies {height:g} mm from the axis; "
            f"allowed: up to {lens.half_field_mm:g} mm, half the field_diameter_mm"
        )
