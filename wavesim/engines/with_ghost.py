"""An engine's field with the lens's ghost, which is coherent with it."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

from lensdesign.errors import InputError
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.scene.engine import Cost, Engine, ErrorTerm, Tiled
from wavesim.scene.ghosts import ghost_of
from wavesim.scene.light import Light
from wavesim.scene.settings import SettingError

GHOST_ERROR = 0.05
"""That tiles may leave of the ghost's own field, which is a small part of the whole."""


class WithGhost(Engine):
    """Another engine's field, and on it that of light which both outer surfaces have reflected.

    The phase is that of rays: coatings may turn it, and a thickness that is off by 0.1 um turns it by more
    than half a wave.

    Parameters
    ----------
    straight : Engine
        Carries the light that goes straight through.
    share : float
        Of the light, that both reflections leave: the product of both reflectances.

    Raises
    ------
    InputError
        If the share is not from 0 to 1, or the engine works in parts.
    """

    name = "with-ghost"

    def __init__(self, straight: Engine, share: float) -> None:
        super().__init__(straight.scene)
        if not 0.0 <= share <= 1.0:
            raise InputError(f"ghost = {share!r}: must be a share of the light, from 0 to 1")
        if isinstance(straight, Tiled):
            raise SettingError(f"{{ghost}}: engine {straight.name} carries none; take eikonal, or no ghost")
        self.straight, self.share = straight, share

    @cached_property
    def ghost(self) -> EikonalTiles:
        """Carries the ghost, as if both surfaces reflected all of the light."""
        return EikonalTiles(ghost_of(self.scene), error=GHOST_ERROR)

    def _forward(self, values: Any) -> Any:
        return self.straight._forward(values) + math.sqrt(self.share) * self.ghost._forward(values)

    def _adjoint(self, values: Any) -> Any:
        return self.straight._adjoint(values) + math.sqrt(self.share) * self.ghost._adjoint(values)

    def cost(self) -> Cost:
        parts = self.straight.cost(), self.ghost.cost()
        return Cost(
            sum(part.seconds for part in parts),
            sum(part.setup_seconds for part in parts),
            sum(part.peak_bytes for part in parts),
            sum(part.peak_bytes_in_single for part in parts),
        )

    def edge_illumination(self, light: Light) -> float:
        return self.straight.edge_illumination(light)

    def neglected(self) -> tuple[ErrorTerm, ...]:
        return self.straight.neglected()

    def settings(self) -> dict[str, Any]:
        return {"engine": self.straight.name, **self.straight.settings(), "ghost": self.share}
