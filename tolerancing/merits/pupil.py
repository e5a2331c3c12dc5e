"""Merits of the reconstruction pupil: path of the perturbed lens minus path of the nominal lens."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FiniteNumber, Positive
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, check_field_point, orientation_text, points_text, refocus_text
from tolerancing.merits.context import Context, Points
from tolerancing.perturbations.batch import PerturbationBatch

if TYPE_CHECKING:
    from wavesim import ReconstructionPupil
    from wavesim.pupil import FocalPlanes

Axis = Literal["x", "y"]
Orientation = Literal["x", "y", "worse"]


class PupilMerit(Merit):
    """A merit of the reconstruction pupil of one field point, or of the worst of several.

    Attributes
    ----------
    field_mm
        Object point (x, y).
    field_points_mm
        Several object points instead of one; the worst of their scores counts.
    refocus
        Whether the reconstruction is refocused to the plane of the flattest phase, which gives the smallest
        root mean square and the highest Strehl ratio. Contrasts are then refocused to their best value within
        :data:`wavesim.pupil.focus.FOCUS_RANGE`. The lateral shift is always removed.
    """

    field_mm: tuple[FiniteNumber, FiniteNumber] = (0.0, 0.0)
    field_points_mm: tuple[tuple[FiniteNumber, FiniteNumber], ...] = ()
    refocus: bool = True

    @model_validator(mode="after")
    def _one_field_key(self) -> PupilMerit:
        if self.field_points_mm and "field_mm" in self.model_fields_set:
            raise ValueError("give field_mm or field_points_mm, not both")
        return self

    @property
    def points(self) -> Points:
        """The object points."""
        return self.field_points_mm or (self.field_mm,)

    @property
    def pupil_points(self) -> Points:
        return self.points

    @property
    def location(self) -> str:
        return points_text(self.points)

    @property
    def details(self) -> tuple[str, ...]:
        return self.location, refocus_text(self.refocus), *super().details

    def check(self, lens: Lens) -> None:
        for point in self.points:
            check_field_point(lens, point, "field_points_mm" if self.field_points_mm else "field_mm")

    def is_compensated(self, compensators: bool) -> bool:
        return self.refocus or compensators

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        return self.worst([self.scores_at(point, context, batch, True) for point in self.points])

    def uncompensated(self, context: Context, batch: PerturbationBatch) -> Array:
        return self.worst([self.scores_at(point, context, batch, False) for point in self.points])

    def scores_at(
        self, point: tuple[float, float], context: Context, batch: PerturbationBatch, compensated: bool
    ) -> Array:
        """Return the scores at one object point, with or without refocusing and compensators."""
        refocused = compensated and self.refocus
        pupils = context.pupils(batch, point, self.wavelength_um, refocused, compensated)
        return np.array([self.best_score(pupil) if refocused else self.score(pupil) for pupil in pupils])

    def worst(self, scores: list[Array]) -> Array:
        """Return the worst score of the object points for each trial; NaN if one is missing."""
        stacked = np.stack(scores)
        return np.asarray(stacked.min(axis=0) if self.at_least is not None else stacked.max(axis=0))

    def score(self, pupil: ReconstructionPupil) -> float:
        """Return the score of one reconstruction pupil."""
        raise NotImplementedError

    def best_score(self, pupil: ReconstructionPupil) -> float:
        """Return the score of a refocused pupil in the best focus for this merit."""
        return self.score(pupil)


class Strehl(PupilMerit):
    """Strehl ratio of the reconstruction's point spread."""

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import strehl

        return float(strehl(pupil))


class RmsWaves(PupilMerit):
    """Root mean square of the reconstruction pupil's phase, in waves."""

    kind_unit: ClassVar[str] = "waves"
    adds_in_squares: ClassVar[bool] = True

    @property
    def column(self) -> str:
        """Column name of the scores in tables: the name alone, as tables have always had it."""
        return self.label

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import rms_waves

        return float(rms_waves(pupil))


