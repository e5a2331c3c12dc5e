"""Registry of the engines by name.

A new engine is a new module and one line in `ENGINES`. Everything else about it belongs to its class.
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
    "eikonal": "wavesim.engines.eikonal.engine:EikonalTiles",
    "hierarchical": "wavesim.engines.eikonal.whole_field:WholeFieldEngine",
    "slices": "wavesim.engines.slices.engine:AnnularSlices",
    "wpm": "wavesim.engines.wpm.engine:WavePropagation",
    "thin-lens": "wavesim.engines.thin_lens:ThinLens",
    "no-lens": "wavesim.engines.no_lens:NoLens",
}
"""Location of each engine as `module:class`. A module is imported when its engine is first requested."""

ALIASES = {"two-level": "hierarchical"}
"""Former names of engines, which settings and files may still use."""

AUTO = "auto"
"""Engine name that selects the cheapest engine within the error limit."""


def engine_class(name: str) -> type[Engine]:
    """Return the class of an engine.

    Parameters
    ----------
    name
        Name of an engine, or one of its former names (`ALIASES`).

    Raises
    ------
    InputError
        If there is no engine of this name.
    """
    name = ALIASES.get(name, name)
    if name not in ENGINES:
        raise InputError(
            f"engine = {name!r}: there is no such engine; allowed: {', '.join((*ENGINES, AUTO))}"
            f"{did_you_mean(name, ENGINES)}"
        )
    module, _, attribute = ENGINES[name].partition(":")
    found: type[Engine] = getattr(import_module(module), attribute)
    return found


def engine_on(engine: Engine, scene: Scene) -> Engine:
    """Return an engine with the same settings, and so the same approximations, for another scene."""
    return engine_class(engine.name)(scene, **engine.settings())


def settings_of(name: str) -> tuple[str, ...]:
    """Return the names of an engine's settings.

    Raises
    ------
    InputError
        If there is no engine of this name.
    """
    return tuple(inspect.signature(engine_class(name)).parameters)[1:]
