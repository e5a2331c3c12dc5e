"""Engines by name.

A new engine is a new module and one line in `ENGINES`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from typing import Any

from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError
from wavesim.scene.engine import Engine, Scene

ENGINES: dict[str, str] = {
    "eikonal": "wavesim.engines.tiles.engine:EikonalTiles",
    "two-level": "wavesim.engines.whole_field.engine:TwoLevelTiles",
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


def make_engine(name: str, scene: Scene, **settings: Any) -> Engine:
    """An engine for a scene.

    Parameters
    ----------
    name
        One of `ENGINES`, or "auto": the cheapest that holds, with the settings of
        :func:`wavesim.engines.choosing.choose`.
    scene
        What is to be carried where.
    **settings
        Of the engine; what is left out stays at the engine's own choice.

    Raises
    ------
    InputError
        If there is no such engine, or it does not know a setting or refuses its value.
    """
    maker: Callable[..., Engine] = engine_class(name) if name != AUTO else _chosen
    allowed = tuple(inspect.signature(maker).parameters)[1:]
    for setting in settings:
        if setting not in allowed:
            listed = f"allowed: {', '.join(allowed)}" if allowed else "it has none"
            raise InputError(
                f"engine {name}: {setting} = {settings[setting]!r}: there is no such setting; {listed}"
                f"{did_you_mean(setting, allowed)}"
            )
    return maker(scene, **settings)


def _chosen(scene: Scene, error: float = 0.1, memory_gb: float = 16.0, runs: int = 2) -> Engine:
    from wavesim.engines.choosing import chosen_engine

    return chosen_engine(scene, error=error, memory_bytes=1e9 * memory_gb, runs=runs)
