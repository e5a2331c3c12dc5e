"""The packages and rooms that hand on public names."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType


def faces(package: str) -> list[ModuleType]:
    """A package, and those of its rooms that hand names on, commands aside."""
    top = importlib.import_module(package)
    names = [info.name for info in pkgutil.walk_packages(top.__path__, f"{package}.") if info.ispkg]
    rooms = [importlib.import_module(name) for name in names if not name.endswith(".cli")]
    return [top, *(room for room in rooms if getattr(room, "__all__", None))]
