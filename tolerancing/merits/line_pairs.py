"""Contrast of reconstructed line pairs, from the reconstruction pupil or from waves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import Positive
from tolerancing.merits.base import orientation_text
from tolerancing.merits.context import Context
from tolerancing.merits.pupil import Axis, Orientation, PupilMerit, worse
from tolerancing.perturbations.batch import PerturbationBatch

if TYPE_CHECKING:
    from wavesim import ReconstructionPupil
    from wavesim.pupil import FocalPlanes
    from wavesim.pupil.patch_reconstruction import PerturbedPatch


BARS = 5
"""Number of bars of a set of lines."""

NOISE_STREAM = 0x6E6F6973
"""Spawn key of the noise of a trial, which separates it from the trial's deltas."""


class LinePairContrast(PupilMerit):
    """Contrast of the reconstructed line pairs; negative if bright and dark are exchanged.

    Attributes
    ----------
    line_width_um
        Width of a bar and of a gap.
    orientation
        Axis along which the bars repeat, or the worse of both.
    patch_um
        Side of the simulated patch, at level ``wave``.
    line
        Whether level ``wave`` simulates a meridional line, with bars along y, instead of the plane.
    electrons
        Electrons in the brightest pixel, at level ``wave``. An ideal retrieval passes their noise on;
        default: no noise.
    """

    line_width_um: Positive
    orientation: Orientation = "worse"
    patch_um: Positive = 34.0
    line: bool = False
    electrons: Annotated[float, Field(ge=1.0, le=1e9)] | None = None

    levels: ClassVar[tuple[str, ...]] = ("pupil", "wave")

    @property
    def details(self) -> tuple[str, ...]:
        lines = (f"lines of {self.line_width_um:g} µm", orientation_text(self.orientation), *super().details)
        if self.used_level != "wave":
            return lines
        light = () if self.electrons is None else (f"{self.electrons:g} electrons in the brightest pixel",)
        return *lines, "on a meridional line" if self.line else "in the plane", *light

    @model_validator(mode="after")
    def _waves(self) -> LinePairContrast:
        if self.level == "pupil" and self.electrons is not None:
            raise ValueError("electrons: noise needs level = 'wave'; change the level, or remove electrons")
        if self.line and self.orientation == "x":
            raise ValueError("orientation = 'x': line = true has bars along y; use orientation = 'y'")
        length = (2 * BARS - 1) * self.line_width_um
        if self.used_level == "wave" and length > self.patch_um:
            raise ValueError(
                f"patch_um = {self.patch_um:g}: {BARS} bars of {self.line_width_um:g} µm need {length:g} µm "
                "or more"
            )
        return self

    def able_levels(self) -> tuple[str, ...]:
        if self.electrons is not None or self.line:
            return ("wave",)
        if (2 * BARS - 1) * self.line_width_um > self.patch_um:
            return ("pupil",)
        return self.levels

    def scores_at(
        self, point: tuple[float, float], context: Context, batch: PerturbationBatch, compensated: bool
    ) -> Array:
        if self.used_level == "pupil":
            return super().scores_at(point, context, batch, compensated)
        reconstructor = context.patch_reconstructor(point, self.wavelength_um, self.patch_um, self.line)
        patches = context.patches(batch, reconstructor, self.wavelength_um, compensated)
        numbers = batch.trial_numbers or (0,) * len(batch)
        return np.array(
            [
                self._patch_contrast(patch, compensated and self.refocus, context.noise_seed, number)
                for patch, number in zip(patches, numbers, strict=True)
            ]
        )

    def score(self, pupil: ReconstructionPupil) -> float:
        from wavesim import line_pair_contrast

        return worse(lambda axis: line_pair_contrast(pupil, self.line_width_um, axis, BARS), self.orientation)

    def best_score(self, pupil: ReconstructionPupil) -> float:
        from wavesim.pupil import FocalPlanes

        planes = FocalPlanes(pupil)

        def best(axis: Axis) -> float:
            return line_pairs_in_focus(planes, self.line_width_um, axis)[0]

        return worse(best, self.orientation)

    def _patch_contrast(self, patch: PerturbedPatch, refocused: bool, seed: int, number: int) -> float:
        from wavesim.pupil import patch_bar_contrast

        def contrast(axis: Axis) -> float:
            stream = np.random.SeedSequence(seed, spawn_key=(number, NOISE_STREAM, int(axis == "y")))
            return patch_bar_contrast(
                patch,
                self.line_width_um,
                axis,
                BARS,
                refocused=refocused,
                best=refocused,
                electrons=self.electrons,
                rng=None if self.electrons is None else np.random.default_rng(stream),
            )

        return contrast("y") if self.line else worse(contrast, self.orientation)


def line_pairs_in_focus(
    pupil: ReconstructionPupil | FocalPlanes, line_width_um: float, axis: Axis
) -> tuple[float, ReconstructionPupil]:
    """Return the contrast of line pairs in their best focus, and the refocused pupil."""
    from wavesim import line_pair_contrast
    from wavesim.pupil import best_focus

    def contrast(refocused: ReconstructionPupil) -> float:
        return line_pair_contrast(refocused, line_width_um, axis, BARS)

    found = best_focus(pupil, contrast).pupil
    return contrast(found), found
