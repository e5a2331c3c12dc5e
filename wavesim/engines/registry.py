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
    "eikonal": "wavesim.engines.eikonal.engine:EikonalEngine",
    "slices": "wavesim.engines.slices.engine:AnnularSlices",
    "wpm": "wavesim.engines.wpm.engine:WavePropagation",
    "thin-lens": "wavesim.engines.thin_lens:ThinLens",
    "no-lens": "wavesim.engines.no_lens:NoLens",
}
"""Location of each engine as `module:class`. A module is imported when its engine is first requested."""

ALIASES: dict[str, str] = dict.fromkeys(
    ("hierarchical", "two-level"), "wavesim.engines.eikonal.engine:HierarchicalTiles"
)
"""Further names that settings and files may use: the eikonal engine whose tiles form a hierarchy."""

AUTO = "auto"
"""Engine name that selects the cheapest engine within the error limit."""


def engine_class(name: str) -> type[Engine]:
    """Return the class of an engine.

    Parameters
    ----------
    name
        Name of an engine, or an alias (`ALIASES`).

    Raises
    ------
    InputError
        If there is no engine of this name.
    """
    locations = ENGINES | ALIASES
    if name not in locations:
        raise InputError(
            f"engine = {name!r}: there is no such engine; allowed: {', '.join((*locations, AUTO))}"
            f"{did_you_mean(name, locations)}"
        )
    module, _, attribute = locations[name].partition(":")
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
    return tuple(inspect.signature(engine_class(name).__init__).parameters)[2:]
