"""Base class of merits: a score for each trial, and the limit that a good lens meets."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FiniteNumber, FrozenModel, Positive
from lensdesign.common.text import number_with_unit
from lensdesign.lens.lens import Lens
from tolerancing.merits.context import Context, Points
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import Name, PerturbedParameter, with_unit

Level = Literal["auto", "ray", "pupil", "wave"]

LARGEST_SCORE = 1e100
"""Largest absolute value of a score. Sums and squares of larger scores might not be finite."""


class Merit(FrozenModel):
    """A figure of merit and its limit.

    This is the base class; :data:`tolerancing.merits.MERITS` lists the merits by kind.

    Attributes
    ----------
    kind
        Name in the registry of merits.
    name
        Lower-case letters, digits and underscores; default: the kind.
    at_least, at_most
        Limit that a good lens meets, in the unit of the merit; exactly one of the two is given.
    wavelength_um
        Vacuum wavelength; default: the first wavelength of the lens.
    level
        Model that computes the score: ``ray`` for traced rays, ``pupil`` for the reconstruction pupil,
        ``wave`` for waves that propagate through the perturbed lens and back through the nominal lens.
        ``auto`` compares the levels in a few trials and selects the fastest that agrees with the most
        accurate one.
    predicted_by
        Name of a low-fidelity merit that scores all trials. This merit then scores only the trials that the
        study's `fidelity` selects.

    Examples
    --------
    >>> from tolerancing.merits import RmsWaves
    >>> merit = RmsWaves(kind="rms_waves", at_most=0.07)
    >>> merit.limit_text, merit.passed([0.05, 0.1]).tolist()
    ('at most 0.07 waves', [True, False])
    """

    kind: str
    name: Name = ""
    at_least: FiniteNumber | None = None
    at_most: FiniteNumber | None = None
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
        """The selected level; for ``auto``, the fastest level that can score the merit."""
        return self.able_levels()[0] if self.level == "auto" else self.level

    def able_levels(self) -> tuple[str, ...]:
        """Return the levels that can compute this merit, the fastest first."""
        return self.levels

    @property
    def file_name(self) -> str | None:
        """Name of the file that the merit reads, relative to the study; None if it reads no file."""
        return None

    def loaded(self, folder: Path) -> Self:
        """Return the merit with the text of its file, read relative to `folder`. No code is run."""
        return self

    @property
    def lacks_consent(self) -> bool:
        """Whether the merit needs user code that may not be executed (:func:`lensdesign.trust_user_code`)."""
        return False

    def without_user_code(self, reason: str) -> Self:
        """Return the merit without its user code; an attempt to run it raises InputError(`reason`)."""
        return self

    def prepare(self) -> None:
        """Check, before the first trial, that the merit can compute scores.

        Raises
        ------
        InputError
            If the merit needs user code that fails to load or may not be run.
        """

    def is_compensated(self, compensators: bool) -> bool:
        """Return whether refocusing or, if `compensators` is true, compensators change the scores."""
        return False

    @property
    def unit(self) -> str:
        """Unit of the scores."""
        return self.kind_unit

    @property
    def label(self) -> str:
        """Name of the merit in tables and messages; default: the kind."""
        return self.name or self.kind

    @property
    def column(self) -> str:
        """Column name of the scores in tables, with the unit."""
        return with_unit(self.label, self.unit)

    @property
    def limit(self) -> float:
        """Value of the limit, lower or upper."""
        value = self.at_least if self.at_least is not None else self.at_most
        assert value is not None  # guaranteed by the validator
        return value

    @property
    def limit_text(self) -> str:
        """The limit in words."""
        return number_with_unit(
            f"{'at least' if self.at_least is not None else 'at most'} {self.limit:g}", self.unit
        )

    @property
    def location(self) -> str:
        """Field points of the merit, in words; empty if it has none."""
        return ""

    @property
    def details(self) -> tuple[str, ...]:
        """Settings of the merit other than its limit, in words."""
        return () if self.wavelength_um is None else (f"light of {self.wavelength_um:g} µm",)

    @property
    def meaning(self) -> str:
        """Definition of the merit in one sentence, followed by its settings."""
        sentence, settings = (type(self).__doc__ or "").splitlines()[0], ", ".join(self.details)
        return f"{sentence} {settings[:1].upper()}{settings[1:]}." if settings else sentence

    def margin(self, scores: Any) -> Array:
        """Return the distance of scores from the limit, positive for good lenses; NaN for missing scores."""
        distance = np.asarray(scores, float) - self.limit
        return distance if self.at_least is not None else -distance

    def passed(self, scores: Any) -> NDArray[np.bool_]:
        """Return whether each score meets the limit; False for missing scores."""
        return self.margin(scores) >= 0.0

    def check(self, lens: Lens) -> None:
        """Check that the settings are possible for a lens.

        Raises
        ------
        ValueError
            If a field point is outside the field of view, or another setting does not fit the lens.
        """

    def check_perturbation(self, parameter: PerturbedParameter) -> None:
        """Check that the merit can score deviations of a parameter.

        Raises
        ------
        ValueError
            If it cannot. The message names the parameter.
        """

    @property
    def pupil_points(self) -> Points:
        """Object points whose pupils determine the values of compensators; empty without pupils."""
        return ()

    @property
    def varies_slices(self) -> bool:
        """True if the score depends on the reconstruction's number of slices."""
        return False

    def setups(self, context: Context, batch: PerturbationBatch) -> Mapping[Hashable, float]:
        """Return the setup steps that a process still needs before a batch, and the seconds of each step."""
        return {}

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        """Score each trial of a batch.

        Parameters
        ----------
        context
            The nominal lens and the data that merits share.
        batch
            Perturbations of the trials.

        Returns
        -------
        ndarray, shape (trials,)
            Scores; NaN for a trial without a score.

        Raises
        ------
        TransferLensError
            If a trial cannot be evaluated at all. The caller then scores the trials one by one.
        """
        raise NotImplementedError

    def uncompensated(self, context: Context, batch: PerturbationBatch) -> Array:
        """Score each trial of a batch without refocusing and compensators; see :meth:`scores`."""
        return self.scores(context, batch)


def all_passed(merits: Sequence[Merit], scores: Array) -> NDArray[np.bool_]:
    """Return whether each lens meets the limits of all merits, from scores of shape (n, merits)."""
    return np.all([merit.passed(scores[:, k]) for k, merit in enumerate(merits)], axis=0)


def points_text(points: Sequence[tuple[float, float]]) -> str:
    """Return object points in words; the worst of several counts."""
    text = ", ".join(f"({x:g}, {y:g})" for x, y in points)
    return f"at {text} mm in the object" + ("; the worst score counts" if len(points) > 1 else "")


def orientation_text(orientation: str) -> str:
    """Return the axis along which the bars of a pattern repeat, in words."""
    return f"along {'the worse axis' if orientation == 'worse' else orientation}"


def refocus_text(refocus: bool) -> str:
    """Return in words whether a reconstruction is refocused."""
    return "refocused" if refocus else "not refocused"


def check_field_point(lens: Lens, point: tuple[float, float], key: str) -> None:
    """Raise a ValueError for an object point outside the field of view."""
    height = float(np.hypot(*point))
    if height > lens.half_field_mm * (1.0 + 1e-9):
        raise ValueError(
            f"{key} = {list(point)}: lies {height:g} mm from the axis; "
            f"allowed: up to {lens.half_field_mm:g} mm, half the field_diameter_mm"
        )
