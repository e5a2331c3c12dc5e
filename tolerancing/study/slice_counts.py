"""Number of annular slices that a reconstruction needs, as in the paper's Fig. 7(a).

The eikonal engine, which has no slices, propagates lines to the exit plane. Annular slices of each number and
compensation propagate them back, and the eikonal engine does so for comparison. The simulation uses a
meridional line, because a plane of the paper's lens has 31,000 samples along each side.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import numpy as np
from pydantic import Field, model_validator

from lensdesign.common.frozen_model import FiniteNumber, FrozenModel, Positive
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, check_field_point
from tolerancing.merits.context import Context
from tolerancing.merits.line_pairs import BARS
from tolerancing.perturbations.parameters import Name
from tolerancing.study.results import Picture, StepResults
from tolerancing.study.series import Coordinates, Series, validate_unique

if TYPE_CHECKING:
    from wavesim.metrics import LineContrast

Compensation = Literal["vertical", "oblique"]

Result = TypeVar("Result")


class SliceCounts(FrozenModel, Series):
    """Series over numbers of annular slices and phase compensations.

    Attributes
    ----------
    name
        Name of the series.
    slices
        Numbers of slices of each surface.
    compensations
        ``vertical`` as in the paper (Eq. C3), ``oblique`` along the direction of the light.
    line_widths_um
        Widths of the lines.
    field_height_mm
        Height of the centre of the lines, along y.
    picture_slices
        Numbers of slices for which images are saved.
    """

    name: Name = "slice_count"
    slices: Annotated[tuple[Annotated[int, Field(ge=1, le=5000)], ...], Field(min_length=1)]
    compensations: Annotated[tuple[Compensation, ...], Field(min_length=1)] = ("vertical", "oblique")
    line_widths_um: Annotated[tuple[Positive, ...], Field(min_length=1)]
    field_height_mm: FiniteNumber = 0.0
    picture_slices: tuple[int, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> SliceCounts:
        validate_unique(self, "slices", "compensations", "line_widths_um")
        unknown = [n for n in self.picture_slices if n not in self.slices]
        if unknown:
            raise ValueError(
                f"picture_slices = {unknown}: allowed: the values of slices, {list(self.slices)}"
            )
        return self

    @property
    def label(self) -> str:
        return self.name

    def __len__(self) -> int:
        return len(self.slices) * len(self.compensations)

    def check(self, lens: Lens) -> None:
        """Raise a ValueError for a field height outside the field of view."""
        check_field_point(lens, (0.0, self.field_height_mm), "field_height_mm")

    def coordinates(self, step: int) -> Coordinates:
        count, kind = divmod(step, len(self.compensations))
        return {"compensation": self.compensations[kind], "slices": float(self.slices[count])}

    def score(self, context: Context, merits: Sequence[Merit], step: int) -> StepResults:
        from wavesim import resolve

        start = time.perf_counter()
        coordinates = self.coordinates(step)
        result = self._by_slices(resolve, context, step)
        slices = int(coordinates["slices"])
        pictures = tuple(_picture(line) for line in result.lines if slices in self.picture_slices)
        scores: dict[str, float] = {}
        for line in result.lines:
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
        """Call the resolving test, or its time estimate, with the settings of a step."""
        from wavesim import SamplingWarning

        coordinates = self.coordinates(step)
        with warnings.catch_warnings():
            # The series uses too few slices on purpose.
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
    """Return an image of the lines, extended along x."""
    profile = line.profile.astype(np.float32)
    return Picture(
        line_width_um=line.line_width_um,
        orientation="y",
        refocused=True,
        half_width_um=BARS * line.line_width_um,
        intensity=np.repeat(profile[:, None], len(profile), axis=1),
    )
