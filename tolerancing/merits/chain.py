"""Contrast of bars after the whole chain: perturbed lens, sensor, phase retrieval, nominal lens.

An object in a round field stop, lit by a plane wave, sends its light through the perturbed lens (eikonal
tiles) to the planes in which the sensor really stands. What its pixels record is reconstructed as if the lens
were the nominal one and all stood where it should. Unlike in :class:`tolerancing.merits.line_pairs`, phases
are not known behind the lens: they are found from intensities. That forgives errors which intensities hardly
tell, such as a little defocus of an amplitude object, and does not forgive light that falls beside its place,
such as the field stop's shadow behind a decentered lens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.section import Positive
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.bars import SIDE, Chain, Ground, Method, Point
from tolerancing.merits.base import Merit, orientation_text, refocus_text
from tolerancing.merits.context import Context
from tolerancing.merits.line_pairs import NOISE_STREAM
from tolerancing.merits.pupil import Axis, Orientation
from tolerancing.perturbations.batch import PerturbationBatch
from wavesim.scene.placement import Placement

if TYPE_CHECKING:
    from wavesim import Measurement


FRAMES = 2
"""Keeps the noise of frames apart from that which level ``wave`` of line pairs adds along x and y."""

APART = SIDE + 2
"""Between the middles of two sets, in line widths."""

ITERATIONS: dict[Method, int] = {"object": 30, "paper": 500}
"""Of a reconstruction, where the study does not say."""


class ReconstructedContrast(Merit):
    """Contrast of bars about the axis after perturbed lens, sensor, retrieval and nominal lens.

    Bars are judged where they show, so that an image beside its place is no blur. Lines that show reversed
    count as displaced by their width, at the cost of the bar that is then beside them.

    Attributes
    ----------
    line_width_um
        Width of a bar and of a gap; five bars, as long as they are wide together.
    orientation
        Axis along which the bars follow each other, or the worse of both: then two sets lie side by side.
    ground
        Opaque bars on a bright ground, or clear ones on a dark ground.
    patch_mm
        Diameter of the field stop about the axis, and side of the square that is reconstructed.
    electrons
        In the brightest pixel of each frame: shot noise, 2 electrons of read noise, and rounding to counts.
        Where left out, pixels tell the mean intensity on them exactly.
    bits
        Of a count.
    method
        ``object``: an amplitude object is sought whose light makes the recorded amplitudes. ``paper``:
        Appendix A finds the field behind the lens, which is carried back.
    iterations
        At most; 30 of ``object``, 500 of ``paper`` where left out.
    refocus
        Whether the object is sought in the plane in which the perturbed lens's rays say that it shows sharp.
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
            f"lines of {self.line_width_um:g} um",
            orientation_text(self.orientation),
            f"on a {self.ground} ground",
            light,
            f"method {self.method}",
            f"{self.iterations or ITERATIONS[self.method]} iterations at most",
            refocus_text(self.refocus),
            *super().details,
        )

    @model_validator(mode="after")
    def _room(self) -> ReconstructedContrast:
        sides = SIDE + (APART if self.orientation == "worse" else 0), SIDE
        needed_mm = 1e-3 * self.line_width_um * math.hypot(*sides)
        if needed_mm > self.patch_mm:
            raise ValueError(
                f"patch_mm = {self.patch_mm:g}: bars of {self.line_width_um:g} um need a field stop of "
                f"{needed_mm:.3g} mm or more"
            )
        return self

    def check(self, lens: Lens) -> None:
        """Refuse a patch that this lens and its planes cannot reconstruct.

        Raises
        ------
        InputError
            For a patch larger than the field, or planes that tell too little of the phase.
        """
        from wavesim.sensor.windows import LEAST_DIVERSITY, diversity
        from wavesim.targets.patch import object_patch

        patch = object_patch(lens, self.patch_mm, wavelength_um=self.wavelength_um)
        figure = diversity(lens, patch, lens.sensor.plane_distances_mm)
        if figure < LEAST_DIVERSITY:
            raise InputError(
                f"patch_mm = {self.patch_mm:g}: the diversity of the design's planes, dz w^2 / (lambda f^2), "
                f"is {figure:.3g}, and must be {LEAST_DIVERSITY:g} or more for their intensities to tell the "
                "phase: take a larger patch, or a scaled-down twin of the lens (lensdesign scale)"
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
            raise InputError(f"{self.label}: reconstructs with the nominal lens, and cannot adapt {names}")
        self.check(context.lens)
        key = (self.line_width_um, self.orientation, self.ground, self.patch_mm, self.wavelength_um)
        chain = context.kept(("chain", *key), lambda: self._chain(context.lens))
        systems = context.placements(batch, self.wavelength_um)
        numbers = batch.numbers or (0,) * len(batch)
        scores = []
        for system, number in zip(systems, numbers, strict=True):
            noise = np.random.SeedSequence(context.noise_seed, spawn_key=(number, NOISE_STREAM, FRAMES))
            planes = chain.recorded(system, self.electrons, self.bits, noise)
            scores.append(self._score(chain, system, planes, refocused))
        return np.array(scores)

    def _chain(self, lens: Lens) -> Chain:
        from wavesim.targets.patch import object_patch

        width_um = self.line_width_um
        pitch_um = 1e3 * object_patch(lens, self.patch_mm, wavelength_um=self.wavelength_um).grid.pitch_mm
        patch = object_patch(
            lens,
            self.patch_mm,
            wavelength_um=self.wavelength_um,
            object_pitch_um=min(pitch_um, 0.5 * width_um),
        )
        aside = 0.5e-3 * APART * width_um
        sets: tuple[tuple[Axis, Point], ...] = (("x", (-aside, 0.0)), ("y", (aside, 0.0)))
        if self.orientation != "worse":
            sets = ((self.orientation, (0.0, 0.0)),)
        return Chain(lens, patch, sets, width_um, self.ground)

    def _score(
        self, chain: Chain, system: Placement, planes: Sequence[Measurement], refocused: bool
    ) -> float:
        """Contrast of the worse set of bars in what is reconstructed from one trial's planes."""
        from wavesim import refocus
        from wavesim.pupil import remove_shift

        seen = (refocus if refocused else remove_shift)(chain.sampler.pupil(system))
        found = chain.reconstructed(
            planes, seen.refocus_um, self.method, self.iterations or ITERATIONS[self.method]
        )
        return min(chain.contrasts(found, seen.shift_um))
