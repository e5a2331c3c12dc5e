"""The loss that is expected of a reconstruction, from the linearised chain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

from lensdesign.common.arrays import Array
from lensdesign.common.section import Positive, tuples
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import check_field_point, points_text
from tolerancing.merits.compensators import ROUNDS, STEP_SHARE, Compensator
from tolerancing.merits.context import Context
from tolerancing.merits.pupil import PupilMerit
from tolerancing.perturbations.batch import PerturbationBatch

if TYPE_CHECKING:
    from wavesim.pupil import LinearisedChain

AZIMUTHS_DEG = (0.0, 90.0)
"""Of the meridians: along x and along y."""


class ReconstructionLoss(PupilMerit):
    """Correlation that an object-domain reconstruction is expected to lose: 0 is none, 1 is all.

    Random objects on two meridians at right angles, each through the linearised chain
    (:mod:`wavesim.pupil.linearised_chain`). What intensities cannot tell costs nothing; compensators of the
    study are those of a calibrated reconstruction, fitted to what intensities see.

    Attributes
    ----------
    patch_mm
        Diameter of the field stop about each field point.
    object
        ``amplitude`` for one that is real, or ``complex``.
    planes_mm
        Where the sensor records, from the exit vertex; the design's planes where left out.
    electrons
        In the brightest pixel of each plane.
    """

    patch_mm: Positive
    object: Literal["amplitude", "complex"] = "amplitude"
    planes_mm: tuple[Positive, ...] = ()
    electrons: Annotated[float, Field(ge=10.0, le=1e9)] = 1e4

    trials_per_chunk: ClassVar[int] = 4
    engine: ClassVar[str] = "linearised chain on meridians"

    _planes = field_validator("planes_mm", mode="before")(tuples)

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
        chains = context.kept(("meridians", *key), lambda: self.chains(context.lens, point))
        adapted: _Adapted | None = None
        if compensated and context.compensators:
            adapted = context.kept(("adapted", *key), lambda: _Adapted(context, chains, self.wavelength_um))
        scores = []
        for system in context.placements(batch, self.wavelength_um):
            waves = [chain.meridian.waves(system) for chain in chains]
            scores.append(expected_loss(chains, adapted.left(waves) if adapted else waves))
        return np.array(scores)

    def chains(self, lens: Lens, point: tuple[float, float]) -> list[LinearisedChain]:
        """Return the linearised chains of a nominal lens about an object point, one for each meridian."""
        from wavesim.pupil import LinearisedChain, Meridian

        wavelength = lens.wavelengths_um[0] if self.wavelength_um is None else self.wavelength_um
        return [
            LinearisedChain(
                Meridian(lens, point, self.patch_mm, azimuth, self.planes_mm, wavelength),
                self.object,
                self.electrons,
            )
            for azimuth in AZIMUTHS_DEG
        ]


class _Adapted:
    """The reconstruction's model, its compensators fitted to what intensities see of a perturbed lens.

    Parameters
    ----------
    context
        Whose compensators they are.
    chains
        On the meridians of one field point.
    wavelength_um
        Of the light; the design's first one if None.
    """

    def __init__(
        self, context: Context, chains: Sequence[LinearisedChain], wavelength_um: float | None
    ) -> None:
        self._context, self._chains, self._wavelength_um = context, chains, wavelength_um
        self._compensators: tuple[Compensator, ...] = context.compensators
        self._limits = np.array([c.limit for c in self._compensators])
        slopes = []
        for step in np.diag(STEP_SHARE * self._limits):
            ends = [self._visible(self._waves(sign * step)) for sign in (1.0, -1.0)]
            slopes.append((ends[0] - ends[1]) / (2.0 * STEP_SHARE))
        self._slopes = np.array(slopes)
        self._products = self._slopes @ self._slopes.T

    def left(self, waves: list[list[Array]]) -> list[list[Array]]:
        """Of a change of path, what the fitted model leaves."""
        from scipy.optimize import lsq_linear

        shares, rest = np.zeros(len(self._limits)), waves
        # Directions that do next to nothing are held where they are.
        floor = 1e-9 * np.trace(self._products) / len(shares) + np.finfo(float).tiny
        triangle = np.linalg.cholesky(self._products + floor * np.eye(len(shares)))
        for _ in range(ROUNDS):
            wanted = np.linalg.solve(triangle, self._slopes @ self._visible(rest))
            shares = shares + lsq_linear(triangle.T, wanted, (-1.0 - shares, 1.0 - shares), method="bvls").x
            model = self._waves(np.clip(shares, -1.0, 1.0) * self._limits)
            rest = [[a - b for a, b in zip(*pair, strict=True)] for pair in zip(waves, model, strict=True)]
        return rest

    def _visible(self, waves: list[list[Array]]) -> Array:
        return np.concatenate([c.visible(own) for c, own in zip(self._chains, waves, strict=True)])

    def _waves(self, values: Array) -> list[list[Array]]:
        batch = self._context.perturbed(self._compensators, values[None])
        (system,) = self._context.placements(batch, self._wavelength_um)
        return [chain.meridian.waves(system) for chain in self._chains]
