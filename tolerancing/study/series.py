"""What a study varies step by step beside its trials: sweeps, grids, slice counts, sensitivities."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import field_validator, model_validator

from lensdesign.lens.lens import Finite, Lens, Positive, Section, tuples
from tolerancing.merits.base import Merit, check_field_point
from tolerancing.merits.line_pairs import LinePairContrast
from tolerancing.merits.pupil import Orientation

if TYPE_CHECKING:
    from tolerancing.merits.context import Context
    from tolerancing.perturbations.batch import PerturbationBatch
    from tolerancing.study.results import StepResults
    from tolerancing.study.study import Study

Coordinates = Mapping[str, float | str]


class Series(ABC):
    """Steps, each scored by itself."""

    @property
    @abstractmethod
    def label(self) -> str:
        """What to call the series."""

    @abstractmethod
    def __len__(self) -> int:
        """Number of steps."""

    @abstractmethod
    def coordinates(self, step: int) -> Coordinates:
        """What is varied in a step, by name with its unit."""

    @abstractmethod
    def score(self, context: Context, study: Study, step: int) -> StepResults:
        """Score one step."""


class LinePairSection(Section):
    """What sweeps and grids score: merits of the study, and line pairs of their own.

    Attributes
    ----------
    merits
        Names of the study's merits to score at each step.
    line_widths_um
        Line pairs whose contrast to score at each step, with and without refocusing.
    orientation
        Axis along which the bars follow each other, or the worse of both.
    field_mm
        Object point (x, y) of the line pairs.
    """

    merits: tuple[str, ...] = ()
    line_widths_um: tuple[Positive, ...] = ()
    orientation: Orientation = "worse"
    field_mm: tuple[Finite, Finite] = (0.0, 0.0)

    _own_lists = field_validator("line_widths_um", "merits", "field_mm", mode="before")(tuples)

    @model_validator(mode="after")
    def _something(self) -> Any:
        if not self.merits and not self.line_widths_um:
            raise ValueError("nothing to score: give merits or line_widths_um")
        refuse_twice(self, "line_widths_um", "merits")
        return self

    def check(self, lens: Lens) -> None:
        """Refuse a field point that the lens does not see, with a ValueError."""
        check_field_point(lens, self.field_mm, "field_mm")

    def line_pairs(self) -> tuple[LinePairContrast, ...]:
        """The contrasts to score, each line width refocused and not; limit 0 is where lines reverse."""
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

    def scored(self, study: Study) -> tuple[Merit, ...]:
        """All that is scored: the study's merits that are named, and the line pairs."""
        return (*(m for m in study.merits if m.label in self.merits), *self.line_pairs())


def refuse_twice(section: Section, *keys: str) -> None:
    """Refuse lists in which something stands twice, with a ValueError."""
    for key in keys:
        items = getattr(section, key)
        if len(set(items)) < len(items):
            raise ValueError(f"{key} = {list(items)}: one stands there twice")


def score_batch_step(
    context: Context,
    series: Series,
    step: int,
    merits: tuple[Merit, ...],
    batch: PerturbationBatch,
    pictured: LinePairSection | None = None,
) -> StepResults:
    """Score a step that is a perturbed lens; draw its pictures if asked for and nothing is missing."""
    import time

    from tolerancing.study.evaluate import score_batch
    from tolerancing.study.pictures import line_pair_pictures
    from tolerancing.study.results import StepResults

    start = time.perf_counter()
    scores, (message,) = score_batch(merits, context, batch)
    pictures = line_pair_pictures(context, pictured, batch) if pictured and not message else ()
    return StepResults(
        series=series.label,
        step=step,
        coordinates=series.coordinates(step),
        scores={merit.label: float(score) for merit, score in zip(merits, scores[0], strict=True)},
        message=message,
        pictures=pictures,
        seconds=time.perf_counter() - start,
    )
