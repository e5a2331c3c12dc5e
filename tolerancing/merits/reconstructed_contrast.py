"""Contrast of bars after the whole imaging chain: perturbed lens, sensor, phase retrieval, nominal lens.

A plane wave illuminates an object in a round field stop. Its light propagates through the perturbed lens
(eikonal tiles) to the actual sensor planes. The recorded intensities are reconstructed as if the lens and all
positions were nominal. Unlike in :mod:`tolerancing.merits.line_pairs`, the phase behind the lens is not known
but retrieved from intensities. The merit is therefore insensitive to errors that hardly change intensities,
such as a small defocus of an amplitude object. It is sensitive to displaced light, such as the shadow of the
field stop behind a decentered lens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import Positive
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.bars import SIDE, BarImagingChain, Ground, Method, Point
from tolerancing.merits.base import Merit, orientation_text, refocus_text
from tolerancing.merits.context import Context
from tolerancing.merits.line_pairs import NOISE_STREAM
from tolerancing.merits.pupil import Axis, Orientation
from tolerancing.perturbations.batch import PerturbationBatch
from wavesim.scene.system_state import SystemState

if TYPE_CHECKING:
    from wavesim import Measurement


SET_SPACING = SIDE + 2
"""Distance between the centres of two sets, in line widths."""

ITERATIONS: dict[Method, int] = {"object": 30, "paper": 500}
"""Default of the largest number of iterations."""


class ReconstructedContrast(Merit):
    """Contrast of bars about the axis after perturbed lens, sensor, retrieval and nominal lens.

    The contrast is evaluated at the displaced position of the bars, so a lateral shift of the image is not a
    blur. Lines with reversed contrast count as displaced by one line width, which costs one bar.

    Attributes
    ----------
    line_width_um
        Width of a bar and of a gap. A set has five bars and is square.
    orientation
        Axis along which the bars repeat, or the worse of both, with two sets side by side.
    ground
        Polarity: opaque bars on a bright ground, or transparent bars on a dark ground.
    patch_mm
        Diameter of the field stop about the axis, and side of the reconstructed square.
    electrons
        Electrons in the brightest pixel of each frame, with shot noise, 2 electrons of read noise and
        rounding to counts; default: mean intensity of each pixel without noise.
    bits
        Bits of a count.
    method
        ``object``: finds the amplitude object that explains the recorded amplitudes. ``paper``: retrieves the
        field behind the lens by Appendix A and propagates it back.
    iterations
        Largest number of iterations; default: 30 for ``object``, 500 for ``paper``.
    refocus
        Whether the object is reconstructed in the plane in which rays of the perturbed lens show it in focus.
    """

    line_width_um: Positive
    orientation: Orientation = "worse"
    ground: Ground = "bright"
    patch_mm: Positive
    electrons: Annotated[float, Field(ge=10.0, le=1e9)] | None = None
    bits: Annotated[int, Field(ge=4, le=16)] = 12
    method: Method = "object"
    iterations: Annotated[int, Field(ge=1, le=10_000)] | None = None
    refocus: bool = True

    levels: ClassVar[tuple[str, ...]] = ("wave",)
    trials_per_chunk: ClassVar[int] = 1
    engine: ClassVar[str] = "eikonal, two planes, retrieval"

    @property
    def details(self) -> tuple[str, ...]:
        light = "no noise"
        if self.electrons is not None:
            light = f"{self.electrons:g} electrons in the brightest pixel, {self.bits} bits"
        return (
            f"lines of {self.line_width_um:g} µm",
            orientation_text(self.orientation),
            f"on a {self.ground} ground",
            light,
            f"method {self.method}",
            f"{self.iterations or ITERATIONS[self.method]} iterations at most",
            refocus_text(self.refocus),
            *super().details,
        )

    @model_validator(mode="after")
    def _bars_fit(self) -> ReconstructedContrast:
        sides = SIDE + (SET_SPACING if self.orientation == "worse" else 0), SIDE
        needed_mm = 1e-3 * self.line_width_um * math.hypot(*sides)
        if needed_mm > self.patch_mm:
            raise ValueError(
                f"patch_mm = {self.patch_mm:g}: bars of {self.line_width_um:g} µm need a field stop of "
                f"{needed_mm:.3g} mm or more"
            )
        return self

    def check(self, lens: Lens) -> None:
        """Check that the lens and its planes allow a reconstruction of the patch.

        Raises
        ------
        InputError
            If the patch is larger than the field, or the diversity of the planes is too small.
        """
        from wavesim.sensor.windows import LEAST_DIVERSITY, diversity
        from wavesim.targets.patch import object_patch

        patch = object_patch(lens, self.patch_mm, wavelength_um=self.wavelength_um)
        figure = diversity(lens, patch, lens.sensor.plane_distances_mm)
        if figure < LEAST_DIVERSITY:
            raise InputError(
                f"patch_mm = {self.patch_mm:g}: the diversity of the design's planes, dz w^2 / (lambda f^2), "
                f"is {figure:.3g}, and must be {LEAST_DIVERSITY:g} or more for phase retrieval: use a larger "
                "patch_mm, or a scaled-down twin of the lens (lensdesign scale)"
            )

    def is_compensated(self, compensators: bool) -> bool:
        return self.refocus

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        return self._scores(context, batch, self.refocus)

    def uncompensated(self, context: Context, batch: PerturbationBatch) -> Array:
        return self._scores(context, batch, False)

    def _scores(self, context: Context, batch: PerturbationBatch, refocused: bool) -> Array:
        if context.compensators:
            names = ", ".join(c.column for c in context.compensators)
            raise InputError(
                f"{self.label}: reconstructs with the nominal lens, and cannot adapt {names}: remove the "
                "compensators or the merit"
            )
        self.check(context.lens)
        key = (self.line_width_um, self.orientation, self.ground, self.patch_mm, self.wavelength_um)
        chain = context.cached(("chain", *key), lambda: self._chain(context.lens))
        systems = context.states(batch, self.wavelength_um)
        numbers = batch.trial_numbers or (0,) * len(batch)
        scores = []
        # Spawn key of the frames' noise, which differs from the keys 0 and 1 of line pairs at level ``wave``.
        frames_key = 2
        for system, number in zip(systems, numbers, strict=True):
            noise = np.random.SeedSequence(context.noise_seed, spawn_key=(number, NOISE_STREAM, frames_key))
            planes = chain.record(system, self.electrons, self.bits, noise)
            scores.append(self._score(chain, system, planes, refocused))
        return np.array(scores)

    def _chain(self, lens: Lens) -> BarImagingChain:
        from wavesim.targets.patch import object_patch

        width_um = self.line_width_um
        pitch_um = 1e3 * object_patch(lens, self.patch_mm, wavelength_um=self.wavelength_um).grid.pitch_mm
        patch = object_patch(
            lens,
            self.patch_mm,
            wavelength_um=self.wavelength_um,
            object_pitch_um=min(pitch_um, 0.5 * width_um),
        )
        offset = 0.5e-3 * SET_SPACING * width_um
        sets: tuple[tuple[Axis, Point], ...] = (("x", (-offset, 0.0)), ("y", (offset, 0.0)))
        if self.orientation != "worse":
            sets = ((self.orientation, (0.0, 0.0)),)
        return BarImagingChain(lens, patch, sets, width_um, self.ground)

    def _score(
        self, chain: BarImagingChain, system: SystemState, planes: Sequence[Measurement], refocused: bool
    ) -> float:
        """Return the contrast of the worse set of bars, reconstructed from one trial's planes."""
        from wavesim import refocus
        from wavesim.pupil import remove_shift

        registered = (refocus if refocused else remove_shift)(chain.sampler.pupil(system))
        found = chain.reconstruct(
            planes, registered.refocus_um, self.method, self.iterations or ITERATIONS[self.method]
        )
        return min(chain.contrasts(found, registered.shift_um))