class ModulationTransfer(PupilMerit):
    """Modulation transfer of the reconstruction at one frequency.

    Attributes
    ----------
    frequency_lp_per_mm
        Line pairs per mm in the object plane.
    orientation
        Axis of the modulation, or the worse axis.
    """

    frequency_lp_per_mm: Positive
    orientation: Orientation = "worse"

    @property
    def details(self) -> tuple[str, ...]:
        own = (f"{self.frequency_lp_per_mm:g} line pairs per mm", orientation_text(self.orientation))
        return *own, *super().details

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import mtf

        return worse(lambda axis: float(mtf(pupil, [self.frequency_lp_per_mm], axis)[0]), self.orientation)

    def best_score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import mtf
        from wavesim.pupil import FocalPlanes

        planes = FocalPlanes(pupil)

        def best(axis: Axis) -> float:
            return in_best_focus(planes, lambda p: float(mtf(p, [self.frequency_lp_per_mm], axis)[0]))

        return worse(best, self.orientation)


class SmallestResolvedLine(PupilMerit):
    """Width of the finest line pairs down to which all wider ones reach a contrast; infinite if none does.

    Attributes
    ----------
    contrast
        Contrast that counts as resolved.
    orientation
        Axis along which the bars repeat, or the worse axis.
    """

    contrast: Annotated[Positive, Field(lt=1.0)] = 0.2
    orientation: Orientation = "worse"

    kind_unit: ClassVar[str] = "um"

    @property
    def details(self) -> tuple[str, ...]:
        return f"contrast {self.contrast:g}", orientation_text(self.orientation), *super().details

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim.pupil import smallest_resolved_line_width_um

        return -worse(
            lambda axis: -smallest_resolved_line_width_um(pupil, axis, self.contrast), self.orientation
        )

    def best_score(self, pupil: ReconstructionPupil) -> float:
        return -worse(lambda axis: -self._finest(pupil, axis), self.orientation)

    def _finest(self, pupil: ReconstructionPupil, axis: Axis) -> float:
        """Return the finest resolved lines, refocusing for slightly finer lines as long as this helps."""
        from wavesim import line_pair_contrast
        from wavesim.pupil import FocalPlanes, best_focus, smallest_resolved_line_width_um

        finest, planes = smallest_resolved_line_width_um(pupil, axis, self.contrast), FocalPlanes(pupil)
        while np.isfinite(finest):
            width = 0.98 * finest
            focused = best_focus(planes, lambda p, w=width: line_pair_contrast(p, w, axis)).pupil  # type: ignore[misc]
            reached = smallest_resolved_line_width_um(focused, axis, self.contrast)
            if not reached < finest:
                break
            finest = reached
        return float(finest)


class ImageShift(PupilMerit):
    """Lateral displacement of the reconstruction in the object plane."""

    kind_unit: ClassVar[str] = "um"

    def scores_at(
        self, point: tuple[float, float], context: Context, batch: PerturbationBatch, compensated: bool
    ) -> Array:
        from wavesim import refocus
        from wavesim.pupil import remove_shift

        register = refocus if compensated and self.refocus else remove_shift
        pupils = context.raw_pupils(batch, point, self.wavelength_um, compensated)
        return np.array([float(np.hypot(*register(pupil).shift_um)) for pupil in pupils])


def in_best_focus(planes: FocalPlanes, score: Callable[[ReconstructionPupil], float]) -> float:
    """Return a score in its best focus."""
    from wavesim.pupil import best_focus

    return score(best_focus(planes, score).pupil)


def worse(score: Callable[[Axis], float], orientation: Orientation) -> float:
    """Return a score along one axis, or the lower score of both axes."""
    axes: tuple[Axis, ...] = ("x", "y") if orientation == "worse" else (orientation,)
    return min(score(axis) for axis in axes)
