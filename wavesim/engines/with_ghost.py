"""The field of an engine together with the lens's ghosts, which are coherent with it."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

from lensdesign.errors import InputError
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.scene.engine import Cost, Engine, ErrorTerm, Tiled
from wavesim.scene.ghosts import coated_ghosts, ghost_of
from wavesim.scene.polarization import is_vector
from wavesim.scene.scattered_light import Light
from wavesim.scene.settings import SettingError


class WithGhost(Engine):
    """Sum of another engine's field and the field of light that surfaces of the lens reflect twice.

    The phase of a ghost is that of its rays and coatings. It is uncertain in practice: a thickness error of
    0.1 um changes it by more than half a wave.

    Parameters
    ----------
    straight : Engine
        Engine of the light that no surface reflects.
    reflectance : float, optional
        Product of the reflectances of both outer surfaces, for a ghost between them alone. Default: all pairs
        of surfaces reflect according to their coatings.

    Raises
    ------
    InputError
        If the reflectance is not from 0 to 1, all coatings are ideal, or the engine works in tiles of a whole
        field or carries polarized light.
    """

    name = "with-ghost"

    def __init__(self, straight: Engine, reflectance: float | None = None) -> None:
        if is_vector(straight.scene.polarization):
            raise SettingError(
                "{polarization}, {ghost}: coherent ghosts are computed for scalar waves only; omit them, "
                "or use {polarization} scalar"
            )
        super().__init__(straight.scene)
        if reflectance is not None and not 0.0 <= reflectance <= 1.0:
            raise InputError(f"ghost = {reflectance!r}: must be a fraction of the light, from 0 to 1")
        if isinstance(straight, Tiled):
            raise SettingError(
                f"{{ghost}}: engine {straight.name} does not support a ghost; use engine eikonal with "
                "hierarchical = False, or no ghost"
            )
        self.straight, self.reflectance = straight, reflectance

    def at_wavelength(self, wavelength_um: float) -> Engine:
        return WithGhost(self.straight.at_wavelength(wavelength_um), self.reflectance)

    @cached_property
    def ghosts(self) -> tuple[FlatTiles, ...]:
        """Engines of the ghosts; with a given reflectance, one whose reflectances are 1."""
        # Allowed relative error of a ghost's own field, which is a small part of the whole field.
        allowed_error = 0.05
        scenes = coated_ghosts(self.scene) if self.reflectance is None else (ghost_of(self.scene),)
        return tuple(FlatTiles(scene, error=allowed_error) for scene in scenes)

    @property
    def _factor(self) -> float:
        return 1.0 if self.reflectance is None else math.sqrt(self.reflectance)

    def _forward(self, values: Any) -> Any:
        total = self.straight._forward(values)
        for ghost in self.ghosts:
            total = total + self._factor * ghost._forward(values)
        return total

    def _adjoint(self, values: Any) -> Any:
        total = self.straight._adjoint(values)
        for ghost in self.ghosts:
            total = total + self._factor * ghost._adjoint(values)
        return total

    def cost(self) -> Cost:
        costs = self.straight.cost(), *(ghost.cost() for ghost in self.ghosts)
        return Cost(
            sum(cost.seconds for cost in costs),
            sum(cost.setup_seconds for cost in costs),
            sum(cost.peak_bytes for cost in costs),
            sum(cost.peak_bytes_in_single for cost in costs),
        )

    def edge_illumination(self, light: Light) -> float:
        return self.straight.edge_illumination(light)

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        return self.straight.error_terms()

    def settings(self) -> dict[str, Any]:
        return {"engine": self.straight.name, **self.straight.settings(), "ghost": self.reflectance}
