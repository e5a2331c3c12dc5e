"""The field of an engine together with the lens's ghost, which is coherent with it."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

from lensdesign.errors import InputError
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.scene.engine import Cost, Engine, ErrorTerm, Tiled
from wavesim.scene.ghosts import ghost_of
from wavesim.scene.scattered_light import Light
from wavesim.scene.settings import SettingError


class WithGhost(Engine):
    """Sum of another engine's field and the field of the light that both outer surfaces reflect.

    The phase of the ghost is that of its rays. It is uncertain in practice: coatings change it, and a
    thickness error of 0.1 um changes it by more than half a wave.

    Parameters
    ----------
    straight : Engine
        Engine of the light that no surface reflects.
    reflectance : float
        Product of the reflectances of both outer surfaces.

    Raises
    ------
    InputError
        If the reflectance is not from 0 to 1, or the engine works in tiles of a whole field.
    """

    name = "with-ghost"

    def __init__(self, straight: Engine, reflectance: float) -> None:
        super().__init__(straight.scene)
        if not 0.0 <= reflectance <= 1.0:
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
    def ghost(self) -> FlatTiles:
        """Engine of the ghost, with both reflectances set to 1."""
        # Allowed relative error of the ghost's own field, which is a small part of the whole field.
        allowed_error = 0.05
        return FlatTiles(ghost_of(self.scene), error=allowed_error)

    def _forward(self, values: Any) -> Any:
        return self.straight._forward(values) + math.sqrt(self.reflectance) * self.ghost._forward(values)

    def _adjoint(self, values: Any) -> Any:
        return self.straight._adjoint(values) + math.sqrt(self.reflectance) * self.ghost._adjoint(values)

    def cost(self) -> Cost:
        costs = self.straight.cost(), self.ghost.cost()
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
