"""Merits of the reconstruction pupil: what a perturbed lens does to a reconstruction by the nominal one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from lensdesign.system import Finite, Lens, Positive, tuples
from tolerancing.context import Context
from tolerancing.merit import Merit, check_field_point
from tolerancing.perturbations import PerturbationBatch

if TYPE_CHECKING:
    from wavesim import ReconstructionPupil

Array = NDArray[np.float64]
Axis = Literal["x", "y"]
Orientation = Literal["x", "y", "worse"]


class PupilMerit(Merit):
    """A merit of the reconstruction pupil of one field point.

    Attributes
    ----------
    field_mm
        Object point (x, y).
    refocus
        Whether the reconstruction is refocused before it is judged. It is always registered sideways.
    """

    field_mm: tuple[Finite, Finite] = (0.0, 0.0)
    refocus: bool = True

    _lists = field_validator("field_mm", mode="before")(tuples)

    def check(self, lens: Lens) -> None:
        check_field_point(lens, self.field_mm, "field_mm")

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        pupils = context.pupils(batch, self.field_mm, self.wavelength_um, self.refocus)
        return np.array([self.score(pupil) for pupil in pupils])

    def score(self, pupil: ReconstructionPupil) -> float:
        """Score of one reconstruction pupil."""
        raise NotImplementedError


class Strehl(PupilMerit):
    """Strehl ratio of the reconstruction's point spread."""

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import strehl

        return float(strehl(pupil))


class RmsWaves(PupilMerit):
    """Root mean square of the reconstruction pupil's phase, in waves."""

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import rms_waves

        return float(rms_waves(pupil))


class LinePairContrast(PupilMerit):
    """Contrast of the reconstructed line pairs; negative where bright and dark trade places.

    Attributes
    ----------
    line_width_um
        Width of a bar and of a gap.
    orientation
        Axis along which the bars follow each other, or the worse of both.
    """

    line_width_um: Positive
    orientation: Orientation = "worse"

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import line_pair_contrast

        return worse(lambda axis: line_pair_contrast(pupil, self.line_width_um, axis), self.orientation)


class ModulationTransfer(PupilMerit):
    """Modulation transfer of the reconstruction at one frequency.

    Attributes
    ----------
    frequency_lp_per_mm
        Line pairs per mm in the object plane.
    orientation
        Axis of the modulation, or the worse of both.
    """

    frequency_lp_per_mm: Positive
    orientation: Orientation = "worse"

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import mtf

        return worse(lambda axis: float(mtf(pupil, [self.frequency_lp_per_mm], axis)[0]), self.orientation)


def worse(score: Callable[[Axis], float], orientation: Orientation) -> float:
    """A score along one axis, or the lower of those along both."""
    axes: tuple[Axis, ...] = ("x", "y") if orientation == "worse" else (orientation,)
    return min(score(axis) for axis in axes)
