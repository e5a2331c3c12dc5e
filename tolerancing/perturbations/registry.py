"""Tables of a study file whose keys depend on what they ask for: a distribution's, a merit's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import DesignError

Entry = TypeVar("Entry")


def pick(registry: Mapping[str, Entry], table: Mapping[str, Any], key: str, source: str) -> Entry:
    """The registry's entry that a table asks for by name.

    Parameters
    ----------
    registry
        What there is, by name.
    table, key
        The table, and the key under which it gives the name.
    source
        What to call the table in messages.

    Raises
    ------
    DesignError
        If the key is missing, or names nothing that there is; the message lists what there is.
    """
    allowed = ", ".join(registry)
    if key not in table:
        raise DesignError(f"{source}: {key}: missing key; allowed values: {allowed}")
    name = table[key]
    if isinstance(name, str) and name in registry:
        return registry[name]
    hint = did_you_mean(str(name), registry)
    raise DesignError(f"{source}: {key} = {name!r}: there is no such {key}; allowed: {allowed}{hint}")
