"""Panes: functions of a workbench or a lens that can be used alone, also in a notebook."""

import lazy_loader

# Public names are listed in __init__.pyi, and imported where they are first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
