"""How many annular slices a reconstruction needs, as in the paper's Fig. 7(a).

Lines are carried to the exit plane by the eikonal engine, which knows no slices, and back by annular slices
of each number and compensation; the eikonal engine itself brings them back for comparison. All this is on a
meridional line: a plane of the paper's lens has 31,000 samples along each side.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import numpy as np
from pydantic import Field, field_validator, model_validator

from lensdesign.common.section import Bounded, Positive, Section, tuples
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, check_field_point
from tolerancing.merits.context import Context
from tolerancing.perturbations.parameters import Name
from tolerancing.study.results import Picture, StepResults
from tolerancing.study.series import Coordinates, Series, validate_unique

if TYPE_CHECKING:
    from wavesim.metrics import LineContrast

BARS = 5

Compensation = Literal["vertical", "oblique"]

Result = TypeVar("Result")


class SliceCounts(Section, Series):
    """Annular slices in several numbers, one or both phase compensations.

    Attributes
    ----------
    name
        What to call the series.
    slices
        Numbers of slices of each surface.
    compensations
        ``vertical`` is the paper's (Eq. C3), ``oblique`` takes the slope of the light.
    line_widths_um
        Widths of the lines.
    field_height_mm
        Of the lines' middle, along y.
    picture_slices
        Numbers of slices at which to keep pictures.
    """

    name: Name = "slice_count"
    slices: Annotated[tuple[Annotated[int, Field(ge=1, le=5000)], ...], Field(min_length=1)]
    compensations: Annotated[tuple[Compensation, ...], Field(min_length=1)] = ("vertical", "oblique")
    line_widths_um: Annotated[tuple[Positive, ...], Field(min_length=1)]
    field_height_mm: Bounded = 0.0
    picture_slices: tuple[int, ...] = ()

    _lists = field_validator("slices", "compensations", "line_widths_um", "picture_slices", mode="before")(
        tuples
    )

    @model_validator(mode="after")
    def _consistent(self) -> SliceCounts:
        validate_unique(self, "slices", "compensations", "line_widths_um")
        strangers = [n for n in self.picture_slices if n not in self.slices]
        if strangers:
            raise ValueError(
                f"picture_slices = {strangers}: allowed are those of slices, {list(self.slices)}"
            )
        return self

    @property
    def label(self) -> str:
        return self.name

    def __len__(self) -> int:
        return len(self.slices) * len(self.compensations)

    def check(self, lens: Lens) -> None:
        """Refuse a field height that the lens does not see, with a ValueError."""
        check_field_point(lens, (0.0, self.field_height_mm), "field_height_mm")

    def coordinates(self, step: int) -> Coordinates:
        count, kind = divmod(step, len(self.compensations))
        return {"compensation": self.compensations[kind], "slices": float(self.slices[count])}

    def score(self, context: Context, merits: Sequence[Merit], step: int) -> StepResults:
        from wavesim import resolve

        start = time.perf_counter()
        coordinates = self.coordinates(step)
        found = self._by_slices(resolve, context, step)
        slices = int(coordinates["slices"])
        pictures = tuple(_picture(line) for line in found.lines if slices in self.picture_slices)
        scores: dict[str, float] = {}
        for line in found.lines:
            width = f"{line.line_width_um:g}um".replace(".", "p")
            scores[f"contrast_{width}"] = line.contrast
            scores[f"weakest_contrast_{width}"] = line.weakest_contrast
            scores[f"contrast_as_is_{width}"] = line.contrast_as_is
            scores[f"contrast_of_eikonal_{width}"] = line.contrast_of_reference
        return StepResults(
            series=self.label,
            step=step,
            coordinates=coordinates,
            scores=scores,
            message="",
            pictures=pictures,
            seconds=time.perf_counter() - start,
        )

    def seconds(self, context: Context, step: int) -> float:
        from wavesim.metrics import resolving_seconds

        return self._by_slices(resolving_seconds, context, step)

    def _by_slices(self, work: Callable[..., Result], context: Context, step: int) -> Result:
        """What the resolving test, or what tells its time, makes of a step."""
        from wavesim import SamplingWarning

        coordinates = self.coordinates(step)
        with warnings.catch_warnings():
            # Too few slices are what this is about.
            warnings.simplefilter("ignore", SamplingWarning)
            return work(
                context.lens,
                self.line_widths_um,
                self.field_height_mm,
                "slices",
                bars=BARS,
                slices=int(coordinates["slices"]),
                compensation=str(coordinates["compensation"]),
            )


def _picture(line: LineContrast) -> Picture:
    """The lines as they look, drawn out along x."""
    profile = line.profile.astype(np.float32)
    return Picture(
        line_width_um=line.line_width_um,
        orientation="y",
        refocused=True,
        half_width_um=BARS * line.line_width_um,
        intensity=np.repeat(profile[:, None], len(profile), axis=1),
    )
