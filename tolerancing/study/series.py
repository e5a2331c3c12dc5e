"""Series of a study, scored step by step in addition to its trials: base class and line pairs."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import model_validator

from lensdesign.common.frozen_model import FiniteNumber, FrozenModel, Positive
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, check_field_point
from tolerancing.merits.context import Context
from tolerancing.merits.line_pairs import LinePairContrast, line_pairs_in_focus
from tolerancing.merits.pupil import Axis, Orientation
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.study.results import Picture, StepResults
from tolerancing.study.scoring import score_batch

if TYPE_CHECKING:
    from wavesim import ReconstructionPupil

Coordinates = Mapping[str, float | str]


class Series(ABC):
    """A series of steps that are scored independently."""

    @property
    @abstractmethod
    def label(self) -> str:
        """Name of the series."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of steps."""

    @abstractmethod
    def coordinates(self, step: int) -> Coordinates:
        """Return the values of the varied parameters of a step, by name with unit."""

    @abstractmethod
    def score(self, context: Context, merits: Sequence[Merit], step: int) -> StepResults:
        """Score one step; `merits` are those that score all trials of the study."""

    def batch(self, context: Context, step: int) -> PerturbationBatch | None:
        """Return the perturbed lens of a step; None if a step is not a perturbed lens."""
        return None

    def seconds(self, context: Context, step: int) -> float | None:
        """Estimate the computing time of a step; None if it is that of a trial."""
        return None


class LinePairSection(FrozenModel):
    """Scores of sweeps and grids: merits of the study, and contrasts of additional line pairs.

    Attributes
    ----------
    merits
        Names of the study's merits that are scored at each step.
    line_widths_um
        Widths of line pairs whose contrast is scored at each step, with and without refocusing.
    orientation
        Axis along which the bars repeat, or the worse axis.
    field_mm
        Object point (x, y) of the line pairs.
    """

    merits: tuple[str, ...] = ()
    line_widths_um: tuple[Positive, ...] = ()
    orientation: Orientation = "worse"
    field_mm: tuple[FiniteNumber, FiniteNumber] = (0.0, 0.0)

    @model_validator(mode="after")
    def _check_scores(self) -> Any:
        if not self.merits and not self.line_widths_um:
            raise ValueError("nothing to score: give merits or line_widths_um")
        validate_unique(self, "line_widths_um", "merits")
        shared = [pairs.label for pairs in self.line_pairs() if pairs.label in self.merits]
        if shared:
            raise ValueError(
                f"merits: {shared[0]!r} is also the name of a contrast of line_widths_um, which is computed "
                "from the reconstruction pupil: give the merit another name, or remove line_widths_um"
            )
        return self

    def check(self, lens: Lens) -> None:
        """Raise a ValueError for a field point outside the field of view."""
        check_field_point(lens, self.field_mm, "field_mm")

    def line_pairs(self) -> tuple[LinePairContrast, ...]:
        """Return the contrast merits, with and without refocusing; below the limit 0 lines are reversed."""
        return tuple(
            LinePairContrast(
                kind="line_pair_contrast",
                name=f"contrast_{width:g}um{'_refocused' if refocus else ''}".replace(".", "p"),
                at_least=0.0,
                line_width_um=width,
                orientation=self.orientation,
                field_mm=self.field_mm,
                refocus=refocus,
                level="pupil",
            )
            for width in self.line_widths_um
            for refocus in (True, False)
        )

    def scored(self, merits: Sequence[Merit]) -> tuple[Merit, ...]:
        """Return all scored merits: the named merits of the study, and the line pairs."""
        return (*(m for m in merits if m.label in self.merits), *self.line_pairs())


def validate_unique(section: FrozenModel, *keys: str) -> None:
    """Raise a ValueError for lists with repeated values."""
    for key in keys:
        items = getattr(section, key)
        if len(set(items)) < len(items):
            raise ValueError(f"{key} = {list(items)}: must be different from each other")


def score_perturbed(
    context: Context,
    series: Series,
    step: int,
    merits: Sequence[Merit],
    batch: PerturbationBatch,
    pictured: LinePairSection | None = None,
) -> StepResults:
    """Score a step that is a perturbed lens, and compute its images if requested and no score is missing."""
    start = time.perf_counter()
    scores, (message,) = score_batch(merits, context, batch)
    pictures = _line_pair_pictures(context, pictured, batch) if pictured and not message else ()
    return StepResults(
        series=series.label,
        step=step,
        coordinates=series.coordinates(step),
        scores={merit.label: float(score) for merit, score in zip(merits, scores[0], strict=True)},
        message=message,
        pictures=pictures,
        seconds=time.perf_counter() - start,
    )


def _line_pair_pictures(
    context: Context, section: LinePairSection, batch: PerturbationBatch
) -> tuple[Picture, ...]:
    """Return images of the line pairs of a section, with and without refocusing."""
    pictures = []
    for merit in section.line_pairs():
        (pupil,) = context.pupils(batch, section.field_mm, merit.wavelength_um, merit.refocus, True)
        pictures.append(line_pair_picture(pupil, merit.line_width_um, merit.orientation, merit.refocus)[1])
    return tuple(pictures)


def line_pair_picture(
    pupil: ReconstructionPupil,
    line_width_um: float,
    orientation: Orientation,
    refocused: bool,
    points: int = 121,
) -> tuple[float, Picture]:
    """Return contrast and image of a line pair along an axis or the worse axis; in best focus if asked."""
    from wavesim import line_pair_contrast
    from wavesim.pupil import line_pair_image

    axes: tuple[Axis, ...] = ("x", "y") if orientation == "worse" else (orientation,)
    results = {
        axis: line_pairs_in_focus(pupil, line_width_um, axis)
        if refocused
        else (line_pair_contrast(pupil, line_width_um, axis), pupil)
        for axis in axes
    }
    axis = min(axes, key=lambda one: results[one][0])
    contrast, focused = results[axis]
    coordinates, intensity = line_pair_image(focused, line_width_um, axis, points=points)
    half_width = float(coordinates[-1])
    return contrast, Picture(line_width_um, axis, refocused, half_width, intensity.astype(np.float32))
