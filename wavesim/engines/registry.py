"""Engines by name.

A new engine is a new module and one line in `ENGINES`; what others ask of it, its class tells.
"""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import TYPE_CHECKING

from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from wavesim.scene.engine import Engine
    from wavesim.scene.scene import Scene

ENGINES: dict[str, str] = {
    "eikonal": "wavesim.engines.tiles.engine:EikonalTiles",
    "two-level": "wavesim.engines.whole_field.engine:WholeFieldEngine",
    "slices": "wavesim.engines.slices.engine:AnnularSlices",
    "wpm": "wavesim.engines.wpm.engine:WavePropagation",
    "thin-lens": "wavesim.engines.thin_lens:ThinLens",
    "no-lens": "wavesim.engines.no_lens:NoLens",
}
"""Name to `module:class`, imported where first asked for."""

AUTO = "auto"
"""Name under which the choice is left to predictions."""


def engine_class(name: str) -> type[Engine]:
    """The class of an engine.

    Raises
    ------
    InputError
        If there is no engine of this name.
    """
    if name not in ENGINES:
        raise InputError(
            f"engine = {name!r}: there is no such engine; allowed: {', '.join((*ENGINES, AUTO))}"
            f"{did_you_mean(name, ENGINES)}"
        )
    module, _, attribute = ENGINES[name].partition(":")
    found: type[Engine] = getattr(import_module(module), attribute)
    return found


def engine_on(engine: Engine, scene: Scene) -> Engine:
    """An engine of another scene with the same settings, so that it errs alike."""
    return engine_class(engine.name)(scene, **engine.settings())


def settings_of(name: str) -> tuple[str, ...]:
    """Names of an engine's settings.

    Raises
    ------
    InputError
        If there is no engine of this name.
    """
    return tuple(inspect.signature(engine_class(name)).parameters)[1:]
