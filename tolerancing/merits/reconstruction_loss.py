"""Expected loss of correlation of a reconstruction, from a linearised model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import Positive
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import check_field_point, points_text
from tolerancing.merits.compensators import GAUSS_NEWTON_STEPS, STEP_FRACTION, Compensator, bounded_step
from tolerancing.merits.context import Context
from tolerancing.merits.pupil import PupilMerit
from tolerancing.perturbations.batch import PerturbationBatch

if TYPE_CHECKING:
    from wavesim.pupil import LinearisedReconstruction

AZIMUTHS_DEG = (0.0, 90.0)
"""Azimuths of the two meridians."""


class ReconstructionLoss(PupilMerit):
    """Correlation that an object-domain reconstruction is expected to lose: 0 is none, 1 is all.

    The loss is the mean over random objects on two perpendicular meridians. Each has a linearised
    reconstruction (:mod:`wavesim.pupil.linearised_reconstruction`). Path errors that do not change
    intensities cause no loss. The study's compensators are fitted to changes of intensity, as a calibration
    from frames would do.

    Attributes
    ----------
    patch_mm
        Diameter of the field stop about each field point.
    object
        ``amplitude`` for a real transmission, or ``complex``.
    planes_mm
        Distances of the sensor planes from the exit vertex; default: the planes of the design.
    electrons
        Electrons in the brightest pixel of each plane.
    """

    patch_mm: Positive
    object: Literal["amplitude", "complex"] = "amplitude"
    planes_mm: tuple[Positive, ...] = ()
    electrons: Annotated[float, Field(ge=10.0, le=1e9)] = 1e4

    trials_per_chunk: ClassVar[int] = 4
    engine: ClassVar[str] = "linearised chain on meridians"

    @property
    def details(self) -> tuple[str, ...]:
        planes = ", ".join(f"{z:g}" for z in self.planes_mm)
        return (
            f"{'an' if self.object == 'amplitude' else 'a'} {self.object} object",
            f"a field stop of {self.patch_mm:g} mm",
            *((f"planes at {planes} mm",) if planes else ()),
            f"{self.electrons:g} electrons in the brightest pixel",
            points_text(self.points),
            *super(PupilMerit, self).details,
        )

    def check(self, lens: Lens) -> None:
        for point in self.points:
            check_field_point(lens, point, "field_points_mm" if self.field_points_mm else "field_mm")
        if self.patch_mm > 1.02 * lens.object.field_diameter_mm:
            raise ValueError(
                f"patch_mm = {self.patch_mm:g}: wider than the field; allowed: up to "
                f"{lens.object.field_diameter_mm:g} mm"
            )

    def is_compensated(self, compensators: bool) -> bool:
        return compensators

    def scores_at(
        self, point: tuple[float, float], context: Context, batch: PerturbationBatch, compensated: bool
    ) -> Array:
        from wavesim.pupil import expected_loss

        key = (point, self.patch_mm, self.object, self.planes_mm, self.electrons, self.wavelength_um)
        reconstructions = context.cached(
            ("meridians", *key), lambda: self.reconstructions(context.lens, point)
        )
        model: _AdaptedModel | None = None
        if compensated and context.compensators:
            model = context.cached(
                ("adapted", *key), lambda: _AdaptedModel(context, reconstructions, self.wavelength_um)
            )
        scores = []
        systems = context.systems(batch, self.wavelength_um)
        for state, system in zip(context.states(batch, self.wavelength_um), systems, strict=True):
            waves = [one.meridian.waves(state, system) for one in reconstructions]
            scores.append(expected_loss(reconstructions, model.residual(waves) if model else waves))
        return np.array(scores)

    def reconstructions(self, lens: Lens, point: tuple[float, float]) -> list[LinearisedReconstruction]:
        """Return a linearised reconstruction about an object point for each meridian."""
        from wavesim.pupil import LinearisedReconstruction, Meridian

        wavelength = lens.wavelengths_um[0] if self.wavelength_um is None else self.wavelength_um
        return [
            LinearisedReconstruction(
                Meridian(lens, point, self.patch_mm, azimuth, self.planes_mm, wavelength),
                self.object,
                self.electrons,
            )
            for azimuth in AZIMUTHS_DEG
        ]


class _AdaptedModel:
    """The reconstruction's model, with compensators fitted to the visible path error of a perturbed lens."""

    def __init__(
        self,
        context: Context,
        reconstructions: Sequence[LinearisedReconstruction],
        wavelength_um: float | None,
    ) -> None:
        self._context, self._reconstructions, self._wavelength_um = context, reconstructions, wavelength_um
        self._compensators: tuple[Compensator, ...] = context.compensators
        self._limits = np.array([c.limit for c in self._compensators])
        slopes = []
        for step in np.diag(STEP_FRACTION * self._limits):
            ends = [self._visible(self._waves(sign * step)) for sign in (1.0, -1.0)]
            slopes.append((ends[0] - ends[1]) / (2.0 * STEP_FRACTION))
        self._slopes = np.array(slopes)
        self._hessian = self._slopes @ self._slopes.T

    def residual(self, waves: list[list[Array]]) -> list[list[Array]]:
        """Return the path error in waves that remains after the model is fitted."""
        fractions, residual = np.zeros(len(self._limits)), waves
        for _ in range(GAUSS_NEWTON_STEPS):
            gradient = self._slopes @ self._visible(residual)
            fractions = fractions + bounded_step(self._hessian, gradient, fractions)
            model = self._waves(np.clip(fractions, -1.0, 1.0) * self._limits)
            residual = [
                [a - b for a, b in zip(*pair, strict=True)] for pair in zip(waves, model, strict=True)
            ]
        return residual

    def _visible(self, waves: list[list[Array]]) -> Array:
        return np.concatenate(
            [one.visible(own) for one, own in zip(self._reconstructions, waves, strict=True)]
        )

    def _waves(self, values: Array) -> list[list[Array]]:
        batch = self._context.perturbed(self._compensators, values[None])
        (system,) = self._context.states(batch, self._wavelength_um)
        return [one.meridian.waves(system) for one in self._reconstructions]
